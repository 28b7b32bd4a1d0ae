//! The page says what the rows say, holds the images and says so, and loads nothing.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use image::{Rgb, RgbImage};

use super::*;

fn row(scheme: &str, attack: &str, psnr: f64) -> InversionRow {
    InversionRow {
        scheme: scheme.into(),
        attack: attack.into(),
        mean_px: (scheme != "nothing").then_some(12.25),
        psnr,
        ssim: psnr / 30.0,
        ..InversionRow::default()
    }
}

fn shaded(shade: u8) -> RgbImage {
    RgbImage::from_fn(20, 16, |x, y| Rgb([shade, 10 * x as u8, 10 * y as u8]))
}

fn report() -> InversionReport {
    let tile = |of: Option<[&str; 2]>, shade| SheetTile {
        of: of.map(|[a, b]| [a.into(), b.into()]),
        scores: "14.00 dB".into(),
        size: [20, 16],
        pixels: shaded(shade).into_raw(),
    };
    let tiles = vec![tile(None, 1), tile(Some(["points", "none"]), 2), tile(Some(["dcl", "guess"]), 3)];
    InversionReport {
        images: 3,
        networks: vec!["U-Net <16>".into()],
        rows: vec![
            row("points", "none", 16.0),
            row("dcl", "guess", 12.5),
            InversionRow { by: Some("transfer".into()), ..row("dcl", "realistic", 13.0) },
            row("nothing", "none", 12.0),
        ],
        sheets: vec![InversionSheet {
            title: "Images".into(),
            note: "Boxes are <objects>.".into(),
            images: vec![SheetImage { name: "kitchen <1>.png".into(), tiles }],
        }],
        details: vec![("Seed".into(), "7".into())],
    }
}

#[test]
fn it_says_what_the_rows_say() {
    let page = inversion_page(&report());
    for words in [
        "16.00 dB",
        "12 px",
        "Dual convergent lines",
        "the best that is told nothing (transfer)",
        "<td>100 %</td>",
        "<td>12 %</td>",
        "<td>25 %</td>",
        "<td>0 %</td>",
        "Best of who is told nothing",
        "Means over 3 images",
        "U-Net &lt;16&gt;",
    ] {
        assert!(page.contains(words), "{words}");
    }
    // Of judges that were not there, nothing is said in the table.
    for judge in ["<th scope=\"col\">LPIPS", "Feature<br>", "Objects<br>", "told apart</th>"] {
        assert!(!page.contains(judge), "{judge}");
    }
    let mut judged = report();
    for row in &mut judged.rows {
        row.lpips = Some(0.4321);
        row.feature_distance = Some(0.171);
        row.objects = Some([3, 11]);
    }
    judged.rows[1].told_apart = Some(0.815);
    let page = inversion_page(&judged);
    for words in ["<td>0.432</td>", "<td>0.171</td>", "<td>3 of 11</td>", "<td>82 %</td>", "told apart"] {
        assert!(page.contains(words), "{words}");
    }
}

#[test]
fn images_are_inside_to_the_pixel_and_the_page_says_so() {
    let page = inversion_page(&report());
    let images: Vec<&str> =
        page.split("data:image/png;base64,").skip(1).filter_map(|rest| rest.split('"').next()).collect();
    assert_eq!(images.len(), 3);
    for (encoded, shade) in images.iter().zip(1..) {
        let bytes = STANDARD.decode(encoded).expect("base64");
        assert_eq!(image::load_from_memory(&bytes).expect("an image").into_rgb8(), shaded(shade));
    }
    assert!(page.contains("<b>This file contains images</b>") && page.contains("do not publish it"));
    assert!(page.contains("alt=\"kitchen &lt;1&gt;.png: Dual convergent lines the guess.\""));
    assert!(page.contains("default-src 'none'; img-src data:;") && !page.contains("http://"));
    assert!(!page.contains("<objects>") && !page.contains("<1>"), "names are no markup");

    let without = inversion_page(&InversionReport { sheets: Vec::new(), ..report() });
    assert!(!without.contains("data:image") && !without.contains("This file contains images"));
    let empty = inversion_page(&InversionReport::default());
    assert!(empty.contains("How to read this") && !empty.contains("<table"));
}
