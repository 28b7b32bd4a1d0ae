//! What a report shows: plain data, filled by whoever measured it.

use image::RgbImage;
use veiloc_geometry::{CameraFromWorld, Pixel};
use veiloc_query::Observations;

use veiloc_audit::AttackSummary;
use veiloc_results::SchemeSummary;

/// Everything on the page, in its order. Any list may be empty; its section is then left out.
#[derive(Debug, Clone, Default)]
pub struct Report {
    /// Heading and browser title.
    pub title: String,
    /// One or two sentences under it: what was done, in plain words.
    pub lead: String,
    /// A few large numbers.
    pub cards: Vec<Card>,
    /// One row per scheme (and score).
    pub localization: Vec<SchemeSummary>,
    /// One row per scheme and attack; the guess is one of them.
    pub attacks: Vec<AttackSummary>,
    /// Images of queries: what the camera saw, what was sent, what the attack made of it.
    pub queries: Vec<QueryPanel>,
    /// The place from above.
    pub top_view: Option<TopView>,
    /// Name and value of facts for whoever repeats the run: command, version, seed, times.
    pub details: Vec<(String, String)>,
}

/// A large number with what it means.
#[derive(Debug, Clone, Default)]
pub struct Card {
    /// With its unit, `"1.2 cm"`.
    pub value: String,
    /// What it is, a few words.
    pub label: String,
    /// One sentence for laypeople.
    pub note: String,
}

/// One query image and what became of it.
#[derive(Debug, Clone)]
pub struct QueryPanel {
    /// Name of the query.
    pub name: String,
    /// The image that never leaves the device.
    pub image: RgbImage,
    /// Its keypoints, pixels.
    pub keypoints: Vec<Pixel>,
    /// What was sent under each scheme.
    pub schemes: Vec<SchemePanel>,
}

/// One scheme's view of a query. Rows need not be in the order of [`QueryPanel::keypoints`] (sealing shuffles them).
#[derive(Debug, Clone)]
pub struct SchemePanel {
    /// Obfuscation scheme.
    pub scheme: String,
    /// What was sent, in the pixels of the (canonical) camera it was sent in.
    pub sent: Observations,
    /// True position of each sent row, in the pixels of that same camera.
    pub truth: Vec<Pixel>,
    /// What the attack answered for each row; empty when there was no attack.
    pub recovered: Vec<Pixel>,
    /// What the prior guess answered for each row; empty when there was none.
    pub guessed: Vec<Pixel>,
    /// Size of the camera's image, pixels.
    pub size: (u32, u32),
}

/// Cameras and map points seen from above.
#[derive(Debug, Clone)]
pub struct TopView {
    /// Map points, map units (metres).
    pub points: Vec<[f64; 3]>,
    /// Unit direction of the map that points right on the page.
    pub right: [f64; 3],
    /// Unit direction of the map that points up on the page.
    pub up: [f64; 3],
    /// Poses of the images in the map.
    pub mapping: Vec<CameraFromWorld>,
    /// One drawing per scheme.
    pub schemes: Vec<TopViewScheme>,
}

/// The queries of one scheme.
#[derive(Debug, Clone)]
pub struct TopViewScheme {
    /// Obfuscation scheme.
    pub scheme: String,
    /// True pose and, where it was localized, the estimated one.
    pub cameras: Vec<(CameraFromWorld, Option<CameraFromWorld>)>,
}
