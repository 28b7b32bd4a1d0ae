//! Matching and VLAD compared with NumPy: `research/oracles/matching.py` wrote `data/matching_oracle.json`.

use serde::Deserialize;
use veiloc_descriptor::{
    DescriptorKind, Descriptors, GlobalDescriptor, MatchOptions, Vocabulary, match_descriptors, two_nearest,
};

#[derive(Deserialize)]
struct Fixture {
    query: String,
    database: String,
    nearest: Vec<u32>,
    distance: Vec<u32>,
    second: Vec<u32>,
    mutual: Vec<(u32, u32)>,
    words: String,
    vlad_of_query: Vec<f64>,
    vlad_of_database: Vec<f64>,
    vlad_cosine: f64,
}

fn fixture() -> Fixture {
    serde_json::from_str(include_str!("../data/matching_oracle.json")).expect("the script wrote it")
}

fn descriptors(hex: &str) -> Descriptors {
    let bytes = (0..hex.len())
        .step_by(2)
        .map(|i| u8::from_str_radix(&hex[i..i + 2], 16).expect("hex digits"))
        .collect();
    Descriptors::new(DescriptorKind::ROOT_SIFT, bytes).expect("whole rows")
}

#[test]
fn nearest_and_second_agree_with_numpy() {
    let fixture = fixture();
    let (query, database) = (descriptors(&fixture.query), descriptors(&fixture.database));
    let found = two_nearest(query.view(), database.view());
    assert_eq!((found.len(), database.len()), (60, 80));
    for (i, two) in found.into_iter().enumerate() {
        let two = two.unwrap();
        let expected = (fixture.nearest[i], fixture.distance[i], Some(fixture.second[i]));
        assert_eq!((two.nearest.index, two.nearest.distance, two.second), expected, "query {i}");
    }
}

#[test]
fn mutual_matches_agree_with_numpy() {
    let fixture = fixture();
    let (query, database) = (descriptors(&fixture.query), descriptors(&fixture.database));
    let found = match_descriptors(query.view(), database.view(), &MatchOptions::default());
    let pairs: Vec<_> = found.iter().map(|m| (m.query, m.database)).collect();
    assert_eq!(pairs, fixture.mutual);
    for m in found {
        let (distance, second) = (fixture.distance[m.query as usize], fixture.second[m.query as usize]);
        assert!((m.distance - (distance as f32).sqrt()).abs() <= 1e-3 * m.distance.max(1.0));
        let ratio = if second == 0 { 1.0 } else { (distance as f32 / second as f32).sqrt() };
        assert!((m.ratio - ratio).abs() <= 1e-5, "ratio {} instead of {ratio}", m.ratio);
    }
}

#[test]
fn vlad_agrees_with_numpy() {
    let fixture = fixture();
    let vocabulary = Vocabulary::new(descriptors(&fixture.words)).unwrap();
    let of_query = vocabulary.aggregate(descriptors(&fixture.query).view());
    let of_database = vocabulary.aggregate(descriptors(&fixture.database).view());
    check_vlad(&of_query, &fixture.vlad_of_query);
    check_vlad(&of_database, &fixture.vlad_of_database);
    let cosine = f64::from(of_query.similarity(of_database.as_codes()));
    assert!((cosine - fixture.vlad_cosine).abs() < 0.002, "{cosine} instead of {}", fixture.vlad_cosine);
}

/// Codes are the exact vector times one factor, rounded: 127 times the root of the number of words in use.
fn check_vlad(global: &GlobalDescriptor, exact: &[f64]) {
    let used = exact.chunks(128).filter(|block| block.iter().any(|&v| v != 0.0)).count();
    assert_eq!((used, global.len()), (5, exact.len()));
    let factor = 127.0 * (used as f64).sqrt();
    for (i, (&code, &v)) in global.as_codes().iter().zip(exact).enumerate() {
        let error = (f64::from(code) - v * factor).abs();
        assert!(error < 0.5001, "code {i} is {code}, exact {}", v * factor);
    }
}
