//! The demo's page: a query on its way, stage by stage as the pipeline runs, and at each stage what became of all.

use std::fmt::Write as _;

use crate::attacked;
use crate::data::{Report, SeenQuery};
use crate::embed::data_address;
use crate::format::{escape, scheme_words};
use crate::run::{QueryDrawing, figure, overview, place_title, places, queries_section};
use crate::sent::{self, dots};
use crate::shell::{self, Section, cards, details};
use crate::tables;

/// The page: one HTML document. Lists that are empty are left out, numbers that are missing are said to be.
pub fn html(report: &Report) -> String {
    let run = &report.run;
    let section = |id, title: &str, body| Section { id, title: title.to_owned(), body };
    let seen = report.seen.as_ref();
    let drawing = run.drawings.first();
    let sections = [
        section("image", "1. The image", seen.map(image).unwrap_or_default()),
        section("keypoints", "2. Keypoints", seen.map(keypoints).unwrap_or_default()),
        section("lines", "3. Lines, sealed", drawing.map(lines).unwrap_or_default()),
        section("matched", "4. Matched to the map", drawing.map(matched).unwrap_or_default()),
        section("pose", "5. The pose", pose(report)),
        section("attacks", "6. What attackers get", attacks(report)),
        section("queries", "Queries, worst first", queries_section(run)),
        details(&run.details),
    ];
    shell::page(&run.title, &run.lead, &cards(&run.cards), &sections)
}

fn image(seen: &SeenQuery) -> String {
    let (w, h) = seen.image.dimensions();
    let Some(address) = data_address(&seen.image) else { return String::new() };
    format!(
        "<div class=\"see\"><figure><svg viewBox=\"0 0 {w} {h}\" role=\"img\" aria-label=\"What the camera saw\">\
         <image id=\"seen\" width=\"{w}\" height=\"{h}\" href=\"{address}\"/></svg><figcaption><b>What the camera saw.</b> Query \
         {}.</figcaption></figure><div><p><b>On the device.</b> This image is never sent. The stages below follow it: what the \
         device makes of it, what crosses the network, what the server does with that, and what somebody gets who attacks \
         it.</p></div></div>",
        escape(&seen.name),
    )
}

fn keypoints(seen: &SeenQuery) -> String {
    let (w, h) = seen.image.dimensions();
    if w == 0 || h == 0 {
        return String::new();
    }
    let points = dots(seen.keypoints.iter().copied());
    format!(
        "<div class=\"see\"><figure><svg viewBox=\"0 0 {w} {h}\" role=\"img\" aria-label=\"Image with keypoints\">\
         <use href=\"#seen\"/><path class=\"dot keypoint\" d=\"{points}\"/><path class=\"dot keypoint2\" d=\"{points}\"/></svg>\
         <figcaption><b>{} keypoints.</b></figcaption></figure><div><p><b>On the device.</b> A keypoint is a place in an image that \
         can be found again in other images. Each comes with a descriptor, a fingerprint of what the place looks like.</p><p>Where \
         keypoints are known, an image can be drawn from them: their positions are what a scheme must hide.</p></div></div>",
        seen.keypoints.len(),
    )
}

fn lines(drawing: &QueryDrawing) -> String {
    if drawing.sent.is_empty() {
        return String::new();
    }
    let mut out = String::from(
        "<p><b>What crosses the network.</b> All that the server gets about positions, under each scheme. Rows are shuffled, and \
         some schemes add decoys.</p><div class=\"four\">",
    );
    for sent in &drawing.sent {
        let (name, what) = scheme_words(&sent.scheme);
        let (drawn, remark) = sent::sent(&sent.sent, sent.size);
        let (w, h) = sent.size;
        let _ = write!(
            out,
            "<figure><svg viewBox=\"{}\" role=\"img\" aria-label=\"What is sent under {name}\"><rect class=\"frame\" \
             width=\"{w}\" height=\"{h}\"/>{drawn}</svg><figcaption><b>{name}.</b> {what} {remark}</figcaption></figure>",
            sent::view_box(sent.size),
        );
    }
    out + "</div>"
}

fn matched(drawing: &QueryDrawing) -> String {
    if drawing.sent.is_empty() {
        return String::new();
    }
    let mut out = String::from(
        "<p><b>On the server.</b> Descriptors are matched to those of map points. A pose makes some of the matches agree (green) and \
         not others (orange); the dots are where it puts the map points of agreeing rows, which is what a server knows of the \
         image that has found the pose.</p><div class=\"four\">",
    );
    for sent in &drawing.sent {
        out.push_str(&figure(sent, ""));
    }
    out + "</div>"
}

fn pose(report: &Report) -> String {
    let (space, tables) = (places(&report.run), overview(&report.run));
    if space.is_empty() {
        return tables;
    }
    let title = place_title(&report.run);
    format!("<h3>{title}</h3>{space}<h3>How well cameras are found</h3>{tables}")
}

fn attacks(report: &Report) -> String {
    let (figures, table) = (attacked::figures(&report.attacked), tables::attacks(&report.attacks));
    if figures.is_empty() && table.is_empty() {
        return String::new();
    }
    format!(
        "<p>The attacker sees what the server sees and tries to put every keypoint back into the image. Each attack stands \
         beside the guess, which uses nothing but the single line: an attack is only worth something where it beats the guess. One \
         succeeds that puts half of the keypoints to within 10 px, tells something with a median under three quarters of the \
         guess's, and fails otherwise. \
         Attacks that an oracle told which keypoints are neighbours show what that knowledge would be worth; nobody is known to \
         have it. What attackers get without it is in docs/audit.md.</p>{figures}{}",
        if table.is_empty() { String::new() } else { format!("<h3>All attacks on all queries</h3>{table}") }
    )
}
