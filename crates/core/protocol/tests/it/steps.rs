//! Queries in steps: every step is the beginning of one seal, and says nothing that the whole query does not.

use super::common;

use common::{own_profile, profile, profiles, query_with};
use veiloc_protocol::{AngleBits, Observations, Profile, QueryError, Scheme, SealedQuery, SizeClass};

const SCHEMES: [&str; 4] = ["points", "random-lines", "coordinate-permutation", "dcl"];

fn query(profile: &Profile, scheme: &str, rows: usize) -> SealedQuery {
    query_with(profile, scheme.parse().expect("a scheme"), AngleBits::default(), rows, 5)
}

/// Whether the rows told by `first` are the first ones told by `all`.
fn begins(all: &Observations, first: &Observations) -> bool {
    match (all, first) {
        (Observations::Points(all), Observations::Points(first)) => all.starts_with(first),
        (Observations::Lines(all), Observations::Lines(first)) => all.starts_with(first),
        (Observations::EitherLine(all), Observations::EitherLine(first)) => all.starts_with(first),
        (Observations::Anchored { lines: all, .. }, Observations::Anchored { lines: first, .. }) => {
            all.starts_with(first)
        }
        _ => false,
    }
}

/// L7: second lines through its keypoints are what an image must not have; a step that was sealed anew would have them.
#[test]
fn l7_steps_are_beginnings_of_one_seal() {
    for scheme in SCHEMES {
        let scheme_of: Scheme = scheme.parse().expect("a scheme");
        for profile in profiles() {
            let whole = query(&profile, scheme, 2048);
            let sizes: Vec<usize> = whole.step_sizes().map(SizeClass::rows).collect();
            assert_eq!(sizes, [256, 512, 1024, 2048]);
            for class in whole.step_sizes() {
                let step = whole.first_rows(class, &profile).expect("it has as many");
                assert!(begins(&whole.observations(), &step.observations()), "{scheme}: {}", step.len());
                let bytes = whole.descriptors().rows(0..class.rows()).to_owned();
                assert!(step.descriptors().to_owned() == bytes, "{scheme}");
                // To the server it is a query like any other: strict reading, its own map, the length of its class.
                assert!(SealedQuery::decode(&step.encode()).expect("well formed") == step);
                profile.check(&step).expect("of this profile");
                let alike = query(&profile, scheme, class.rows()).encode().len();
                assert_eq!(step.encode().len(), alike, "{scheme}: a length of its own");
                // The leak: another seal of the same image has other rows.
                let anew = query_with(&profile, scheme_of, AngleBits::default(), class.rows(), 6);
                assert!(!begins(&whole.observations(), &anew.observations()), "the measure does not see it");
            }
            let last = whole.first_rows(SizeClass::Rows2048, &profile).expect("all");
            assert!(last == whole, "{scheme}: the last step is the query");
        }
    }
}

/// The global descriptor of all rows would tell of those that are not sent.
#[test]
fn the_global_descriptor_knows_the_sent_rows_alone() {
    let profile = profile();
    let whole = query(&profile, "dcl", 1024);
    let step = whole.first_rows(SizeClass::Rows256, &profile).expect("it has as many");
    let of_rows = profile.global_model().of_rows(step.descriptors()).expect("a vocabulary");
    assert!(*step.global() == of_rows);
    assert!(of_rows != *whole.global(), "the leak would be seen");
    // One that is made of the image has no rows to be made of.
    let own = own_profile();
    let image = query(&own, "dcl", 1024);
    assert!(image.first_rows(SizeClass::Rows256, &own).expect("as many").global() == image.global());
}

#[test]
fn what_is_no_step_is_refused() {
    let whole = query(&profile(), "dcl", 512);
    let refused = whole.first_rows(SizeClass::Rows1024, &profile()).expect_err("too few");
    assert!(matches!(refused, QueryError::Mismatch { what: "rows", .. }), "{refused}");
    let refused = whole.first_rows(SizeClass::Rows256, &own_profile()).expect_err("another profile");
    assert!(matches!(refused, QueryError::WrongProfile { .. }), "{refused}");
}
