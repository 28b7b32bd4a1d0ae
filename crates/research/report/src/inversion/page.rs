//! The page: what it holds, the conclusion in numbers, the table, the images, how to read them, how to repeat it.

use std::fmt::Write as _;

use veiloc_evaluation::audit::count;

use super::table::{attack_words, given, table};
use super::{InversionReport, InversionRow, InversionSheet, SheetTile};
use crate::card::Card;
use crate::embed::exact_address;
use crate::format::escape;
use crate::shell::{self, Section, cards, details};

/// The page as one HTML document that loads nothing.
pub fn inversion_page(report: &InversionReport) -> String {
    let section = |id, title: &str, body| Section { id, title: title.to_owned(), body };
    let mut sections = vec![section("table", "Table 1: images made of what attacks recover", means(report))];
    for (sheet, id) in report.sheets.iter().zip(["sheet", "wide"]) {
        sections.push(section(id, &sheet.title, tiles(sheet)));
    }
    sections.push(section("read", "How to read this", HOW_TO_READ.to_owned()));
    sections.push(details(&report.details));
    let lead = format!(
        "{} went through a network that makes images of descriptors: with the keypoints as they are, with what attacks recover \
         of what is sent under each scheme, and with nothing at all.",
        count(report.images, "image"),
    );
    let top = format!("{}{}", private(report), cards(&numbers(&report.rows)));
    shell::page("What images can be made of queries", &lead, &top, &sections)
}

/// Who gets the file gets the images: that stands above everything else.
fn private(report: &InversionReport) -> &'static str {
    if report.sheets.iter().all(|sheet| sheet.images.is_empty()) {
        ""
    } else {
        "<p class=\"private\"><b>This file contains images</b>: the originals, made small, and what was made of their descriptors, \
         which is what the schemes are there to prevent. It is for whoever owns them. Nothing was sent anywhere to make it; do not \
         publish it or pass it on without thinking of the people and places in it. <code>--shown 0</code> leaves the images out.</p>"
    }
}

fn numbers(rows: &[InversionRow]) -> Vec<Card> {
    let card = |row: &InversionRow, label: &str, note: String| Card {
        value: format!("{:.2} dB", row.psnr),
        label: label.to_owned(),
        note,
    };
    let of = |scheme: &str| rows.iter().find(|row| row.scheme == scheme);
    let mut found = Vec::new();
    if let Some(row) = of("points") {
        found.push(card(row, "Keypoints as they are", "What the network can do, by PSNR.".to_owned()));
    }
    let told_nothing = |row: &&InversionRow| ["guess", "realistic", "lines"].contains(&row.attack.as_str());
    if let Some(row) = rows.iter().filter(told_nothing).max_by(|a, b| a.psnr.total_cmp(&b.psnr)) {
        let note = format!(
            "{}: {}.",
            veiloc_evaluation::audit::scheme_words(&row.scheme),
            row.by.as_deref().unwrap_or(&row.attack)
        );
        found.push(card(row, "Best of who is told nothing", note));
    }
    if let Some(row) = of("nothing") {
        found.push(card(
            row,
            "Nothing at all",
            "An answer without any descriptor; no more is a leak.".to_owned(),
        ));
    }
    found
}

fn means(report: &InversionReport) -> String {
    let table = table(&report.rows);
    if table.is_empty() {
        return table;
    }
    let mut out =
        format!("<p>Means over {}, on the networks' grids.</p>{table}", count(report.images, "image"));
    for network in &report.networks {
        let _ = write!(out, "<p class=\"note\">{}</p>", escape(network));
    }
    out
}

fn tiles(sheet: &InversionSheet) -> String {
    if sheet.images.is_empty() {
        return String::new();
    }
    let mut out = format!("<p>{}</p>", escape(&sheet.note));
    for image in &sheet.images {
        let _ = write!(out, "<h3>{}</h3><div class=\"tiles\">", escape(&image.name));
        for tile in &image.tiles {
            out.push_str(&tile_of(&image.name, tile));
        }
        out.push_str("</div>");
    }
    out
}

fn tile_of(name: &str, tile: &SheetTile) -> String {
    let Some(address) = exact_address(tile.size, &tile.pixels) else { return String::new() };
    let [width, height] = tile.size;
    let (what, attack) = match &tile.of {
        None => ("Original".to_owned(), String::new()),
        Some([scheme, attack]) if attack == "none" => (given(scheme), String::new()),
        Some([scheme, attack]) => (given(scheme), format!(" {}.", attack_words(attack, None))),
    };
    format!(
        "<figure><img width=\"{width}\" height=\"{height}\" alt=\"{}: {what}{attack}\" src=\"{address}\"><figcaption><b>{what}.</b>\
         {attack} {}</figcaption></figure>",
        escape(name),
        escape(&tile.scores),
    )
}

const HOW_TO_READ: &str = "\
<p>Where keypoints and descriptors are known, a network can draw an image of them. A scheme hides where keypoints are; an attack \
says where they were, and the network draws an image of that. The more the result is like the original, the more was told.</p>\
<p><b>Scores near those of nothing are not worth calling an image</b>: that row is what the network answers that was given no \
descriptor. Closed form and graph are told which keypoints are neighbours, which nobody is known to know; the other rows are what \
somebody gets who has the query, or the images of its map. Other networks, larger or trained longer, make better images of the \
same: no row is an upper bound.</p>\
<dl><dt>PSNR</dt><dd>Peak signal-to-noise ratio, decibels: the higher, the closer in brightness and colour.</dd>\
<dt>SSIM</dt><dd>Structural similarity, to 1: the higher, the more alike in structure.</dd>\
<dt>LPIPS, feature distance</dt><dd>Distances in the eyes of networks, from 0: the lower, the more alike. They do not compare with \
each other.</dd>\
<dt>Objects</dt><dd>Of the objects that a detector finds in the originals, as many are found again, of the same class in the same \
place.</dd>\
<dt>Wrong places told apart</dt><dd>How often the network believes a keypoint in its right place more than one in a wrong place; \
50 % is chance.</dd>\
<dt>Of what keypoints give</dt><dd>Where the PSNR lies between nothing (0 %) and keypoints as they are (100 %).</dd></dl>";
