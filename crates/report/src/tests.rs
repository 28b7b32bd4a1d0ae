//! The page is whole, safe, and says what is missing.

use std::collections::BTreeMap;

use image::RgbImage;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_attacks::{
    ClosedFormOptions, ErrorSummary, NeighbourLists, Observation, bits_over_prior, closed_form, errors_px,
    lift, prior_only,
};
use veiloc_geometry::{CameraFromWorld, Intrinsics, Pencils, Pixel, PixelLine};
use veiloc_query::{AnchoredLine, Observations};
use veiloc_synth::{PathOptions, Place, RenderOptions};

use super::*;
use veiloc_audit::{Attack, AttackSummary};
use veiloc_results::SchemeSummary;

const SIZE: (u32, u32) = (640, 480);

fn attack(
    scheme: &str,
    sent: Observations,
    seen: &[Observation],
    truth: &[Pixel],
) -> (SchemePanel, Vec<AttackSummary>) {
    let lists = NeighbourLists::nearest(truth, 20);
    let options = ClosedFormOptions::default();
    let recovered: Vec<Pixel> = closed_form(seen, &lists, SIZE.0, SIZE.1, &options)
        .expect("lists fit")
        .iter()
        .map(|r| r.pixel)
        .collect();
    let guessed = prior_only(seen, SIZE.0, SIZE.1);
    let guess_errors = errors_px(guessed.clone(), truth);
    let rows = [(Attack::CLOSED_FORM, &recovered), (Attack::PRIOR, &guessed)].map(|(attack, answers)| {
        let errors = errors_px(answers.clone(), truth);
        let s = ErrorSummary::of(&errors);
        AttackSummary {
            scheme: scheme.into(),
            attack,
            images: 1,
            mean_px: s.mean_px,
            median_px: s.median_px,
            under_30px: s.under_30px,
            bits_over_prior: bits_over_prior(&errors, &guess_errors, SIZE.0, SIZE.1),
            ms: 0.4,
            ..AttackSummary::default()
        }
    });
    let panel =
        SchemePanel { scheme: scheme.into(), sent, truth: truth.to_vec(), recovered, guessed, size: SIZE };
    (panel, rows.into())
}

/// Places where the image has corners: enough like keypoints for a drawing.
fn corners(image: &image::GrayImage) -> Vec<Pixel> {
    let at = |x: u32, y: u32| f64::from(image.get_pixel(x, y).0[0]);
    let mut found = Vec::new();
    for y in (6..SIZE.1 - 6).step_by(6) {
        for x in (6..SIZE.0 - 6).step_by(6) {
            let bend = at(x + 3, y + 3) + at(x - 3, y - 3) - at(x + 3, y - 3) - at(x - 3, y + 3);
            if bend.abs() > 42.0 {
                found.push(Pixel::new(f64::from(x) + 0.5, f64::from(y) + 0.5));
            }
        }
    }
    found
}

fn summary(scheme: &str, centimetres: Option<f64>) -> SchemeSummary {
    SchemeSummary {
        scheme: scheme.into(),
        score: "likelihood".into(),
        queries: 12,
        localized: if centimetres.is_some() { 12 } else { 2 },
        median_rotation_deg: centimetres.map(|c| c * 0.1),
        median_translation: centimetres.map(|c| c * 0.01),
        recall: BTreeMap::from([
            ("0.05/5".into(), 0.92),
            ("0.25/2".into(), 1.0),
            ("nonsense".into(), f64::NAN),
        ]),
        mean_inlier_ratio: Some(0.61),
        sealed_bytes: Some(68_000),
        sent: None,
        median_ms: BTreeMap::from([("match".into(), 31.0), ("pose".into(), 12.4)]),
        ..SchemeSummary::default()
    }
}

/// A report on a rendered view: everything but the poses is measured.
fn sample() -> Report {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let place = Place::generate(7);
    let path = place.camera_path(&PathOptions::default());
    let camera: Intrinsics = "PINHOLE,640,480,525,525,320,240".parse().expect("valid");
    let view = place.render(&path.queries[7], &camera, &RenderOptions::default());
    let truth = corners(&view.gray());
    let pencils = Pencils::paper(SIZE.0, SIZE.1);
    let random: Vec<PixelLine> =
        truth.iter().map(|p| PixelLine::through(*p, rng.random_range(0.0..std::f64::consts::PI))).collect();
    let permuted = lift::coordinate_permutation(&truth, &mut rng);
    let pairs = permuted.iter().map(|o| o.lines().map(|l| l.expect("two"))).collect();
    let anchored = truth
        .iter()
        .map(|p| AnchoredLine {
            anchor: pencils.anchor_of(*p),
            angle: pencils.angle_of(pencils.anchor_of(*p), *p),
        })
        .collect();
    let seen: Vec<Observation> = random.iter().map(|l| Observation::Line(*l)).collect();
    let (mut schemes, mut attacks) = (Vec::new(), Vec::new());
    let halves = lift::dual_convergent(&truth, &pencils);
    for (panel, rows) in [
        attack("random-lines", Observations::Lines(random), &seen, &truth),
        attack("coordinate-permutation", Observations::EitherLine(pairs), &permuted, &truth),
        attack("dcl", Observations::Anchored { pencils, lines: anchored }, &halves, &truth),
    ] {
        schemes.push(panel);
        attacks.extend(rows);
    }
    let mut jitter = |size: f64| [0; 6].map(|_| rng.random_range(-size..size));
    let estimated = |k: usize, pose: &CameraFromWorld, jitter: &mut dyn FnMut(f64) -> [f64; 6]| match k {
        3 => None,
        5 => Some(pose.perturbed(&jitter(0.3))),
        _ => Some(pose.perturbed(&jitter(0.01))),
    };
    let cameras: Vec<_> =
        path.queries.iter().enumerate().map(|(k, p)| (*p, estimated(k, p, &mut jitter))).collect();
    let points = (0..SIZE.1)
        .step_by(4)
        .flat_map(|y| (0..SIZE.0).step_by(9).map(move |x| (x, y)))
        .filter_map(|(x, y)| view.point(x, y).map(|p| p.coords.into()))
        .collect();
    Report {
        title: "A place, hidden views, and what leaked".into(),
        lead: "A rendered room was mapped, twelve views of it were hidden behind lines and localized, and an attacker \
               tried to undo the hiding."
            .into(),
        cards: vec![
            Card {
                value: "12 of 12".into(),
                label: "hidden views localized".into(),
                note: "under dual convergent lines, from lines alone".into(),
            },
            Card {
                value: "1.1 cm".into(),
                label: "median position error".into(),
                note: "a finger's width, in a room of 6.8 by 5.8 metres".into(),
            },
            Card {
                value: "1 %".into(),
                label: "of keypoints recovered".into(),
                note: "to within 30 px by the geometry attack, though it was told all neighbours".into(),
            },
        ],
        localization: vec![summary("points", Some(0.4)), summary("random-lines", Some(0.9)), summary("dcl", None)],
        attacks,
        queries: vec![QueryPanel {
            name: "query_07.png".into(),
            image: view.rgb().clone(),
            keypoints: truth,
            schemes,
        }],
        top_view: Some(TopView {
            points,
            right: [1.0, 0.0, 0.0],
            up: [0.0, 1.0, 0.0],
            mapping: path.mapping,
            schemes: ["points", "dcl"]
                .map(|s| TopViewScheme { scheme: s.into(), cameras: cameras.clone() })
                .into(),
        }),
        details: vec![("seed".into(), "7".into())],
    }
}

/// Addresses that a browser would fetch: anything but data and places on the page.
fn outside_addresses(page: &str) -> Vec<&str> {
    ["src=\"", "href=\"", "url(", "@import", "http:", "https:", "//"]
        .iter()
        .flat_map(|mark| page.match_indices(mark).map(move |(at, _)| (at + mark.len(), *mark)))
        .map(|(at, mark)| (&page[at..page.len().min(at + 24)], mark))
        .filter(|(rest, mark)| !(mark.ends_with('"') && rest.starts_with("data:image/jpeg;base64,")))
        // Base64 holds slashes, two of them now and then.
        .filter(|(_, mark)| *mark != "//")
        .map(|(rest, _)| rest)
        .collect()
}

/// Places where a number that is none was written as one.
fn numbers_that_are_none(page: &str) -> Vec<&str> {
    // Not inside words, and not inside images: base64 has letters around it.
    let edge = |c: Option<char>| c.is_none_or(|c| !c.is_ascii_alphanumeric() && c != '+' && c != '/');
    ["NaN", "inf"]
        .iter()
        .flat_map(|bad| page.match_indices(bad))
        .filter(|(at, bad)| {
            edge(page[..*at].chars().next_back()) && edge(page[at + bad.len()..].chars().next())
        })
        .map(|(at, bad)| &page[at..at + bad.len()])
        .collect()
}

#[test]
fn the_page_is_whole_and_needs_no_network() {
    let page = html(&sample());
    if let Some(file) = std::env::var_os("VEILOC_REPORT_SAMPLE") {
        std::fs::write(file, &page).expect("the sample is written where the caller asked for it");
    }
    assert_eq!(outside_addresses(&page), Vec::<&str>::new());
    assert!(page.len() < 3_000_000, "{} bytes", page.len());
    assert!(!page.contains("<script"));
    assert_eq!(numbers_that_are_none(&page), Vec::<&str>::new());
    for tag in ["section", "figure", "table", "svg", "div", "tr", "ul", "figcaption", "main", "html"] {
        let (opened, closed) =
            (page.matches(&format!("<{tag}")).count(), page.matches(&format!("</{tag}>")).count());
        assert!(opened == closed && opened > 0, "{tag}: {opened} opened, {closed} closed");
    }
    // The median of the scheme that failed is in words, and one hidden view is marked as lost.
    assert!(page.contains("not localized") && page.contains("11 of 12 localized"));
    assert!(page.contains("within<br>5 cm, 5°") || page.contains("Within<br>5 cm, 5°"));
    assert_eq!(page.matches("aria-label=\"What is sent\"").count(), 3);
}

#[test]
fn names_cannot_become_markup() {
    let evil = "<script>alert(1)</script>\"'&";
    let mut report = Report {
        title: evil.into(),
        lead: evil.into(),
        cards: vec![Card { value: evil.into(), label: evil.into(), note: evil.into() }],
        localization: vec![summary(evil, Some(1.0))],
        attacks: vec![AttackSummary { scheme: evil.into(), ..AttackSummary::default() }],
        details: vec![(evil.into(), evil.into())],
        ..Report::default()
    };
    report.localization[0].median_ms.insert(evil.into(), 1.0);
    report.localization[0].recall.insert(evil.into(), 1.0);
    report.queries = vec![QueryPanel {
        name: evil.into(),
        image: RgbImage::new(8, 8),
        keypoints: vec![],
        schemes: vec![SchemePanel {
            scheme: evil.into(),
            sent: Observations::Points(vec![]),
            truth: vec![],
            recovered: vec![],
            guessed: vec![],
            size: (8, 8),
        }],
    }];
    let page = html(&report);
    assert!(!page.contains("<script") && !page.contains("alert(1)</script>"));
    assert!(page.contains("&lt;script&gt;alert(1)&lt;/script&gt;&quot;&#39;&amp;"));
}

#[test]
fn empty_and_broken_numbers_are_survived() {
    let bare = html(&Report::default());
    assert!(bare.ends_with("</html>\n") && !bare.contains("<section>"));
    let nan = Pixel::new(f64::NAN, f64::INFINITY);
    let report = Report {
        localization: vec![SchemeSummary { median_rotation_deg: Some(f64::NAN), ..summary("points", None) }],
        attacks: vec![AttackSummary {
            mean_px: f64::INFINITY,
            median_px: f64::NAN,
            under_30px: f64::NAN,
            bits_over_prior: f64::NAN,
            ..AttackSummary::default()
        }],
        queries: vec![QueryPanel {
            name: String::new(),
            image: RgbImage::new(0, 0),
            keypoints: vec![nan],
            schemes: vec![SchemePanel {
                scheme: "random-lines".into(),
                sent: Observations::Lines(vec![PixelLine::through(nan, 0.0)]),
                truth: vec![nan, nan],
                recovered: vec![nan],
                guessed: vec![],
                size: (0, 0),
            }],
        }],
        top_view: Some(TopView {
            points: vec![[f64::NAN; 3]],
            right: [1.0, 0.0, 0.0],
            up: [0.0, 1.0, 0.0],
            mapping: vec![],
            schemes: vec![],
        }),
        ..Report::default()
    };
    let page = html(&report);
    assert_eq!(numbers_that_are_none(&page), Vec::<&str>::new());
}
