//! From an image to the one message that leaves the device: the entry points of this crate.

use rand::CryptoRng;
use veiloc_features::{Features, Image, Limits, SharedGlobal};
use veiloc_protocol::{CoarseGravity, ExtractionLimits, Hints, Profile, SealedIn, SealedQuery};

use crate::rule::FrameRule;
use crate::seal::HiddenState;
use crate::{KnownCamera, KnownPlace, Orientation, SealError, SealOptions, Session};

/// Seals images for one map: [`Self::extract`], then [`Self::seal`], alone or [`Self::in_session`].
///
/// What the profile asks for is checked once, when the sealer is made. One sealer serves any number of images.
#[derive(Debug, Clone)]
pub struct Sealer {
    profile: Profile,
    options: SealOptions,
    limits: ExtractionLimits,
    image_global: Option<SharedGlobal>,
    place: Option<KnownPlace>,
}

impl Sealer {
    /// For the map of this profile, with the decisions of the device.
    ///
    /// # Errors
    /// [`SealError::VocabularyTooLarge`] when the profile's vocabulary exceeds the limit of the device, and
    /// [`SealError::GlobalOfImage`] when it requests a global descriptor of the image without the owner's consent
    /// ([`SealOptions::with_image_global`]).
    pub fn new(profile: &Profile, options: SealOptions) -> Result<Self, SealError> {
        let image_global = options.image_global(profile)?.cloned();
        let limits = options.bounded(profile)?;
        let place = options.place(profile)?;
        Ok(Self { profile: profile.clone(), options, limits, image_global, place })
    }

    /// Features of an image as the profile requests them, within the limits of the device, with the global descriptor of
    /// the image if the owner consented to it. An image larger than the limit is scaled down first, and its camera with
    /// it.
    ///
    /// - `image`: what a mask hides of it ([`Image::without`]) is never read: two images that differ only there have equal
    ///   features, and no keypoint is returned whose descriptor window touches the mask (rule L13).
    /// - `camera`: of the image as it is in the file or sensor, before any turn of the image ([`Image::turns`]).
    ///   [`Intrinsics`](veiloc_geometry::Intrinsics) are those of a calibrated camera.
    ///
    /// Descriptors do not show the image's border (rule L11): the image is continued by its mirror image; for other
    /// extractors, keypoints whose descriptor window crosses the border are dropped.
    ///
    /// # Errors
    /// [`SealError::Image`] when the image does not have the camera's size, its extraction was stopped
    /// ([`Image::with_stop`]), or the device has no extractor of the profile's descriptor kind.
    pub fn extract(&self, image: Image, camera: impl Into<KnownCamera>) -> Result<Extracted, SealError> {
        let KnownCamera { intrinsics, focal } = camera.into();
        let intrinsics = intrinsics.turned(image.turns());
        let extractor = self.options.extractors().of_kind(self.profile.descriptor_kind())?;
        // Computed on the image after masking (rules L13 and L14).
        let global = self.image_global().map(|own| own.describe(&image)).transpose()?;
        // Some keypoints lie at the border or beyond the window and are dropped during sealing (rule L11). Without spare
        // ones an image would fall into a smaller size class.
        let most = self.limits.max_keypoints + self.limits.max_keypoints / SPARE;
        let limits = Limits { max_keypoints: most as usize, max_side: self.limits.max_image_side };
        let size = Some((intrinsics.width, intrinsics.height));
        let image = veiloc_features::extract_loaded(image, size, extractor, limits)?;
        let features = Features { global, ..image.features.whole(image.size, extractor.support_radius()) };
        let intrinsics = intrinsics.resized(image.size.0, image.size.1);
        Ok(Extracted::new(features, KnownCamera { intrinsics, focal }))
    }

    /// Seals one image: the only function, with [`SessionSealer::seal`], that turns keypoints into lines.
    ///
    /// The scheme is that of the options, regardless of the profile.
    ///
    /// 1. Each keypoint is undistorted and re-projected into the canonical camera (L6). Those without a ray, outside
    ///    its window (L11), or within one pixel of an anchor are dropped.
    /// 2. The strongest are selected: as many as the largest size class not above their count, the profile's limit and the
    ///    device's. Below the smallest class, decoys made of the sent rows fill the query up (L5).
    /// 3. Position, dithered by up to half a pixel (L2); anchor, line, code (L1, L9). Features with one position share one
    ///    dither and one line (L7).
    /// 4. Rows are shuffled (L3); strength, scale and orientation are not sent (L4).
    /// 5. A global descriptor of the image is sent only where the map requests one and the owner consented to it (L14).
    ///
    /// An image is sealed once (L7), so its features are taken by value. When the network fails, send the same bytes
    /// again. Sealing a second time would draw second lines through the same keypoints, and these lines cross in the
    /// keypoints. For several images of one scene use [`Self::in_session`] (L10).
    ///
    /// ```compile_fail,E0382
    /// # use veiloc_obfuscation::{Extracted, SealOptions, Sealer, device_rng};
    /// # fn f(sealer: Sealer, extracted: Extracted) {
    /// let first = sealer.seal(extracted, &mut device_rng().unwrap());
    /// let retry = sealer.seal(extracted, &mut device_rng().unwrap()); // the image is used up
    /// # }
    /// ```
    ///
    /// `rng`: [`crate::device_rng`] on a device; tests pass a seeded generator.
    ///
    /// # Errors
    /// [`SealError`]: no usable keypoint, all of one anchor (dcl), a position that is not finite, an invalid camera,
    /// descriptors of another kind than the profile's, too few keypoints of a kind that has no decoys, or, with
    /// [`SealOptions::only_balanced`], a query that could not determine a pose.
    pub fn seal(&self, extracted: Extracted, rng: &mut impl CryptoRng) -> Result<SealedQuery, SealError> {
        self.seal_and(&extracted, rng, |_| ()).map(|(query, ())| query)
    }

    /// For the next image of a session, whose images share their anchors (rule L10).
    pub const fn in_session<'a>(&'a self, session: &'a mut Session) -> SessionSealer<'a> {
        SessionSealer { sealer: self, session }
    }

    /// The profile of the map.
    pub const fn profile(&self) -> &Profile {
        &self.profile
    }

    /// The place of the pack, if the device has one.
    pub const fn place(&self) -> Option<&KnownPlace> {
        self.place.as_ref()
    }

    /// The decisions of the device.
    pub const fn options(&self) -> &SealOptions {
        &self.options
    }

    /// How much of an image is extracted: what the profile requests, within the limits of the device. The longest side
    /// is one of [`DeviceLimits::IMAGE_SIDES`](crate::DeviceLimits::IMAGE_SIDES).
    pub const fn limits(&self) -> ExtractionLimits {
        self.limits
    }

    /// The extractor of the global descriptor of the image, which is sent; `None` where the profile requests none.
    pub const fn image_global(&self) -> Option<&SharedGlobal> {
        self.image_global.as_ref()
    }

    /// Seals an image, and calls `look` with the hidden values before they are discarded.
    pub(crate) fn seal_and<T>(
        &self,
        extracted: &Extracted,
        rng: &mut impl CryptoRng,
        look: impl FnOnce(&HiddenState<'_>) -> T,
    ) -> Result<(SealedQuery, T), SealError> {
        self.check(&extracted.features)?;
        let (query, seen) = self.seal_frame(extracted, &FrameRule::default(), rng, look)?;
        self.check_sides(&query)?;
        Ok((query.with_sealed_in(SealedIn::Alone), seen))
    }
}

/// One keypoint in addition to this many is extracted: the window drops up to a quarter of an image, and a session drops
/// keypoints that must not be sent again.
const SPARE: u32 = 2;

/// A [`Sealer`] for the next image of a session.
#[derive(Debug)]
pub struct SessionSealer<'a> {
    pub(crate) sealer: &'a Sealer,
    pub(crate) session: &'a mut Session,
}

impl SessionSealer<'_> {
    /// Seals the next image: as [`Sealer::seal`], with the session's layout and the orientation of the camera
    /// ([`Extracted::with_orientation`]).
    ///
    /// Without an orientation, the image continues the session only where recognized keypoints agree that the camera
    /// rested or turned on the spot; otherwise it starts anew.
    ///
    /// An error leaves the session unchanged.
    ///
    /// # Errors
    /// [`SealError`] as for [`Sealer::seal`]; [`SealError::TooManyStarts`] when the layout would have to be placed anew
    /// once more; [`SealError::SessionScheme`] for a scheme without anchors where they must be fixed in the world;
    /// [`SealError::SessionChanged`] for another layout or camera than in earlier images; [`SealError::TurnedAway`]
    /// when the layout must be placed anew and hardly any new keypoint is seen; [`SealError::NoGravity`] when anchors
    /// are tied to gravity and the image that starts has no gravity direction.
    pub fn seal(self, extracted: Extracted, rng: &mut impl CryptoRng) -> Result<SealedQuery, SealError> {
        self.session.seal_and(self.sealer, &extracted, rng, |_| ()).map(|(query, ())| query)
    }
}

/// The features of one image with their camera, until they are sealed. Not cloned: an image is sealed once (rule L7).
pub struct Extracted {
    pub(crate) features: Features,
    pub(crate) camera: KnownCamera,
    pub(crate) orientation: Orientation,
    pub(crate) gravity: Option<CoarseGravity>,
}

impl Extracted {
    /// Features that did not come from [`Sealer::extract`]. `camera`: that of their pixels.
    pub fn new(features: Features, camera: impl Into<KnownCamera>) -> Self {
        Self { features, camera: camera.into(), orientation: Orientation::unknown(), gravity: None }
    }

    /// With the orientation of the camera when it took the image. Only its gravity direction is sent, rounded, with a
    /// standard deviation of [`CoarseGravity::TRACKING_SD_DEG`], unless the device sends none
    /// ([`SealOptions::without_gravity`]). The rotation serves a session.
    #[must_use]
    pub fn with_orientation(self, orientation: Orientation) -> Self {
        Self { orientation, ..self }
    }

    /// With a gravity direction that was measured while the image was taken, in place of that of the orientation. It
    /// helps where few keypoints match. It reveals the tilt of the device, rounded to about a degree
    /// (`docs/reference/privacy-rules.md`).
    #[must_use]
    pub fn with_gravity(self, gravity: Option<CoarseGravity>) -> Self {
        Self { gravity, ..self }
    }

    /// The features, in pixels of [`Self::camera`].
    pub const fn features(&self) -> &Features {
        &self.features
    }

    /// The camera of the features: that of the image, scaled as the image was for extraction.
    pub const fn camera(&self) -> &KnownCamera {
        &self.camera
    }

    /// What a query says about the camera beside its rows.
    pub(crate) fn hints(&self, options: &SealOptions) -> Hints {
        let gravity = self.gravity.or_else(|| self.orientation.coarse_gravity());
        Hints { focal: self.camera.focal, gravity: gravity.filter(|_| options.sends_gravity()) }
    }
}

// Keypoints and gravity must not be logged (rule L8).
impl std::fmt::Debug for Extracted {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Extracted({})", self.features.keypoints.len())
    }
}
