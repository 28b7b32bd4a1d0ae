//! Several frames of one file, as a server that has localized them all puts them together.

use veiloc_attacks::multi_view::{Frame, FramesOptions, TriangulatedKeypoint, select_frames, multi_view_attack};
use veiloc_attacks::{AttackError, KnownImage, mutual_matches};

use super::view::View;

/// Which frames of a place an attack of several puts together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum FrameChoice {
    /// Those whose lines tell most about the attacked frame's positions: turned much, moved little.
    #[default]
    Turn,
    /// Those with most matches.
    Nearest,
}

/// Ratio of descriptor distances below which a match counts when frames are chosen by matches.
const RATIO: f64 = 0.9;

/// What `frames` frames, image `own` and others of the choice, tell about the keypoints of `own`, all with their poses
/// as the server found them: `[N]`; `None` when it, or every other, has none.
///
/// `views`, `images`: `[images]` of the file.
pub(super) fn sighted(
    views: &[View],
    images: &[KnownImage],
    own: usize,
    frames: usize,
    choice: FrameChoice,
) -> Result<Option<Vec<TriangulatedKeypoint>>, AttackError> {
    let frame = |i: usize| {
        let pose = views[i].pose.as_ref()?;
        let observations = if i == own { &views[i].observations } else { &views[i].sent };
        Some(Frame {
            camera: pose.camera,
            cam_from_world: pose.cam_from_world,
            observations,
            descriptors: images[i].descriptors(),
        })
    };
    let Some((first, pose)) = frame(own).zip(views[own].pose.as_ref()) else { return Ok(None) };
    let others: Vec<Frame<'_>> = (0..views.len()).filter(|i| *i != own).filter_map(frame).collect();
    if others.is_empty() {
        return Ok(None);
    }
    let options = FramesOptions::with_depths(pose.depths).beside(pose.known.clone());
    let count = frames.saturating_sub(1);
    let chosen = match choice {
        FrameChoice::Turn => select_frames(&first, &others, count, &options)?,
        FrameChoice::Nearest => nearest(&first, &others, count)?,
    };
    let all: Vec<Frame<'_>> = std::iter::once(first).chain(chosen.into_iter().map(|i| others[i])).collect();
    multi_view_attack(&all, &options).map(Some)
}

/// Those with most matches: the server goes by descriptors, as for its own map. Equal counts stay in their order.
fn nearest(first: &Frame<'_>, others: &[Frame<'_>], count: usize) -> Result<Vec<usize>, AttackError> {
    let mut counted: Vec<(usize, usize)> = Vec::with_capacity(others.len());
    for (i, other) in others.iter().enumerate() {
        let matches = mutual_matches(first.descriptors, other.descriptors, RATIO)?;
        counted.push((matches.iter().flatten().count(), i));
    }
    counted.sort_by_key(|o| std::cmp::Reverse(o.0));
    Ok(counted.into_iter().take(count).map(|o| o.1).collect())
}
