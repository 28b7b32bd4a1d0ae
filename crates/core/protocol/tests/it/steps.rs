//! Progressive queries: every step is a prefix of one sealed query, and reveals nothing beyond the whole query.

use super::common;

use common::{own_profile, profile, profiles, query_with};
use veiloc_protocol::{AngleBits, Observations, Profile, QueryError, Scheme, SealedQuery, SizeClass};

const SCHEMES: [&str; 4] = ["points", "random-lines", "coordinate-permutation", "dcl"];

fn query(profile: &Profile, scheme: &str, rows: usize) -> SealedQuery {
    query_with(profile, scheme.parse().expect("a scheme"), AngleBits::default(), rows, 5)
}

/// Whether the rows of `first` are the first rows of `all`.
fn is_prefix(all: &Observations, first: &Observations) -> bool {
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

/// L7: an image must not get second lines through its keypoints; a step that was sealed again would have them.
#[test]
fn l7_steps_are_prefixes_of_one_sealed_query() {
    for scheme in SCHEMES {
        let scheme_of: Scheme = scheme.parse().expect("a scheme");
        for profile in profiles() {
            let whole = query(&profile, scheme, 2048);
            let sizes: Vec<usize> = whole.step_sizes().map(SizeClass::rows).collect();
            assert_eq!(sizes, [256, 512, 1024, 2048]);
            for class in whole.step_sizes() {
                let step = whole.first_rows(class, &profile).expect("it has as many");
                assert!(is_prefix(&whole.observations(), &step.observations()), "{scheme}: {}", step.len());
                let bytes = whole.descriptors().expect("rows").rows(0..class.rows()).to_owned();
                assert!(step.descriptors().expect("rows").to_owned() == bytes, "{scheme}");
                // To the server it is an ordinary query: strict decoding, its own map, the length of its class.
                assert!(SealedQuery::decode(&step.encode()).expect("well formed") == step);
                profile.check(&step).expect("of this profile");
                let alike = query(&profile, scheme, class.rows()).encode().len();
                assert_eq!(step.encode().len(), alike, "{scheme}: a length of its own");
                // The leak: a second sealing of the same image has other rows.
                let resealed = query_with(&profile, scheme_of, AngleBits::default(), class.rows(), 6);
                assert!(
                    !is_prefix(&whole.observations(), &resealed.observations()),
                    "the measure does not see the leak"
                );
            }
            let last = whole.first_rows(SizeClass::Rows2048, &profile).expect("all");
            assert!(last == whole, "{scheme}: the last step is the query");
        }
    }
}

/// A global descriptor of all rows would reveal information about rows that are not sent.
#[test]
fn global_descriptor_depends_only_on_sent_rows() {
    let profile = profile();
    let whole = query(&profile, "dcl", 1024);
    let step = whole.first_rows(SizeClass::Rows256, &profile).expect("it has as many");
    let of_rows = profile.global_model().of_rows(step.descriptors().expect("rows")).expect("a vocabulary");
    assert!(step.global() == Some(&of_rows));
    assert!(Some(&of_rows) != whole.global(), "the two differ, so a leak would be visible");
    // A global descriptor of the image does not depend on rows.
    let own = own_profile();
    let image = query(&own, "dcl", 1024);
    assert!(image.first_rows(SizeClass::Rows256, &own).expect("as many").global() == image.global());
}

#[test]
fn invalid_steps_are_rejected() {
    let whole = query(&profile(), "dcl", 512);
    let refused = whole.first_rows(SizeClass::Rows1024, &profile()).expect_err("too few");
    assert!(matches!(refused, QueryError::Mismatch { what: "rows", .. }), "{refused}");
    let refused = whole.first_rows(SizeClass::Rows256, &own_profile()).expect_err("another profile");
    assert!(matches!(refused, QueryError::WrongProfile { .. }), "{refused}");
}
