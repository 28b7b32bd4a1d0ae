//! Several frames of one file, as a server that has localized them all puts them together.

use veiloc_attacks::{
    AttackError, Frame, FramesOptions, KnownImage, Sighted, mutual_matches, several_frames,
};

use super::view::View;

/// Ratio of descriptor distances below which a match counts when frames are chosen.
const RATIO: f64 = 0.9;

/// What the `frames` frames nearest to image `own` tell about its keypoints, itself among them, all with their poses
/// as the server found them: `[N]`; `None` when it, or every other, has none.
///
/// The nearest are those with most matches: the server goes by descriptors, as for its own map.
///
/// `views`, `images`: `[images]` of the file.
pub(super) fn sighted(
    views: &[View],
    images: &[KnownImage],
    own: usize,
    frames: usize,
) -> Result<Option<Vec<Sighted>>, AttackError> {
    let frame = |i: usize| {
        let pose = views[i].pose?;
        let observations = if i == own { &views[i].observations } else { &views[i].sent };
        Some(Frame {
            camera: pose.camera,
            cam_from_world: pose.cam_from_world,
            observations,
            descriptors: images[i].descriptors(),
        })
    };
    let Some((first, pose)) = frame(own).zip(views[own].pose) else { return Ok(None) };
    let mut others: Vec<(usize, usize)> = Vec::new();
    for i in (0..views.len()).filter(|i| *i != own && views[*i].pose.is_some()) {
        let matches = mutual_matches(first.descriptors, images[i].descriptors(), RATIO)?;
        others.push((matches.iter().flatten().count(), i));
    }
    // Stable: equal counts stay in the order of the file.
    others.sort_by_key(|o| std::cmp::Reverse(o.0));
    let chosen = others.iter().take(frames.saturating_sub(1)).filter_map(|o| frame(o.1));
    let all: Vec<Frame<'_>> = std::iter::once(first).chain(chosen).collect();
    if all.len() < 2 {
        return Ok(None);
    }
    several_frames(&all, &FramesOptions::with_depths(pose.depths)).map(Some)
}
