//! Sessions: frames of one device and one place that share their anchors in the world (rule L10).
//!
//! Two lines of one keypoint from anchors that turn with the camera meet in the keypoint. Where the anchors are directions
//! held fixed in the **world**, every plane of a keypoint holds the same direction through every camera centre, and no number
//! of frames fixes it. So the first frame of a session says where its layout is, and every later one turns the layout into its
//! camera by the orientation that the device measured against the first ([`Orientation`]).
//!
//! What a session adds to [`crate::seal`]:
//! - **The layout stays in the world**, anchors and sectors ([`SessionAnchors`]); the query tells how it is turned.
//! - **A band** along the borders of sectors is left out: what lies there may belong to another anchor in the next frame, and
//!   two lines of two anchors cross in the keypoint ([`SessionOptions::band_deg`]).
//! - **Angles are told on a grid** that is fixed with the anchors, in place of a dither drawn anew: a keypoint that is seen again
//!   at its angle is told by the same code, and does not scatter ([`SessionOptions::step`]).
//!
//! - **What was told is remembered** and told again by the very same row, or left out where it would belong to another anchor now
//!   ([`SessionOptions::memory`]).
//!
//! Where the camera has turned so far that nearly all keypoints belong to one anchor, the layout is put where it serves again, and
//! what was told before is left out.
//!
//! A frame without orientation is still of the session when nearly all that is seen again says that the camera rested or turned on
//! the spot. Otherwise it can share nothing with others and starts anew, and one place sees only so many starts
//! ([`SessionOptions::most_starts`]).

mod align;
mod bytes;
mod memory;
mod options;
mod orientation;
mod place;

use rand::CryptoRng;
use veiloc_features::Features;
use veiloc_geometry::Intrinsics;
use veiloc_geometry::nalgebra::Rotation3;
use veiloc_protocol::{CanonicalCamera, Profile, Scheme, SealedQuery};

pub use options::{SessionAnchors, SessionAnchorsError, SessionOptions};
pub use orientation::Orientation;

use memory::Memory;
use place::place;

use crate::grid::AngleGrid;
use crate::rule::{FrameRule, Recalled};
use crate::schemes::dcl::pencils;
use crate::seal::{Hidden, Kept, check, seal_frame};
use crate::{SealError, SealOptions};

/// What the frames of one place share: held by the device, and by nobody else.
///
/// ```
/// # use rand::Rng;
/// # use veiloc_descriptor::{DescriptorKind, Descriptors, Vocabulary};
/// # use veiloc_features::{Features, Keypoint};
/// # use veiloc_geometry::Pixel;
/// use veiloc_obfuscation::{Orientation, SealOptions, Session, SessionOptions, device_rng};
/// # let kind = DescriptorKind::ROOT_SIFT;
/// # let profile = veiloc_protocol::Profile::vlad(Vocabulary::new(Descriptors::new(kind, vec![20; 2 * 128])?)?);
/// # let features = || -> Features {
/// #     let place = |i: u32| Pixel::new(f64::from(20 + i * 97 % 600), f64::from(20 + i * 61 % 440));
/// #     let keypoints = (0..300).map(|i| Keypoint { pixel: place(i), scale: 2.0, orientation: 0.0, response: 1.0 });
/// #     let bytes = (0..300 * 128_u32).map(|i| (i * 31 % 90) as u8).collect();
/// #     Features { keypoints: keypoints.collect(), descriptors: Descriptors::new(kind, bytes).expect("rows"), global: None }
/// # };
///
/// let camera = "SIMPLE_RADIAL,640,480,525,320,240,-0.01".parse()?;
/// let (options, mut rng) = (SealOptions::default(), device_rng()?);
/// let mut session = Session::new(SessionOptions::default(), &mut rng);
/// // How the device held its camera, against any frame that stays in the world: from its gyroscope or odometry.
/// for quaternion in [[1.0, 0.0, 0.0, 0.0], [0.995, 0.0, 0.0998, 0.0]] {
///     let held = Orientation::from_quaternion(quaternion).ok_or("no rotation")?;
///     let sealed = session.seal(features(), &camera, &profile, &options, &held, &mut rng)?;
///     assert_eq!(sealed.scheme().to_string(), "dcl");
/// }
/// assert_eq!((session.frames(), session.starts()), (2, 1));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, PartialEq)]
pub struct Session {
    options: SessionOptions,
    key: [u8; 32],
    start: Option<Start>,
    frames: u32,
    starts: u32,
    memory: Memory,
}

/// Where the layout was put, and what has to stay the same for it to stay there.
#[derive(Clone, Copy, PartialEq)]
struct Start {
    scheme: Scheme,
    /// Places of anchors are told in heights of its image.
    camera: CanonicalCamera,
    /// As soon as a frame told how the camera was held.
    layout_from_world: Option<Rotation3<f64>>,
}

impl Session {
    /// One that has not begun. Its key is drawn from `rng`: [`crate::device_rng`] on a device.
    pub fn new(options: SessionOptions, rng: &mut impl CryptoRng) -> Self {
        let mut key = [0; 32];
        rng.fill_bytes(&mut key);
        Self { options, key, start: None, frames: 0, starts: 0, memory: Memory::default() }
    }

    /// Seals the next frame: as [`crate::seal`], with the layout where the session has it.
    ///
    /// `held`: how the device held the camera. Without an orientation the frame goes on only where what is seen again says that
    /// the camera rested or turned on the spot, and else starts anew.
    ///
    /// Nothing of the session changes when this fails.
    ///
    /// # Errors
    /// [`SealError`] as of [`crate::seal`]; [`SealError::TooManyStarts`] when the layout would have to be put elsewhere once
    /// more; [`SealError::SessionScheme`] for a scheme without anchors where they are to stay in the world;
    /// [`SealError::SessionChanged`] for another layout or camera than the frames before;
    /// [`SealError::TurnedAway`] where the layout has to be put anew and hardly anything new is seen;
    /// [`SealError::NoGravity`] when anchors are tied to gravity and the frame that starts does not tell it.
    pub fn seal(
        &mut self,
        features: Features,
        camera: &Intrinsics,
        profile: &Profile,
        options: &SealOptions,
        held: &Orientation,
        rng: &mut impl CryptoRng,
    ) -> Result<SealedQuery, SealError> {
        self.seal_and(features, (camera, profile), options, held, rng, |_| ()).map(|(query, ())| query)
    }

    /// Frames that were sealed.
    pub const fn frames(&self) -> u32 {
        self.frames
    }

    /// How often the layout was put somewhere new.
    pub const fn starts(&self) -> u32 {
        self.starts
    }

    /// How it was set up.
    pub const fn options(&self) -> &SessionOptions {
        &self.options
    }

    /// Seals, and lets `look` see what is hidden.
    pub(crate) fn seal_and<T>(
        &mut self,
        features: Features,
        (camera, profile): (&Intrinsics, &Profile),
        options: &SealOptions,
        held: &Orientation,
        rng: &mut impl CryptoRng,
        look: impl FnOnce(&Hidden<'_>) -> T,
    ) -> Result<(SealedQuery, T), SealError> {
        check(&features, profile)?;
        let placed = place(self, &features, camera, options, held)?;
        let cam_from_layout = placed.turn.cam_from_layout();
        let in_world = self.options.anchors != SessionAnchors::Image;
        let remembers = in_world && self.options.memory;
        let mut recalled = match options.scheme() {
            Scheme::Dcl(layout) if remembers => {
                let pinhole = CanonicalCamera::for_intrinsics(camera)?.pinhole();
                let pencils = pencils(layout, &pinhole, placed.turn);
                let anchor_of = |i: usize| {
                    let pixel = pinhole.project(camera.unproject(features.keypoints[i].pixel)?);
                    Some(pencils.anchor_of(pixel))
                };
                let (matched, seen) = (&placed.matched, &placed.seen);
                self.memory.recall(matched, &features.descriptors, seen, &cam_from_layout, anchor_of)
            }
            _ => vec![(Recalled::New, None); features.keypoints.len()],
        };
        for (recalled, _) in recalled.iter_mut().zip(&placed.left_out).filter(|(_, left_out)| **left_out) {
            recalled.0 = Recalled::Crossed;
        }
        let rule = FrameRule {
            turn: placed.turn,
            band: if in_world { self.options.band_deg.to_radians() } else { 0.0 },
            grid: (in_world && self.options.step > 0.0)
                .then(|| AngleGrid::new(&self.key, placed.starts, self.options.step)),
            recalled: recalled.iter().map(|(what, _)| *what).collect(),
        };
        let see = |hidden: &Hidden<'_>| {
            let row = |(kept, place): (&Kept, &usize)| {
                let direction = cam_from_layout.inverse() * placed.seen[kept.source]?;
                Some((kept.source, recalled[kept.source].1, direction, *hidden.told.get(*place)?))
            };
            let rows: Vec<_> = hidden.kept.iter().zip(&hidden.places.of).filter_map(row).collect();
            (rows, look(hidden))
        };
        let (query, (rows, looked)) = seal_frame(&features, camera, profile, options, &rule, rng, see)?;
        if placed.turned_away || placed.left_out.contains(&true) {
            // Kept, such a frame would put the layout where the next one is no better off.
            query.check_sides().map_err(|lopsided| SealError::TurnedAway { few: lopsided.few })?;
        }
        self.frames = self.frames.saturating_add(1);
        (self.start, self.starts) = (placed.start, placed.starts);
        if remembers {
            let at = (self.starts, self.frames);
            self.memory.remember(rows.into_iter(), &features.descriptors, at);
        }
        Ok((query, looked))
    }
}

// The key and the orientations are secrets.
impl std::fmt::Debug for Session {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Session({} frames, {} starts)", self.frames, self.starts)
    }
}
