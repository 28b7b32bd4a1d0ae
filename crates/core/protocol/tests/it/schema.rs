//! The schema in `proto/` and the code agree: each reads what the other writes, to the same bytes.

use super::common;

use prost_reflect::prost::Message;
use prost_reflect::{DescriptorPool, DynamicMessage, Value};
use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_protocol::{
    AngleBits, CoarseGravity, FocalKnowledge, Hints, LayoutTurn, Pack, Profile, QueryError, Scheme,
    SealedQuery,
};

fn pool() -> DescriptorPool {
    let proto = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../proto");
    let files = ["veiloc/v1/sealed_query.proto", "veiloc/v1/profile.proto", "veiloc/v1/pack.proto"];
    let set = protox::compile(files, [proto]).expect("the schema compiles");
    DescriptorPool::from_file_descriptor_set(set).expect("the schema is complete")
}

/// Decodes with the schema, checks that exactly the fields of the schema are present, and encodes again.
fn reread(name: &str, bytes: &[u8]) -> DynamicMessage {
    let descriptor = pool().get_message_by_name(name).expect("in the schema");
    let message = DynamicMessage::decode(descriptor.clone(), bytes).expect("our bytes are such a message");
    assert_eq!(message.unknown_fields().count(), 0, "{name} has fields the schema lacks");
    // A query has descriptors, or what the device found in a pack.
    let described = ["descriptors", "global"];
    let matched = ["pack_id", "pack_points", "candidates"];
    let is_matched = matched.iter().any(|field| message.has_field_by_name(field));
    let absent: &[&str] = if is_matched { &described } else { &matched };
    for field in descriptor.fields() {
        let is_expected = name != "veiloc.v1.SealedQuery" || !absent.contains(&field.name());
        assert_eq!(message.has_field(&field), is_expected, "{}", field.full_name());
    }
    assert_eq!(message.encode_to_vec(), bytes, "{name}");
    message
}

fn number(message: &DynamicMessage, field: &str) -> u32 {
    message.get_field_by_name(field).and_then(|v| v.as_u32()).unwrap_or_else(|| panic!("{field}"))
}

#[test]
fn sealed_queries_match_the_schema() {
    for scheme in ["points", "random-lines", "coordinate-permutation", "dcl:horizontal,s=2"] {
        let scheme: Scheme = scheme.parse().expect("a scheme");
        for bits in [6, 12, 16].map(|b| AngleBits::new(b).expect("allowed")) {
            let query = common::query(scheme, bits, 256, 5);
            let message = reread("veiloc.v1.SealedQuery", &query.encode());
            let is_dcl = matches!(scheme, Scheme::Dcl(_));
            let expected = [
                ("version", 1),
                ("dividing_angle", 0),
                ("anchor_distance", if is_dcl { 200 } else { 0 }),
                ("angle_bits", u32::from(bits.get())),
                ("camera_focal", 36),
                ("camera_width", 20),
                ("camera_height", 15),
                ("rows", 256),
                ("descriptor_dim", 128),
                ("turn_x", 0),
            ];
            for (field, value) in expected {
                assert_eq!(number(&message, field), value, "{field} of {scheme}");
            }
            let descriptors = message.get_field_by_name("descriptors").expect("in the schema");
            assert_eq!(descriptors.as_bytes().expect("bytes"), query.descriptors().expect("rows").as_bytes());
            let id = message.get_field_by_name("profile_id").expect("in the schema");
            assert_eq!(id.as_bytes().expect("bytes").as_ref(), query.profile_id().as_bytes());
            assert_eq!(SealedQuery::decode(&message.encode_to_vec()).expect("unchanged"), query);
        }
    }
}

fn text(message: &DynamicMessage, field: &str) -> String {
    let value = message.get_field_by_name(field).unwrap_or_else(|| panic!("{field}"));
    value.as_str().expect("text").to_owned()
}

#[test]
fn kinds_and_hints_match_the_schema() {
    for (profile, name, dim, encoding, norm, global, codes) in [
        (common::profile(), "sift", 128, 1, 512, "vlad", 512),
        (common::own_profile(), "own-kind", 48, 2, 300, "own-global", 40),
        (common::compact_profile(), "compact", 64, 3, 374, "vlad", 256),
    ] {
        let message = reread("veiloc.v1.Profile", &profile.encode());
        assert_eq!(
            (text(&message, "descriptor_name"), text(&message, "global_name")),
            (name.into(), global.into())
        );
        for (field, value) in [
            ("version", 1),
            ("descriptor_dim", dim),
            ("descriptor_encoding", encoding),
            ("descriptor_norm", norm),
            ("max_keypoints", 2048),
            ("max_image_side", 1600),
            ("global_codes", codes),
        ] {
            assert_eq!(number(&message, field), value, "{field} of {name}");
        }
        assert_eq!(Profile::decode(&message.encode_to_vec()).expect("unchanged"), profile);

        let scheme: Scheme = "dcl:horizontal,s=2".parse().expect("a scheme");
        let gravity = CoarseGravity::new([0.0, 1.0, 0.25], 4.0).expect("a direction");
        let hints = Hints { focal: FocalKnowledge::Exif, gravity: Some(gravity) };
        let query = common::query_with_hints(hints, &profile, scheme, AngleBits::default(), 512, 5);
        let message = reread("veiloc.v1.SealedQuery", &query.encode());
        // (0, 0.8, 0.2) on the octahedron: cells 128 and 230; class 3, as 4 degrees are half a degree times 2^3.
        assert_eq!(number(&message, "focal_known"), 2);
        assert_eq!(number(&message, "gravity"), 1 + (3 * 256 + 128) * 256 + 230);
        assert_eq!(text(&message, "descriptor_name"), name);
        for (field, value) in [
            ("version", 1),
            ("scheme", 4),
            ("dividing_angle", 0),
            ("anchor_distance", 200),
            ("angle_bits", 12),
            ("camera_focal", 36),
            ("camera_width", 20),
            ("camera_height", 15),
            ("rows", 512),
            ("descriptor_dim", dim),
            ("descriptor_encoding", encoding),
            ("descriptor_norm", norm),
        ] {
            assert_eq!(number(&message, field), value, "{field} of {name}");
        }
        let global = message.get_field_by_name("global").expect("in the schema");
        assert_eq!(global.as_bytes().expect("bytes").len(), codes as usize);
        assert_eq!(SealedQuery::decode(&message.encode_to_vec()).expect("unchanged"), query);
    }
}

/// L16: a match query has no descriptor.
#[test]
fn match_queries_and_packs_match_the_schema() {
    let pack = common::pack();
    let message = reread("veiloc.v1.Pack", &pack.encode());
    assert_eq!((number(&message, "version"), number(&message, "points")), (1, pack.point_count()));
    assert_eq!(Pack::decode(&message.encode_to_vec()).expect("unchanged"), pack);
    let query = common::match_query(&pack);
    let message = reread("veiloc.v1.SealedQuery", &query.encode());
    assert_eq!(number(&message, "pack_points"), pack.point_count());
    assert!(query.descriptors().is_none() && query.global().is_none());
    assert_eq!(SealedQuery::decode(&message.encode_to_vec()).expect("unchanged"), query);
    // Both kinds of content in one message are refused.
    for field in ["descriptors", "global"] {
        let mut both = message.clone();
        both.set_field_by_name(field, Value::Bytes(vec![7; 8].into()));
        let refused = SealedQuery::decode(&both.encode_to_vec());
        assert_eq!(refused, Err(QueryError::NotCanonical { what: "sealed query" }), "{field}");
    }
}

#[test]
fn layouts_and_turns_match_the_schema() {
    let turn = LayoutTurn::new(&Rotation3::from_scaled_axis(Vector3::new(0.5, -0.25, 0.0))).expect("finite");
    for (scheme, turn, distance, layout, code) in [
        ("dcl:axis=67,sectors=20,anchors=-0.12/-0.49+1.5/0", LayoutTurn::default(), 0, 26, 0),
        ("dcl:horizontal,s=2", turn, 200, 0, 500_000),
    ] {
        let scheme: Scheme = scheme.parse().expect("a scheme");
        let query = common::query_turned(turn, &common::profile(), scheme, 5);
        let message = reread("veiloc.v1.SealedQuery", &query.encode());
        for (field, value) in [("version", 1), ("scheme", 4), ("anchor_distance", distance), ("turn_x", code)]
        {
            assert_eq!(number(&message, field), value, "{field}");
        }
        let bytes = message.get_field_by_name("layout").expect("in the schema");
        assert_eq!(bytes.as_bytes().expect("bytes").len(), layout);
        assert_eq!(SealedQuery::decode(&message.encode_to_vec()).expect("unchanged"), query);
    }
}

/// L4 and L6 as properties of the schema: a field for any of these would be a leak, so their absence is pinned.
#[test]
fn schema_has_exactly_these_fields() {
    let names = |message: &str| -> Vec<String> {
        let descriptor = pool().get_message_by_name(message).expect("in the schema");
        descriptor.fields().map(|field| field.name().to_owned()).collect()
    };
    assert_eq!(
        names("veiloc.v1.SealedQuery"),
        [
            "version",
            "profile_id",
            "scheme",
            "dividing_angle",
            "anchor_distance",
            "angle_bits",
            "camera_focal",
            "camera_width",
            "camera_height",
            "rows",
            "descriptor_name",
            "descriptor_dim",
            "descriptor_encoding",
            "descriptor_norm",
            "positions",
            "descriptors",
            "global",
            "focal_known",
            "gravity",
            "layout",
            "turn_x",
            "turn_y",
            "turn_z",
            "pack_id",
            "pack_points",
            "candidates",
        ]
    );
    // No position of a point, a keypoint or a camera, no name, no time.
    assert_eq!(
        names("veiloc.v1.Pack"),
        ["version", "profile", "points", "images", "row_points", "descriptors", "checksum"]
    );
    // No scheme and no angle bits: an operator has no field to request less protection.
    assert_eq!(
        names("veiloc.v1.Profile"),
        [
            "version",
            "descriptor_name",
            "descriptor_dim",
            "descriptor_encoding",
            "descriptor_norm",
            "max_keypoints",
            "max_image_side",
            "global_name",
            "global_codes",
            "vocabulary",
        ]
    );
}
