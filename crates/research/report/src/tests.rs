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
use veiloc_protocol::{AnchoredLine, Observations};
use veiloc_synthetic::{PathOptions, Place, RenderOptions};

use super::*;
use veiloc_evaluation::audit::{Attack, AttackSummary};
use veiloc_evaluation::results::SchemeSummary;
use veiloc_pose::State;

const SIZE: (u32, u32) = (640, 480);

fn attack(scheme: &str, seen: &[Observation], truth: &[Pixel]) -> (AttackedScheme, Vec<AttackSummary>) {
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
    let by = |attack, answers| AttackedBy { attack, told: true, answers };
    let attacks = vec![by(Attack::CLOSED_FORM, recovered), by(Attack::GRAPH, truth.to_vec())];
    let drawn = AttackedScheme { scheme: scheme.into(), truth: truth.to_vec(), size: SIZE, guessed, attacks };
    (drawn, rows.into())
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
    let (mut attacked, mut attacks) = (Vec::new(), Vec::new());
    let halves = lift::dual_convergent(&truth, &pencils);
    for (drawn, rows) in [
        attack("random-lines", &seen, &truth),
        attack("coordinate-permutation", &permuted, &truth),
        attack("dcl", &halves, &truth),
    ] {
        attacked.push(drawn);
        attacks.extend(rows);
    }
    let sent = [
        ("random-lines", Observations::Lines(random)),
        ("coordinate-permutation", Observations::EitherLine(pairs)),
        ("dcl", Observations::Anchored { pencils, lines: anchored }),
    ];
    let states = [RowState::Agrees, RowState::Disagrees, RowState::Unmatched];
    let sent = sent.map(|(scheme, sent)| SentDrawing {
        scheme: scheme.into(),
        rows: (0..sent.len()).map(|row| states[row % 3]).collect(),
        sent,
        size: SIZE,
        projected: truth.iter().copied().step_by(3).collect(),
    });
    let name = |k: usize| format!("query_{k:02}.png");
    let mut jitter = |size: f64| [0; 6].map(|_| rng.random_range(-size..size));
    let mut outcomes = Vec::new();
    for row in 0..3 {
        for (k, truth) in path.queries.iter().enumerate() {
            let size = if k == 5 { 0.3 } else { 0.01 };
            let estimate = (k != 3).then(|| truth.perturbed(&jitter(size)));
            outcomes.push(QueryOutcome {
                row,
                name: name(k),
                truth: Some(*truth),
                estimate,
                state: Some([State::Trusted, State::Doubtful][usize::from(k == 5)]),
                position_error: estimate.map(|e| e.translation_error(truth)),
                rotation_error_deg: estimate.map(|e| e.rotation_error_degrees(truth)),
                position_sd: estimate.map(|_| 0.006),
                rotation_sd_deg: Some(0.1),
                inliers: 120,
                matches: 200,
                bytes: Some(68_000),
                ms: Some(43.4),
                remark: (k == 7).then(|| "few matches agree".to_owned()),
            });
        }
    }
    let points = (0..SIZE.1)
        .step_by(4)
        .flat_map(|y| (0..SIZE.0).step_by(9).map(move |x| (x, y)))
        .filter_map(|(x, y)| view.point(x, y).map(|p| p.coords.into()))
        .collect();
    let row = |scheme: &str, centimetres| RunRow {
        scheme: scheme.into(),
        summary: Some(summary(scheme, centimetres)),
        ..RunRow::default()
    };
    let mut run = RunReport {
        title: "A place, hidden views, and what leaked".into(),
        lead: "A rendered room was mapped, twelve views of it were hidden behind lines and localized, and an attacker \
               tried to undo the hiding."
            .into(),
        remarks: vec!["This file contains an image.".into()],
        rows: vec![
            row("random-lines", Some(0.9)),
            row("coordinate-permutation", Some(0.4)),
            row("dcl", None),
        ],
        outcomes,
        places: vec![PlaceView { name: String::new(), points, mapping: path.mapping, up: None }],
        drawings: vec![QueryDrawing {
            place: 0,
            name: name(7),
            image: Some(view.rgb().clone()),
            sent: sent.into(),
        }],
        details: vec![("seed".into(), "7".into())],
        ..RunReport::default()
    };
    run.add_cards();
    let seen = SeenQuery { name: name(7), image: view.rgb().clone(), keypoints: truth };
    Report { run, seen: Some(seen), attacked, attacks }
}

/// Addresses that a browser would fetch: anything but data and places on the page.
fn outside_addresses(page: &str) -> Vec<&str> {
    ["src=\"", "href=\"", "url(", "@import", "http:", "https:", "//"]
        .iter()
        .flat_map(|mark| page.match_indices(mark).map(move |(at, _)| (at + mark.len(), *mark)))
        .map(|(at, mark)| (&page[at..page.len().min(at + 24)], mark))
        .filter(|(rest, mark)| {
            !(mark.ends_with('"') && (rest.starts_with("data:image/jpeg;base64,") || rest.starts_with('#')))
        })
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

/// Tags that must be closed, and those a page of ours always has.
fn check_whole(page: &str) {
    assert_eq!(outside_addresses(page), Vec::<&str>::new());
    assert!(page.len() < 3_000_000, "{} bytes", page.len());
    let before_script = &page[..page.rfind("<script>").expect("a script")];
    assert_eq!(numbers_that_are_none(before_script), Vec::<&str>::new());
    for tag in
        ["section", "figure", "table", "svg", "div", "tr", "ul", "figcaption", "main", "html", "details"]
    {
        let (opened, closed) =
            (page.matches(&format!("<{tag}")).count(), page.matches(&format!("</{tag}>")).count());
        assert!(opened == closed && opened > 0, "{tag}: {opened} opened, {closed} closed");
    }
    // What the page's own policy would not let a browser do.
    let body = &page[page.find("<body>").expect("a body")..page.rfind("<script>").expect("a script")];
    assert!(!body.contains(" style=") && !body.contains(" onclick") && !body.contains("javascript:"));
    // The place's data and nothing else.
    assert_eq!(body.matches("<script").count(), body.matches("<script type=\"application/json\"").count());
    // Names on the page are each there once, and every reference has its name.
    let named = |mark: &str| -> Vec<&str> {
        body.match_indices(mark).filter_map(|(at, _)| body[at + mark.len()..].split('"').next()).collect()
    };
    let mut ids = named(" id=\"");
    for reference in named(" href=\"#") {
        assert!(ids.contains(&reference), "{reference}");
    }
    ids.sort_unstable();
    assert!(ids.windows(2).all(|pair| pair[0] != pair[1]), "{ids:?}");
}

#[test]
fn pages_are_whole_and_need_no_network() {
    let report = sample();
    for (name, page) in [("demo.html", html(&report)), ("run.html", run_page(&report.run))] {
        if let Some(folder) = std::env::var_os("VEILOC_REPORT_SAMPLES") {
            let path = std::path::Path::new(&folder).join(name);
            std::fs::write(path, &page).expect("samples are written where the caller asked for them");
        }
        check_whole(&page);
        // The median of the scheme that failed is in words, and one hidden view is lost.
        assert!(page.contains("not localized") && page.contains("11 of 12 localized"));
        assert!(page.contains("Within<br>5 cm, 5°"));
        assert_eq!(page.matches("aria-label=\"Rows under ").count(), if name == "run.html" { 3 } else { 6 });
    }
}

#[test]
fn the_demo_shows_stages_as_the_pipeline_runs_and_the_best_attack_first() {
    let page = html(&sample());
    let stages =
        ["1. The image", "2. Keypoints", "3. Lines", "4. Matched", "5. The pose", "6. What attackers"];
    let at: Vec<usize> =
        stages.iter().map(|stage| page.find(&format!("<h2>{stage}")).expect(stage)).collect();
    assert!(at.is_sorted(), "{at:?}");
    // The graph attack of the sample answers the truth itself: it succeeds, and stands before the closed form.
    let drawn =
        &page[page.find("<h3>Random lines</h3><div class=\"row\">").expect("attacks on random lines")..];
    let (best, other) = (drawn.find("Layout of the neighbour graph"), drawn.find("closed form"));
    assert!(best < other, "{best:?} {other:?}");
    assert!(drawn.contains("<span class=\"verdict succeeds\">succeeds</span> 100 % of the keypoints"));
}

#[test]
fn queries_come_worst_first_and_lists_lead_to_their_drawings() {
    let run = sample().run;
    let page = run_page(&run);
    let worst = worst_first(&run.rows, &run.outcomes);
    assert_eq!([&worst[0].1, &worst[1].1], ["query_03.png", "query_05.png"]);
    assert!(page.contains("<details class=\"query\" id=\"query-0\" open>"));
    assert!(page.contains("\"n\":\"query_07.png\"") && page.contains("\"id\":\"query-0\""));
    assert!(page.contains("few matches agree"));
    let bare = run_page(&RunReport { drawings: Vec::new(), ..run });
    assert!(!bare.contains("data:image/jpeg") && bare.contains("Queries that are not drawn"));
}

#[test]
fn names_cannot_become_markup() {
    let evil = "<script>alert(1)</script>\"'&";
    let mut report = sample();
    let run = &mut report.run;
    run.title = evil.into();
    run.lead = evil.into();
    run.remarks = vec![evil.into()];
    run.cards = vec![Card { value: evil.into(), label: evil.into(), note: evil.into() }];
    run.details = vec![(evil.into(), evil.into())];
    run.places[0].name = evil.into();
    run.drawings[0].name = evil.into();
    for row in &mut run.rows {
        row.scheme = evil.into();
        row.beside = evil.into();
        row.condition = Some(evil.into());
        let summary = row.summary.as_mut().expect("a summary");
        summary.median_ms.insert(evil.into(), 1.0);
        summary.recall.insert(evil.into(), 1.0);
    }
    for outcome in &mut run.outcomes {
        outcome.name = evil.into();
        outcome.remark = Some(evil.into());
    }
    run.figures =
        vec![RunFigure { caption: evil.into(), svg: "<svg width=\"8\" height=\"8\"></svg>".into() }];
    report.attacks = vec![AttackSummary { scheme: evil.into(), ..AttackSummary::default() }];
    report.attacked[0].scheme = evil.into();
    report.seen.as_mut().expect("seen").name = evil.into();
    let scripts = |page: &str| page.matches("<script").count();
    for (page, clean) in [(html(&report), html(&sample())), (run_page(&report.run), run_page(&sample().run))]
    {
        assert_eq!(scripts(&page), scripts(&clean));
        assert!(!page.contains("alert(1)</script>"));
        assert!(page.contains("&lt;script&gt;alert(1)&lt;/script&gt;&quot;&#39;&amp;"));
    }
}

#[test]
fn empty_and_broken_numbers_are_survived() {
    let bare = html(&Report::default());
    assert!(bare.ends_with("</html>\n") && !bare.contains("<section"));
    let nan = Pixel::new(f64::NAN, f64::INFINITY);
    let lost = QueryOutcome { row: 9, position_error: Some(f64::NAN), ..QueryOutcome::default() };
    let broken = QueryOutcome {
        truth: Some(CameraFromWorld::identity()),
        estimate: Some(CameraFromWorld::identity()),
        position_error: Some(f64::NAN),
        rotation_error_deg: Some(f64::INFINITY),
        position_sd: Some(f64::INFINITY),
        ms: Some(f64::NAN),
        ..QueryOutcome::default()
    };
    let summary = SchemeSummary { median_rotation_deg: Some(f64::NAN), ..summary("points", None) };
    let run = RunReport {
        rows: vec![RunRow { scheme: "points".into(), summary: Some(summary), ..RunRow::default() }],
        outcomes: vec![lost, broken],
        figures: vec![RunFigure { caption: String::new(), svg: "no drawing".into() }],
        places: vec![PlaceView { points: vec![[f64::NAN; 3], [1.0, 2.0, 3.0]], ..PlaceView::default() }],
        drawings: vec![QueryDrawing {
            place: 7,
            name: String::new(),
            image: Some(RgbImage::new(0, 0)),
            sent: vec![SentDrawing {
                scheme: "random-lines".into(),
                sent: Observations::Lines(vec![PixelLine::through(nan, 0.0)]),
                size: (0, 0),
                rows: vec![],
                projected: vec![nan],
            }],
        }],
        ..RunReport::default()
    };
    let report = Report {
        run,
        seen: Some(SeenQuery { name: String::new(), image: RgbImage::new(0, 0), keypoints: vec![nan] }),
        attacked: vec![AttackedScheme {
            scheme: "random-lines".into(),
            truth: vec![nan, nan],
            size: (0, 0),
            guessed: vec![],
            attacks: vec![AttackedBy { attack: Attack::GRAPH, told: false, answers: vec![nan] }],
        }],
        attacks: vec![AttackSummary {
            mean_px: f64::INFINITY,
            median_px: f64::NAN,
            under_30px: f64::NAN,
            bits_over_prior: f64::NAN,
            ..AttackSummary::default()
        }],
    };
    for page in [html(&report), run_page(&report.run)] {
        let body = &page[..page.rfind("<script>").expect("a script")];
        assert_eq!(numbers_that_are_none(body), Vec::<&str>::new());
    }
}
