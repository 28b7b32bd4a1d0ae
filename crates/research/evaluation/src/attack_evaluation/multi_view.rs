//! Attack on several frames of one file by a server that has localized all of them.

use veiloc_attacks::multi_view::{
    Frame, FramesOptions, TriangulatedKeypoint, multi_view_attack, select_frames,
};
use veiloc_attacks::{AttackError, mutual_matches};

use super::context::AttackContext;
use crate::EvalError;

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

/// Recovers the keypoints of an image from several frames, including itself, with the poses that the server found:
/// `[N]`; `None` when the image, or every other frame, has no pose.
pub(super) fn by_frames(a: &AttackContext<'_>) -> Result<Option<Vec<TriangulatedKeypoint>>, EvalError> {
    if a.scene.images.len() < a.frames {
        return Err(EvalError::Options(format!(
            "{} frames are requested, but the file of {} has {} images",
            a.frames,
            a.image().name,
            a.scene.images.len()
        )));
    }
    let (views, images) = (a.views()?, a.known()?);
    let frame = |i: usize| {
        let pose = views[i].pose.as_ref()?;
        let observations = if i == a.own { &views[i].observations } else { &views[i].lines };
        Some(Frame {
            camera: pose.camera,
            cam_from_world: pose.cam_from_world,
            observations,
            descriptors: images[i].descriptors(),
        })
    };
    let Some((first, pose)) = frame(a.own).zip(a.pose()) else { return Ok(None) };
    let others: Vec<Frame<'_>> = (0..views.len()).filter(|i| *i != a.own).filter_map(frame).collect();
    if others.is_empty() {
        return Ok(None);
    }
    let options = FramesOptions::with_depths(pose.depths).with_known_points(pose.known.clone());
    let count = a.frames.saturating_sub(1);
    let chosen = match a.evaluation().choice {
        FrameChoice::Turn => select_frames(&first, &others, count, &options)?,
        FrameChoice::Nearest => nearest(&first, &others, count)?,
    };
    let all: Vec<Frame<'_>> = std::iter::once(first).chain(chosen.into_iter().map(|i| others[i])).collect();
    Ok(Some(multi_view_attack(&all, &options)?))
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
