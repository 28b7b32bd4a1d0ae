//! Arbitrary bytes: rejected with a reason, or decoded and encoded again unchanged. Never a panic.

use super::common;

use proptest::prelude::*;
use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_protocol::{
    AnchoredRow, AngleBits, CanonicalCamera, CoarseGravity, FocalKnowledge, Hints, LayoutTurn, Profile,
    QueryError, QueryParts, Rows, Scheme, SealedQuery, SentContent, SizeClass,
};

fn sealed(scheme: Scheme) -> Vec<u8> {
    common::query(scheme, AngleBits::default(), 256, 3).encode()
}

/// The same with every profile, and for dcl two more: stripes, and a later frame of a session.
fn sealed_in_all(scheme: Scheme) -> Vec<Vec<u8>> {
    let bits = AngleBits::default();
    let mut all: Vec<_> =
        common::profiles().iter().map(|p| common::query_with(p, scheme, bits, 256, 3).encode()).collect();
    if matches!(scheme, Scheme::Dcl(_)) {
        all.extend(layouts().map(|query| query.encode()));
    }
    all
}

fn layouts() -> [SealedQuery; 2] {
    let stripes = "dcl:axis=67,sectors=21,anchors=-0.12/-0.49+1.5/0+@30".parse().expect("a layout");
    let turn = LayoutTurn::new(&Rotation3::from_scaled_axis(Vector3::new(0.1, -0.4, 0.0))).expect("finite");
    let paper = "dcl:paper".parse().expect("a layout");
    [(stripes, LayoutTurn::default()), (paper, turn)]
        .map(|(scheme, turn)| common::query_turned(turn, &common::profile(), scheme, 3))
}

/// Layouts and turns are read as written; invalid numbers are named in the error.
#[test]
fn layouts_and_turns() {
    let [stripes, session] = layouts();
    for query in [&stripes, &session] {
        let read = SealedQuery::decode(&query.encode()).expect("own bytes");
        assert_eq!((&read, read.turn()), (query, query.turn()));
        assert_eq!(read.observations(), query.observations());
        assert!(!format!("{read:?} {:?}", read.turn()).contains('.'), "L8");
    }
    // The message ends with the layout (2 + 1 + 26 bytes after gravity) and three turns of 2 + 4 bytes.
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
    // A row of an anchor that this layout of three does not have.
    let mut found = 0;
    for at in 0..stripes.encode().len() {
        found += usize::from(matches!(with(at, 0xFF), Err(QueryError::Row { .. })));
    }
    assert!(found > 100, "{found}");
    // Only dcl has a layout and a turn.
    let points = common::query(Scheme::Points, AngleBits::default(), 256, 3).encode();
    let turned = [&points[..points.len() - 1], &[1][..]].concat();
    assert!(matches!(SealedQuery::decode(&turned), Err(QueryError::Field { field: "turn", .. })));
    let at = points.len() - 18 - 1;
    assert_eq!(points[at], 0, "length of the layout");
    let layout = [&points[..at], &[26][..], &bytes[layout..layout + 26], &points[at + 1..]].concat();
    assert!(matches!(SealedQuery::decode(&layout), Err(QueryError::Length { field: "layout", .. })));
    let parts = QueryParts {
        camera: session.canonical_camera(),
        scheme: Scheme::Points,
        angle_bits: AngleBits::default(),
        rows: Rows::Points(vec![veiloc_protocol::PositionRow::new(0.0, 0.0).expect("the centre"); 256]),
        content: SentContent::Described {
            descriptors: session.descriptors().expect("rows").to_owned(),
            image_global: None,
        },
        hints: Hints::default(),
        turn: session.turn(),
    };
    let refused = SealedQuery::new(&common::profile(), parts);
    assert!(matches!(refused, Err(QueryError::Field { field: "turn", .. })), "{refused:?}");
}

#[test]
fn messages_round_trip() {
    for scheme in Scheme::ALL {
        for bits in (AngleBits::MIN..=AngleBits::MAX).map(|b| AngleBits::new(b).expect("allowed")) {
            for profile in common::profiles() {
                let query = common::query_with(&profile, scheme, bits, 256, u64::from(bits.get()));
                let read = SealedQuery::decode(&query.encode()).expect("own bytes");
                assert_eq!(read, query);
                assert_eq!(read.observations(), query.observations());
                assert_eq!(read.len(), 256);
                profile.check(&read).expect("sealed with it");
            }
        }
    }
    for profile in common::profiles() {
        let read = Profile::decode(&profile.encode()).expect("own bytes");
        assert_eq!((read.id(), &read), (profile.id(), &profile));
    }
}

/// L5: the number of bytes depends only on scheme and layout, angle bits, class, descriptor kind and global model.
#[test]
fn all_messages_of_a_class_are_equally_long() {
    let bits = AngleBits::default();
    for scheme in Scheme::ALL {
        for profile in common::profiles() {
            for class in SizeClass::ALL {
                let length = |hints, seed| {
                    let query = common::query_with_hints(hints, &profile, scheme, bits, class.rows(), seed);
                    query.encode().len()
                };
                // The length depends neither on gravity nor on how well the focal length is known.
                let lengths: Vec<usize> =
                    hints().into_iter().zip(1..).map(|(h, seed)| length(h, seed)).collect();
                assert!(lengths.iter().all(|l| *l == lengths[0]), "{scheme} {class:?} {lengths:?}");
            }
        }
    }
    // Nor on the rotation of the layout in a later frame of a session.
    let turns = [[0.0; 3], [0.1, -0.4, 0.0], [-3.0, 0.2, 0.5]];
    for scheme in ["dcl:paper", "dcl:axis=67,sectors=20,anchors=-0.12/-0.49+1.5/0"] {
        let length = |[x, y, z]: [f64; 3]| {
            let turn = LayoutTurn::new(&Rotation3::from_scaled_axis(Vector3::new(x, y, z))).expect("finite");
            let scheme = scheme.parse().expect("a layout");
            common::query_turned(turn, &common::profile(), scheme, 3).encode().len()
        };
        let lengths = turns.map(length);
        assert!(lengths.iter().all(|l| *l == lengths[0]), "{scheme} {lengths:?}");
    }
}

/// All camera hints, with the extremes of gravity.
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

/// Camera hints are read as written, and their numbers are checked.
#[test]
fn camera_hints_round_trip_and_are_checked() {
    let seal =
        |hints| common::query_with_hints(hints, &common::profile(), paper(), AngleBits::default(), 256, 3);
    let mut forms = std::collections::BTreeSet::new();
    for hint in hints() {
        let query = seal(hint);
        let read = SealedQuery::decode(&query.encode()).expect("own bytes");
        assert_eq!((read.focal_known(), read.gravity()), (hint.focal, hint.gravity));
        assert!(forms.insert(query.encode()), "two of them have the same encoding");
    }
    // The two hints are twelve bytes, twice a key of two bytes and a number; an empty layout (3 bytes) and three turns
    // (6 each) follow.
    let bytes = seal(Hints::default()).encode();
    let tail = bytes.len() - 21 - 12;
    assert_eq!(bytes[tail..tail + 12], [0x95, 0x01, 1, 0, 0, 0, 0x9D, 0x01, 0, 0, 0, 0]);
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
        with(at, value).expect("the limits of the allowed range");
    }
    // Without both hints, or without one.
    let without = |cut: std::ops::Range<usize>| {
        SealedQuery::decode(&[&bytes[..tail + cut.start], &bytes[tail + cut.end..]].concat())
    };
    for (cut, name) in [(0..12, "focal_known"), (0..6, "focal_known"), (6..12, "gravity")] {
        let refused = without(cut);
        assert!(matches!(refused, Err(QueryError::Missing { field }) if field == name), "{refused:?}");
    }
    let printed = format!("{:?} {:?}", seal(hints()[5]), hints());
    assert!(!printed.contains('.'), "L8: {printed}");
}

#[test]
fn truncated_and_extended_messages_are_rejected() {
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
    for profile in common::profiles() {
        let bytes = profile.encode();
        for cut in 0..bytes.len() {
            assert!(Profile::decode(&bytes[..cut]).is_err(), "{profile:?} cut at {cut}");
        }
        assert!(Profile::decode(&[&bytes[..], &[0x7D, 1, 2, 3, 4]].concat()).is_err());
    }
}

/// Field numbers and types are right, but the encoding is not canonical.
#[test]
fn encoding_is_canonical() {
    for bytes in sealed_in_all(Scheme::default()) {
        let repeated = [&bytes[..5], &bytes[..]].concat();
        assert!(matches!(SealedQuery::decode(&repeated), Err(QueryError::NotCanonical { .. })));
        let reordered = [&bytes[5..], &bytes[..5]].concat();
        assert!(matches!(SealedQuery::decode(&reordered), Err(QueryError::NotCanonical { .. })));
        let unknown = [&bytes[..], &[0xF5, 0x01, 1, 2, 3, 4]].concat();
        assert!(matches!(SealedQuery::decode(&unknown), Err(QueryError::NotCanonical { .. })));
    }
    // A complete message after another one.
    let [sift, own, ..] = common::profiles();
    let [sift, own] =
        [sift, own].map(|p| common::query_with(&p, Scheme::default(), AngleBits::default(), 256, 3).encode());
    assert!(SealedQuery::decode(&[&sift[..], &own[..]].concat()).is_err());
    assert!(SealedQuery::decode(&[&own[..], &sift[..]].concat()).is_err());
}

/// Descriptor kinds and global models have one encoding, and must agree with the other fields.
#[test]
fn descriptor_kinds_and_global_models_are_checked() {
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
        let error = SealedQuery::decode(&with_field(&query[1], field, value));
        assert!(matches!(error, Err(QueryError::Field { field, .. }) if field == name), "{error:?}");
    }
    // Another descriptor length requires another number of bytes; the name "sift" stands for one kind only.
    let longer = SealedQuery::decode(&with_field(&query[1], 12, 49));
    assert!(matches!(longer, Err(QueryError::Length { field: "descriptors", .. })), "{longer:?}");
    let taken = SealedQuery::decode(&with_field(&query[0], 12, 64));
    assert!(matches!(taken, Err(QueryError::Descriptor { what: "descriptor_name", .. })), "{taken:?}");

    let profiles = common::profiles().map(|p| p.encode());
    for (profile, field, value) in
        [(0, 3, 64), (1, 3, 0), (1, 4, 9), (1, 5, 0), (0, 6, 10), (0, 7, 9999), (1, 9, 0)]
    {
        assert!(Profile::decode(&with_field(&profiles[profile], field, value)).is_err(), "{field} = {value}");
    }
    let codes = Profile::decode(&with_field(&profiles[0], 9, 511));
    assert!(matches!(codes, Err(QueryError::NotCanonical { .. })), "not those of the vocabulary: {codes:?}");
    // Vocabulary words for a model that has none.
    let mut words = profiles[1].clone();
    assert_eq!(words.pop(), Some(0), "an empty vocabulary");
    words.extend([1, 7]);
    assert!(matches!(Profile::decode(&words), Err(QueryError::NotCanonical { .. })));
}

/// The id of the right profile, but descriptors of another kind or a global descriptor of another length.
#[test]
fn query_with_wrong_profile_id_is_rejected() {
    let profile = common::own_profile();
    let query = common::query_with(&profile, paper(), AngleBits::default(), 256, 1);
    let bytes = query.encode();
    let norm = SealedQuery::decode(&with_field(&bytes, 14, 301)).expect("a query");
    assert!(matches!(profile.check(&norm), Err(QueryError::Mismatch { what: "descriptor kind", .. })));
    // Hints, an empty layout and turns follow the global descriptor.
    let end = bytes.len() - 12 - 21;
    let at = end - 40 - 1;
    assert_eq!(bytes[at], 40, "length of the global descriptor");
    let mut shorter = [&bytes[..end - 1], &bytes[end..]].concat();
    shorter[at] = 39;
    let shorter = SealedQuery::decode(&shorter).expect("a query");
    assert!(matches!(profile.check(&shorter), Err(QueryError::Mismatch { .. })));
}

/// The scheme whose layout are two numbers.
fn paper() -> Scheme {
    "dcl:paper".parse().expect("a layout")
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
fn error_names_the_invalid_field() {
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
    ] {
        let error = SealedQuery::decode(&with_field(&sealed(paper()), field, value));
        assert!(
            matches!(error, Err(QueryError::Field { field, .. }) if field == name),
            "{name} = {value}: {error:?}"
        );
    }
    // Another number of angle bits requires another number of bytes.
    let longer = with_field(&sealed(paper()), 6, 13);
    assert!(matches!(SealedQuery::decode(&longer), Err(QueryError::Length { field: "positions", .. })));
    let more = with_field(&sealed(paper()), 10, 512);
    assert!(matches!(SealedQuery::decode(&more), Err(QueryError::Length { .. })));
    // A line that misses a smaller image.
    let small = with_field(&with_field(&sealed(Scheme::RandomLines), 8, 1), 9, 1);
    assert!(matches!(SealedQuery::decode(&small), Err(QueryError::Row { .. })));
    // Layout numbers where there is no layout.
    let layout = with_field(&sealed(Scheme::Points), 5, 100);
    assert!(matches!(SealedQuery::decode(&layout), Err(QueryError::Field { field: "anchor_distance", .. })));

    let profile = common::profile().encode();
    for (field, value, name) in [(6, 10, "max_keypoints"), (7, 9999, "max_image_side")] {
        let error = Profile::decode(&with_field(&profile, field, value));
        assert!(matches!(error, Err(QueryError::Field { field, .. }) if field == name), "{error:?}");
    }
}

/// The error for another version states the remedy for each message type, whatever else the message contains.
#[test]
fn version_error_states_the_remedy() {
    for found in [0, 2, 5, u32::MAX] {
        let query = with_field(&sealed(Scheme::default()), 1, found);
        let profile = with_field(&common::profile().encode(), 1, found);
        // A string where this version has a number.
        let otherwise = [&query[..5], &[0x1A, 1, b'x']].concat();
        for (refused, kind, remedy) in [
            (SealedQuery::decode(&query).expect_err("refused"), "sealed query", "update the app"),
            (SealedQuery::decode(&otherwise).expect_err("refused"), "sealed query", "update the app"),
            (Profile::decode(&profile).expect_err("refused"), "profile", "fetch the profile again"),
        ] {
            assert!(
                matches!(refused, QueryError::Version { what, found: f, supported: 1, .. } if what == kind && f == found),
                "{refused:?}"
            );
            let text = refused.to_string();
            assert!(text.contains(&format!("{kind} has version {found}")) && text.contains(remedy), "{text}");
        }
    }
}

#[test]
fn session_version_error_states_the_remedy() {
    use veiloc_protocol::RigMessage;
    let refused = RigMessage::decode(b"vqrig2\nwhatever").expect_err("refused");
    assert!(
        matches!(refused, QueryError::Version { what: "session", found: 2, supported: 1, .. }),
        "{refused:?}"
    );
    assert!(refused.to_string().contains("update the app"), "{refused}");
    for none in [&b""[..], b"vqrig", b"vqrig\n", b"vqrig1", b"vqrig-1\n", b"vqrig99999999999999\n", b"vqri"] {
        let refused = RigMessage::decode(none).expect_err("refused");
        assert!(!matches!(refused, QueryError::Field { .. }), "{refused:?}");
    }
}

/// A length prefix of nearly 2^64 before a few bytes: rejected before memory is reserved.
#[test]
fn huge_length_prefix_allocates_nothing() {
    for field in [2_u8, 11, 15] {
        let mut bytes = vec![0x0D, 1, 0, 0, 0, field << 3 | 2];
        bytes.extend([0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0x01]);
        bytes.extend([0; 100]);
        assert!(matches!(SealedQuery::decode(&bytes), Err(QueryError::Malformed { .. })), "{field}");
    }
    assert!(matches!(SealedQuery::decode(&vec![0; 10_000_000]), Err(QueryError::TooLong { .. })));
    assert!(matches!(Profile::decode(&vec![0; 10_000_000]), Err(QueryError::TooLong { .. })));
    assert!(matches!(SealedQuery::decode(&[]), Err(QueryError::Missing { field: "version" })));
}

#[test]
fn query_for_another_map_is_rejected() {
    let profile = common::profile();
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
fn mismatched_parts_are_rejected() {
    let bits = AngleBits::default();
    let profile = common::profile();
    let camera = CanonicalCamera::from_codes(36, 20, 15).expect("allowed");
    let row = AnchoredRow::new(bits, veiloc_geometry::Anchor::FIRST, 1.0);
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
            content: SentContent::Described { descriptors, image_global: None },
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
    fn any_bytes_are_rejected_or_round_trip(bytes in prop::collection::vec(any::<u8>(), 0..600)) {
        if let Ok(query) = SealedQuery::decode(&bytes) {
            prop_assert_eq!(query.encode(), bytes.clone());
        }
        if let Ok(profile) = Profile::decode(&bytes) {
            prop_assert_eq!(profile.encode(), bytes);
        }
    }

    #[test]
    fn damaged_messages_are_rejected_or_round_trip(
        scheme in 0..4_usize,
        form in 0..5_usize,
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
    fn damaged_profiles_are_rejected_or_round_trip(
        index in any::<prop::sample::Index>(),
        value in any::<u8>(),
        form in 0..3_usize,
    ) {
        let mut bytes = common::profiles()[form].encode();
        let at = index.index(bytes.len());
        bytes[at] = value;
        if let Ok(profile) = Profile::decode(&bytes) {
            prop_assert_eq!(profile.encode(), bytes);
        }
    }
}
