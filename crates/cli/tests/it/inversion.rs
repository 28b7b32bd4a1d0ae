//! `veiloc eval inversion`: images that a network reconstructs from attack results, and their similarity.

use std::path::Path;
use std::process::Command;

/// Runs a command line; an argument that looks like a file name is a path in the folder, and below `data/` one of the
/// attacks' test data.
fn run(folder: &Path, words: &str) -> Result<(), String> {
    let tests = Path::new(env!("CARGO_MANIFEST_DIR")).join("../research/attacks/tests/data");
    let at = |word: &str| match word.strip_prefix("data/") {
        Some(name) => tests.join(name).display().to_string(),
        None if word.contains('.') => folder.join(word).display().to_string(),
        None => word.to_owned(),
    };
    let output = Command::new(env!("CARGO_BIN_EXE_veiloc")).args(words.split_whitespace().map(at)).output();
    let output = output.expect("the binary runs");
    if output.status.success() { Ok(()) } else { Err(String::from_utf8_lossy(&output.stderr).into_owned()) }
}

/// Squares on a gradient, with corners for SIFT.
fn draw(folder: &Path, name: &str, shift: u32) {
    let value = |x: u32, y: u32| {
        let square = ((x + shift) / 9 * 37 + (y + 2 * shift) / 7 * 61) % 5 * 40;
        image::Rgb([square as u8, (x + 60) as u8, (y + 90) as u8])
    };
    image::RgbImage::from_fn(96, 80, value).save(folder.join(name)).expect("written");
}

#[test]
fn images_are_reconstructed_and_compared() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path();
    draw(folder, "image-1.png", 31);
    draw(folder, "n01440764_tench.png", 93);
    let read = |name: &str| std::fs::read(folder.join(name)).expect("written");
    let text = |name: &str| String::from_utf8(read(name)).expect("text");
    let eval = "eval inversion image-1.png n01440764_tench.png --features sift --network data/learned/inversion.toml --schemes points,dcl -k 5";
    run(folder, &format!("{eval} --show 2 --contact-sheet sheet.png --report page.html --json rows.json"))
        .expect("evaluated");
    assert!(read("sheet.png").starts_with(b"\x89PNG"));
    let page = text("page.html");
    // Two images: the originals and seven rows of each, and the extracted ones in the wide view.
    assert_eq!(page.matches("data:image/png;base64,").count(), 2 * (1 + 7) + 2 * (1 + 4));
    assert!(page.contains("This file contains images") && page.contains("Dual convergent lines"));
    let document = text("rows.json");
    for field in [
        "\"image\": \"image-1.png\"",
        "\"scheme\": \"dcl\"",
        "\"attack\": \"closed-form\"",
        "\"attack\": \"lines\"",
        "\"st_lpips\": null",
        "\"classes\": null",
        "\"has_visibility\": true",
        "\"roc_auc\": 0.",
    ] {
        assert!(document.contains(field), "{field} {document}");
    }
    let judged = "--perceptual data/image_metrics/distance.onnx --classifier data/image_metrics/classifier.onnx --attacks closed-form";
    run(folder, &format!("{eval} --show 0 {judged} --report bare.html --json rows.json")).expect("evaluated");
    let page = text("bare.html");
    assert!(!page.contains("data:image") && page.contains("ST-LPIPS</th>") && page.contains("Recognised,"));
    assert!(page.contains("1 images are named by their ImageNet synset"));
    let document = text("rows.json");
    for field in
        ["\"labelled\": 1", "\"pseudo_labelled\": 1", "\"st_lpips\": 0.", "\"top_5\": true", "\"top_5\": 2"]
    {
        assert!(document.contains(field), "{field} {document}");
    }
    assert!(document.contains("\"closed-form\"") && !document.contains("\"graph\""), "{document}");
}

#[test]
fn unusable_networks_are_named() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path();
    draw(folder, "image-1.png", 31);
    for (words, file, expected_words) in [
        ("--network image-1.png", "image-1.png", "research/train"),
        ("--network data/learned/positions.toml", "positions.toml", "kind \"inversion\" is required"),
        ("--network gone.onnx", "gone.toml", "cannot be read"),
        ("--network data/learned/nan.toml", "nan.onnx", "not finite"),
        ("--network data/learned/plain.toml --features compact", "plain.toml", "--features sift"),
        ("--network data/learned/plain.toml --classifier image-1.png", "image-1.png", "cannot be used"),
        ("--network data/learned/plain.toml --perceptual gone.onnx", "gone.onnx", "cannot read"),
        ("--network data/learned/plain.toml --attacks layout", "--attacks", "use one of prior"),
    ] {
        let features = if words.contains("--features") { "" } else { "--features sift" };
        let refused = run(folder, &format!("eval inversion image-1.png --schemes dcl {features} {words}"))
            .expect_err(words);
        assert!(refused.contains(file) && refused.contains(expected_words), "{words}: {refused}");
    }
}
