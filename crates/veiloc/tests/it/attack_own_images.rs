//! The example attacks the user's own images, beside the prior-only baseline.

#[path = "../../examples/attack_own_images.rs"]
#[expect(dead_code, reason = "its own main is not called")]
#[expect(clippy::duplicate_mod, reason = "each example has the module beside it")]
mod example;

use veiloc::audit::Attack;

#[test]
fn example_attacks_own_images() {
    let document = example::run(Vec::new()).expect("it runs");
    let median = |attack: Attack| {
        let row = document.attacks.iter().find(|r| r.scheme == "dcl" && r.attack == attack);
        row.expect("it ran").median_px
    };
    // On dcl the paper's attack is worse than the baseline; the layout of the graph with true neighbours is better.
    assert!(median(Attack::CLOSED_FORM) > median(Attack::PRIOR), "{document:?}");
    assert!(median(Attack::GRAPH) < 0.2 * median(Attack::PRIOR), "{document:?}");
}
