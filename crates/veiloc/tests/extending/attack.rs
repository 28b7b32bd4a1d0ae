//! An attack of one's own: a value beside those of the table.

use veiloc::audit::{
    Answers, Attack, AttackEvaluation, AttackObserver, ImageGroup, Needs, NeighbourSource, attack_groups,
    attacks_table,
};
use veiloc::geometry::Pixel;
use veiloc::query::{AngleBits, Scheme};

/// Puts every keypoint on its own line, nearest to the middle of what the guess says of its neighbours: it needs to be told
/// who they are.
const MIDDLE: Attack = Attack {
    name: "middle-of-neighbours",
    words: "middle of the neighbours' guesses",
    holds: "",
    needs: Needs::NEIGHBOURS,
    run: |a, _| {
        let guess = a.guess();
        let middle = |i: usize| {
            let near = a.neighbours.of(i);
            let n = near.len().max(1) as f64;
            let sum = near.iter().fold((0.0, 0.0), |s, j| {
                let p = guess[*j as usize];
                (s.0 + p.u / n, s.1 + p.v / n)
            });
            if near.is_empty() {
                return guess[i];
            }
            let middle = Pixel::new(sum.0, sum.1);
            a.observations[i].lines()[0].map_or(middle, |line| line.closest_point(middle))
        };
        Ok(Answers::from((0..guess.len()).map(middle).collect::<Vec<_>>()))
    },
};

struct Quiet;

impl AttackObserver for Quiet {}

#[test]
fn an_attack_of_ones_own_stands_in_the_table_beside_the_guess() {
    let evaluation = AttackEvaluation {
        files: Vec::new(),
        synthetic: 400,
        images: None,
        schemes: vec![Scheme::RandomLines, Scheme::default()],
        attacks: vec![MIDDLE, Attack::CLOSED_FORM],
        neighbours: NeighbourSource::Oracle,
        k: 20,
        corrupt: vec![0.0],
        server: None,
        frames: Vec::new(),
        angle_bits: AngleBits::default(),
        seed: 1,
    };
    let groups: Vec<ImageGroup> = Vec::new();
    let document = attack_groups(&evaluation, groups, &mut Quiet).expect("it runs");
    let row = |scheme: &str, attack: Attack| {
        document.attacks.iter().find(|r| r.scheme == scheme && r.attack == attack).expect("it ran").clone()
    };
    // Neighbours' guesses surround the keypoint under random lines, whose directions differ.
    let (own, guess) = (row("random-lines", MIDDLE), row("random-lines", Attack::PRIOR));
    assert!(own.mean_px < guess.mean_px && own.bits_over_prior > 0.0, "{own:?} {guess:?}");
    assert!(attacks_table(&document).contains("middle-of-neighbours"));
}
