//! Reports contain the measured values, load nothing, are accessible, and escape all names.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use crate::attack_evaluation::{
    Attack, AttackEvaluation, AttackSummary, Audit, AuditOptions, ImageGroup, PROTECTION, run_audit,
};
use crate::results::SchemeSummary;
use image::{Rgb, RgbImage};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_datasets::problem_files::{KeypointImage, synthetic_image};
use veiloc_geometry::{CameraFromWorld, Pixel, PixelLine};
use veiloc_pose::State;
use veiloc_protocol::{Observations, Scheme};
use veiloc_synthetic::{PathOptions, RenderedRoom};

use veiloc_report::{
    Card, LengthUnit, LocalizationReport, MatchState, Method, QueryDrawing, QueryOutcome, SceneView,
    SentDrawing, localization_page, worst_first,
};

use super::*;

const HOSTILE: &str = "<script>alert(1)</script>\"'&";

/// An audit of one image with this name, and of the synthetic scene.
fn audited(image: KeypointImage, synthetic: usize, file: Option<&std::path::Path>) -> (Audit, AuditOptions) {
    let options = AuditOptions {
        evaluation: AttackEvaluation {
            synthetic,
            schemes: vec![Scheme::RandomLines, Scheme::CoordinatePermutation, Scheme::default()],
            attacks: vec![Attack::CLOSED_FORM, "closed-form-in-image".parse().expect("an attack")],
            corrupt: vec![0.0, 30.0],
            seed: 5,
            groups: vec![ImageGroup { name: "images".to_owned(), images: vec![image] }],
            ..AttackEvaluation::default()
        },
        shown: 1,
        command: "veiloc audit <x>".to_owned(),
    };
    let audit = run_audit(&options, &|_, _| file.map(Into::into), &()).expect("it runs");
    (audit, options)
}

fn summary(scheme: &str, error: Option<f64>) -> SchemeSummary {
    SchemeSummary {
        scheme: scheme.into(),
        score: "likelihood".into(),
        queries: 12,
        localized: if error.is_some() { 11 } else { 2 },
        trusted: Some(10),
        median_rotation_deg: error.map(|e| 10.0 * e),
        median_translation: error,
        recall: BTreeMap::from([
            ("0.05/5".into(), 0.92),
            ("0.25/2".into(), 1.0),
            ("nonsense".into(), f64::NAN),
        ]),
        mean_inlier_ratio: Some(0.61),
        sealed_bytes: Some(68_000),
        median_ms: BTreeMap::from([("match".into(), 31.0), ("pose".into(), 12.4)]),
        ..SchemeSummary::default()
    }
}

/// A demo report: cameras of a rendered scene, and attacks on uniform keypoints. Created once.
fn sample() -> DemoReport {
    static SAMPLE: LazyLock<DemoReport> = LazyLock::new(made);
    SAMPLE.clone()
}

fn made() -> DemoReport {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let path = RenderedRoom::generate(7).camera_path(&PathOptions::default());
    let (audit, _) = audited(synthetic_image(150, 8), 0, None);
    let part = audit.document.inputs.expect("inputs");
    let shown = audit.inputs.expect("inputs").shown.remove(0);
    let states = [MatchState::Inlier, MatchState::Outlier, MatchState::Unmatched];
    let sent: Vec<SentDrawing> = shown
        .schemes
        .iter()
        .map(|scheme| SentDrawing {
            scheme: scheme.scheme.to_string(),
            rows: (0..scheme.sent.len()).map(|row| states[row % 3]).collect(),
            sent: scheme.sent.clone(),
            size: shown.size,
            projected: shown.truth.iter().copied().step_by(3).collect(),
        })
        .collect();
    let name = |k: usize| format!("query_{k:02}.png");
    let mut outcomes = Vec::new();
    for method in 0..3 {
        for (k, truth) in path.queries.iter().enumerate() {
            let size = if k == 5 { 0.3 } else { 0.01 };
            let estimate = (k != 3).then(|| truth.perturbed(&[0; 6].map(|_| rng.random_range(-size..size))));
            outcomes.push(QueryOutcome {
                method,
                name: name(k),
                truth: Some(*truth),
                estimate,
                state: Some(if k == 5 { State::Doubtful } else { State::Trusted }),
                position_error: estimate.map(|e| e.translation_error(truth)),
                rotation_error_deg: estimate.map(|e| e.rotation_error_degrees(truth)),
                position_sd: estimate.map(|_| 0.000_02),
                rotation_sd_deg: Some(0.1),
                inliers: 120,
                matches: 200,
                bytes: Some(68_000),
                ms: Some(43.4),
                remark: (k == 7).then(|| "few matches agree".to_owned()),
            });
        }
    }
    let method = |scheme: &str, error| Method {
        scheme: scheme.into(),
        figures: Some(fill::figures_of(&summary(scheme, error))),
        ..Method::default()
    };
    let image = RgbImage::from_fn(640, 480, |x, y| Rgb([x as u8, y as u8, 90]));
    let points = (0..900).map(|i| [f64::from(i % 30) * 0.1, f64::from(i / 30) * 0.1, 0.5]).collect();
    let mut run = LocalizationReport {
        title: "A scene".into(),
        lead: "A rendered room.".into(),
        notices: vec!["This file contains an image.".into()],
        methods: vec![
            method("random-lines", Some(0.009)),
            method("coordinate-permutation", Some(0.004)),
            method("dcl", None),
        ],
        outcomes,
        scenes: vec![SceneView { points, cameras: path.mapping, ..SceneView::default() }],
        drawings: vec![QueryDrawing {
            scene: 0,
            name: name(7),
            image: Some(image.clone()),
            is_undistorted: true,
            sent,
        }],
        facts: vec![("Seed".into(), "7".into())],
        ..LocalizationReport::default()
    };
    run.add_cards();
    let seen = DeviceQuery { name: name(7), image, keypoints: shown.truth.clone() };
    DemoReport { run, seen: Some(seen), attacked: Some(shown), attacks: part.attacks }
}

/// The body up to the script.
fn body(page: &str) -> &str {
    let end = page.rfind("<script>").unwrap_or(page.len());
    &page[page.find("<body>").expect("a body")..end]
}

/// Values of an attribute.
fn values<'a>(page: &'a str, attribute: &str) -> Vec<&'a str> {
    let mark = format!(" {attribute}=\"");
    page.match_indices(&mark).filter_map(|(at, _)| page[at + mark.len()..].split('"').next()).collect()
}

/// Properties of every page.
fn check(page: &str) {
    let body = body(page);
    assert!(page.len() < 3_000_000, "{} bytes", page.len());
    assert!(page.contains("content=\"default-src 'none'; img-src data:;"));
    // The page fetches nothing and respects its own policy.
    for address in values(body, "src").into_iter().chain(values(body, "href")) {
        assert!(address.starts_with('#') || address.starts_with("data:image/"), "{address}");
    }
    for bad in
        [" style=", " onclick", "javascript:", "url(", "@import", "http:", "https:", "<link", "<iframe"]
    {
        assert!(!body.contains(bad), "{bad}");
    }
    assert_eq!(body.matches("<script").count(), body.matches("<script type=\"application/json\"").count());
    // Ids are unique, and every reference has a target.
    let mut ids = values(body, "id");
    for reference in values(body, "href").iter().filter_map(|href| href.strip_prefix('#')) {
        assert!(ids.contains(&reference), "{reference}");
    }
    ids.sort_unstable();
    assert!(ids.windows(2).all(|pair| pair[0] != pair[1]), "{ids:?}");
    // Tables have column and row headers; pictures have names; there is one top-level heading.
    for table in body.split("<table>").skip(1).filter_map(|rest| rest.split("</table>").next()) {
        let rows = table.matches("<tr").count() - 1;
        assert!(table.contains("<thead><tr><th scope=\"col\""), "{table}");
        assert_eq!(table.matches("<th scope=\"row\">").count(), rows, "{table}");
    }
    for image in body.split("<img ").skip(1) {
        assert!(values(&format!(" {image}"), "alt").first().is_some_and(|alt| !alt.is_empty()));
    }
    for svg in body.split("<figure><svg").skip(1) {
        let head = svg.split('>').next().unwrap_or_default();
        assert!(head.contains("role=\"img\"") && head.contains("aria-label=\""), "{head}");
    }
    assert_eq!(body.matches("<h1>").count(), 1);
    // No invalid number was written as text; matches within words and base64 are ignored.
    let edge = |c: Option<char>| c.is_none_or(|c| !c.is_ascii_alphanumeric() && c != '+' && c != '/');
    for (at, bad) in ["NaN", "inf"].iter().flat_map(|bad| body.match_indices(bad)) {
        let is_word = !edge(body[..at].chars().next_back()) || !edge(body[at + bad.len()..].chars().next());
        assert!(is_word, "{}", &body[at.saturating_sub(60)..at + 10]);
    }
}

#[test]
fn reports_are_self_contained_and_accessible() {
    let report = sample();
    let (audit, options) = audited(synthetic_image(150, 8), 150, None);
    for page in [demo_page(&report), localization_page(&report.run), audit_page(&audit, &options)] {
        check(&page);
    }
}

#[test]
fn tables_use_map_units_with_significant_digits() {
    let mut run = sample().run;
    let page = localization_page(&run);
    for text in [
        "Position<br>error<br>(map units)",
        "± 0.00002<",
        "Recall at<br>0.05, 5°",
        "0.009",
        "11 of 12",
        "not localized",
    ] {
        assert!(page.contains(text), "{text}");
    }
    assert!(!body(&page).contains(" cm") && !body(&page).contains(" mm"));
    run.unit = LengthUnit::Metres;
    let page = localization_page(&run);
    for text in ["Position<br>error<", "± 0.02 mm<", "Recall at<br>5 cm, 5°", "9 mm"] {
        assert!(page.contains(text), "{text}");
    }
}

#[test]
fn queries_are_sorted_worst_first_and_linked_to_drawings() {
    let run = sample().run;
    let page = localization_page(&run);
    let worst = worst_first(&run.methods, &run.outcomes);
    assert_eq!([&worst[0].1, &worst[1].1], ["query_03.png", "query_05.png"]);
    assert!(page.contains("id=\"query-0\" open"));
    assert!(page.contains("\"n\":\"query_07.png\"") && page.contains("\"id\":\"query-0\""));
    assert!(page.contains("few matches agree") && page.contains("Queries that are not drawn"));
    let bare = localization_page(&LocalizationReport { drawings: Vec::new(), ..run });
    assert!(!bare.contains("data:image/jpeg"));
}

#[test]
fn demo_shows_pipeline_stages_in_order() {
    let page = demo_page(&sample());
    let stages = ["1. The image", "2. Keypoints", "3. Lines", "4. Matched", "5. The pose", "6. Attacks"];
    let at: Vec<usize> =
        stages.iter().map(|stage| page.find(&format!("<h2>{stage}")).expect(stage)).collect();
    assert!(at.is_sorted(), "{at:?}");
    assert!(
        page.contains("The paper's attack (closed form)")
            && page.contains("Prior-only baseline".to_lowercase().as_str())
    );
}

/// Text of the cells of the rows of a table.
fn cells(table: &str) -> Vec<Vec<String>> {
    let text =
        |cell: &str| cell.split('<').filter_map(|part| part.split_once('>')).map(|p| p.1).collect::<String>();
    let rows = table.split("<tbody>").nth(1).expect("rows").split("</tr>").filter(|row| row.contains("<td"));
    rows.map(|row| row.split("<td").skip(1).map(|cell| text(&format!("<td{cell}"))).collect()).collect()
}

#[test]
fn audit_tables_equal_document() {
    let (audit, options) = audited(synthetic_image(220, 8), 0, None);
    let page = audit_page(&audit, &options);
    let part = audit.document.inputs.as_ref().expect("inputs");
    let table = page.split("aria-label=\"Every attack on every scheme\"").nth(1).expect("the table");
    let rows = cells(table.split("</table>").next().expect("its end"));
    // Three schemes: the baseline once, two attacks at two shares of replaced neighbours.
    assert_eq!((rows.len(), part.attacks.attacks.len()), (15, 15));
    let number = |text: &str| text.split(' ').next().and_then(|n| n.parse::<f64>().ok()).expect("a number");
    // The document has them in another order.
    let mut medians: Vec<f64> = part.attacks.attacks.iter().map(|row| row.median_px).collect();
    let mut shown: Vec<f64> = rows.iter().map(|row| number(&row[4])).collect();
    medians.sort_by(f64::total_cmp);
    shown.sort_by(f64::total_cmp);
    assert!(medians.iter().zip(&shown).all(|(a, b)| (a - b).abs() <= 0.5), "{medians:?} {shown:?}");
    assert!(page.contains(&format!("<p class=\"lead\">{PROTECTION} ")), "the first sentences");
    let at = |id: &str| page.find(&format!("section id=\"{id}\"")).unwrap_or(usize::MAX);
    assert!(at("images") < at("strongest"), "the pictures are first");
    let mut gaining = part.attacks.clone();
    for row in gaining.attacks.iter_mut().filter(|row| row.attack != Attack::PRIOR) {
        (row.median_px, row.bits_over_prior) = (115.0, 0.44);
    }
    let summary = attacks::summary(&gaining).into_string();
    assert!(summary.contains("gains 0.44 bits") && !summary.contains("result protected"), "{summary}");
    // The table at the top has the strongest attack on each scheme.
    let table = page.split("aria-label=\"The strongest attack on each scheme\"").nth(1).expect("the table");
    let rows = cells(table.split("</table>").next().expect("its end"));
    assert_eq!(rows.len(), 6, "with true neighbours, and the baseline: {rows:?}");
    for (entry, rows) in part.strongest.iter().zip(rows.chunks(2)) {
        let strongest = entry.with_oracle.expect("an attack");
        assert!(rows[0][5].eq_ignore_ascii_case(strongest.words), "{entry:?} {rows:?}");
        let row = part.attacks.row(&entry.scheme, strongest).expect("a row");
        assert!((number(&rows[0][2]) - row.median_px).abs() <= 0.5, "{rows:?}");
    }
}

#[test]
fn audit_has_photographs_only_on_request() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let file = folder.path().join("a.png");
    RgbImage::from_fn(320, 240, |x, y| Rgb([x as u8, y as u8, 90])).save(&file).expect("written");
    let image = || KeypointImage { width: 640, height: 480, ..synthetic_image(80, 2) };
    let (audit, options) = audited(image(), 0, Some(&file));
    let with = audit_page(&audit, &options);
    assert!(with.contains("This file contains the photographs"));
    assert_eq!(with.matches("data:image/jpeg").count(), 1, "drawn once, and referred to");
    let (audit, options) = audited(image(), 80, None);
    let without = audit_page(&audit, &options);
    assert!(!without.contains("data:image") && without.contains("contains true positions of keypoints"));
    assert!(without.contains("Fig. 4: dcl under the paper") && without.contains("Fig. 5"));
}

#[test]
fn names_are_escaped() {
    let mut report = sample();
    let run = &mut report.run;
    run.title = HOSTILE.into();
    run.lead = HOSTILE.into();
    run.notices = vec![HOSTILE.into()];
    run.cards = vec![Card { value: HOSTILE.into(), label: HOSTILE.into(), note: HOSTILE.into() }];
    run.facts = vec![(HOSTILE.into(), HOSTILE.into())];
    run.scenes[0].name = HOSTILE.into();
    run.drawings[0].name = HOSTILE.into();
    for method in &mut run.methods {
        method.scheme = HOSTILE.into();
        method.variant = HOSTILE.into();
        method.condition = Some(HOSTILE.into());
        let figures = method.figures.as_mut().expect("figures");
        figures.median_ms.insert(HOSTILE.into(), 1.0);
        figures.recall.insert(HOSTILE.into(), 1.0);
    }
    for outcome in &mut run.outcomes {
        outcome.name = HOSTILE.into();
        outcome.remark = Some(HOSTILE.into());
    }
    report.attacks.attacks[0].scheme = HOSTILE.into();
    report.attacked.as_mut().expect("an image").name = HOSTILE.into();
    report.seen.as_mut().expect("a query").name = HOSTILE.into();
    let (audit, options) =
        audited(KeypointImage { name: HOSTILE.into(), ..synthetic_image(60, 2) }, 60, None);
    for page in [demo_page(&report), localization_page(&report.run), audit_page(&audit, &options)] {
        check(&page);
        assert!(!page.contains("<script>alert"));
        assert!(page.contains("&lt;script&gt;alert(1)&lt;/script&gt;&quot;'&amp;"));
    }
}

#[test]
fn empty_reports_and_invalid_numbers_give_pages() {
    check(&demo_page(&DemoReport::default()));
    let nan = Pixel::new(f64::NAN, f64::INFINITY);
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
    let mut run = LocalizationReport {
        methods: vec![Method {
            scheme: "points".into(),
            figures: Some(fill::figures_of(&summary)),
            ..Method::default()
        }],
        outcomes: vec![QueryOutcome { method: 9, ..broken.clone() }, broken],
        scenes: vec![SceneView { points: vec![[f64::NAN; 3], [1.0, 2.0, 3.0]], ..SceneView::default() }],
        drawings: vec![QueryDrawing {
            scene: 7,
            name: String::new(),
            image: Some(RgbImage::new(0, 0)),
            is_undistorted: true,
            sent: vec![SentDrawing {
                scheme: "random-lines".into(),
                sent: Observations::Lines(vec![PixelLine::through(nan, 0.0)]),
                size: (0, 0),
                rows: vec![],
                projected: vec![nan],
            }],
        }],
        ..LocalizationReport::default()
    };
    run.add_cards();
    let mut report = sample();
    for row in &mut report.attacks.attacks {
        let scheme = row.scheme.clone();
        *row = AttackSummary { scheme, median_px: f64::NAN, bits_over_prior: f64::NAN, ..row.clone() };
    }
    for attack in report.attacked.iter_mut().flat_map(|shown| &mut shown.schemes).flat_map(|s| &mut s.attacks)
    {
        attack.answers.fill(nan);
        attack.errors.fill(f64::NAN);
    }
    let seen = DeviceQuery { name: String::new(), image: RgbImage::new(0, 0), keypoints: vec![nan] };
    check(&localization_page(&run));
    check(&demo_page(&DemoReport { run, seen: Some(seen), ..report }));
    let one = KeypointImage { keypoints: vec![Pixel::new(3.0, 4.0)], ..synthetic_image(1, 1) };
    let (audit, options) = audited(one, 0, None);
    let page = audit_page(&audit, &options);
    check(&page);
    assert!(page.contains("1 image with 1 keypoint "));
}
