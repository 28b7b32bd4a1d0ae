//! `veiloc train` that stops and goes on: the file that it writes is the one it would have written at once.

use std::path::Path;
use std::process::Command;

use veiloc_datasets::problem_files::{KeypointImage, encode_keypoints};
use veiloc_geometry::Pixel;

/// Runs a command in words; paths stand in the folder.
fn train(folder: &Path, words: &str) -> Result<(), String> {
    let at = |word: &str| {
        let is_file = word.contains('.') && !word.starts_with(|c: char| c.is_ascii_digit());
        if is_file { folder.join(word).display().to_string() } else { word.to_owned() }
    };
    let words = std::iter::once("train".to_owned()).chain(words.split_whitespace().map(at));
    let output = Command::new(env!("CARGO_BIN_EXE_veiloc")).args(words).output().expect("the binary runs");
    if output.status.success() { Ok(()) } else { Err(String::from_utf8_lossy(&output.stderr).into_owned()) }
}

fn write(folder: &Path, name: &str, shift: usize) {
    let images: Vec<KeypointImage> = (0..3)
        .map(|image| {
            let place = |i: usize| {
                let i = i + 7 * image + shift;
                Pixel::new((i * 37 % 319) as f64 + 0.5, (i * 61 % 239) as f64 + 0.5)
            };
            let keypoints: Vec<Pixel> = (0..90).map(place).collect();
            let bytes = (0..90 * 6).map(|i| (i * 53 + image * 11 + shift) as u8).collect();
            let name = format!("{name}-{image}");
            KeypointImage { name, width: 320, height: 240, keypoints, descriptors: Some((bytes, 6)) }
        })
        .collect();
    std::fs::write(folder.join(name), encode_keypoints(&images, false).expect("encoded")).expect("written");
}

#[test]
fn a_training_in_pieces_writes_the_same_network() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path();
    for (shift, name) in ["train.jsonl", "validate.jsonl", "test.jsonl"].iter().enumerate() {
        write(folder, name, 1000 * shift);
    }
    for kind in ["neighbours", "positions --scheme dcl"] {
        let common = format!(
            "{kind} --train train.jsonl --validate validate.jsonl --test test.jsonl --steps 5 --every 2 --images 2 \
             --keypoints 40 --width 16 --layers 1 --json document.json"
        );
        train(folder, &format!("{common} -o whole.net --plot curve.svg")).expect("trained");
        let read = |name: &str| std::fs::read(folder.join(name)).expect("written");
        assert!(read("curve.svg").starts_with(b"<svg"));
        // A limit that is over after every step.
        for steps in 1..=5 {
            train(folder, &format!("{common} -o pieces.net --resume --minutes 0.0000001")).expect("a piece");
            assert_eq!(folder.join("pieces.net.state").exists(), steps < 5, "{kind} {steps}");
            let document = String::from_utf8(read("document.json")).expect("text");
            assert!(document.contains(&format!("\"steps_done\": {steps}")), "{document}");
        }
        assert_eq!(read("pieces.net"), read("whole.net"), "{kind}");

        // What cannot go on says why, and nothing is begun anew behind one's back.
        train(folder, &format!("{common} -o other.net --minutes 0.0000001")).expect("a piece");
        let other = train(folder, &format!("{common} -o other.net --resume --seed 1")).expect_err("another");
        assert!(other.contains("other options or images"), "{other}");
        std::fs::write(folder.join("other.net.state"), b"no training").expect("written");
        let none = train(folder, &format!("{common} -o other.net --resume")).expect_err("no training");
        assert!(none.contains("other.net.state") && none.contains("no interrupted training"), "{none}");
    }
    let both = train(folder, "neighbours --train a.b --validate a.b -o c.net --minutes 1 --hours 1");
    assert!(both.is_err_and(|e| e.contains("cannot be used with")));
}
