//! The strongest attack on each scheme.

use serde::Serialize;

use super::attacks::{Attack, Knowledge};
use super::document::{AttackDocument, AttackSummary};
use crate::results::text_table::{TextTable, percent};

/// The strongest attacks on one scheme: those with the largest gain over the prior-only baseline, at the smallest
/// share of replaced neighbours.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct StrongestAttacks {
    /// Obfuscation scheme.
    pub scheme: String,
    /// Among the attacks without an oracle; absent when none was run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub without_oracle: Option<Attack>,
    /// Among the attacks with true neighbours from an oracle; absent when none was run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub with_oracle: Option<Attack>,
}

impl AttackDocument {
    /// The strongest attacks, one entry per scheme, in the order of the document.
    pub fn strongest(&self) -> Vec<StrongestAttacks> {
        let baselines = self.attacks.iter().filter(|row| row.attack == Attack::PRIOR);
        let of = |scheme: &str, oracle: bool| {
            let rows =
                self.least_replaced().filter(|row| row.scheme == scheme && row.attack != Attack::PRIOR);
            strongest(rows.filter(|row| self.uses_oracle(row.attack) == oracle)).map(|row| row.attack)
        };
        let entry = |row: &AttackSummary| StrongestAttacks {
            scheme: row.scheme.clone(),
            without_oracle: of(&row.scheme, false),
            with_oracle: of(&row.scheme, true),
        };
        baselines.map(entry).collect()
    }

    /// The row of an attack on a scheme at the smallest share of replaced neighbours; of several rows, the one with
    /// the largest gain.
    pub fn row(&self, scheme: &str, attack: Attack) -> Option<&AttackSummary> {
        strongest(self.least_replaced().filter(|row| row.scheme == scheme && row.attack == attack))
    }

    /// Smallest share of replaced neighbours, percent; infinite when no attack uses neighbours.
    pub fn least_replaced_percent(&self) -> f64 {
        let uses = |row: &&AttackSummary| row.attack.needs(Knowledge::Neighbours) && row.corrupt.is_finite();
        self.attacks.iter().filter(uses).map(|row| row.corrupt).fold(f64::INFINITY, f64::min)
    }

    fn least_replaced(&self) -> impl Iterator<Item = &AttackSummary> {
        let least = self.least_replaced_percent();
        self.attacks
            .iter()
            .filter(move |row| !row.attack.needs(Knowledge::Neighbours) || row.corrupt <= least)
    }
}

/// The attack with the largest gain over the prior-only baseline; one without a number comes last.
pub(super) fn strongest<'a>(rows: impl Iterator<Item = &'a AttackSummary>) -> Option<&'a AttackSummary> {
    let bits = |row: &AttackSummary| {
        if row.bits_over_prior.is_nan() { f64::NEG_INFINITY } else { row.bits_over_prior }
    };
    rows.max_by(|a, b| bits(a).total_cmp(&bits(b)))
}

/// The strongest attacks as a text table, beside the prior-only baseline.
pub fn strongest_table(document: &AttackDocument) -> String {
    let mut table = TextTable::new(["scheme", "attacker", "attack", "median", "< 10 px", "bits"], 3);
    for StrongestAttacks { scheme, without_oracle, with_oracle } in document.strongest() {
        let attackers = [
            ("baseline", Some(Attack::PRIOR)),
            ("without an oracle", without_oracle),
            ("with true neighbours", with_oracle),
        ];
        for (attacker, attack) in attackers {
            let Some(row) = attack.and_then(|attack| document.row(&scheme, attack)) else { continue };
            table.push(vec![
                scheme.clone(),
                attacker.to_owned(),
                row.attack.to_string(),
                format!("{:.1}", row.median_px),
                percent(row.under_10px),
                if row.attack == Attack::PRIOR {
                    "0".to_owned()
                } else {
                    format!("{:+.2}", row.bits_over_prior)
                },
            ]);
        }
    }
    table.render()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::attack_evaluation::Neighbours;

    fn row(attack: &str, corrupt: f64, bits_over_prior: f64) -> AttackSummary {
        let attack = attack.parse().expect("an attack");
        AttackSummary {
            scheme: "dcl".to_owned(),
            attack,
            corrupt,
            bits_over_prior,
            ..AttackSummary::default()
        }
    }

    #[test]
    fn attacks_with_and_without_oracle_are_ranked_separately() {
        let mut document = AttackDocument {
            neighbours: Neighbours::Oracle,
            attacks: vec![
                row("prior", 0.0, 0.0),
                row("closed-form", 10.0, -2.0),
                row("closed-form", 40.0, 9.0),
                row("graph", 10.0, 5.0),
                row("transfer", 0.0, 2.0),
                row("static-camera", 0.0, f64::NAN),
            ],
            ..AttackDocument::default()
        };
        let found = |document: &AttackDocument| {
            let found = document.strongest();
            assert_eq!(found.len(), 1);
            [found[0].without_oracle, found[0].with_oracle].map(|attack| attack.map(|attack| attack.name))
        };
        assert_eq!(found(&document), [Some("transfer"), Some("graph")]);
        assert_eq!(document.least_replaced_percent(), 10.0);
        assert_eq!(document.row("dcl", Attack::CLOSED_FORM).map(|row| row.corrupt), Some(10.0));
        let text = strongest_table(&document);
        assert!(text.contains("without an oracle") && text.contains("+2.00"), "{text}");
        // Predicted neighbours do not come from an oracle.
        document.neighbours = Neighbours::Predicted;
        assert_eq!(found(&document), [Some("graph"), None]);
        document.attacks.truncate(1);
        assert_eq!(found(&document), [None, None]);
    }
}
