//! The example does what it says: one's own images are attacked, beside the guess.

#[path = "../../examples/attack_own_images.rs"]
#[expect(dead_code, reason = "its own main is not called")]
#[expect(clippy::duplicate_mod, reason = "each example has the module beside it")]
mod example;

use veiloc::audit::Attack;

#[test]
fn own_images_are_attacked_beside_the_guess() {
    let document = example::run(Vec::new()).expect("it runs");
    let median = |attack: Attack| {
        let row = document.attacks.iter().find(|r| r.scheme == "dcl" && r.attack == attack);
        row.expect("it ran").median_px
    };
    // The paper's attack is worse than guessing on dcl; the layout of the graph, told the true neighbours, is not.
    assert!(median(Attack::CLOSED_FORM) > median(Attack::PRIOR), "{document:?}");
    assert!(median(Attack::GRAPH) < 0.2 * median(Attack::PRIOR), "{document:?}");
}
