//! `veiloc synth city`: rooms in one world.

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
