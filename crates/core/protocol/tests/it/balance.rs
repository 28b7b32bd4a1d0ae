//! The check that a device makes before it sends.

use veiloc_descriptor::{DescriptorKind, Descriptors, Vocabulary};
use veiloc_geometry::Anchor;
use veiloc_protocol::{
    AnchoredRow, AngleBits, CanonicalCamera, Hints, LayoutTurn, LineRow, MIN_PER_SIDE, Profile, QueryParts,
    Rows, SealedQuery, SentContent, UnbalancedAnchors,
};

fn query(scheme: &str, rows: Rows) -> SealedQuery {
    let kind = DescriptorKind::ROOT_SIFT;
    let words = Descriptors::new(kind, vec![7; 128]).and_then(Vocabulary::new).expect("one word");
    let camera = CanonicalCamera::from_codes(36, 20, 15).expect("allowed");
    let descriptors = Descriptors::new(kind, vec![3; 128 * rows.len()]).expect("whole rows");
    let (scheme, angle_bits) = (scheme.parse().expect("a scheme"), AngleBits::default());
    let parts = QueryParts {
        camera,
        scheme,
        angle_bits,
        rows,
        content: SentContent::Described { descriptors, image_global: None },
        hints: Hints::default(),
        turn: LayoutTurn::default(),
    };
    SealedQuery::new(&Profile::vlad(words), parts).expect("parts fit")
}

/// A query with `second` rows of the second anchor, the others of the first.
fn dcl(second: usize) -> SealedQuery {
    let bits = AngleBits::default();
    let row = |i| AnchoredRow::new(bits, if i < second { Anchor::SECOND } else { Anchor::FIRST }, 1.0);
    query("dcl", Rows::Dcl((0..256).map(row).collect()))
}

#[test]
fn rows_per_side_are_counted() {
    for second in [0, 1, MIN_PER_SIDE - 1, MIN_PER_SIDE, 128, 256 - MIN_PER_SIDE, 256 - MIN_PER_SIDE + 1, 256]
    {
        let query = dcl(second);
        assert_eq!(query.sides(), Some(vec![256 - second, second]));
        let few = second.min(256 - second);
        let expected = if few < MIN_PER_SIDE { Err(UnbalancedAnchors { few, all: 256 }) } else { Ok(()) };
        assert_eq!(query.check_sides(), expected, "{second}");
    }
    let error = dcl(3).check_sides().expect_err("unbalanced").to_string();
    assert!(error.contains("3 of 256") && error.contains("turn the camera"), "{error}");
}

#[test]
fn schemes_without_anchors_have_no_sides() {
    let bits = AngleBits::default();
    let row = LineRow::through(bits, 5, 10.0, 20.0).expect("inside");
    let query = query("random-lines", Rows::RandomLines(vec![row; 256]));
    assert_eq!((query.sides(), query.check_sides()), (None, Ok(())));
}
