//! What a report shows: plain data, filled by whoever measured it.

use image::RgbImage;
use veiloc_evaluation::audit::{Attack, AttackSummary};
use veiloc_geometry::Pixel;

use crate::run::RunReport;

/// The demo's page: a query on its way, stage by stage, and what became of all. Any list may be empty; its section is then left
/// out.
#[derive(Debug, Clone, Default)]
pub struct Report {
    /// The run: heading, lead, cards, tables, the place, the queries. The first query drawn is the one that stages show.
    pub run: RunReport,
    /// The same query as the camera saw it, and its keypoints.
    pub seen: Option<SeenQuery>,
    /// What attacks made of that query, scheme by scheme.
    pub attacked: Vec<AttackedScheme>,
    /// One row per scheme and attack on all queries; the guess is one of them.
    pub attacks: Vec<AttackSummary>,
}

/// What the device sees of a query.
#[derive(Debug, Clone)]
pub struct SeenQuery {
    /// Name of the query.
    pub name: String,
    /// The image that never leaves the device.
    pub image: RgbImage,
    /// Its keypoints, pixels.
    pub keypoints: Vec<Pixel>,
}

/// What attacks made of a query under a scheme.
#[derive(Debug, Clone)]
pub struct AttackedScheme {
    /// Obfuscation scheme.
    pub scheme: String,
    /// True positions of the rows that were attacked, pixels.
    pub truth: Vec<Pixel>,
    /// Size of the camera's image, pixels.
    pub size: (u32, u32),
    /// What the prior guess answered for each row; empty when there was none.
    pub guessed: Vec<Pixel>,
    /// The attacks.
    pub attacks: Vec<AttackedBy>,
}

/// What one attack answered.
#[derive(Debug, Clone)]
pub struct AttackedBy {
    /// The attack.
    pub attack: Attack,
    /// Whether an oracle told it which keypoints are neighbours.
    pub told: bool,
    /// Where it puts each row's keypoint, pixels.
    pub answers: Vec<Pixel>,
}
