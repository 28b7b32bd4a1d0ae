//! What the attacks found: the stable JSON document, and the table for people.

use serde::Serialize;

use super::kind::AttackKind;
use crate::text_table::TextTable;

/// The document that `veiloc attack --json` prints.
#[derive(Debug, Clone, Default, Serialize)]
pub struct AttackDocument {
    /// Version of this document; a field is never removed or given another meaning under the same number.
    pub version: u32,
    /// `attack`.
    pub command: &'static str,
    /// What was attacked.
    pub data: Vec<String>,
    /// Who told the neighbours: `oracle`, `predicted` or `transferred`.
    pub neighbours: &'static str,
    /// Neighbours a keypoint.
    pub k: usize,
    /// Share of predicted neighbours that are among the true `k` nearest; absent for an oracle.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub precision: Option<f64>,
    /// What the same share is when neighbours are drawn by lot.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub chance: Option<f64>,
    /// Seed of every random choice.
    pub seed: u64,
    /// One entry per scheme, attack and share of replaced neighbours.
    pub attacks: Vec<AttackSummary>,
}

/// One attack on one scheme.
#[derive(Debug, Clone, Default, Serialize)]
pub struct AttackSummary {
    /// Obfuscation scheme.
    pub scheme: String,
    /// Attack.
    pub attack: String,
    /// Percent of the neighbours that were replaced by keypoints drawn by lot.
    pub corrupt: f64,
    /// Pictures.
    pub images: usize,
    /// Mean error of a keypoint, pixels.
    pub mean_px: f64,
    /// Median error, pixels.
    pub median_px: f64,
    /// Share of keypoints with an error under 5 px, 0 to 1.
    pub under_5px: f64,
    /// The same under 10 px.
    pub under_10px: f64,
    /// The same under 30 px.
    pub under_30px: f64,
    /// What the attack tells beyond the guess, bits a keypoint.
    pub bits_over_prior: f64,
    /// Milliseconds a picture, median, without the search for neighbours.
    pub ms: f64,
}

/// The attacks as a table for people.
pub fn attacks_table(document: &AttackDocument) -> String {
    let head =
        ["scheme", "attack", "corrupt", "mean px", "median", "< 5 px", "< 10 px", "< 30 px", "bits", "ms"];
    let mut table = TextTable::new(head, 2);
    let percent = |share: f64| format!("{:.1} %", 100.0 * share);
    for a in &document.attacks {
        let corrupt = if a.corrupt > 0.0 { format!("{:.0} %", a.corrupt) } else { String::new() };
        let guess = a.attack == AttackKind::Prior.name();
        table.push(vec![
            a.scheme.clone(),
            a.attack.clone(),
            corrupt,
            format!("{:.1}", a.mean_px),
            format!("{:.1}", a.median_px),
            percent(a.under_5px),
            percent(a.under_10px),
            percent(a.under_30px),
            if guess { "0".to_owned() } else { format!("{:+.2}", a.bits_over_prior) },
            format!("{:.1}", a.ms),
        ]);
    }
    let told = document.precision.zip(document.chance).map(|(precision, chance)| {
        format!("\n{} of the neighbours are true, by lot {}\n", percent(precision), percent(chance))
    });
    table.render() + &told.unwrap_or_default()
}
