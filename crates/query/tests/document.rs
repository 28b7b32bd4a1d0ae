//! `docs/wire-format.md` states how long messages are; here it is held to it.

mod common;

use veiloc_descriptor::{DescriptorKind, Descriptors, Vocabulary};
use veiloc_query::{
    AngleBits, CanonicalCamera, Hints, LayoutTurn, Profile, QueryParts, Rows, Scheme, SealedQuery, SizeClass,
};

/// Length of a sealed query for a vocabulary of 64 words, by making one.
fn length(scheme: Scheme, class: SizeClass) -> usize {
    let small = common::query_with(&common::profile_v2(), scheme, AngleBits::default(), class.rows(), 1);
    // The messages of the tests have a global descriptor of 4 words: 60 words are missing, and the prefix that tells
    // the length of the field has two bytes for 512 bytes as for 8192.
    small.encode().len() + 60 * 128
}

#[test]
fn lengths_are_as_documented() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/wire-format.md");
    let document = std::fs::read_to_string(path).expect("the document is there");
    for scheme in Scheme::ALL {
        let cells: Vec<String> =
            SizeClass::ALL.into_iter().map(|class| length(scheme, class).to_string()).collect();
        let line = format!("| `{}` | {} |", scheme.name(), cells.join(" | "));
        assert!(document.contains(&line), "docs/wire-format.md should say\n{line}");
    }
}

/// One real message with 64 words, so that the sum above is known to be right.
#[test]
fn the_sum_of_the_lengths_is_right() {
    let words = Descriptors::new(DescriptorKind::ROOT_SIFT, vec![9; 64 * 128]).expect("whole rows");
    let profile = Profile::vlad(Vocabulary::new(words).expect("64 words"));
    let camera = CanonicalCamera::from_codes(36, 20, 15).expect("allowed");
    let row = veiloc_query::PositionRow::new(0.0, 0.0).expect("the centre");
    let descriptors = Descriptors::new(DescriptorKind::ROOT_SIFT, vec![1; 256 * 128]).expect("whole rows");
    let parts = QueryParts {
        camera,
        scheme: Scheme::Points,
        angle_bits: AngleBits::default(),
        rows: Rows::Points(vec![row; 256]),
        descriptors,
        image_global: None,
        hints: Hints::default(),
        turn: LayoutTurn::default(),
    };
    let query = SealedQuery::new(&profile, parts).expect("parts fit");
    assert_eq!(query.encode().len(), length(Scheme::Points, SizeClass::Rows256));
    assert_eq!(profile.encode().len(), 7 * 5 + (2 + 4) + (2 + 4) + 3 + 64 * 128);
}
