//! The page says what the document says, the sentences follow the figures, and nothing is loaded or injected.

use veiloc_geometry::Pixel;
use veiloc_query::{AngleBits, Scheme};

use super::conclusion::conclusion;
use super::*;
use crate::audit::{
    AttackDocument, AttackEvaluation, AttackKind, AttackSummary, ImageGroup, NeighbourSource, synthetic_image,
};

fn options(groups: Vec<ImageGroup>, synthetic: usize) -> AuditOptions {
    AuditOptions {
        evaluation: AttackEvaluation {
            files: Vec::new(),
            synthetic,
            images: None,
            schemes: vec![Scheme::RandomLines, Scheme::CoordinatePermutation, Scheme::default()],
            attacks: vec![AttackKind::ClosedForm, AttackKind::ClosedFormInImage],
            neighbours: NeighbourSource::Oracle,
            k: 20,
            corrupt: vec![0.0, 30.0],
            server: None,
            frames: Vec::new(),
            angle_bits: AngleBits::default(),
            seed: 5,
        },
        groups,
        shown: 1,
        command: "veiloc audit <x>".to_owned(),
    }
}

fn nowhere(_: usize, _: usize) -> Option<std::path::PathBuf> {
    None
}

/// Text of each cell of the rows of the page's tables.
fn cells(page: &str) -> Vec<Vec<String>> {
    let bodies = page.split("<tbody>").skip(1).filter_map(|rest| rest.split("</tbody>").next());
    let text = |cell: &str| {
        let cell = cell.split("<small>").next().unwrap_or(cell);
        cell.split('<')
            .filter_map(|part| part.split_once('>').map_or(Some(part), |p| Some(p.1)))
            .collect::<String>()
    };
    let row = |row: &str| {
        row.split("</td>")
            .map(|cell| text(cell.rsplit_once("<td").map_or(cell, |c| c.1).trim_start_matches('>')))
            .collect()
    };
    bodies
        .flat_map(|body| body.split("</tr>").filter(|r| r.contains("<td")).map(row).collect::<Vec<_>>())
        .collect()
}

/// The first number in a cell.
fn number(cell: &str) -> f64 {
    let from = cell.rsplit('>').next().unwrap_or(cell);
    let digits: String = from.chars().take_while(|c| c.is_ascii_digit() || ".+-".contains(*c)).collect();
    digits.parse().unwrap_or_else(|_| panic!("{cell:?} holds no number"))
}

#[test]
fn page_and_document_agree() {
    let group = ImageGroup { name: "own".to_owned(), images: vec![synthetic_image(220, 8)] };
    let audit = run_audit(&options(vec![group], 180), &nowhere, &()).expect("it runs");
    let rows = cells(&audit.html);
    let parts = [audit.document.inputs.as_ref(), audit.document.synthetic.as_ref()];
    let summaries: Vec<(&AttackSummary, f64)> = parts
        .iter()
        .flatten()
        .flat_map(|p| p.attacks.attacks.iter().zip(p.bending.iter().copied()))
        .collect();
    // Two parts, three schemes; the guess once, two attacks at two shares.
    assert_eq!(summaries.len(), 2 * 3 * 5);
    assert_eq!(rows.len(), summaries.len(), "{rows:?}");
    for (cells, (row, bent)) in rows.iter().zip(summaries) {
        let close = |cell: usize, value: f64, scale: f64| {
            assert!((number(&cells[cell]) - scale * value).abs() <= 0.0501, "{cells:?} {row:?}");
        };
        close(2, row.mean_px, 1.0);
        close(3, row.median_px, 1.0);
        close(4, row.under_5px, 100.0);
        close(5, row.under_10px, 100.0);
        close(6, row.under_30px, 100.0);
        assert!((number(&cells[7]) - row.bits_over_prior).abs() <= 0.00501, "{cells:?} {row:?}");
        close(8, bent, 100.0);
    }
    assert_eq!(audit.document.inputs.as_ref().map(|p| p.keypoints), Some(220));
    for sentence in &audit.document.conclusion {
        let text = sentence.split_once(": ").expect("a subject").1;
        assert!(audit.html.contains(&crate::report::format::escape(text)), "{text}");
    }
}

fn row(scheme: &str, attack: &str, corrupt: f64, (px, under_10px, bits): (f64, f64, f64)) -> AttackSummary {
    AttackSummary {
        scheme: scheme.to_owned(),
        attack: attack.to_owned(),
        corrupt,
        images: 1,
        mean_px: px,
        median_px: px,
        under_5px: under_10px / 2.0,
        under_10px,
        under_30px: under_10px,
        bits_over_prior: bits,
        ..AttackSummary::default()
    }
}

/// Two schemes; what the graph attack has on each, at 0 and at 40 % of false neighbours, and the closed form on dcl.
fn words(lines: (f64, f64, f64), dcl: [(f64, f64, f64); 2], closed_px: f64, bending: f64) -> String {
    let guess = (100.0, 0.04, 0.0);
    let attacks = vec![
        row("random-lines", "prior", 0.0, guess),
        row("random-lines", "closed-form", 0.0, (5.0, 0.3, 0.05)),
        row("random-lines", "graph", 0.0, lines),
        row("dcl", "prior", 0.0, guess),
        row("dcl", "closed-form", 0.0, (closed_px, 0.0, -2.0)),
        row("dcl", "graph", 0.0, dcl[0]),
        row("dcl", "graph", 40.0, dcl[1]),
    ];
    let part = AuditPart {
        bending: vec![bending; attacks.len()],
        keypoints: 10,
        attacks: AttackDocument { neighbours: "oracle", k: 20, attacks, ..AttackDocument::default() },
    };
    conclusion(&part).iter().map(|s| s.plain() + "\n").collect()
}

#[test]
fn sentences_follow_the_figures() {
    let (found, lost, worse) = ((1.0, 0.98, 6.0), (60.0, 0.1, 0.7), (120.0, 0.03, -0.3));
    let all = words(found, [found, lost], 300.0, 0.9);
    assert!(all.contains("In short: Against the strongest attack that was run, most keypoint positions are given away under random-lines and dcl."), "{all}");
    assert!(all.contains("dcl (worse") || all.contains("worse than guessing"), "{all}");
    assert!(all.contains("With none of the neighbours replaced it puts 98.0 %"), "{all}");
    assert!(all.contains("With 40 % of the neighbours replaced at random it puts 10.0 %"), "{all}");

    let one = words(found, [lost, lost], 300.0, 0.9);
    assert!(one.contains("given away under random-lines, but not under dcl."), "{one}");
    assert!(one.contains("(dcl): An attacker learns a little"), "{one}");
    assert!(
        one.contains("With none of the neighbours replaced it puts 10.0 %")
            && !one.contains("The arrangement is given away"),
        "{one}"
    );

    let none = words(worse, [worse, worse], 300.0, 0.9);
    assert!(
        none.contains(
            "No attack that was run puts half of the keypoints within 10 px under random-lines and dcl."
        ),
        "{none}"
    );
    assert!(none.contains("(dcl): No attack that was run learns more than the guess"), "{none}");

    let bent = words(found, [lost, lost], 300.0, 0.2);
    assert!(bent.contains("off by 20.0 % of their length"), "{bent}");

    let stands = words(found, [found, found], 50.0, 0.9);
    assert!(stands.contains("With 40 % of the neighbours replaced at random it puts 98.0 %"), "{stands}");
    assert!(!stands.contains("worse than guessing") && stands.contains("(2.0 times nearer)"), "{stands}");
}

#[test]
fn limits_name_what_was_not_run_and_who_told_the_neighbours() {
    let mut part = AuditPart {
        attacks: AttackDocument {
            neighbours: "predicted",
            k: 20,
            precision: Some(0.093),
            chance: Some(0.01),
            attacks: vec![
                row("dcl", "prior", 0.0, (100.0, 0.0, 0.0)),
                row("dcl", "graph", 0.0, (280.0, 0.0, -1.0)),
            ],
            ..AttackDocument::default()
        },
        ..AuditPart::default()
    };
    let say = |part: &AuditPart| conclusion(part).iter().map(|s| s.plain() + "\n").collect::<String>();
    let told = say(&part);
    assert!(told.contains("9.3 % of them true, where drawing at random has 1.0 %"), "{told}");
    let not_run = told.split("Not run here: ").nth(1).and_then(|r| r.split('.').next()).expect("a list");
    assert!(not_run.contains("transfer") && not_run.contains("closed-form"), "{not_run}");
    assert!(!not_run.split(", ").any(|name| name == "graph" || name == "prior"), "{not_run}");
    part.attacks.neighbours = "oracle";
    assert!(say(&part).contains("told the true 20 nearest"), "{}", say(&part));
    assert!(!say(&part).contains("Without being told"), "{}", say(&part));
    part.attacks.attacks[1] = row("dcl", "graph", 0.0, (2.0, 0.9, 5.0));
    part.attacks.attacks.push(row("dcl", "transfer", 0.0, (19.0, 0.35, 2.0)));
    assert!(
        say(&part).contains("the strongest is positions taken over from a map (transfer)"),
        "{}",
        say(&part)
    );
    assert!(say(&part).contains("puts 35.0 % of the keypoints within 10 px"), "{}", say(&part));
    part.attacks.attacks.truncate(1);
    assert!(say(&part).contains("Only the guess was run"), "{}", say(&part));
    part.attacks.attacks.clear();
    assert!(!say(&part).contains("In short"), "{}", say(&part));
}

#[test]
fn the_page_loads_nothing_and_names_are_only_text() {
    let mut image = synthetic_image(60, 2);
    image.name = "<script>alert('x')</script>&\".jpg".to_owned();
    let group = ImageGroup { name: "<img src=x onerror=alert(1)>".to_owned(), images: vec![image] };
    let page = run_audit(&options(vec![group], 60), &nowhere, &()).expect("it runs").html;
    for bad in ["<script", "<img src=x", "http:", "https:", "url(", "@import", "<link", "<iframe", "src=\"/"]
    {
        assert!(!page.contains(bad), "{bad}");
    }
    for target in page.split("href=\"").skip(1).chain(page.split("src=\"").skip(1)) {
        assert!(target.starts_with('#') || target.starts_with("data:image/"), "{}", &target[..40]);
    }
    assert!(page.contains("&lt;script&gt;alert(&#39;x&#39;)&lt;/script&gt;&amp;&quot;.jpg"));
    assert!(page.contains("veiloc audit &lt;x&gt;"), "the command");
    assert!(!page.contains("NaN") && !page.contains(">inf"));
}

#[test]
fn a_photograph_is_inside_and_stays_out_when_it_shall() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let file = folder.path().join("a.png");
    image::RgbImage::from_fn(320, 240, |x, y| image::Rgb([x as u8, y as u8, 90]))
        .save(&file)
        .expect("written");
    let mut image = synthetic_image(80, 2);
    (image.width, image.height) = (640, 480);
    let group = ImageGroup { name: "a.png".to_owned(), images: vec![image] };
    let options = options(vec![group], 0);
    let with = run_audit(&options, &|_, _| Some(file.clone()), &()).expect("it runs").html;
    assert!(
        with.contains("This file contains the photographs")
            && with.contains("in place of the paper's Fig. 6")
    );
    assert!(with.matches("data:image/jpeg").count() > 8 && !with.contains("synthetic scene"));
    let without = run_audit(&options, &nowhere, &()).expect("it runs").html;
    assert!(!without.contains("data:image") && without.contains("true positions of keypoints"));
    let mut figures_only = options.clone();
    figures_only.shown = 0;
    let bare = run_audit(&figures_only, &|_, _| Some(file.clone()), &()).expect("it runs").html;
    assert!(!bare.contains("This file contains") && !bare.contains("data:image"));
    let gone = run_audit(&options, &|_, _| Some("gone.png".into()), &()).expect_err("no such file");
    assert!(gone.to_string().contains("gone.png"), "{gone}");
}

#[test]
fn what_is_asked_twice_is_done_once() {
    let groups = || {
        vec![ImageGroup {
            name: "two".to_owned(),
            images: vec![synthetic_image(90, 1), synthetic_image(80, 2)],
        }]
    };
    let mut twice = options(groups(), 0);
    twice.evaluation.schemes.extend(twice.evaluation.schemes.clone());
    twice.evaluation.attacks.push(AttackKind::ClosedForm);
    twice.evaluation.corrupt.push(0.0);
    let rows = |o: &AuditOptions| {
        let inputs = run_audit(o, &nowhere, &()).expect("it runs").document.inputs.expect("inputs");
        let errors: Vec<f64> = inputs.attacks.attacks.iter().map(|r| r.mean_px).collect();
        (inputs.keypoints, errors, inputs.bending)
    };
    assert_eq!(rows(&twice), rows(&options(groups(), 0)));
    assert_eq!(rows(&twice).0, 170);
}

#[test]
fn neighbours_that_were_all_replaced_are_not_called_true() {
    let mut options = options(Vec::new(), 150);
    let said =
        |o: &AuditOptions| run_audit(o, &nowhere, &()).expect("it runs").document.conclusion.join("\n");
    assert!(!said(&options).contains("at least"), "{}", said(&options));
    options.evaluation.corrupt = vec![30.0];
    assert!(said(&options).contains("at least 30 % of them were replaced"), "{}", said(&options));
    assert!(said(&options).contains("near keypoints of each, 30 % of them at random"), "{}", said(&options));
}

#[test]
fn degenerate_images_make_a_page() {
    let mut one = synthetic_image(1, 1);
    one.keypoints = vec![Pixel::new(3.0, 4.0)];
    let group = ImageGroup { name: "one".to_owned(), images: vec![one] };
    let page = run_audit(&options(vec![group], 0), &nowhere, &()).expect("it runs").html;
    assert!(page.contains("1 image with 1 keypoint ") && !page.contains("NaN"), "{}", &page[..0]);
    let nothing = run_audit(&options(Vec::new(), 0), &nowhere, &()).expect_err("nothing");
    assert!(nothing.to_string().contains("nothing to attack"), "{nothing}");
}
