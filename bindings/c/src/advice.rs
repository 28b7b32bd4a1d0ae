//! What the user should do, in words.

use std::ffi::{CString, c_char};
use std::sync::OnceLock;

use veiloc_ar::{Advice, Situation};

use crate::answer::VeilocAnswer;
use crate::pointers;
use crate::query::VeilocQueryInfo;

/// What the user should do.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VeilocAdvice {
    /// The frame is too dark.
    TooDark = 0,
    /// The camera turns so fast that frames are blurred.
    MoveSlower = 1,
    /// The frame shows too little texture.
    ShowMoreDetail = 2,
    /// The frame shows texture on one side only.
    ShowBothSides = 3,
    /// Several frames were not found: this may be another place.
    NotInThisPlace = 4,
    /// The frame was not found.
    TurnToMappedPlace = 5,
    /// What the frame shows exists in several places of the map.
    ShowSurroundings = 6,
    /// What the frame shows is too far away, or in too small a part of it.
    MoveCloser = 7,
    /// The pose is trusted.
    Ready = 8,
}

/// The advice for the last frame.
///
/// - `query`: null when the frame could not be sealed.
/// - `answer`: null when there was none, or the service found no pose.
/// - `degrees_per_second`: rotation of the camera while it took the frame; 0 when it is not known.
/// - `misses`: how many frames in a row the service found no pose for.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_advice(
    query: *const VeilocQueryInfo,
    answer: *const VeilocAnswer,
    degrees_per_second: f64,
    misses: u32,
) -> VeilocAdvice {
    // SAFETY: the contract of the crate.
    let query = unsafe { pointers::optional(query) };
    // SAFETY: as above.
    let answer = unsafe { pointers::optional(answer) }.map(|answer| &answer.answer);
    let situation = Situation {
        brightness: query.map(|query| query.brightness),
        keypoints: query.map(|query| query.keypoints as usize),
        degrees_per_second: (degrees_per_second > 0.0).then_some(degrees_per_second),
        answer,
        misses,
    };
    match Advice::of(&situation) {
        Advice::TooDark => VeilocAdvice::TooDark,
        Advice::MoveSlower => VeilocAdvice::MoveSlower,
        Advice::ShowMoreDetail => VeilocAdvice::ShowMoreDetail,
        Advice::ShowBothSides => VeilocAdvice::ShowBothSides,
        Advice::NotInThisPlace => VeilocAdvice::NotInThisPlace,
        Advice::TurnToMappedPlace => VeilocAdvice::TurnToMappedPlace,
        Advice::ShowSurroundings => VeilocAdvice::ShowSurroundings,
        Advice::MoveCloser => VeilocAdvice::MoveCloser,
        Advice::Ready => VeilocAdvice::Ready,
    }
}

/// A sentence for the user, in English; null for a number that is no advice.
#[unsafe(no_mangle)]
pub extern "C" fn veiloc_advice_text(advice: u32) -> *const c_char {
    static TEXTS: OnceLock<Vec<CString>> = OnceLock::new();
    let texts = TEXTS.get_or_init(|| {
        Advice::ALL.iter().map(|advice| CString::new(advice.text()).unwrap_or_default()).collect()
    });
    texts.get(advice as usize).map_or(std::ptr::null(), |text| text.as_ptr())
}
