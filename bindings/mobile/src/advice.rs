//! What the user should do, in words.

use std::sync::Arc;

use veiloc_ar::Situation;

use crate::answer::Answer;
use crate::query::Query;

pub use veiloc_ar::Advice;

/// What the user should do.
#[uniffi::remote(Enum)]
pub enum Advice {
    /// The frame is too dark.
    TooDark,
    /// The camera turns so fast that frames are blurred.
    MoveSlower,
    /// The frame shows too little texture.
    ShowMoreDetail,
    /// The frame shows texture on one side only.
    ShowBothSides,
    /// Several frames were not found: this may be another place.
    NotInThisPlace,
    /// The frame was not found.
    TurnToMappedPlace,
    /// What the frame shows exists in several places of the map.
    ShowSurroundings,
    /// What the frame shows is too far away, or in too small a part of it.
    MoveCloser,
    /// The pose is trusted.
    Ready,
}

/// The advice for the last frame.
///
/// - `query`: null when the frame could not be sealed.
/// - `answer`: null when there was none, or the service found no pose.
/// - `degrees_per_second`: rotation of the camera while it took the frame, when it is known.
/// - `misses`: how many frames in a row the service found no pose for.
#[uniffi::export(default(degrees_per_second = None, misses = 0))]
pub fn advice(
    query: Option<Arc<Query>>,
    answer: Option<Arc<Answer>>,
    degrees_per_second: Option<f64>,
    misses: u32,
) -> Advice {
    let situation = Situation {
        brightness: query.as_ref().map(|query| query.brightness()),
        keypoints: query.as_ref().map(|query| query.keypoints() as usize),
        degrees_per_second,
        answer: answer.as_ref().map(|answer| &answer.answer),
        misses,
    };
    Advice::of(&situation)
}

/// A sentence for the user, in English.
#[uniffi::export]
pub fn advice_text(advice: Advice) -> String {
    advice.text().to_owned()
}
