//! Errors: a status for the program, a message for people.

use std::cell::RefCell;
use std::ffi::{CString, c_char};
use std::fmt::Display;
use std::panic::{AssertUnwindSafe, catch_unwind};

use veiloc_ar::BurstError;
use veiloc_obfuscation::{SealError, SealErrorKind};

/// What an app does about an error.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VeilocStatus {
    /// No error.
    Ok = 0,
    /// An argument is invalid: null, an unknown word or number, a pose that is no rotation.
    Argument = 1,
    /// The bytes are not a profile of this version: fetch it again, or update the app.
    Profile = 2,
    /// The frame or its camera cannot be used: sizes, strides, lengths.
    Image = 3,
    /// Too little texture, or on one side only: take another frame.
    Texture = 4,
    /// Too few rows on one side of the dividing line: the query must not be sent; take another frame.
    Unbalanced = 5,
    /// The bytes are not a session: begin a new one.
    Session = 6,
    /// The session would have to be placed anew too often: walk on, and show another view.
    TooManyStarts = 7,
    /// The camera turned away from the session's anchors: turn on or back.
    TurnedAway = 8,
    /// The frame cannot be sealed as the profile and the options ask.
    Seal = 9,
    /// The bytes are not an answer, or content anchors, of this version.
    Answer = 10,
    /// There is no trusted answer yet.
    NotAligned = 11,
    /// An error of the library: please report it.
    Internal = 12,
    /// The call was cancelled; nothing changed.
    Cancelled = 13,
    /// The bytes are not a pack of this version, or it has descriptors with which packs are not used: fetch it again, or
    /// update the app.
    Pack = 14,
    /// Hardly anything in the frame is of the place of the pack: point the camera at the place.
    NotThisPlace = 15,
}

/// An error before it becomes a status.
pub(crate) struct Failure {
    status: VeilocStatus,
    message: String,
}

impl Failure {
    pub(crate) fn new(status: VeilocStatus, message: impl Display) -> Self {
        Self { status, message: message.to_string() }
    }
}

impl From<SealError> for Failure {
    fn from(error: SealError) -> Self {
        let status = match error.kind() {
            SealErrorKind::Image => VeilocStatus::Image,
            SealErrorKind::Texture => VeilocStatus::Texture,
            SealErrorKind::Unbalanced => VeilocStatus::Unbalanced,
            SealErrorKind::NotThisPlace => VeilocStatus::NotThisPlace,
            SealErrorKind::Session => VeilocStatus::Session,
            SealErrorKind::TooManyStarts => VeilocStatus::TooManyStarts,
            SealErrorKind::TurnedAway => VeilocStatus::TurnedAway,
            SealErrorKind::Stopped => VeilocStatus::Cancelled,
            _ => VeilocStatus::Seal,
        };
        Self::new(status, error)
    }
}

impl From<BurstError> for Failure {
    fn from(error: BurstError) -> Self {
        match error {
            BurstError::Frame(error) => error.into(),
            error => Self::new(VeilocStatus::Argument, error),
        }
    }
}

thread_local! {
    /// The message of the last failed call of this thread.
    static MESSAGE: RefCell<CString> = RefCell::new(CString::default());
}

fn store(message: &str) {
    // A zero byte would end the text early.
    let text: String = message.chars().filter(|c| *c != '\0').collect();
    MESSAGE.with(|stored| *stored.borrow_mut() = CString::new(text).unwrap_or_default());
}

/// Runs the body of a function: stores the message of an error, and catches panics.
pub(crate) fn guarded(body: impl FnOnce() -> Result<(), Failure>) -> VeilocStatus {
    // After a panic the handles of the call are as they were before it: the library changes a session and an alignment
    // only as its last step.
    match catch_unwind(AssertUnwindSafe(body)) {
        Ok(Ok(())) => VeilocStatus::Ok,
        Ok(Err(failure)) => {
            store(&failure.message);
            failure.status
        }
        Err(panic) => {
            let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
            let text = text.or_else(|| panic.downcast_ref::<String>().cloned());
            store(&format!("internal error: {}", text.as_deref().unwrap_or("a panic")));
            VeilocStatus::Internal
        }
    }
}

/// The message of the last call of this thread that failed, in English; empty before one. Valid until the next call of
/// this thread fails.
#[unsafe(no_mangle)]
pub extern "C" fn veiloc_last_error() -> *const c_char {
    MESSAGE.with(|stored| stored.borrow().as_ptr())
}

/// The version of the library.
#[unsafe(no_mangle)]
pub extern "C" fn veiloc_version() -> *const c_char {
    const VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), "\0");
    VERSION.as_ptr().cast()
}
