//! Descriptions, where files are looked for, and networks that are not what they are said to be.

mod common;

use std::path::{Path, PathBuf};

use common::{drawn, models_folder};
use veiloc_features::{Extractor, FeatureError, Image};
use veiloc_networks::{Description, Models, NetworkError};

fn data(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

/// The built-in description of XFeat, with a part replaced.
fn described(part: &str, by: &str) -> Result<Description, NetworkError> {
    let text = std::fs::read_to_string(models_folder().join("xfeat.toml")).expect("a description");
    assert!(part.is_empty() || text.contains(part), "{part}");
    Description::parse(&text.replace(part, by), Path::new("own.toml"))
}

#[test]
fn all_descriptions_are_read_and_built_in() {
    let models = Models::new(Vec::new());
    let names: Vec<&str> = models.all().map(|found| found.description.name()).collect();
    assert_eq!(names, ["xfeat", "alike", "alike-t", "superpoint"]);
    let files = std::fs::read_dir(models_folder()).expect("a folder").count();
    assert_eq!(files, names.len(), "a description that is not built in");
    for found in models.all() {
        assert!(found.file.is_none() && !found.description.licence().is_empty());
        assert!(found.description.source().starts_with("https://"));
    }
}

#[test]
fn what_is_no_description_is_refused_by_its_fault() {
    described("", "").expect("a description");
    for (part, by, says) in [
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
        ("sight = 32", "sight = -1", "sight"),
        ("files = [", "files = [\"../elsewhere.onnx\", ", "without folders"),
        ("[descriptors]\nlayer = 0", "[descriptors]", "descriptors.layer"),
        ("[scores]", "[score]", "score"),
    ] {
        let refused = described(part, by).expect_err(by);
        assert!(matches!(refused, NetworkError::Description { .. }), "{by}: {refused}");
        let text = refused.to_string();
        assert!(text.contains(says) && text.starts_with("own.toml"), "{by}: {text}");
    }
}

#[test]
fn a_file_that_is_not_there_says_where_it_is_got_and_was_looked_for() {
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
        unknown.contains("\"orb\"") && unknown.contains("xfeat, alike, alike-t, superpoint"),
        "{unknown}"
    );
    assert!(matches!(models.open("gone.toml", None), Err(NetworkError::Read { .. })));
    // Found in the folder, and in its sub-folder of the model's name.
    std::fs::write(folder.path().join("alike-n.pth"), "no weights").expect("written");
    std::fs::create_dir(folder.path().join("xfeat")).expect("made");
    std::fs::write(folder.path().join("xfeat/xfeat_640x640.onnx"), "no network").expect("written");
    let found: Vec<bool> = models.all().map(|found| found.file.is_some()).collect();
    assert_eq!(found, [true, true, false, false]);
    assert!(matches!(models.open("alike", None), Err(NetworkError::Weights { .. })));
    assert!(matches!(models.open("xfeat", None), Err(NetworkError::Model { .. })));
}

#[test]
fn networks_that_are_not_what_they_are_said_to_be_are_refused() {
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
    // A detector of boxes: three channels, one output of another form.
    let refused = with("channels = 1", "channels = 1").expect_err("three channels").to_string();
    assert!(refused.contains("number of channels"), "{refused}");
    let opened = with("channels = 1", "channels = 3").expect("its input fits");
    let broken = opened.extract(&Image::from(drawn(80, 60)), 100).expect_err("it has one output");
    assert!(matches!(broken, FeatureError::Extractor { .. }), "{broken}");
    assert!(broken.to_string().contains("no output"), "{broken}");
    let opened = with("channels = 1\n", "channels = 3\n").expect("its input fits");
    assert!(!format!("{opened:?}").is_empty());
    // Weights of another network.
    for name in ["alike", "superpoint"] {
        let refused = models.open(name, Some(&data("plain.pth"))).expect_err("other weights");
        assert!(refused.to_string().contains("lacks the tensor"), "{refused}");
    }
}

/// What ONNX lets a file leave out means the same as what is said.
#[test]
fn strides_that_are_left_out_are_one() {
    let description = data("corners.toml");
    let of = |file: &str| {
        let learned = Models::new(Vec::new()).open(description.to_str().expect("text"), Some(&data(file)));
        learned.expect("a network").extract(&Image::from(drawn(120, 90)), 200).expect("extracted")
    };
    let said = of("corners.onnx");
    assert!(said.keypoints.len() > 20, "{}", said.keypoints.len());
    assert!(of("corners-plain.onnx") == said);
}
