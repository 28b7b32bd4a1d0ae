//! Results of the attacks: the stable JSON document and the text table.

use serde::Serialize;

use super::attacks::{Attack, Knowledge};
use super::multi_view::FrameChoice;
use super::neighbours::Neighbours;
use crate::results::text_table::{TextTable, percent};

/// Errors of attacks on keypoints. In documents the attack `prior` is the prior-only baseline.
#[derive(Debug, Clone, Default, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct AttackDocument {
    /// Version of this document.
    pub version: u32,
    /// `attack`.
    pub command: &'static str,
    /// What was attacked.
    pub data: Vec<String>,
    /// Source of the neighbour lists.
    pub neighbours: Neighbours,
    /// Neighbours per keypoint.
    pub k: usize,
    /// Share of predicted neighbours that are among the true `k` nearest; absent for an oracle.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub precision: Option<f64>,
    /// The same share for random neighbours; absent for an oracle.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub chance: Option<f64>,
    /// Knowledge of the attacking server, one entry per scheme; absent without `--known`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub server: Vec<ServerSummary>,
    /// How attacks on several frames chose them; absent without such attacks.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frame_selection: Option<FrameChoice>,
    /// What a device with the pack of the place sends of the attacked images; absent without `--pack`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub with_pack: Option<WithPack>,
    /// Seed of every random choice.
    pub seed: u64,
    /// One entry per scheme, attack and share of replaced neighbours.
    pub attacks: Vec<AttackSummary>,
}

/// What a device with the pack of the place sends, without decoys.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct WithPack {
    /// `matches` or `explained`.
    pub send: &'static str,
    /// Number of keypoints of the attacked images.
    pub keypoints: usize,
    /// Number of those that are sent.
    pub sent: usize,
    /// Images of which nothing is sent, because they do not show the place.
    pub images_not_sent: usize,
}

/// Knowledge of the server after localizing the queries of one scheme.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ServerSummary {
    /// Obfuscation scheme.
    pub scheme: String,
    /// Number of images.
    pub images: usize,
    /// Images with a pose that the server trusts; for the others it knows nothing.
    pub trusted: usize,
    /// Share of all keypoints whose position the server has from its map, 0 to 1.
    pub known: f64,
    /// Median error of these positions, pixels.
    pub known_median_px: f64,
    /// Share of these positions with an error under 10 px, 0 to 1; the others are mostly false inliers.
    pub known_under_10px: f64,
    /// The same under 30 px.
    pub known_under_30px: f64,
    /// Share of all keypoints on which the errors of attacks are measured, 0 to 1.
    pub measured: f64,
}

/// One attack on one scheme.
#[derive(Debug, Clone, Default, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct AttackSummary {
    /// Obfuscation scheme.
    pub scheme: String,
    /// Name of the attack.
    pub attack: Attack,
    /// Percent of the neighbours that were replaced by keypoints drawn at random.
    pub corrupt: f64,
    /// Frames of one scene, or seals of one image, that the attack used, including the attacked one; absent for
    /// attacks on one image.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frames: Option<usize>,
    /// Number of images.
    pub images: usize,
    /// Number of keypoints that errors are measured on.
    pub keypoints: usize,
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
    /// Information gain over the prior-only baseline, bits per keypoint.
    pub bits_over_prior: f64,
    /// Share of the answers that the attack accepts, 0 to 1; absent if it does not rate its answers.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub accepted: Option<f64>,
    /// Median error of accepted answers, pixels; absent without accepted answers.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub accepted_median_px: Option<f64>,
    /// Share of accepted answers with an error under 10 px, 0 to 1; absent without accepted answers.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub accepted_under_10px: Option<f64>,
    /// With a private region: how well the attack tells its keypoints from others that the map does not explain, as the
    /// area under the ROC curve, median over images; absent if it does not estimate this.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hiding_auc: Option<f64>,
    /// Milliseconds per image, median, without the search for neighbours.
    pub ms: f64,
}

impl AttackDocument {
    /// Whether an oracle gave the attack the true neighbours, which no real attacker has.
    pub fn uses_oracle(&self, attack: Attack) -> bool {
        self.neighbours == Neighbours::Oracle && attack.needs(Knowledge::Neighbours)
    }

    /// Whether there are attacks with an oracle and others, beside the baseline.
    pub(crate) fn has_both(&self) -> bool {
        let any = |oracle| {
            self.attacks.iter().any(|a| a.attack != Attack::PRIOR && self.uses_oracle(a.attack) == oracle)
        };
        any(true) && any(false)
    }
}

/// The attacks as a text table: those without an oracle first, then the others, with the baseline repeated.
pub fn attacks_table(document: &AttackDocument) -> String {
    let tables = if document.has_both() {
        let oracle = |a: &AttackSummary| document.uses_oracle(a.attack);
        format!(
            "{}\nAttacks with true neighbours from an oracle, which no real attacker has\n{}",
            rows(document.attacks.iter().filter(|a| !oracle(a))),
            rows(document.attacks.iter().filter(|a| oracle(a) || a.attack == Attack::PRIOR))
        )
    } else {
        rows(document.attacks.iter())
    };
    let precision_text = document.precision.zip(document.chance).map(|(precision, chance)| {
        format!(
            "\n{} of the neighbours are true; random neighbours: {}\n",
            percent(precision),
            percent(chance)
        )
    });
    let with_pack = document.with_pack.as_ref().map(|with| {
        let elsewhere = match with.images_not_sent {
            0 => String::new(),
            images => format!("; nothing of {images} of the images, which do not show the place"),
        };
        let WithPack { send, keypoints, sent, .. } = with;
        format!("\nWith the pack {sent} of {keypoints} keypoints are sent ({send}){elsewhere}\n")
    });
    let notes = [precision_text, with_pack].into_iter().flatten().collect::<String>();
    tables + &notes + &of_server(document) + &accepted(document)
}

fn rows<'a>(attacks: impl Iterator<Item = &'a AttackSummary>) -> String {
    let head =
        ["scheme", "attack", "corrupt", "mean px", "median", "< 5 px", "< 10 px", "< 30 px", "bits", "ms"];
    let mut table = TextTable::new(head, 2);
    for a in attacks {
        let corrupt = if a.corrupt > 0.0 { format!("{:.0} %", a.corrupt) } else { String::new() };
        let is_prior = a.attack == Attack::PRIOR;
        let several = if a.attack.needs(Knowledge::Seals) { "seals" } else { "frames" };
        let frames = a.frames.map_or_else(String::new, |n| format!(", {n} {several}"));
        table.push(vec![
            a.scheme.clone(),
            format!("{}{frames}", a.attack),
            corrupt,
            format!("{:.1}", a.mean_px),
            format!("{:.1}", a.median_px),
            percent(a.under_5px),
            percent(a.under_10px),
            percent(a.under_30px),
            if is_prior { "0".to_owned() } else { format!("{:+.2}", a.bits_over_prior) },
            format!("{:.1}", a.ms),
        ]);
    }
    table.render()
}

/// The server's knowledge, in sentences.
fn of_server(document: &AttackDocument) -> String {
    let one = |s: &ServerSummary| {
        format!(
            "\n{}: a pose for {} of {} images; the server knows {} of the keypoints (median error {:.1} px, {} under \
             10 px); errors are measured on {} of the keypoints\n",
            s.scheme,
            s.trusted,
            s.images,
            percent(s.known),
            s.known_median_px,
            percent(s.known_under_10px),
            percent(s.measured)
        )
    };
    document.server.iter().map(one).collect()
}

/// Accepted answers of the attacks that rate them.
fn accepted(document: &AttackDocument) -> String {
    let one = |a: &AttackSummary| {
        let (share, median, under) = (a.accepted?, a.accepted_median_px?, a.accepted_under_10px?);
        let frames = a.frames.map_or_else(String::new, |n| format!(", {n} frames"));
        Some(format!(
            "\n{} on {}{frames}: accepts {:.1} % of its answers; their median error is {median:.1} px, and \
             {:.1} % are under 10 px\n",
            a.attack,
            a.scheme,
            100.0 * share,
            100.0 * under
        ))
    };
    let accepted: String = document.attacks.iter().filter_map(one).collect();
    let hiding = |a: &AttackSummary| {
        let auc = a.hiding_auc?;
        Some(format!(
            "\n{} on {}: tells keypoints of the private region from others that the map does not explain with an area \
             under the ROC curve of {auc:.2}\n",
            a.attack, a.scheme
        ))
    };
    accepted + &document.attacks.iter().filter_map(hiding).collect::<String>()
}
