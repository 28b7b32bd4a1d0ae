//! A user-defined attack: a value beside those of the table.

use veiloc::audit::{
    Attack, AttackEvaluation, Knowledge, RecoveredPositions, attacks_table, evaluate_attacks,
};
use veiloc::geometry::Pixel;
use veiloc::protocol::Scheme;

/// Projects the mean of the neighbours' prior-only positions on the keypoint's own line; it needs neighbour lists.
const NEIGHBOUR_MEAN: Attack = Attack {
    name: "middle-of-neighbours",
    words: "mean of the neighbours' prior-only positions",
    holds: "",
    needs: &[Knowledge::Neighbours],
    run: |a| {
        let (prior, neighbours) = (a.prior_only(), a.neighbours()?);
        let middle = |i: usize| {
            let near = neighbours.of(i);
            let n = near.len().max(1) as f64;
            let sum = near.iter().fold((0.0, 0.0), |s, j| {
                let p = prior[*j as usize];
                (s.0 + p.u / n, s.1 + p.v / n)
            });
            if near.is_empty() {
                return prior[i];
            }
            let middle = Pixel::new(sum.0, sum.1);
            a.observations()[i].lines()[0].map_or(middle, |line| line.closest_point(middle))
        };
        Ok(RecoveredPositions::from((0..prior.len()).map(middle).collect::<Vec<_>>()))
    },
};

#[test]
fn user_defined_attack_is_in_the_table() {
    let evaluation = AttackEvaluation {
        synthetic: 400,
        schemes: vec![Scheme::RandomLines, Scheme::default()],
        attacks: vec![NEIGHBOUR_MEAN, Attack::CLOSED_FORM],
        seed: 1,
        ..AttackEvaluation::default()
    };
    let document = evaluate_attacks(&evaluation, "Attacking", &(), &mut |_| {}).expect("it runs");
    let row = |scheme: &str, attack: Attack| {
        document.attacks.iter().find(|r| r.scheme == scheme && r.attack == attack).expect("it ran").clone()
    };
    // With random lines the neighbours' prior-only positions surround the keypoint, because the directions differ.
    let (own, prior) = (row("random-lines", NEIGHBOUR_MEAN), row("random-lines", Attack::PRIOR));
    assert!(own.mean_px < prior.mean_px && own.bits_over_prior > 0.0, "{own:?} {prior:?}");
    assert!(attacks_table(&document).contains("middle-of-neighbours"));
}
