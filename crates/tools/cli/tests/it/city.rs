//! `veiloc synth city` and `eval retrieval`: rooms in one world, and retrieval among synthetic descriptors.

use super::common;

use common::scene;

#[test]
fn rooms_of_a_city_are_localized() {
    let scene = scene();
    scene
        .run("synth city --out city --rooms 2 --map-views 10 --query-views 1 --width 320 --seed 3")
        .succeeded();
    let lines = |file: &str| String::from_utf8(scene.read(file)).expect("text").lines().count();
    assert_eq!((lines("city/map.txt"), lines("city/query.txt")), (20, 2));
    let found = scene
        .run(
            "eval scene --posed city/posed --images city/images --map-list city/map.txt --query-list city/query.txt \
             --schemes points --json",
        )
        .succeeded()
        .json();
    assert_eq!(found["map"]["images"], 20, "{found}");
    assert_eq!(found["queries"].as_array().map(Vec::len), Some(2), "{found}");
    // Points of one room are not searched in the next: its poses are in the city's axes.
    let right = found["queries"].as_array().expect("queries").iter();
    let right = right.filter(|q| q["translation_error"].as_f64().is_some_and(|e| e < 0.25)).count();
    assert!(right >= 1, "{found}");

    let refused = scene.run("synth city --out city --rooms 1");
    assert!(refused.code == Some(1) && refused.stderr.contains("the folder is not empty"), "{refused}");
    let refused = scene.run("synth city --out none --rooms 1 --differing 1.5");
    assert!(refused.code == Some(1) && refused.stderr.contains("from 0 to 1"), "{refused}");
    assert!(!scene.path("none").exists());
}

#[test]
fn index_matches_exhaustive_search() {
    let scene = scene();
    let found = scene
        .run(
            "eval retrieval --map place.vmap --images images --query-list queries.txt --sizes 8,5000 --retrieve 5 --json",
        )
        .succeeded()
        .json();
    let rows = found["rows"].as_array().expect("rows");
    let of = |images: u64, search: &str| {
        let row = rows.iter().find(|r| r["images"] == images && r["search"] == search);
        row.unwrap_or_else(|| panic!("{images} {search}: {found}"))
    };
    assert_eq!(rows.len(), 4);
    for images in [8, 5000] {
        assert_eq!(of(images, "all")["recall"], 1.0, "{found}");
        assert!(of(images, "index")["recall"].as_f64().is_some_and(|recall| recall > 0.9), "{found}");
    }
    assert_eq!(of(8, "index")["recall"], 1.0, "of so few all are compared: {found}");
    assert_eq!((&of(8, "all")["real"], &of(8, "all")["map_share"]), (&8.into(), &1.0.into()), "{found}");
    let refused = scene.run("eval retrieval --map place.vmap --images images --sizes 0");
    assert!(refused.code == Some(1) && refused.stderr.contains("no images to search"), "{refused}");
}
