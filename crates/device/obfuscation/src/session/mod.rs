//! Sessions: frames of one device in one scene that share their anchors in the world (rule L10).
//!
//! If anchors turn with the camera, two lines of one keypoint meet in the keypoint. If the anchors are directions fixed
//! in the **world**, all planes of a scene point contain that direction through every camera centre, and no number of
//! frames determines the point. Therefore the first frame of a session defines the layout, and every later frame
//! rotates the layout into its camera by the orientation that the device measured relative to the first frame
//! ([`Orientation`]).
//!
//! What a session adds to [`Sealer::seal`]:
//! - **The layout is fixed in the world**, anchors and sectors ([`SessionAnchors`]); the query contains its rotation.
//! - **Keypoints near sector borders are dropped**: in the next frame they may belong to another anchor, and two lines
//!   of two anchors cross in the keypoint ([`SessionOptions::band_deg`]).
//! - **Angles are quantized on a grid** that is fixed with the anchors, instead of a new dither per frame: a keypoint
//!   that is seen again at the same angle gets the same code and does not scatter ([`SessionOptions::step`]).
//! - **Sent rows are stored**: a keypoint that is seen again is sent as the same row, or dropped where it would now
//!   belong to another anchor ([`SessionOptions::memory`]).
//!
//! When the camera has turned so far that nearly all keypoints belong to one anchor, the layout is placed anew, and
//! keypoints that were sent before are dropped.
//!
//! A frame without orientation still belongs to the session when nearly all recognized keypoints agree that the camera
//! rested or turned on the spot. Otherwise it shares nothing with earlier frames and starts anew; the number of starts
//! per scene is limited ([`SessionOptions::max_starts`]).

mod align;
mod bytes;
mod memory;
mod options;
mod orientation;
mod overlap;
mod placement;

use rand::CryptoRng;
use sha2::{Digest as _, Sha256};
use veiloc_geometry::nalgebra::Rotation3;
use veiloc_protocol::{CanonicalCamera, Scheme, SealedIn, SealedQuery, SessionTag};

pub use options::{SessionAnchors, SessionAnchorsError, SessionOptions};
pub use orientation::Orientation;

use memory::Memory;
use placement::place_layout;

use crate::grid::AngleGrid;
use crate::rule::{FrameRule, RowHistory};
use crate::schemes::dcl::pencils;
use crate::seal::{HiddenState, SelectedKeypoint};
use crate::{Extracted, SealError, Sealer};

/// What the frames of one scene share. Only the device holds it.
///
/// ```
/// # use rand::Rng;
/// # use veiloc_descriptor::{DescriptorKind, Descriptors, Vocabulary};
/// # use veiloc_features::{Features, Keypoint};
/// # use veiloc_geometry::Pixel;
/// use veiloc_geometry::Intrinsics;
/// use veiloc_obfuscation::{
///     Extracted, Orientation, SealOptions, Sealer, Session, SessionOptions, device_rng,
/// };
/// # let kind = DescriptorKind::ROOT_SIFT;
/// # let profile = veiloc_protocol::Profile::vlad(Vocabulary::new(Descriptors::new(kind, vec![20; 2 * 128])?)?);
/// # let features = || -> Features {
/// #     let pixel = |i: u32| Pixel::new(f64::from(20 + i * 97 % 600), f64::from(20 + i * 61 % 440));
/// #     let keypoints = (0..300).map(|i| Keypoint { pixel: pixel(i), scale: 2.0, orientation: 0.0, response: 1.0 });
/// #     let bytes = (0..300 * 128_u32).map(|i| (i * 31 % 90) as u8).collect();
/// #     Features { keypoints: keypoints.collect(), descriptors: Descriptors::new(kind, bytes).expect("rows"), global: None }
/// # };
///
/// let camera: Intrinsics = "SIMPLE_RADIAL,640,480,525,320,240,-0.01".parse()?;
/// let (sealer, mut rng) = (Sealer::new(&profile, SealOptions::default())?, device_rng()?);
/// let mut session = Session::new(SessionOptions::default(), &mut rng);
/// // Orientation of the camera relative to any frame that is fixed in the world: from gyroscope or odometry.
/// for quaternion in [[1.0, 0.0, 0.0, 0.0], [0.995, 0.0, 0.0998, 0.0]] {
///     let orientation = Orientation::from_quaternion(quaternion).ok_or("no rotation")?;
///     let extracted = Extracted::new(features(), camera).with_orientation(orientation);
///     let sealed = sealer.in_session(&mut session).seal(extracted, &mut rng)?;
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
    /// Starts that may have sent keypoints of an earlier one again, under other anchors.
    retries: u32,
    memory: Memory,
}

/// The layout of the current start, and what must not change while it is used.
#[derive(Clone, Copy, PartialEq)]
struct Start {
    scheme: Scheme,
    /// Anchor positions are given in heights of its image.
    camera: CanonicalCamera,
    /// Set as soon as a frame gives its orientation.
    layout_from_world: Option<Rotation3<f64>>,
}

impl Session {
    /// A session without frames. Its key is drawn from `rng`: [`crate::device_rng`] on a device.
    pub fn new(options: SessionOptions, rng: &mut impl CryptoRng) -> Self {
        let mut key = [0; 32];
        rng.fill_bytes(&mut key);
        Self { options, key, start: None, frames: 0, starts: 0, retries: 0, memory: Memory::default() }
    }

    /// Number of sealed frames.
    pub const fn frames(&self) -> u32 {
        self.frames
    }

    /// How often the layout was placed.
    pub const fn starts(&self) -> u32 {
        self.starts
    }

    /// Names the last frame's part of this session on its device: queries of one part may be sent together as a rig. A new part
    /// begins with a frame that starts anew because its orientation is not known: it may send keypoints again, under other
    /// anchors. The name says nothing of the key, and is not sent.
    pub fn tag(&self) -> SessionTag {
        let hash = Sha256::new()
            .chain_update(b"veiloc session tag")
            .chain_update(self.key)
            .chain_update(self.retries.to_le_bytes())
            .finalize();
        SessionTag(std::array::from_fn(|i| hash[i]))
    }

    /// The options of this session.
    pub const fn options(&self) -> &SessionOptions {
        &self.options
    }

    /// Seals, and calls `look` with the hidden values.
    pub(crate) fn seal_and<T>(
        &mut self,
        sealer: &Sealer,
        extracted: &Extracted,
        rng: &mut impl CryptoRng,
        look: impl FnOnce(&HiddenState<'_>) -> T,
    ) -> Result<(SealedQuery, T), SealError> {
        let (features, camera) = (&extracted.features, &extracted.camera.intrinsics);
        sealer.check(features)?;
        let scheme = sealer.options().scheme();
        let placement = place_layout(self, extracted, scheme)?;
        let cam_from_layout = placement.turn.cam_from_layout();
        let in_world = self.options.anchors != SessionAnchors::Image;
        let remembers = in_world && self.options.memory;
        let mut history = match scheme {
            Scheme::Dcl(layout) if remembers => {
                let pinhole = placement.camera.pinhole();
                let pencils = pencils(layout, &pinhole, placement.turn);
                let anchor_of = |i: usize| {
                    let pixel = pinhole.project(camera.unproject(features.keypoints[i].pixel)?);
                    Some(pencils.anchor_of(pixel))
                };
                let (matched, seen) = (&placement.matched, &placement.seen);
                self.memory.row_histories(matched, &features.descriptors, seen, &cam_from_layout, anchor_of)
            }
            _ => vec![(RowHistory::New, None); features.keypoints.len()],
        };
        for (history, _) in history.iter_mut().zip(&placement.dropped).filter(|(_, dropped)| **dropped) {
            history.0 = RowHistory::OtherAnchor;
        }
        let rule = FrameRule {
            camera: Some(placement.camera),
            turn: placement.turn,
            band: if in_world { self.options.band_deg.to_radians() } else { 0.0 },
            grid: (in_world && self.options.step > 0.0)
                .then(|| AngleGrid::new(&self.key, placement.starts, self.options.step)),
            history: history.iter().map(|(what, _)| *what).collect(),
        };
        let see = |hidden: &HiddenState<'_>| {
            let row = |(selected, position): (&SelectedKeypoint, &usize)| {
                let direction = cam_from_layout.inverse() * placement.seen[selected.source]?;
                Some((selected.source, history[selected.source].1, direction, *hidden.sent.get(*position)?))
            };
            let rows: Vec<_> = hidden.selected.iter().zip(&hidden.positions.index).filter_map(row).collect();
            (rows, look(hidden))
        };
        let (query, (rows, looked)) = sealer.seal_frame(extracted, &rule, rng, see)?;
        if placement.turned_away || placement.dropped.contains(&true) {
            // Not stored: the layout of such a frame would not serve the next one either.
            query.check_sides().map_err(|unbalanced| SealError::TurnedAway { few: unbalanced.few })?;
        }
        sealer.check_sides(&query)?;
        self.frames = self.frames.saturating_add(1);
        // Anchors in the image are placed anew in each frame, as the owner of the device wants it.
        let is_anew = self.starts > 0 && placement.starts > self.starts && in_world;
        self.retries = self.retries.saturating_add(u32::from(is_anew && !placement.turned_away));
        (self.start, self.starts) = (placement.start, placement.starts);
        if remembers {
            let at = (self.starts, self.frames);
            self.memory.remember(rows.into_iter(), &features.descriptors, at);
        }
        Ok((query.with_sealed_in(SealedIn::Session(self.tag())), looked))
    }
}

// The key and the orientations are secrets.
impl std::fmt::Debug for Session {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Session({} frames, {} starts)", self.frames, self.starts)
    }
}
