//! `docs/reference/wire-format.md` states the length of messages; these tests check it.

use super::common;

use std::f64::consts::PI;

use veiloc_descriptor::{DescriptorKind, Descriptors, Vocabulary};
use veiloc_geometry::nalgebra::Vector3;
use veiloc_protocol::{
    AngleBits, CanonicalCamera, DclLayout, Hints, LayoutTurn, Observations, Profile, QueryParts, Rows,
    Scheme, SealedQuery, SentContent, SizeClass,
};

/// Length of a sealed query for a vocabulary of 64 words, from an example query.
fn length(scheme: Scheme, class: SizeClass) -> usize {
    let small = common::query_with(&common::profile(), scheme, AngleBits::default(), class.rows(), 1);
    // The test messages have a global descriptor of 4 words: 60 words are missing, and the length prefix of the field
    // has two bytes for 512 bytes as for 8192.
    small.encode().len() + 60 * 128
}

#[test]
fn lengths_are_as_documented() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../docs/reference/wire-format.md");
    let document = std::fs::read_to_string(path).expect("the document exists");
    for scheme in Scheme::ALL {
        let cells: Vec<String> =
            SizeClass::ALL.into_iter().map(|class| length(scheme, class).to_string()).collect();
        let line = format!("| `{}` | {} |", scheme.name(), cells.join(" | "));
        assert!(document.contains(&line), "docs/reference/wire-format.md should say\n{line}");
    }
}

/// One real message with 64 words, to check the computed length above.
#[test]
fn documented_length_sum_is_exact() {
    let words = Descriptors::new(DescriptorKind::ROOT_SIFT, vec![9; 64 * 128]).expect("whole rows");
    let profile = Profile::vlad(Vocabulary::new(words).expect("64 words"));
    let camera = CanonicalCamera::from_codes(36, 20, 15).expect("allowed");
    let row = veiloc_protocol::PositionRow::new(0.0, 0.0).expect("the centre");
    let descriptors = Descriptors::new(DescriptorKind::ROOT_SIFT, vec![1; 256 * 128]).expect("whole rows");
    let parts = QueryParts {
        camera,
        scheme: Scheme::Points,
        angle_bits: AngleBits::default(),
        rows: Rows::Points(vec![row; 256]),
        content: SentContent::Described { descriptors, image_global: None },
        hints: Hints::default(),
        turn: LayoutTurn::default(),
    };
    let query = SealedQuery::new(&profile, parts).expect("parts fit");
    assert_eq!(query.encode().len(), length(Scheme::Points, SizeClass::Rows256));
    assert_eq!(profile.encode().len(), 7 * 5 + (2 + 4) + (2 + 4) + 3 + 64 * 128);
}

fn document() -> String {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../docs/reference/wire-format.md");
    std::fs::read_to_string(path).expect("the document exists")
}

/// The dump of a query in the document, as fields: offset, bytes (omitted ones as their count), label.
fn dump_fields(section: &str) -> Vec<(usize, Vec<u8>, usize, String)> {
    let mut fields = Vec::new();
    let mut open: Option<(usize, Vec<u8>)> = None;
    let dump = section.split("```text\n").nth(1).and_then(|rest| rest.split("```").next()).expect("a dump");
    for line in dump.lines() {
        let (offset, rest) = line.trim_start().split_once("  ").expect("an offset");
        let offset: usize = offset.parse().expect("a number");
        if let Some(rest) = rest.strip_prefix("… ") {
            let (count, label) = rest.split_once(" bytes: ").expect("how many");
            fields.push((offset, Vec::new(), count.parse().expect("a number"), label.to_owned()));
            continue;
        }
        if rest == "end" {
            fields.push((offset, Vec::new(), 0, rest.to_owned()));
            continue;
        }
        // Up to 16 bytes, in a column of their own.
        let (hex, label) = rest.split_at_checked(47).unwrap_or((rest, ""));
        let bytes = hex.split_whitespace().map(|byte| u8::from_str_radix(byte, 16).expect("a byte"));
        let (_, so_far) = open.get_or_insert((offset, Vec::new()));
        so_far.extend(bytes);
        if !label.trim().is_empty() {
            let (offset, bytes) = open.take().expect("just put there");
            fields.push((offset, bytes, 0, label.trim().to_owned()));
        }
    }
    assert!(open.is_none(), "a line without a label");
    fields
}

#[test]
fn documented_dump_matches_the_decoder() {
    let document = document();
    let (_, section) = document.split_once("### A query, byte by byte").expect("the section");
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/exif-gravity.vquery");
    assert!(section.contains("crates/core/protocol/tests/data/exif-gravity.vquery"));
    let file = std::fs::read(path).expect("the known answer");
    let fields = dump_fields(section);

    // Every byte of the file appears once, in order and unchanged.
    let mut at = 0;
    for (offset, bytes, omitted, label) in &fields {
        assert_eq!(*offset, at, "{label}");
        assert_eq!(file[at..at + bytes.len()], bytes[..], "{label}");
        at += bytes.len() + omitted;
    }
    assert_eq!(at, file.len());

    // The labels must equal the values that the program reads.
    let query = SealedQuery::decode(&file).expect("a sealed query");
    let (focal, width, height) = query.canonical_camera().codes();
    let Scheme::Dcl(DclLayout::Halves(layout)) = query.scheme() else { panic!("dcl of two halves") };
    let (angle, distance) = layout.codes();
    let kind = query.descriptor_kind();
    let gravity = query.gravity().expect("the query has one");
    let fixed = |name: &str, value: u32| (name.to_owned(), value);
    let numbers = [
        fixed("version", 1),
        fixed("scheme", 4),
        fixed("dividing_angle", angle),
        fixed("anchor_distance", distance),
        fixed("angle_bits", query.angle_bits().get().into()),
        fixed("camera_focal", focal),
        fixed("camera_width", width),
        fixed("camera_height", height),
        fixed("rows", query.len() as u32),
        fixed("descriptor_dim", kind.dim() as u32),
        fixed("descriptor_encoding", 1),
        fixed("descriptor_norm", kind.norm() as u32),
        fixed("focal_known", 2),
    ];
    assert_eq!(query.focal_known().name(), "exif");
    let label_of = |name: &str| {
        let mut all = fields.iter().filter(|(.., label)| label.split([' ', ',']).next() == Some(name));
        let (_, bytes, _, label) = all.next().unwrap_or_else(|| panic!("the dump has no label {name}"));
        (bytes, label.strip_prefix(name).expect("it begins so").trim_start_matches([' ', ',']).to_owned())
    };
    for (name, value) in numbers {
        let (bytes, label) = label_of(&name);
        assert_eq!(label.split(' ').next(), Some(value.to_string().as_str()), "{name}");
        assert_eq!(bytes[bytes.len() - 4..], value.to_le_bytes(), "{name}");
    }
    assert_eq!(label_of("camera_focal").1, format!("{focal} ({} pixels)", query.canonical_camera().focal()));
    assert_eq!(label_of("camera_width").1, format!("{width} ({} pixels)", query.canonical_camera().width()));
    assert_eq!(
        label_of("camera_height").1,
        format!("{height} ({} pixels)", query.canonical_camera().height())
    );
    assert_eq!(label_of("profile_id").1, query.profile_id().to_string());
    assert_eq!(label_of("descriptor_name").1, kind.name());
    assert_eq!(label_of("positions").1, format!("{} bytes", 256 * 14 / 8));
    assert_eq!(
        label_of("descriptors").1,
        format!("{} bytes", query.descriptors().expect("rows").as_bytes().len())
    );
    assert_eq!(label_of("global").1, format!("{} bytes", 4 * 128));

    // Gravity, by the formula of the document.
    let code: u32 = label_of("gravity").1.parse().expect("a number");
    let (k, a, b) = ((code - 1) >> 16, (code - 1) >> 8 & 255, (code - 1) & 255);
    assert!(section.contains(&format!("`{code}` is `k = {k}`, `a = {a}`, `b = {b}`")));
    assert_eq!(gravity.sd_deg(), 0.5 * f64::from(1 << k));
    let [x, y, z] = gravity.in_camera();
    assert!(section.contains(&format!("`({x:.6}, {y:.6}, {z:.6})`").replace('-', "−")), "{x} {y} {z}");

    // The first two rows.
    let (_, _, _, rows) = fields.iter().find(|(.., label)| label.starts_with("row 0: anchor")).expect("rows");
    let Observations::Anchored { pencils, lines } = query.observations() else { panic!("dcl") };
    for (row, label) in rows.split("; ").enumerate() {
        let label = label.strip_prefix(&format!("row {row}: anchor ")).expect("in order");
        let (anchor, code) = label.split_once(", angle ").expect("both");
        let code: f64 = code.parse().expect("a number");
        // 480 rows of pixels, s = 1, focal length 512 pixels; e is the viewing direction.
        let down = if anchor == "0" { -240.0 / 512.0 } else { 240.0 / 512.0 };
        let d = Vector3::new(0.0, down, 1.0).normalize();
        let zero = (Vector3::z() - d * d.z).normalize();
        let (sin, cos) = ((code + 0.5) * PI / 4096.0).sin_cos();
        let inward = zero * cos + d.cross(&zero) * sin;
        let [found_d, found_zero, found_quarter] = pencils.frame(lines[row].anchor);
        let (found_sin, found_cos) = lines[row].angle.sin_cos();
        assert!((found_d - d).norm() < 1e-9, "row {row}: {found_d} and not {d}");
        let found = found_zero * found_cos + found_quarter * found_sin;
        assert!((found - inward).norm() < 1e-9, "row {row}: {found} and not {inward}");
        if row == 0 {
            for v in [d, inward] {
                let printed = format!("`({:.6}, {:.6}, {:.6})`", v.x, v.y, v.z).replace('-', "−");
                assert!(section.contains(&printed), "{printed}");
            }
            let bits = format!("`{anchor} {code:013b}`", code = code as u32);
            assert!(section.contains(&bits), "{bits}");
            assert!(section.contains(&format!("`φ = {} · π / 4096`", code + 0.5)));
        }
    }
}
