//! The report of `veiloc eval inversion`: the paper's Tables 2 and 7, and each image beside the images reconstructed from
//! its descriptors.

use crate::attack_evaluation::inversion::{
    ContactSheet, InversionDocument, NetworkRow, ReconstructionRow, SummaryRow, Tile,
};
use maud::{Markup, html};

use veiloc_report::images::lossless_address;
use veiloc_report::numbers::{capital, count, percent, pixels, scheme_name};
use veiloc_report::page::{Card, Page, Section, figure, fold};
use veiloc_report::table::{Cell, Table, cell, number, words};

/// A column of the table: its header, and the cell of a row.
type Measure = (&'static str, fn(&SummaryRow, &[SummaryRow]) -> Cell);

/// The numeric columns. A column without values is left out.
const MEASURES: [Measure; 8] = [
    ("Mean error\nof positions", |row, _| cell(row.mean_px.map(pixels))),
    ("PSNR", |row, _| cell(format!("{:.2} dB", row.psnr))),
    ("SSIM", |row, _| cell(format!("{:.3}", row.ssim))),
    ("ST-LPIPS", |row, _| cell(row.st_lpips.map(|v| format!("{v:.3}")))),
    ("Objects\nfound again", |row, _| cell(found_again(row.objects_found, row.objects))),
    ("Recognised,\ntop-1 / top-5", |row, _| {
        cell(row.top_1.zip(row.top_5).map(|(one, five)| format!("{one} / {five}")))
    }),
    ("Wrong positions\ndetected (AUC)", |row, _| cell(row.roc_auc.map(|v| format!("{v:.2}")))),
    ("Share of the\nkeypoints' gain", |row, rows| cell(gain(rows, row).map(percent))),
];

/// The report as one HTML document. The second sheet is a view twice as wide and high; `facts`: information for a
/// repetition.
pub fn inversion_page(
    document: &InversionDocument,
    [sheet, wide]: &[ContactSheet; 2],
    facts: &[(String, String)],
) -> String {
    let images = count(document.images, "image");
    let lead = format!(
        "A network reconstructed {images} from descriptors: with the true keypoints, with positions that attacks recover under \
         each scheme, and without input.",
    );
    let columns =
        [words("Scheme"), words("Attack")].into_iter().chain(MEASURES.map(|(name, _)| number(name)));
    let mut table = Table::new("Images reconstructed from recovered positions", columns.collect());
    let mut last = None;
    for row in &document.summary {
        let is_first = last != Some(&row.scheme);
        let class = match (row.scheme.as_str(), is_first && last.is_some()) {
            ("none", _) => "baseline group",
            (_, true) => "group",
            (_, false) => "",
        };
        let mut cells = vec![cell(attack_words(row.attack, row.best_attack.as_deref()))];
        cells.extend(MEASURES.map(|(_, of)| of(row, &document.summary)));
        table.push(class, html! { @if is_first { (given(&row.scheme)) } }, cells);
        last = Some(&row.scheme);
    }
    let has_rows = !document.summary.is_empty();
    let means = html! {
        @if has_rows {
            p { "Means over " (images) ", on the network's grid." }
            (table.html())
            p.note { (network_words(&document.network)) }
            @if let Some(classes) = &document.classes { p.note { (classes.sentence()) } }
        }
    };
    let page = Page {
        title: "Images reconstructed from queries",
        lead: &lead,
        notices: if sheet.rows.is_empty() { Vec::new() } else { vec![notice()] },
        cards: &cards(&document.summary),
        sections: vec![
            Section::new("table", "Images reconstructed from recovered positions", means),
            Section::new("images", "Image by image", gallery(document, sheet, "")),
            Section::new(
                "wide",
                "In a view twice as wide and high",
                gallery(document, wide, "twice the view of "),
            ),
            Section::new("read", "How to read this", how_to_read()),
        ],
        facts,
    };
    page.html()
}

/// A warning: the file contains images.
fn notice() -> Markup {
    html! {
        b { "This file contains images" } ": reduced originals, and reconstructions from their descriptors. It is for their owner. \
         Nothing was sent over a network to make it; consider the people and places in them before you share it. "
        code { "--show 0" } " leaves the images out."
    }
}

fn cards(rows: &[SummaryRow]) -> Vec<Card> {
    let card = |row: &SummaryRow, label: &str, note: String| Card {
        value: format!("{:.2} dB", row.psnr),
        label: label.to_owned(),
        note,
    };
    let of = |scheme: &str| rows.iter().find(|row| row.scheme == scheme);
    let needs_no_oracle = |row: &&SummaryRow| ["prior", "realistic", "lines"].contains(&row.attack);
    let best = rows.iter().filter(needs_no_oracle).max_by(|a, b| a.psnr.total_cmp(&b.psnr));
    let keypoints =
        of("points").map(|row| card(row, "True keypoints", "The network's own limit, by PSNR.".to_owned()));
    let best = best.map(|row| {
        let attack = attack_words(row.attack, row.best_attack.as_deref()).to_lowercase();
        card(row, "Strongest attack without an oracle", format!("{}: {attack}.", given(&row.scheme)))
    });
    let nothing = of("none")
        .map(|row| card(row, "No descriptor", "The output of the network without any input.".to_owned()));
    [keypoints, best, nothing].into_iter().flatten().collect()
}

/// Display name of the network's input.
fn given(scheme: &str) -> String {
    match scheme {
        "unordered" => "Descriptors alone".to_owned(),
        "none" => "Nothing".to_owned(),
        scheme => scheme_name(scheme),
    }
}

/// Display name of an attack.
fn attack_words(attack: &str, by: Option<&str>) -> String {
    let words = match attack {
        "none" => "none needed",
        "prior" => "prior-only baseline",
        "closed-form" => "closed form with true neighbours",
        "graph" => "graph with true neighbours",
        "realistic" => "strongest without an oracle",
        "lines" => "none: each descriptor spread over its line",
        "matched" => "none: only what the server's map matches",
        "server-side" => "the server's, with true neighbours",
        "iterative" => "the server's iterative one, with true neighbours",
        "occlusion" => "the server's: where its map is hidden",
        other => other,
    };
    capital(&by.map_or_else(|| words.to_owned(), |by| format!("{words} ({by})")))
}

fn network_words(of: &NetworkRow) -> String {
    let judges = if of.has_visibility { " It also estimates how likely each position is right." } else { "" };
    format!(
        "{}: trained on {} descriptors of {} numbers; images of {} pixels on the longer side.{judges}",
        of.file, of.features, of.dimension, of.side
    )
}

fn found_again(found: Option<usize>, all: Option<usize>) -> Option<String> {
    found.zip(all).map(|(found, all)| format!("{found} of {all}"))
}

/// Gain of a row in PSNR relative to the gain of true keypoints over no descriptors; `None` without both of these
/// rows.
fn gain(rows: &[SummaryRow], row: &SummaryRow) -> Option<f64> {
    let psnr = |scheme: &str| rows.iter().find(|row| row.scheme == scheme).map(|row| row.psnr);
    let (least, most) = (psnr("none")?, psnr("points")?);
    // An untrained network has no gain.
    (most - least > 0.1).then(|| (row.psnr - least) / (most - least))
}

/// Each image of a sheet with its reconstructions.
fn gallery(document: &InversionDocument, sheet: &ContactSheet, view: &str) -> Markup {
    // Rows are ordered by column, and within a column by image.
    let own = |column: usize, image: usize| document.rows.get(column * document.images + image);
    let column =
        |name: &str| document.summary.iter().position(|row| format!("{} {}", row.scheme, row.attack) == name);
    let tiles = |index: usize, name: &str, tiles: &[Tile]| {
        html! {
            div.tiles {
                @for (tile, title) in tiles.iter().zip(&sheet.columns) {
                    (tile_figure(&format!("{view}{name}"), tile, column(title).and_then(|column| own(column, index))))
                }
            }
        }
    };
    html! {
        @if !sheet.rows.is_empty() {
            p {
                "The original on the grid of the network, then what was made of it, with the scores of each image. Boxes are objects \
                 that a detector finds, where one was given."
            }
            @for (index, row) in sheet.rows.iter().enumerate() {
                @let name = own(0, index).map_or("image", |row| row.image.as_str());
                (fold(name, index == 0 && view.is_empty(), &tiles(index, name, row)))
            }
        }
    }
}

fn tile_figure(name: &str, tile: &Tile, row: Option<&ReconstructionRow>) -> Markup {
    let drawn = tile.drawn();
    let (width, height) = (drawn.width(), drawn.height());
    let Some(address) = lossless_address([width, height], drawn.data()) else { return html! {} };
    let what = row.map_or_else(|| "Original".to_owned(), |row| given(&row.scheme));
    let attack =
        row.filter(|row| row.attack != "none").map(|row| format!(" {}.", attack_words(row.attack, None)));
    let attack = attack.unwrap_or_default();
    let alt = format!("{name}: {what}.{attack}");
    let picture = html! { img width=(width) height=(height) alt=(alt) src=(address); };
    figure(&picture, &html! { b { (what) "." } (attack) " " @if let Some(row) = row { (scores(row)) } })
}

fn scores(row: &ReconstructionRow) -> String {
    let lpips = row.st_lpips.map_or_else(String::new, |lpips| format!(", ST-LPIPS {lpips:.3}"));
    let class = match (row.top_1, row.top_5) {
        (Some(true), _) => ", class recognised",
        (_, Some(true)) => ", class among the five likeliest",
        (Some(false), _) => ", class not recognised",
        _ => "",
    };
    let objects = found_again(row.objects_found, row.objects.filter(|all| *all > 0));
    let objects = objects.map_or_else(String::new, |objects| format!(", {objects} objects found again"));
    format!("{:.2} dB, SSIM {:.3}{lpips}{objects}{class}.", row.psnr, row.ssim)
}

fn how_to_read() -> Markup {
    html! {
        p {
            "From keypoints and their descriptors a network can draw an image. A scheme hides the positions of the keypoints; an attack \
             recovers positions, and the network draws an image from those. The more the result resembles the original, the more \
             information leaked."
        }
        p {
            b { "A score near that of nothing means that no image was recovered" } ": that row is the network's output without any \
             descriptor. The closed form and the graph use true neighbours, which no real attacker has; the other rows need \
             the query alone, or the images of its map. Larger networks, or networks trained longer, reconstruct better images: no row is an \
             upper bound."
        }
        dl {
            dt { "PSNR" } dd { "Peak signal-to-noise ratio, decibels: higher is closer in brightness and colour." }
            dt { "SSIM" } dd { "Structural similarity, at most 1: higher is more alike in structure." }
            dt { "ST-LPIPS" } dd { "Shift-tolerant perceptual distance in the features of AlexNet, from 0: lower is more alike." }
            dt { "Objects found again" } dd { "Of the objects that a detector finds in the originals, how many it finds again, of the same class at the same position." }
            dt { "Recognised" } dd { "Of how many images an ImageNet classifier names the right class first, and among its five likeliest." }
            dt { "Wrong positions detected" } dd { "Area under the ROC curve of the network's confidence in positions; 0.5 is chance." }
            dt { "Share of the keypoints' gain" } dd { "The PSNR between nothing (0 %) and true keypoints (100 %)." }
        }
    }
}

#[cfg(test)]
mod tests {
    use base64::Engine as _;
    use base64::engine::general_purpose::STANDARD;
    use veiloc_features::ColourImage;

    use super::*;

    const HOSTILE: &str = "<script>alert('x')</script>.png";

    fn row(scheme: &str, attack: &'static str, psnr: f64) -> SummaryRow {
        SummaryRow {
            scheme: scheme.into(),
            attack,
            best_attack: None,
            mean_px: (scheme != "none").then_some(12.25),
            median_px: None,
            psnr,
            ssim: psnr / 30.0,
            private_psnr: None,
            st_lpips: None,
            top_1: None,
            top_5: None,
            objects: None,
            objects_found: None,
            roc_auc: None,
        }
    }

    fn shaded(shade: u8) -> Tile {
        let data = (0..20 * 16).flat_map(|i| [shade, (10 * (i % 20)) as u8, (10 * (i / 20)) as u8]).collect();
        Tile { image: ColourImage::new(20, 16, data).expect("three bytes a pixel"), boxes: Vec::new() }
    }

    fn evaluated() -> (InversionDocument, [ContactSheet; 2]) {
        let rebuilt = |scheme: &str, attack| ReconstructionRow {
            image: HOSTILE.into(),
            scheme: scheme.into(),
            attack,
            psnr: 14.0,
            ssim: 0.5,
            private_psnr: None,
            st_lpips: None,
            top_1: None,
            top_5: None,
            objects: None,
            objects_found: None,
            mean_px: None,
        };
        let network = NetworkRow {
            file: "unet.toml".into(),
            features: "sift".into(),
            dimension: 128,
            side: 48,
            has_visibility: false,
        };
        let document = InversionDocument {
            version: 1,
            command: "eval inversion",
            images: 1,
            k: 20,
            seed: 7,
            network,
            classes: None,
            summary: vec![
                row("points", "none", 16.0),
                row("dcl", "prior", 12.5),
                SummaryRow { best_attack: Some("transfer".into()), ..row("dcl", "realistic", 13.0) },
                row("none", "none", 12.0),
            ],
            rows: vec![rebuilt("points", "none"), rebuilt("dcl", "prior")],
        };
        let columns = ["original", "points none", "dcl guess"].map(str::to_owned).to_vec();
        let sheet = ContactSheet { columns, rows: vec![vec![shaded(1), shaded(2), shaded(3)]] };
        (document, [sheet, ContactSheet::default()])
    }

    #[test]
    fn table_has_all_rows_and_only_columns_with_values() {
        let (mut document, sheets) = evaluated();
        let page = inversion_page(&document, &sheets, &[]);
        for text in [
            "16.00 dB",
            "12.2 px",
            "Dual convergent lines",
            "Strongest without an oracle (transfer)",
            "unet.toml",
        ] {
            assert!(page.contains(text), "{text}");
        }
        for share in ["100 %", "12 %", "25 %", "0 %"] {
            assert!(page.contains(&format!("<td>{share}</td>")), "{share}");
        }
        let heads = |page: &str| page.matches("<th scope=\"col\"").count();
        assert_eq!(heads(&page), 2 + 4, "metrics without values have no column");
        for row in &mut document.summary {
            (row.st_lpips, row.top_1, row.top_5) = (Some(0.4321), Some(2), Some(5));
            (row.objects_found, row.objects) = (Some(3), Some(11));
        }
        document.summary[1].roc_auc = Some(0.815);
        let page = inversion_page(&document, &sheets, &[]);
        assert_eq!(heads(&page), 2 + 8);
        for text in ["0.432", "2 / 5", "3 of 11", "0.81", "–"] {
            assert!(page.contains(&format!("<td>{text}</td>")), "{text}");
        }
    }

    #[test]
    fn images_are_embedded_losslessly_and_names_escaped() {
        let (document, sheets) = evaluated();
        let page = inversion_page(&document, &sheets, &[("Seed".into(), "7".into())]);
        let images: Vec<&str> =
            page.split("data:image/png;base64,").skip(1).filter_map(|rest| rest.split('"').next()).collect();
        assert_eq!(images.len(), 3);
        for (encoded, shade) in images.iter().zip(1..) {
            let bytes = STANDARD.decode(encoded).expect("base64");
            let image = image::load_from_memory(&bytes).expect("an image").into_rgb8();
            assert_eq!(image.as_raw(), shaded(shade).drawn().data());
        }
        assert!(page.contains("<b>This file contains images</b>"));
        assert!(
            !page.contains("<script")
                && page.contains("alt=\"&lt;script&gt;alert('x')&lt;/script&gt;.png: Original.\"")
        );

        let none = [ContactSheet::default(), ContactSheet::default()];
        let without = inversion_page(&document, &none, &[]);
        assert!(!without.contains("data:image") && !without.contains("This file contains images"));
    }
}
