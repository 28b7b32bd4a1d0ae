//! The report of the demo: a query in the pipeline, stage by stage, and the results of all queries.

use crate::attack_evaluation::{AttackDocument, ShownImage};
use image::RgbImage;
use maud::{Markup, html};
use veiloc_geometry::Pixel;

use super::attacks;
use veiloc_report::drawing::{self, Margin};
use veiloc_report::images::data_address;
use veiloc_report::localization::{
    LocalizationReport, QueryDrawing, figure, overview, queries_section, scene_title, scenes,
};
use veiloc_report::numbers::{scheme_explanation, scheme_name};
use veiloc_report::page::{self, Page, Section, fold};

/// Results of the demo. Any list may be empty; its section is then left out.
#[derive(Debug, Clone, Default)]
pub struct DemoReport {
    /// Heading, lead, large numbers, tables, the scene, the queries. The stages show the first drawn query.
    pub run: LocalizationReport,
    /// The image of the same query, with its keypoints.
    pub seen: Option<DeviceQuery>,
    /// Keypoints of that query as recovered by attacks.
    pub attacked: Option<ShownImage>,
    /// The attacks on all queries.
    pub attacks: AttackDocument,
}

/// A query on the device.
#[derive(Debug, Clone)]
pub struct DeviceQuery {
    /// Name of the query.
    pub name: String,
    /// The image that never leaves the device.
    pub image: RgbImage,
    /// Its keypoints, pixels.
    pub keypoints: Vec<Pixel>,
}

/// The report as one HTML document.
pub fn demo_page(report: &DemoReport) -> String {
    let run = &report.run;
    let or_nothing = |body: Option<Markup>| body.unwrap_or_default();
    let drawing = run.drawings.first().filter(|drawing| !drawing.sent.is_empty());
    let tables = overview(run);
    let found = html! {
        h3 { (scene_title(run)) }
        (scenes(run))
        h3 { "Errors of all queries" }
        (tables)
    };
    let page = Page {
        title: &run.title,
        lead: &run.lead,
        notices: run.notices.iter().map(|notice| html! { (notice) }).collect(),
        cards: &run.cards,
        sections: vec![
            Section::new("image", "1. The image", or_nothing(report.seen.as_ref().and_then(image))),
            Section::new("keypoints", "2. Keypoints", or_nothing(report.seen.as_ref().and_then(keypoints))),
            Section::new("lines", "3. Lines, sealed", or_nothing(drawing.map(lines))),
            Section::new("matched", "4. Matched to the map", or_nothing(drawing.map(matched))),
            Section::new("pose", "5. The pose", or_nothing((!tables.0.is_empty()).then_some(found))),
            Section::new("attacks", "6. Attacks on sealed queries", recovered(report)),
            Section::new("queries", "Queries, worst first", queries_section(run)),
        ],
        facts: &run.facts,
    };
    page.html()
}

/// An image with text beside it.
fn picture_with_text(picture: &Markup, caption: &Markup, text: &Markup) -> Markup {
    html! { div.see { (page::figure(picture, caption)) div { (text) } } }
}

fn image(seen: &DeviceQuery) -> Option<Markup> {
    let (w, h) = seen.image.dimensions();
    let address = data_address(&seen.image)?;
    let picture = html! {
        svg viewBox=(format!("0 0 {w} {h}")) role="img" aria-label="What the camera saw" {
            image #seen width=(w) height=(h) href=(address) {}
        }
    };
    let text = html! {
        p {
            b { "On the device." } " This image is never sent. The stages below show what the device computes from it, what crosses \
             the network, what the server computes, and what an attacker recovers."
        }
    };
    Some(picture_with_text(
        &picture,
        &html! { b { "What the camera saw." } " Query " (seen.name) "." },
        &text,
    ))
}

fn keypoints(seen: &DeviceQuery) -> Option<Markup> {
    let (w, h) = seen.image.dimensions();
    if w == 0 || h == 0 {
        return None;
    }
    let points = drawing::dots(seen.keypoints.iter().copied());
    let picture = html! {
        svg.picture viewBox=(format!("0 0 {w} {h}")) role="img" aria-label="The image with its keypoints" {
            use href="#seen" {}
            path class="dot ring" d=(points) {}
            path class="dot keypoint" d=(points) {}
        }
    };
    let text = html! {
        p {
            b { "On the device." } " A keypoint is a point of an image that can be found again in other images. Each comes with a \
             descriptor, a vector that describes its surroundings."
        }
        p {
            "A network can reconstruct the image from keypoints and descriptors: a scheme must hide the positions of the keypoints."
        }
    };
    Some(picture_with_text(&picture, &html! { b { (seen.keypoints.len()) " keypoints." } }, &text))
}

fn lines(query: &QueryDrawing) -> Markup {
    html! {
        p {
            b { "What crosses the network." } " All that the server gets about positions, under each scheme. Rows are shuffled, and \
             some schemes add decoys."
        }
        div.two {
            @for sent in &query.sent {
                @let name = scheme_name(&sent.scheme);
                @let (drawn, remark) = drawing::sent(&sent.sent, sent.size);
                @let label = format!("What is sent under {name}");
                (page::figure(
                    &drawing::picture(&label, sent.size, Margin::Narrow, &drawn),
                    &html! { b { (name) "." } " " (scheme_explanation(&sent.scheme)) " " (remark) },
                ))
            }
        }
    }
}

fn matched(query: &QueryDrawing) -> Markup {
    html! {
        p {
            b { "On the server." } " Descriptors are matched to those of map points. Some of the matches agree with the pose, its inliers \
             (green); others do not (orange). The dots are the map points of inliers as the pose projects them, which a server that has \
             found the pose knows of the image."
        }
        div.two { @for sent in &query.sent { (figure(sent, &html! {})) } }
    }
}

fn recovered(report: &DemoReport) -> Markup {
    if report.attacks.attacks.is_empty() {
        return html! {};
    }
    html! {
        p { "The attacker sees what the server sees, and tries to recover the position of every keypoint." }
        (attacks::summary(&report.attacks))
        @if let Some(shown) = &report.attacked {
            h3 { "Recovered keypoints of the query" }
            (attacks::gallery(shown, &report.attacks, "attacked"))
        }
        (fold("Table: every attack on every scheme", false, &attacks::table(&report.attacks, &[])))
    }
}
