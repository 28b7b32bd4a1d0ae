//! What the user should do, in words.

use std::fmt;

use veiloc_protocol::{Answer, DoubtKind};

/// What is known about the last frame and its answer.
#[derive(Debug, Clone, Copy, Default)]
pub struct Situation<'a> {
    /// Mean gray of the frame, 0 to 1 ([`SealedBurst::brightness`](crate::SealedBurst::brightness)).
    pub brightness: Option<f64>,
    /// Keypoints that were found; `None` when the frame was not sealed.
    pub keypoints: Option<usize>,
    /// Rotation of the camera while it took the frame, degrees per second.
    pub degrees_per_second: Option<f64>,
    /// The answer; `None` when there was none, or no pose was found.
    pub answer: Option<&'a Answer>,
    /// How many frames in a row were answered without a pose (`not-localized`).
    pub misses: u32,
}

/// What the user should do. The first that applies is given, causes before effects.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Advice {
    /// The frame is too dark.
    TooDark,
    /// The camera turns so fast that frames are blurred.
    MoveSlower,
    /// The frame shows too little texture.
    ShowMoreDetail,
    /// The frame shows texture on one side only.
    ShowBothSides,
    /// Several frames were not found: the camera looks at what the map does not have, or this is another place.
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

/// Mean gray below which a frame without many keypoints counts as dark.
const DARK: f64 = 0.12;
/// Keypoints of the smallest size class: with fewer, decoys fill the query up.
const FEW: usize = 256;
/// Rotation that moves the image of a phone by ten pixels in a hundredth of a second.
const FAST_DEG_PER_SECOND: f64 = 60.0;
/// Frames without a pose that stand for another place.
const MANY_MISSES: u32 = 5;

impl Advice {
    /// The advice for a situation.
    pub fn of(situation: &Situation<'_>) -> Self {
        let Situation { brightness, keypoints, degrees_per_second, answer, misses } = *situation;
        if answer.is_some_and(Answer::trusted) {
            return Self::Ready;
        }
        let few = keypoints.is_none_or(|count| count < FEW);
        if few && brightness.is_some_and(|mean| mean < DARK) {
            return Self::TooDark;
        }
        if degrees_per_second.is_some_and(|speed| speed > FAST_DEG_PER_SECOND) {
            return Self::MoveSlower;
        }
        if few {
            return Self::ShowMoreDetail;
        }
        let doubts = answer.map_or(&[][..], |answer| &answer.doubts);
        let has = |kind| doubts.iter().any(|doubt| doubt.kind == kind);
        match answer {
            None if misses >= MANY_MISSES => Self::NotInThisPlace,
            None => Self::TurnToMappedPlace,
            Some(_) if has(DoubtKind::Ambiguous) => Self::ShowSurroundings,
            Some(_) if has(DoubtKind::OneSided) => Self::ShowBothSides,
            Some(_) if has(DoubtKind::Imprecise) => Self::MoveCloser,
            Some(_) if has(DoubtKind::WeakEvidence) => Self::TurnToMappedPlace,
            Some(_) => Self::ShowSurroundings,
        }
    }

    /// All of them.
    pub const ALL: [Self; 9] = [
        Self::TooDark,
        Self::MoveSlower,
        Self::ShowMoreDetail,
        Self::ShowBothSides,
        Self::NotInThisPlace,
        Self::TurnToMappedPlace,
        Self::ShowSurroundings,
        Self::MoveCloser,
        Self::Ready,
    ];

    /// A name for programs, which translate it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::TooDark => "too-dark",
            Self::MoveSlower => "move-slower",
            Self::ShowMoreDetail => "show-more-detail",
            Self::ShowBothSides => "show-both-sides",
            Self::NotInThisPlace => "not-in-this-place",
            Self::TurnToMappedPlace => "turn-to-mapped-place",
            Self::ShowSurroundings => "show-surroundings",
            Self::MoveCloser => "move-closer",
            Self::Ready => "ready",
        }
    }

    /// A sentence for the user, in English.
    pub const fn text(self) -> &'static str {
        match self {
            Self::TooDark => "It is too dark here.",
            Self::MoveSlower => "Move the phone more slowly.",
            Self::ShowMoreDetail => "Point the camera at something with more detail.",
            Self::ShowBothSides => "Turn the camera until both halves of the image show detail.",
            Self::NotInThisPlace => "This does not look like the mapped place.",
            Self::TurnToMappedPlace => "Turn the camera to another part of the place.",
            Self::ShowSurroundings => "This view exists more than once. Show more of what is around it.",
            Self::MoveCloser => "Move closer, or show something that is nearer.",
            Self::Ready => "Position found.",
        }
    }
}

impl fmt::Display for Advice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}
