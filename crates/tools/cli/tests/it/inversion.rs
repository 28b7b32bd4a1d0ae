//! `veiloc train inversion` and `veiloc eval inversion`: a training in pieces, and what is made of its network.

use std::path::Path;
use std::process::Command;

/// Runs a command in words; what looks like a file stands in the folder.
fn run(folder: &Path, words: &str) -> Result<(), String> {
    let at = |word: &str| {
        let is_file = word.contains('.') && !word.starts_with(|c: char| c.is_ascii_digit());
        if is_file { folder.join(word).display().to_string() } else { word.to_owned() }
    };
    let output = Command::new(env!("CARGO_BIN_EXE_veiloc")).args(words.split_whitespace().map(at)).output();
    let output = output.expect("the binary runs");
    if output.status.success() { Ok(()) } else { Err(String::from_utf8_lossy(&output.stderr).into_owned()) }
}

/// Squares on a slope, with corners for SIFT to find.
fn draw(folder: &Path, name: &str, shift: u32) {
    let value = |x: u32, y: u32| {
        let square = ((x + shift) / 9 * 37 + (y + 2 * shift) / 7 * 61) % 5 * 40;
        image::Rgb([square as u8, (x + 60) as u8, (y + 90) as u8])
    };
    image::RgbImage::from_fn(96, 80, value).save(folder.join(name)).expect("written");
}

#[test]
fn a_training_in_pieces_writes_the_same_network_and_images_are_made_of_it() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let folder = folder.path();
    for shift in 0..4 {
        draw(folder, &format!("image-{shift}.png"), 31 * shift);
    }
    let common = "train inversion --train image-0.png image-1.png image-2.png --validate image-3.png --steps 4 --every 2 \
                  --images 2 --width 2 --depth 2 --side 16 --json document.json";
    run(folder, &format!("{common} -o whole.net --plot curve.svg")).expect("trained");
    let read = |name: &str| std::fs::read(folder.join(name)).expect("written");
    assert!(read("curve.svg").starts_with(b"<svg"));
    for steps in 1..=4 {
        run(folder, &format!("{common} -o pieces.net --resume --minutes 0.0000001")).expect("a piece");
        assert_eq!(folder.join("pieces.net.state").exists(), steps < 4, "{steps}");
        let document = String::from_utf8(read("document.json")).expect("text");
        assert!(document.contains(&format!("\"steps_done\": {steps}")), "{document}");
    }
    assert_eq!(read("pieces.net"), read("whole.net"));
    let shared = run(folder, &format!("{common} -o other.net --validate image-0.png")).expect_err("in both");
    assert!(shared.contains("1 images are among those learned from"), "{shared}");
    let lines = run(folder, &format!("{common} -o other.net --sees lines")).expect_err("of what");
    assert!(lines.contains("needs a scheme"), "{lines}");

    let eval =
        "eval inversion image-1.png image-3.png --network whole.net --schemes points,dcl -k 5 --shown 2";
    run(folder, &format!("{eval} --sheet sheet.png --report page.html --json rows.json")).expect("evaluated");
    assert!(read("sheet.png").starts_with(b"\x89PNG"));
    let page = String::from_utf8(read("page.html")).expect("text");
    // Two images: the originals and five rows of each, and those that are given places in the wide view.
    assert_eq!(page.matches("data:image/png;base64,").count(), 2 * (1 + 5) + 2 * (1 + 4));
    assert!(page.contains("This file contains images") && page.contains("Dual convergent lines"));
    let bare = eval.replace("--shown 2", "--shown 0");
    run(folder, &format!("{bare} --report bare.html --json rows.json")).expect("evaluated");
    assert!(!String::from_utf8(read("bare.html")).expect("text").contains("data:image"));
    let document = String::from_utf8(read("rows.json")).expect("text");
    for field in [
        "\"image\": \"image-3.png\"",
        "\"scheme\": \"dcl\"",
        "\"attack\": \"closed-form\"",
        "\"lpips\": null",
    ] {
        assert!(document.contains(field), "{field} {document}");
    }
    run(folder, &format!("{common} --shape invsfm -o staged.net")).expect("trained");
    run(folder, &format!("{} --json rows.json", eval.replace("whole", "staged"))).expect("evaluated");
    let document = String::from_utf8(read("rows.json")).expect("text");
    assert!(
        document.contains("\"form\": \"invsfm\"") && document.contains("\"told_apart\": 0."),
        "{document}"
    );
    let bag =
        run(folder, &format!("{common} -o other.net --shape invsfm --sees bag")).expect_err("no places");
    assert!(bag.contains("use --sees places"), "{bag}");
    let none = run(folder, "eval inversion image-1.png --network image-1.png").expect_err("no network");
    assert!(none.contains("image-1.png") && none.contains("no inversion network"), "{none}");
    let half = run(folder, "eval inversion image-1.png --network whole.net --lpips alex.npz")
        .expect_err("no backbone");
    assert!(half.contains("--lpips-backbone"), "{half}");
}
