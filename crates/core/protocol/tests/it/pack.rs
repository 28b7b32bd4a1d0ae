//! Packs: round trips, damage, and what a device must not accept.

use super::common;

use proptest::prelude::*;
use veiloc_descriptor::{DescriptorKind, Descriptors, PointImage as _};
use veiloc_protocol::{Pack, QueryError};

#[test]
fn packs_round_trip() {
    let pack = common::pack();
    let bytes = pack.encode();
    let read = Pack::decode(&bytes).expect("a pack");
    assert_eq!(read, pack);
    assert_eq!(read.encode(), bytes);
    assert_eq!((read.image_count(), read.row_count(), read.point_count()), (3, 28, 20));
    let image = read.image(1);
    assert_eq!((image.points().len(), image.point_of(3)), (12, Some(11)));
    assert_eq!(image.descriptors().row(0), read.descriptors().row(read.rows_of(1).start));
    assert_eq!(format!("{read:?}"), format!("Pack({}, 20 points, 3 images)", read.id()));
}

#[test]
fn every_damaged_byte_is_noticed() {
    let bytes = common::pack().encode();
    for at in 0..bytes.len() {
        let mut changed = bytes.clone();
        changed[at] ^= 1 << (at % 8);
        assert!(Pack::decode(&changed).is_err(), "byte {at}");
        assert!(Pack::decode(&bytes[..at]).is_err(), "cut after {at}");
    }
    let longer = [bytes.as_slice(), &[0]].concat();
    assert!(Pack::decode(&longer).is_err());
    let newer = [&[0x0d, 9, 0, 0, 0], &bytes[5..]].concat();
    assert!(matches!(Pack::decode(&newer), Err(QueryError::Version { what: "pack", found: 9, .. })));
}

#[test]
fn parts_that_do_not_fit_are_refused() {
    let profile = common::compact_profile();
    let kind = profile.descriptor_kind();
    let rows = |count: usize| Descriptors::new(kind, vec![120; count * kind.dim()]).expect("whole rows");
    let other = Descriptors::new(DescriptorKind::ROOT_SIFT, vec![9; 128]).expect("a row");
    for (what, points, images) in [
        ("rows of a pack", 0, vec![]),
        ("points of an image", 1, vec![(vec![0], rows(1)), (vec![], rows(0))]),
        ("points of an image", 2, vec![(vec![1, 0], rows(2))]),
        ("point of a row", 1, vec![(vec![0, 1], rows(2))]),
        ("points", 3, vec![(vec![0, 2], rows(2))]),
        ("descriptors of an image", 1, vec![(vec![0], rows(2))]),
        ("descriptors of an image", 1, vec![(vec![0], other)]),
        ("points of a pack", u32::MAX, vec![(vec![0], rows(1))]),
    ] {
        let refused = Pack::new(profile.clone(), points, images);
        assert!(
            matches!(&refused, Err(QueryError::Mismatch { what: w, .. }) if *w == what),
            "{what}: {refused:?}"
        );
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_bytes_are_refused_or_round_trip(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        if let Ok(pack) = Pack::decode(&bytes) {
            prop_assert_eq!(pack.encode(), bytes);
        }
    }

    /// A hostile operator can compute the checksum: the other checks hold without it.
    #[test]
    fn changed_packs_with_a_right_checksum_never_panic(at in 0_usize..1200, value: u8) {
        let mut bytes = common::pack().encode();
        let end = bytes.len() - 18;
        let at = at % end;
        bytes[at] = value;
        let checksum = <sha2::Sha256 as sha2::Digest>::digest(&bytes[..end]);
        let place = bytes.len() - 16;
        bytes[place..].copy_from_slice(&checksum[..16]);
        if let Ok(pack) = Pack::decode(&bytes) {
            prop_assert_eq!(pack.encode(), bytes);
            for image in 0..pack.image_count() {
                prop_assert!(pack.image(image).points().iter().all(|point| *point < pack.point_count()));
            }
        }
    }
}
