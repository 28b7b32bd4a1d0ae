//! Attack on several frames of one file by a server that has localized all of them.

use veiloc_attacks::multi_view::{
    Frame, FramesOptions, TriangulatedKeypoint, multi_view_attack, select_frames,
};
use veiloc_attacks::{AttackError, KnownImage, mutual_matches};

use super::server_view::ServerView;

/// How an attack on several frames chooses them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum FrameChoice {
    /// Frames that carry the most information about the attacked frame: large rotation, small translation.
    #[default]
    Turn,
    /// Frames with the most matches.
    Nearest,
}

/// Ratio test for the matches by which frames are chosen.
const RATIO: f64 = 0.9;

/// Recovers the keypoints of image `own` from `frames` frames, including itself, with the poses that the server
/// found: `[N]`; `None` when `own`, or every other frame, has no pose.
///
/// `views`, `images`: `[images]` of the file.
pub(super) fn multi_view_answers(
    views: &[ServerView],
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
    let options = FramesOptions::with_depths(pose.depths).with_known_points(pose.known.clone());
    let count = frames.saturating_sub(1);
    let chosen = match choice {
        FrameChoice::Turn => select_frames(&first, &others, count, &options)?,
        FrameChoice::Nearest => nearest(&first, &others, count)?,
    };
    let all: Vec<Frame<'_>> = std::iter::once(first).chain(chosen.into_iter().map(|i| others[i])).collect();
    multi_view_attack(&all, &options).map(Some)
}

/// Frames with the most descriptor matches, as for the server's own map. Ties keep their order.
fn nearest(first: &Frame<'_>, others: &[Frame<'_>], count: usize) -> Result<Vec<usize>, AttackError> {
    let mut counted: Vec<(usize, usize)> = Vec::with_capacity(others.len());
    for (i, other) in others.iter().enumerate() {
        let matches = mutual_matches(first.descriptors, other.descriptors, RATIO)?;
        counted.push((matches.iter().flatten().count(), i));
    }
    counted.sort_by_key(|o| std::cmp::Reverse(o.0));
    Ok(counted.into_iter().take(count).map(|o| o.1).collect())
}
