//! Descriptions, search folders, and networks that do not match their description.

use super::common;

use std::path::{Path, PathBuf};

use common::{drawn, models_folder};
use veiloc_descriptor::Encoding;
use veiloc_features::learned::{Description, Engine, Learned, Models};
use veiloc_features::{Extractor, FeatureError, Image};

fn data(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/data/learned").join(name)
}

/// The built-in description of XFeat, with a replaced part.
fn described(part: &str, by: &str) -> Result<Description, FeatureError> {
    let text = std::fs::read_to_string(models_folder().join("xfeat.toml")).expect("a description");
    assert!(part.is_empty() || text.contains(part), "{part}");
    Description::parse(&text.replace(part, by), Path::new("own.toml"))
}

#[test]
fn all_descriptions_are_read_and_built_in() {
    let models = Models::new(Vec::new());
    let names: Vec<&str> = models.all().map(|found| found.description.name()).collect();
    let expected = [
        "xfeat",
        "xfeat-compact",
        "alike",
        "alike-t",
        "alike-t-compact",
        "aliked-t16",
        "aliked-n16",
        "aliked-n16rot",
        "aliked-n32",
        "superpoint",
    ];
    assert_eq!(names, expected);
    let files = std::fs::read_dir(models_folder()).expect("a folder").count();
    assert_eq!(files, names.len(), "a description that is not built in");
    for found in models.all() {
        assert!(found.file.is_none() && !found.description.licence().is_empty());
        assert!(found.description.source().starts_with("https://"));
        let made =
            found.description.export().is_none_or(|by| by.starts_with("python scripts/export_onnx.py "));
        assert!(
            made && found
                .description
                .files()
                .iter()
                .all(|file| Path::new(file).extension().is_some_and(|e| e == "onnx"))
        );
    }
}

#[test]
fn invalid_description_is_rejected_with_its_fault() {
    described("", "").expect("a description");
    for (part, by, expected) in [
        ("name = \"xfeat\"", "name = \"X feat\"", "name"),
        ("name = \"xfeat\"", "name = \"sift\"", "sift"),
        ("channels = 1", "channels = 2", "1 or 3"),
        ("margin = 48", "margin = 3000", "margin"),
        ("margin = 48", "margins = 32", "unknown field"),
        ("normalize = \"image\"", "normalize = { mean = [0.5], deviation = [0.0] }", "deviation"),
        ("normalize = \"image\"", "normalize = { mean = [0.5, 1.0], deviation = [1.0, 1.0] }", "a channel"),
        ("numbers = 64", "numbers = 5000", "dim"),
        ("length = 256", "length = 60000", "norm"),
        ("radius = 2", "radius = 1000", "radius"),
        ("threshold = 0.05", "threshold = nan", "threshold"),
        ("form = \"cells\"", "form = \"map\"", "stride"),
        ("receptive_field = 32", "receptive_field = -1", "receptive_field"),
        ("files = [", "files = [\"../other.onnx\", ", "without folders"),
        ("[descriptors]\nlayer = 0", "[descriptors]", "layer"),
        ("[scores]", "[score]", "score"),
    ] {
        let refused = described(part, by).expect_err(by);
        assert!(matches!(refused, FeatureError::Description { .. }), "{by}: {refused}");
        let text = refused.to_string();
        assert!(text.contains(expected) && text.starts_with("own.toml"), "{by}: {text}");
    }
}

#[test]
fn error_of_a_missing_file_has_its_source_and_searched_folders() {
    let folder = tempfile::tempdir().expect("a folder");
    let models = Models::new(vec![folder.path().to_owned()]);
    let text = models.open("xfeat", None).expect_err("no file").to_string();
    for part in
        ["xfeat_800x576.onnx or xfeat_640x640.onnx", "accelerated_features", "Apache-2.0", "VEILOC_MODELS"]
    {
        assert!(text.contains(part), "{text}");
    }
    assert!(text.contains(&folder.path().display().to_string()), "{text}");
    let unknown = models.open("orb", None).expect_err("unknown").to_string();
    assert!(
        unknown.contains("\"orb\"") && unknown.contains("xfeat, xfeat-compact, alike, alike-t"),
        "{unknown}"
    );
    assert!(matches!(models.open("gone.toml", None), Err(FeatureError::Read { .. })));
    // Found in the folder, and in its sub-folder with the model's name.
    std::fs::write(folder.path().join("alike-n.onnx"), "no network").expect("written");
    std::fs::create_dir(folder.path().join("xfeat")).expect("made");
    std::fs::write(folder.path().join("xfeat/xfeat_640x640.onnx"), "no network").expect("written");
    let found: Vec<bool> = models.all().map(|found| found.file.is_some()).collect();
    assert_eq!(
        found,
        [true, true, true, false, false, false, false, false, false, false],
        "compact kinds use the file of the plain ones"
    );
    assert!(matches!(models.open("alike", None), Err(FeatureError::Network { .. })));
    assert!(matches!(models.open("xfeat", None), Err(FeatureError::Network { .. })));
}

#[test]
fn network_must_match_its_description() {
    let folder = tempfile::tempdir().expect("a folder");
    let own = folder.path().join("own.toml");
    let models = Models::new(Vec::new());
    let with = |part: &str, by: &str| {
        let text = std::fs::read_to_string(models_folder().join("xfeat.toml")).expect("a description");
        assert!(text.contains(part), "{part}");
        std::fs::write(&own, text.replace("name = \"xfeat\"", "name = \"own\"").replace(part, by))
            .expect("written");
        models.open(own.to_str().expect("text"), Some(&data("two-boxes.onnx")))
    };
    // A box detector: three channels, one output of another shape.
    let refused = with("channels = 1", "channels = 1").expect_err("three channels").to_string();
    assert!(refused.contains("number of channels"), "{refused}");
    let opened = with("channels = 1", "channels = 3").expect("its input fits");
    let broken = opened.extract(&Image::from(drawn(80, 60)), 100).expect_err("it has one output");
    assert!(matches!(broken, FeatureError::Extractor { .. }), "{broken}");
    assert!(broken.to_string().contains("no output"), "{broken}");
    let opened = with("channels = 1\n", "channels = 3\n").expect("its input fits");
    assert!(!format!("{opened:?}").is_empty());
}

/// A head is a file beside the network, with inputs and an output of known names.
#[test]
fn error_names_an_invalid_head() {
    let text = std::fs::read_to_string(models_folder().join("aliked-n16.toml")).expect("a description");
    let with = |head: &str| {
        let text = text.replace("aliked-n16-head.onnx", head).replace("numbers = 128", "numbers = 9");
        let description = Description::parse(&text, Path::new("own.toml"))?;
        Learned::open(description, &data("made-up-aliked.onnx"), Engine::Rten)
    };
    for (head, expected) in [
        ("../other.onnx", "descriptors.head"),
        ("gone.onnx", "gone.onnx"),
        ("corners.onnx", "features and keypoints"),
    ] {
        let refused = with(head).expect_err(head).to_string();
        assert!(refused.contains(expected), "{head}: {refused}");
    }
    let opened = with("made-up-aliked-head.onnx").expect("it is a head");
    let refused = opened.extract(&Image::from(drawn(80, 60)), 10).expect_err("8 numbers").to_string();
    assert!(refused.contains("instead of 9"), "{refused}");
}

/// The description of corners with a projection, in its own folder beside the content of `file`.
fn projected(part: &str, by: &str, file: Option<&[u8]>) -> Result<Description, FeatureError> {
    let folder = tempfile::tempdir().expect("a folder");
    let text = std::fs::read_to_string(data("corners-compact.toml")).expect("a description");
    assert!(text.contains(part), "{part}");
    if let Some(bytes) = file {
        std::fs::write(folder.path().join("corners-compact.bin"), bytes).expect("written");
    }
    Description::parse(&text.replace(part, by), &folder.path().join("own.toml"))
}

#[test]
fn error_names_an_invalid_projection() {
    let whole = std::fs::read(data("corners-compact.bin")).expect("a projection");
    let kind = projected("", "", Some(&whole)).expect("a description").kind();
    assert_eq!((kind.dim(), kind.encoding(), kind.packed_len()), (24, Encoding::Coarse, 12));
    let oversized = vec![0; 2 << 20];
    let overflow = [&whole[..2 * 24 * 25], &[0xff, 0xff, 0xff, 0x7f].repeat(24)].concat();
    for (part, by, file, expected) in [
        (
            "",
            "",
            None,
            &["own.toml", "\"corners-compact.bin\" is neither a file beside", "xfeat-compact.bin"][..],
        ),
        (
            "",
            "",
            Some(&whole[1..]),
            &["corners-compact.bin", "it has 1295 bytes", "25 numbers to 24 has 1296"],
        ),
        ("", "", Some(&oversized), &["corners-compact.bin", "2097152 bytes", "more than the maximum"]),
        ("numbers = 24", "numbers = 22", Some(&whole), &["corners-compact.bin", "25 numbers to 22 has 1188"]),
        ("numbers = 24", "numbers = 23", Some(&whole), &["own.toml", "dim", "even"]),
        ("numbers = 24", "numbers = 5000", Some(&whole), &["own.toml", "dim", "512"]),
        ("shift = 16", "shift = 31", Some(&whole), &["corners-compact.bin", "shift is 31", "1 to 30"]),
        ("", "", Some(&overflow), &["corners-compact.bin", "overflow"]),
        ("file = \"c", "file = \"../c", Some(&whole), &["own.toml", "projection.file", "without folders"]),
        ("shift = 16", "shifts = 16", Some(&whole), &["own.toml", "unknown field"]),
        // A built-in projection is for descriptors of another dimension.
        (
            "corners-compact.bin",
            "xfeat-compact.bin",
            None,
            &["xfeat-compact.bin", "6336 bytes", "25 numbers"],
        ),
    ] {
        let refused = projected(part, by, file).expect_err(by).to_string();
        assert!(expected.iter().all(|word| refused.contains(word)), "{expected:?}: {refused}");
    }
}

/// The same keypoints as the base model, with projected descriptors within a step of the matrix product.
#[test]
fn projected_network_has_the_same_keypoints() {
    let of = |name: &str| {
        let description = data(&format!("{name}.toml"));
        Models::new(Vec::new()).open(description.to_str().expect("text"), None).expect("a network")
    };
    let image = Image::from(drawn(120, 90));
    let [plain, compact] = ["corners", "corners-compact"].map(|name| of(name).extract(&image, 200));
    let (plain, compact) = (plain.expect("extracted"), compact.expect("extracted"));
    assert!(plain.keypoints == compact.keypoints && plain.keypoints.len() > 20);
    let file = std::fs::read(data("corners-compact.bin")).expect("a projection");
    let weight = |k: usize, j: usize| {
        let at = 2 * (25 * k + j);
        f64::from(i16::from_le_bytes([file[at], file[at + 1]]))
    };
    let mut levels = std::collections::BTreeSet::new();
    for row in 0..plain.keypoints.len() {
        let values: Vec<i16> = plain.descriptors.view().values(row).collect();
        for (k, byte) in compact.descriptors.row(row).iter().enumerate() {
            let at = 2 * 24 * 25 + 4 * k;
            let offset = i32::from_le_bytes(file[at..at + 4].try_into().expect("four"));
            let sum: f64 = values.iter().enumerate().map(|(j, x)| weight(k, j) * f64::from(*x)).sum();
            let steps = ((sum + f64::from(offset)) / 65536.0).clamp(-8.0, 7.999);
            let value = f64::from(Encoding::Coarse.value(*byte)) / 16.0;
            assert!((value - steps).abs() <= 0.5, "row {row}, number {k}: {value} {steps}");
            levels.insert(*byte);
        }
    }
    assert!(levels.len() > 12, "the numbers fill their levels: {levels:?}");
}

#[test]
fn derived_description_has_only_the_differences() {
    let parse = |text: &str| Description::parse(text, Path::new("own.toml"));
    let own = parse("name = \"mine\"\nof = \"alike-t-compact\"\n").expect("a description");
    let models = Models::new(Vec::new());
    let whole = models.all().find(|found| found.description.name() == "alike-t-compact").expect("built in");
    let (own_kind, kind) = (own.kind(), whole.description.kind());
    assert_eq!((own_kind.name(), own_kind.norm()), ("mine", kind.norm()));
    assert_eq!((own.files(), own.licence()), (whole.description.files(), whole.description.licence()));
    for (text, expected) in [
        ("name = \"mine\"\nof = \"orb\"", "\"orb\""),
        ("name = \"mine\"\nof = 3", "no model"),
        ("name = \"mine\"\nof = \"xfeat\"\nscore = 1", "unknown field"),
        ("of = \"xfeat\"\n[descriptors]\nlayer = 0\nnumbers = 32\nreceptive_field = 32", "xfeat"),
    ] {
        let refused = parse(text).expect_err(text);
        assert!(matches!(refused, FeatureError::Description { .. }), "{text}: {refused}");
        assert!(refused.to_string().contains(expected), "{text}: {refused}");
    }
}

/// Attributes that ONNX allows to omit have their default values.
#[test]
fn default_strides_are_one() {
    let description = data("corners.toml");
    let of = |file: &str| {
        let learned = Models::new(Vec::new()).open(description.to_str().expect("text"), Some(&data(file)));
        learned.expect("a network").extract(&Image::from(drawn(120, 90)), 200).expect("extracted")
    };
    let features = of("corners.onnx");
    assert!(features.keypoints.len() > 20, "{}", features.keypoints.len());
    assert!(of("corners-plain.onnx") == features);
}
