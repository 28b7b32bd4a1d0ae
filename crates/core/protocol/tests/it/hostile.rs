//! Bytes from negatives: refused with a reason, or read and written again unchanged. Never a panic.

use super::common;

use proptest::prelude::*;
use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_protocol::{
    AnchoredRow, AngleBits, AngleForm, CanonicalCamera, CoarseGravity, FocalKnowledge, Hints, LayoutTurn,
    Profile, QueryError, QueryParts, Rows, Scheme, SealedQuery, SizeClass, WireVersion,
};

fn sealed(scheme: Scheme) -> Vec<u8> {
    common::query(scheme, AngleBits::default(), 256, 3).encode()
}

/// The same in version 1, in version 2, in version 2 with descriptors of another kind, both in version 3, and for dcl two of
/// version 4: stripes, and a later frame of a session.
fn sealed_in_all(scheme: Scheme) -> Vec<Vec<u8>> {
    let bits = AngleBits::default();
    let [v1, sift, own, _] =
        common::profiles(scheme, bits).map(|p| common::query_with(&p, scheme, bits, 256, 3));
    let older = |query: &SealedQuery| common::in_version_2(query.clone());
    let mut all = vec![v1.encode(), older(&sift).encode(), older(&own).encode(), sift.encode(), own.encode()];
    if matches!(scheme, Scheme::Dcl(_)) {
        all.extend(version_4().map(|query| query.encode()));
    }
    all
}

fn version_4() -> [SealedQuery; 2] {
    let profile = common::profile_v2();
    let stripes = "dcl:axis=67,sectors=21,anchors=-0.12/-0.49+1.5/0+@30".parse().expect("a layout");
    let turn = LayoutTurn::new(&Rotation3::from_scaled_axis(Vector3::new(0.1, -0.4, 0.0))).expect("finite");
    let paper = "dcl:paper".parse().expect("a layout");
    [(stripes, LayoutTurn::default()), (paper, turn)]
        .map(|(scheme, turn)| common::query_turned(turn, &profile, scheme, 3))
}

/// Layouts and turns are read as written; numbers that no layout has are named, and what version 3 can say is not said in
/// version 4.
#[test]
fn layouts_of_version_4() {
    let [stripes, session] = version_4();
    for query in [&stripes, &session] {
        let read = SealedQuery::decode(&query.encode()).expect("own bytes");
        assert_eq!((&read, read.version(), read.turn()), (query, WireVersion::V4, query.turn()));
        assert_eq!(read.observations(), query.observations());
        assert!(query.clone().in_version_2().is_err());
        assert!(!format!("{read:?} {:?}", read.turn()).contains('.'), "L8");
    }
    // The message ends with the layout (2 + 1 + 26 bytes behind gravity) and three turns of 2 + 4 bytes.
    let (bytes, layout) = (stripes.encode(), stripes.encode().len() - 18 - 26);
    let with = |at: usize, value: u8| {
        let mut bytes = bytes.clone();
        bytes[at] = value;
        SealedQuery::decode(&bytes)
    };
    for (at, value) in [(layout, 1), (layout, 5), (layout + 1, 2), (layout + 20, 20), (layout + 21, 100)] {
        assert_eq!(with(at, value), Err(QueryError::SectorLayout), "{at} {value}");
    }
    // An unused anchor that is not zero.
    assert!(matches!(with(layout + 14, 1), Err(QueryError::NotCanonical { .. })));
    assert!(matches!(with(bytes.len() - 1, 0x7F), Err(QueryError::Field { field: "turn", .. })));
    // Two halves that are not turned belong into version 3.
    let mut plain = session.encode();
    let end = plain.len();
    for at in [end - 16, end - 10, end - 4] {
        plain[at..at + 4].fill(0);
    }
    assert!(matches!(SealedQuery::decode(&plain), Err(QueryError::NotCanonical { .. })));
    // A row of an anchor that this layout of three has not.
    let profile = common::profile_v2();
    let mut found = 0;
    for at in 0..stripes.encode().len() {
        found += usize::from(matches!(with(at, 0xFF), Err(QueryError::Row { .. })));
    }
    assert!(found > 100, "{found}");
    // What has no dcl has no version 4, and version 1 no such layout.
    let wish = common::profile(Scheme::default(), AngleBits::default());
    for query in [&stripes, &session] {
        let refused = SealedQuery::version_for(&wish, query.scheme(), query.turn());
        assert!(matches!(refused, Err(QueryError::Unsayable { version: 1, .. })));
        assert_eq!(SealedQuery::version_for(&profile, query.scheme(), query.turn()), Ok(WireVersion::V4));
    }
}

#[test]
fn what_is_written_is_read() {
    for scheme in Scheme::ALL {
        for bits in (AngleBits::MIN..=AngleBits::MAX).map(|b| AngleBits::new(b).expect("allowed")) {
            for profile in common::profiles(scheme, bits) {
                let query = common::query_with(&profile, scheme, bits, 256, u64::from(bits.get()));
                let read = SealedQuery::decode(&query.encode()).expect("own bytes");
                assert_eq!(read, query);
                assert_eq!(read.observations(), query.observations());
                let is_first = profile.version() == WireVersion::V1;
                let version = if is_first { WireVersion::V1 } else { WireVersion::V3 };
                assert_eq!((read.len(), read.version()), (256, version));
                profile.check(&read).expect("sealed with it");
            }
        }
        for profile in common::profiles(scheme, AngleBits::default()) {
            let read = Profile::decode(&profile.encode()).expect("own bytes");
            assert_eq!((read.id(), &read), (profile.id(), &profile));
        }
    }
}

/// L5: the number of bytes follows from version, scheme, angle bits, class, descriptor kind and global model.
#[test]
fn all_messages_of_a_class_are_equally_long() {
    let bits = AngleBits::default();
    for scheme in Scheme::ALL {
        for profile in common::profiles(scheme, bits) {
            for class in SizeClass::ALL {
                let length = |hints, seed| {
                    let query = common::query_saying(hints, &profile, scheme, bits, class.rows(), seed);
                    query.encode().len()
                };
                // Whether gravity is told, and which, and how well the focal length is known, shows in no length.
                let is_first = profile.version() == WireVersion::V1;
                let told = if is_first { vec![Hints::default(); 3] } else { hints() };
                let lengths: Vec<usize> =
                    told.into_iter().zip(1..).map(|(h, seed)| length(h, seed)).collect();
                assert!(lengths.iter().all(|l| *l == lengths[0]), "{scheme} {class:?} {lengths:?}");
            }
        }
    }
}

/// Everything that may be said of a camera, with the extremes of gravity.
fn hints() -> Vec<Hints> {
    let gravity = |down, sd| Some(CoarseGravity::new(down, sd).expect("a direction"));
    let all = [
        None,
        gravity([-1.0, -1.0, -1.0], 0.5),
        gravity([0.0, 1.0, 0.0], 2.0),
        gravity([1.0, 1.0, -1e-9], 16.0),
    ];
    FocalKnowledge::ALL.into_iter().flat_map(|focal| all.map(|gravity| Hints { focal, gravity })).collect()
}

/// What version 3 says of a camera is read as it was written, and its numbers are checked; older versions refuse to say it.
#[test]
fn what_a_device_says_of_its_camera() {
    let bits = AngleBits::default();
    let [v1, v2, ..] = common::profiles(Scheme::default(), bits);
    let row = AnchoredRow::new(AngleForm::HalfCircle, bits, veiloc_geometry::Anchor::FIRST, 1.0);
    let seal = |profile: &Profile, hints| {
        let query = common::query_with(profile, Scheme::default(), bits, 256, 3);
        let parts = QueryParts {
            camera: query.canonical_camera(),
            scheme: query.scheme(),
            angle_bits: bits,
            rows: Rows::Dcl(vec![row; 256]),
            descriptors: query.descriptors().to_owned(),
            image_global: None,
            hints,
            turn: LayoutTurn::default(),
        };
        SealedQuery::new(profile, parts)
    };
    let mut forms = std::collections::BTreeSet::new();
    for said in hints() {
        let query = seal(&v2, said).expect("version 3");
        let read = SealedQuery::decode(&query.encode()).expect("own bytes");
        assert_eq!((read.focal_known(), read.gravity()), (said.focal, said.gravity));
        assert!(forms.insert(query.encode()), "two of them have one form");
        let says_nothing = said == Hints::default();
        let older = [seal(&v1, said), query.in_version_2()];
        for refused in older {
            assert_eq!(refused.is_ok(), says_nothing);
            assert!(says_nothing || matches!(refused, Err(QueryError::Unsayable { .. })), "{refused:?}");
        }
    }
    // The two numbers are the last twelve bytes: a key of two bytes and a number, twice.
    let bytes = seal(&v2, Hints::default()).expect("version 3").encode();
    let tail = bytes.len() - 12;
    assert_eq!(bytes[tail..], [0x95, 0x01, 1, 0, 0, 0, 0x9D, 0x01, 0, 0, 0, 0]);
    let with = |at: usize, value: u32| {
        let mut bytes = bytes.clone();
        bytes[tail + at..tail + at + 4].copy_from_slice(&value.to_le_bytes());
        SealedQuery::decode(&bytes)
    };
    for (at, value, name) in [
        (2, 0, "focal_known"),
        (2, 4, "focal_known"),
        (2, u32::MAX, "focal_known"),
        (8, 393_217, "gravity"),
        (8, u32::MAX, "gravity"),
    ] {
        let refused = with(at, value);
        assert!(matches!(refused, Err(QueryError::Field { field, .. }) if field == name), "{name} = {value}");
    }
    for (at, value) in [(2, 3), (8, 1), (8, 393_216)] {
        with(at, value).expect("the ends of what may be said");
    }
    // Version 2 with the fields of version 3, and version 3 without them, or without one.
    let mut two = bytes.clone();
    two[1] = 2;
    assert!(matches!(SealedQuery::decode(&two), Err(QueryError::NotCanonical { .. })));
    let mut three = bytes[..tail].to_vec();
    assert!(matches!(SealedQuery::decode(&three), Err(QueryError::Missing { field: "focal_known" })));
    three.extend(&bytes[tail + 6..]);
    assert!(matches!(SealedQuery::decode(&three), Err(QueryError::Missing { field: "focal_known" })));
    let told = format!("{:?} {:?}", seal(&v2, hints()[5]), hints());
    assert!(!told.contains('.'), "L8: {told}");
}

#[test]
fn every_truncation_and_every_extension_is_refused() {
    for (scheme, bytes) in
        Scheme::ALL.into_iter().flat_map(|s| sealed_in_all(s).into_iter().map(move |bytes| (s, bytes)))
    {
        let cuts = (0..200).chain((200..bytes.len()).step_by(97)).chain([bytes.len() - 1]);
        for cut in cuts {
            assert!(SealedQuery::decode(&bytes[..cut]).is_err(), "{scheme} cut at {cut}");
        }
        for extra in [&[0_u8][..], &[0x08, 0x01], &[0xFF; 9], &[0x7D, 1, 2, 3, 4]] {
            assert!(SealedQuery::decode(&[&bytes, extra].concat()).is_err(), "{scheme} {extra:?}");
        }
    }
    for profile in common::profiles(Scheme::default(), AngleBits::default()) {
        let bytes = profile.encode();
        for cut in 0..bytes.len() {
            assert!(Profile::decode(&bytes[..cut]).is_err(), "{profile:?} cut at {cut}");
        }
        assert!(Profile::decode(&[&bytes[..], &[0x7D, 1, 2, 3, 4]].concat()).is_err());
    }
}

/// Field numbers and types are right, but the same thing is said in another way.
#[test]
fn there_is_one_form_only() {
    for bytes in sealed_in_all(Scheme::default()) {
        let repeated = [&bytes[..5], &bytes[..]].concat();
        assert!(matches!(SealedQuery::decode(&repeated), Err(QueryError::NotCanonical { .. })));
        let reordered = [&bytes[5..], &bytes[..5]].concat();
        assert!(matches!(SealedQuery::decode(&reordered), Err(QueryError::NotCanonical { .. })));
        let unknown = [&bytes[..], &[0xF5, 0x01, 1, 2, 3, 4]].concat();
        assert!(matches!(SealedQuery::decode(&unknown), Err(QueryError::NotCanonical { .. })));
    }
    // A whole message of one version behind one of the other: the fields of both, and the form of neither.
    let all = sealed_in_all(Scheme::default());
    let [v1, v2, ..] = all.as_slice() else { unreachable!() };
    assert!(SealedQuery::decode(&[&v1[..], &v2[..]].concat()).is_err());
    assert!(SealedQuery::decode(&[&v2[..], &v1[..]].concat()).is_err());
}

/// What version 2 says of kinds and global models may be said in one way, and must agree with the other fields.
#[test]
fn what_version_2_says_of_kinds_is_checked() {
    let query = sealed_in_all(Scheme::default());
    for (field, value, name) in [
        (12, 0, "descriptor_dim"),
        (12, 513, "descriptor_dim"),
        (12, u32::MAX, "descriptor_dim"),
        (13, 0, "descriptor_encoding"),
        (13, 4, "descriptor_encoding"),
        (14, 0, "descriptor_norm"),
        (14, u32::MAX, "descriptor_norm"),
    ] {
        let error = SealedQuery::decode(&with_field(&query[2], field, value));
        assert!(matches!(error, Err(QueryError::Field { field, .. }) if field == name), "{error:?}");
    }
    // Another length of a descriptor asks for another number of bytes; the name "sift" stands for one kind only.
    let longer = SealedQuery::decode(&with_field(&query[2], 12, 49));
    assert!(matches!(longer, Err(QueryError::Length { field: "descriptors", .. })), "{longer:?}");
    let taken = SealedQuery::decode(&with_field(&query[1], 12, 64));
    assert!(matches!(taken, Err(QueryError::Descriptor { what: "descriptor_name", .. })), "{taken:?}");

    let profiles = common::profiles(Scheme::default(), AngleBits::default()).map(|p| p.encode());
    for (profile, field, value) in
        [(1, 3, 64), (2, 3, 0), (2, 4, 9), (2, 5, 0), (1, 6, 10), (1, 7, 9999), (2, 9, 0)]
    {
        assert!(Profile::decode(&with_field(&profiles[profile], field, value)).is_err(), "{field} = {value}");
    }
    let codes = Profile::decode(&with_field(&profiles[1], 9, 511));
    assert!(matches!(codes, Err(QueryError::NotCanonical { .. })), "not those of the vocabulary: {codes:?}");
    // Words behind a model that has none.
    let mut words = profiles[2].clone();
    assert_eq!(words.pop(), Some(0), "an empty vocabulary");
    words.extend([1, 7]);
    assert!(matches!(Profile::decode(&words), Err(QueryError::NotCanonical { .. })));
}

/// The right name of the profile, and descriptors of another kind or a global descriptor of another length.
#[test]
fn a_query_that_lies_about_its_profile_is_refused() {
    let profile = common::own_profile();
    let query = common::query_with(&profile, Scheme::default(), AngleBits::default(), 256, 1);
    let bytes = common::in_version_2(query).encode();
    let norm = SealedQuery::decode(&with_field(&bytes, 14, 301)).expect("a query");
    assert!(matches!(profile.check(&norm), Err(QueryError::Mismatch { what: "descriptor kind", .. })));
    let at = bytes.len() - 40 - 1;
    assert_eq!(bytes[at], 40, "length of the global descriptor");
    let mut shorter = bytes[..bytes.len() - 1].to_vec();
    shorter[at] = 39;
    let shorter = SealedQuery::decode(&shorter).expect("a query");
    assert!(matches!(profile.check(&shorter), Err(QueryError::Mismatch { .. })));
}

/// The value of the `fixed32` field with this one-byte key, replaced. All such fields lie before the long ones.
fn with_field(bytes: &[u8], field: u8, value: u32) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    let mut at = 0;
    loop {
        let (number, kind) = (bytes[at] >> 3, bytes[at] & 7);
        if number == field {
            bytes[at + 1..at + 5].copy_from_slice(&value.to_le_bytes());
            return bytes;
        }
        at += if kind == 5 { 5 } else { 2 + usize::from(bytes[at + 1]) };
    }
}

#[test]
fn wrong_numbers_are_named() {
    for (field, value, name) in [
        (3, 0, "scheme"),
        (3, 9, "scheme"),
        (4, 18_000, "dividing_angle"),
        (5, 0, "anchor_distance"),
        (6, 5, "angle_bits"),
        (6, u32::MAX, "angle_bits"),
        (7, 200, "camera_focal"),
        (8, 0, "camera_width"),
        (9, 257, "camera_height"),
        (10, 255, "rows"),
        (10, u32::MAX, "rows"),
        (11, 2, "descriptor_kind"),
    ] {
        let error = SealedQuery::decode(&with_field(&sealed(Scheme::default()), field, value));
        assert!(
            matches!(error, Err(QueryError::Field { field, .. }) if field == name),
            "{name} = {value}: {error:?}"
        );
    }
    for found in [0, 5, u32::MAX] {
        let other = with_field(&sealed(Scheme::default()), 1, found);
        let refused = QueryError::Version { what: "sealed query", found, supported: 4 };
        assert_eq!(SealedQuery::decode(&other), Err(refused));
    }
    // One version's fields under the other's number.
    let swapped = SealedQuery::decode(&with_field(&sealed(Scheme::default()), 1, 2));
    assert!(matches!(swapped, Err(QueryError::Malformed { .. })), "{swapped:?}");
    // Another number of angle bits asks for another number of bytes.
    let longer = with_field(&sealed(Scheme::default()), 6, 13);
    assert!(matches!(SealedQuery::decode(&longer), Err(QueryError::Length { field: "positions", .. })));
    let more = with_field(&sealed(Scheme::default()), 10, 512);
    assert!(matches!(SealedQuery::decode(&more), Err(QueryError::Length { .. })));
    // A line that misses a smaller image.
    let small = with_field(&with_field(&sealed(Scheme::RandomLines), 8, 1), 9, 1);
    assert!(matches!(SealedQuery::decode(&small), Err(QueryError::Row { .. })));
    // Layout numbers where there is no layout.
    let layout = with_field(&sealed(Scheme::Points), 5, 100);
    assert!(matches!(SealedQuery::decode(&layout), Err(QueryError::Field { field: "anchor_distance", .. })));

    let profile = common::profile(Scheme::default(), AngleBits::default()).encode();
    for (field, value, name) in [(2, 7, "scheme"), (7, 10, "max_keypoints"), (8, 9999, "max_image_side")] {
        let error = Profile::decode(&with_field(&profile, field, value));
        assert!(matches!(error, Err(QueryError::Field { field, .. }) if field == name), "{error:?}");
    }
}

/// A length of nearly 2^64 bytes in front of a few: refused before anything is reserved.
#[test]
fn a_lying_length_costs_nothing() {
    for (version, field) in [(1, 2_u8), (1, 12), (1, 13), (1, 14), (2, 2), (2, 11), (2, 15)] {
        let mut bytes = vec![0x0D, version, 0, 0, 0, field << 3 | 2];
        bytes.extend([0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0x01]);
        bytes.extend([0; 100]);
        assert!(matches!(SealedQuery::decode(&bytes), Err(QueryError::Malformed { .. })), "{field}");
    }
    assert!(matches!(SealedQuery::decode(&vec![0; 10_000_000]), Err(QueryError::TooLong { .. })));
    assert!(matches!(Profile::decode(&vec![0; 10_000_000]), Err(QueryError::TooLong { .. })));
    assert!(matches!(SealedQuery::decode(&[]), Err(QueryError::Missing { field: "version" })));
}

#[test]
fn a_query_for_another_map_is_told_apart() {
    let profile = common::profile(Scheme::default(), AngleBits::default());
    let query = common::query(Scheme::default(), AngleBits::default(), 256, 1);
    profile.check(&query).expect("sealed with it");
    // The device chose another scheme and fewer bits: still the same map.
    let six = AngleBits::new(6).expect("allowed");
    profile.check(&common::query(Scheme::RandomLines, six, 256, 1)).expect("same vocabulary");

    let other = Profile::vlad(common::vocabulary(&mut common::Draw::new(8)));
    assert!(matches!(other.check(&query), Err(QueryError::WrongProfile { .. })));
    let limits = veiloc_protocol::ExtractionLimits { max_keypoints: 1000, ..profile.limits() };
    assert!(profile.with_limits(limits).expect("allowed").check(&query).is_err());
}

#[test]
fn parts_that_do_not_fit_are_refused() {
    let bits = AngleBits::default();
    let profile = common::profile(Scheme::default(), bits);
    let camera = CanonicalCamera::from_codes(36, 20, 15).expect("allowed");
    let row = AnchoredRow::new(AngleForm::HalfCircle, bits, veiloc_geometry::Anchor::FIRST, 1.0);
    let descriptors = |n: usize| {
        veiloc_descriptor::Descriptors::new(profile.descriptor_kind(), vec![1; n * 128]).expect("whole rows")
    };
    for (rows, descriptors, what) in [
        (Rows::Dcl(vec![row; 256]), descriptors(255), "descriptors"),
        (Rows::Dcl(vec![row; 255]), descriptors(255), "rows"),
        (Rows::Dcl(Vec::new()), descriptors(0), "rows"),
        (Rows::Points(Vec::new()), descriptors(0), "scheme"),
    ] {
        let (scheme, angle_bits) = (Scheme::default(), bits);
        let parts = QueryParts {
            camera,
            scheme,
            angle_bits,
            rows,
            descriptors,
            image_global: None,
            hints: Hints::default(),
            turn: LayoutTurn::default(),
        };
        let error = SealedQuery::new(&profile, parts);
        assert!(matches!(error, Err(QueryError::Mismatch { what: w, .. }) if w == what), "{error:?}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_bytes_are_refused_or_read_unchanged(bytes in prop::collection::vec(any::<u8>(), 0..600)) {
        if let Ok(query) = SealedQuery::decode(&bytes) {
            prop_assert_eq!(query.encode(), bytes.clone());
        }
        if let Ok(profile) = Profile::decode(&bytes) {
            prop_assert_eq!(profile.encode(), bytes);
        }
    }

    #[test]
    fn damaged_messages_are_refused_or_read_unchanged(
        scheme in 0..4_usize,
        form in 0..7_usize,
        flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
        head in any::<bool>(),
    ) {
        let mut bytes = sealed_in_all(Scheme::ALL[scheme]).into_iter().cycle().nth(form).expect("endless");
        for (index, value) in flips {
            let range = if head { 80 } else { bytes.len() };
            bytes[index.index(range)] = value;
        }
        if let Ok(query) = SealedQuery::decode(&bytes) {
            prop_assert_eq!(query.encode(), bytes);
            prop_assert_eq!(query.observations().len(), query.len());
        }
    }

    #[test]
    fn damaged_profiles_are_refused_or_read_unchanged(
        index in any::<prop::sample::Index>(),
        value in any::<u8>(),
        form in 0..4_usize,
    ) {
        let mut bytes = common::profiles(Scheme::default(), AngleBits::default())[form].encode();
        let at = index.index(bytes.len());
        bytes[at] = value;
        if let Ok(profile) = Profile::decode(&bytes) {
            prop_assert_eq!(profile.encode(), bytes);
        }
    }
}
