//! The web page shows attacks of this table: with their names and descriptions, and the same number of neighbours.

use veiloc_evaluation::attack_evaluation::{Attack, AttackEvaluation, Knowledge};
use veiloc_web::inspection::{ATTACKS, NEIGHBOURS};

#[test]
fn web_page_uses_names_of_audit_attacks() {
    for (name, words, neighbours) in ATTACKS {
        let attack: Attack = name.parse().expect("known");
        assert_eq!((attack.words, attack.needs(Knowledge::Neighbours)), (words, neighbours), "{name}");
    }
    assert_eq!(AttackEvaluation::default().k, NEIGHBOURS);
}
