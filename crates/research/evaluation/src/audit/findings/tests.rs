//! The sentences follow the figures, and nothing is done twice.

use veiloc_datasets::problem_files::synthetic_image;
use veiloc_protocol::Scheme;

use super::*;
use crate::audit::{Attack, AttackSummary, ImageGroup, Neighbours};

fn options(groups: Vec<ImageGroup>, synthetic: usize) -> AuditOptions {
    AuditOptions {
        evaluation: AttackEvaluation {
            synthetic,
            schemes: vec![Scheme::RandomLines, Scheme::CoordinatePermutation, Scheme::default()],
            attacks: vec![Attack::CLOSED_FORM, "closed-form-in-image".parse().expect("an attack")],
            corrupt: vec![0.0, 30.0],
            seed: 5,
            ..AttackEvaluation::default()
        },
        groups,
        shown: 1,
        command: "veiloc audit <x>".to_owned(),
    }
}

fn nowhere(_: usize, _: usize) -> Option<PathBuf> {
    None
}

fn row(scheme: &str, attack: &str, corrupt: f64, (px, under_10px, bits): (f64, f64, f64)) -> AttackSummary {
    AttackSummary {
        scheme: scheme.to_owned(),
        attack: attack.parse().expect("an attack"),
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
        attacks: AttackDocument {
            neighbours: Neighbours::Oracle,
            k: 20,
            attacks,
            ..AttackDocument::default()
        },
    };
    conclusion(&part).iter().map(|s| s.plain() + "\n").collect()
}

#[test]
fn sentences_follow_the_figures() {
    let (found, lost, worse) = ((1.0, 0.98, 6.0), (60.0, 0.1, 0.7), (120.0, 0.03, -0.3));
    let all = words(found, [found, lost], 300.0, 0.9);
    assert!(all.contains("In short: Against the strongest attack that was run most keypoint positions are given away under random-lines and dcl."), "{all}");
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
            "Against the strongest attack that was run half of the keypoints or more stay farther off than 10 px under \
             random-lines and dcl."
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
            neighbours: Neighbours::Predicted,
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
    part.attacks.neighbours = Neighbours::Oracle;
    assert!(say(&part).contains("told the true 20 nearest"), "{}", say(&part));
    assert!(!say(&part).contains("Told by an oracle"), "{}", say(&part));
    part.attacks.attacks[1] = row("dcl", "graph", 0.0, (2.0, 0.9, 5.0));
    part.attacks.attacks.push(row("dcl", "transfer", 0.0, (19.0, 0.35, 2.0)));
    assert!(
        say(&part).contains("The strongest, positions taken over from a map (transfer), puts 17.5 %"),
        "{}",
        say(&part)
    );
    // Attackers who exist come first, and do not get what an oracle gives.
    assert!(
        say(&part).contains(
            "In short: Against the strongest attack that needs no oracle half of the keypoints or more stay farther off than \
             10 px under dcl. Against an attacker whom an oracle tells the true neighbours, which nobody has, most keypoint \
             positions are given away under dcl."
        ),
        "{}",
        say(&part)
    );
    let (exists, told) = (say(&part).find("(transfer)"), say(&part).find("Told by an oracle: most"));
    assert!(exists.is_some() && exists < told, "{}", say(&part));
    part.attacks.attacks.truncate(1);
    assert!(say(&part).contains("Only the guess was run"), "{}", say(&part));
    part.attacks.attacks.clear();
    assert!(!say(&part).contains("In short"), "{}", say(&part));
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
    twice.evaluation.attacks.push(Attack::CLOSED_FORM);
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
