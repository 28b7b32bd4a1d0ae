//! What the device decides: the scheme, how much it sends, and how far it follows a profile.

use veiloc_descriptor::{GlobalModel, Vocabulary};
use veiloc_features::{Extractors, SharedGlobal};
use veiloc_protocol::{AngleBits, CoarseGravity, ExtractionLimits, FocalKnowledge, Hints, Profile, Scheme};

use crate::SealError;

/// How an image is sealed. All of it is the device's choice; nothing here comes from a profile.
///
/// `points`, which protects nothing, has a constructor of its own, so that it can be reached on purpose only:
///
/// ```
/// use veiloc_obfuscation::SealOptions;
/// use veiloc_protocol::Scheme;
///
/// assert_eq!(SealOptions::default().scheme().to_string(), "dcl");
/// let lines = SealOptions::new("random-lines".parse()?)?.with_max_keypoints(512);
/// assert_eq!(lines.scheme(), Scheme::RandomLines);
/// assert!(SealOptions::new(Scheme::Points).is_err());
/// assert_eq!(SealOptions::unprotected_points().scheme(), Scheme::Points);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct SealOptions {
    scheme: Scheme,
    angle_bits: AngleBits,
    max_keypoints: Option<usize>,
    limits: DeviceLimits,
    hints: Hints,
    extractors: Extractors,
    image_global: Option<SharedGlobal>,
}

/// `dcl` with a vertical dividing line, 12-bit angles, as many keypoints as the profile asks for within
/// [`DeviceLimits::default`]; the camera is calibrated, gravity is not told, features are SIFT's ([`Extractors::for_sealing`]), and
/// no global descriptor of the image is sent.
impl Default for SealOptions {
    fn default() -> Self {
        Self {
            scheme: Scheme::default(),
            angle_bits: AngleBits::default(),
            max_keypoints: None,
            limits: DeviceLimits::default(),
            hints: Hints::default(),
            extractors: Extractors::for_sealing(),
            image_global: None,
        }
    }
}

impl SealOptions {
    /// With a scheme that hides positions, all else as [`Self::default`].
    ///
    /// # Errors
    /// [`SealError::Unprotected`] for `points`.
    pub fn new(scheme: Scheme) -> Result<Self, SealError> {
        match scheme {
            Scheme::Points => Err(SealError::Unprotected),
            Scheme::RandomLines | Scheme::CoordinatePermutation | Scheme::Dcl(_) => {
                Ok(Self { scheme, ..Self::default() })
            }
        }
    }

    /// **No protection**: positions are sent as they are. The baseline of evaluations, and for places where the server
    /// may see everything anyway.
    pub fn unprotected_points() -> Self {
        Self { scheme: Scheme::Points, ..Self::default() }
    }

    /// The same with another number of bits per angle.
    #[must_use]
    pub const fn with_angle_bits(mut self, angle_bits: AngleBits) -> Self {
        self.angle_bits = angle_bits;
        self
    }

    /// The same with at most so many keypoints, the strongest usable ones: what is not sent is not leaked.
    ///
    /// A number between two size classes is cut to the smaller; below the smallest class decoys fill up (L5).
    /// `docs/results/privacy.md` has what fewer keypoints cost and what they buy. This is the device's own word and takes the
    /// place of [`DeviceLimits::max_keypoints`]; what the profile asks for still holds.
    #[must_use]
    pub const fn with_max_keypoints(mut self, most: usize) -> Self {
        self.max_keypoints = Some(most);
        self
    }

    /// The same, following a profile to another extent.
    #[must_use]
    pub const fn with_limits(mut self, limits: DeviceLimits) -> Self {
        self.limits = limits;
        self
    }

    /// The same for an image whose focal length is known so well ([`KnownCamera`](crate::KnownCamera) tells it). The server
    /// estimates the focal length too where it is not calibrated.
    #[must_use]
    pub const fn with_focal(mut self, focal: FocalKnowledge) -> Self {
        self.hints.focal = focal;
        self
    }

    /// The same for an image during which the device felt gravity so. It helps where few keypoints match; it tells how
    /// the device was tilted, rounded to about a degree (`docs/reference/privacy-rules.md`).
    #[must_use]
    pub const fn with_gravity(mut self, gravity: Option<CoarseGravity>) -> Self {
        self.hints.gravity = gravity;
        self
    }

    /// The same with other extractors than SIFT alone: those a program has for what it sends ([`Extractors::sealing`]). Which of
    /// them is used, the profile says by its kind of descriptors; a kind that is not among them is refused.
    #[must_use]
    pub fn with_extractors(mut self, extractors: Extractors) -> Self {
        self.extractors = extractors;
        self
    }

    /// **The owner's consent** to send a global descriptor that this makes of the image, where the map asks for this very model.
    ///
    /// It tells of more than the rows do: of the light, and of what shows no keypoints (decision 0024, `docs/reference/privacy-rules.md`, rule
    /// L14). Nothing a profile or a server says takes its place, and where the map asks for none, none is made.
    #[must_use]
    pub fn with_image_global(mut self, extractor: SharedGlobal) -> Self {
        self.image_global = Some(extractor);
        self
    }

    /// What makes the global descriptor of the image that this profile asks for; `None` where the rows say all it needs.
    ///
    /// # Errors
    /// [`SealError::GlobalOfImage`] when the owner did not consent to this very model.
    pub fn image_global(&self, profile: &Profile) -> Result<Option<&SharedGlobal>, SealError> {
        match profile.global_model() {
            GlobalModel::Vlad(_) => Ok(None),
            GlobalModel::Named(asked) => match &self.image_global {
                Some(own) if own.model() == *asked => Ok(Some(own)),
                _ => Err(SealError::GlobalOfImage { name: asked.name().to_owned(), codes: asked.dim() }),
            },
        }
    }

    /// What makes features.
    pub const fn extractors(&self) -> &Extractors {
        &self.extractors
    }

    /// What is said of the camera beside the rows.
    pub const fn hints(&self) -> Hints {
        self.hints
    }

    /// What happens to positions.
    pub const fn scheme(&self) -> Scheme {
        self.scheme
    }

    /// Bits of an angle on the wire.
    pub const fn angle_bits(&self) -> AngleBits {
        self.angle_bits
    }

    /// How much of an image is extracted: what the profile asks for, within what the device allows.
    ///
    /// # Errors
    /// [`SealError::VocabularyTooLarge`] when the profile's vocabulary is beyond what the device allows, and
    /// [`SealError::GlobalOfImage`] when it asks for a global descriptor of the image that the owner did not consent to
    /// ([`Self::with_image_global`]).
    pub fn bounded(&self, profile: &Profile) -> Result<ExtractionLimits, SealError> {
        let asked = profile.limits();
        self.image_global(profile)?;
        let words = profile.vocabulary().map_or(0, Vocabulary::len);
        let allowed = self.limits.max_vocabulary_words;
        if words > allowed {
            return Err(SealError::VocabularyTooLarge { words, allowed });
        }
        // Not cut to what is sent: some keypoints of the image have no place in the canonical camera.
        let most = self.max_keypoints.unwrap_or(0).max(self.limits.max_keypoints);
        Ok(ExtractionLimits {
            max_keypoints: asked.max_keypoints.min(u32::try_from(most).unwrap_or(u32::MAX)),
            max_image_side: asked.max_image_side.min(self.limits.max_image_side),
        })
    }

    /// Most keypoints that are sent.
    pub(crate) fn most(&self, profile: &Profile) -> usize {
        let own = self.max_keypoints.unwrap_or(self.limits.max_keypoints);
        own.min(profile.limits().max_keypoints as usize)
    }
}

/// How far a device follows a profile, which somebody else wrote. `docs/reference/privacy-rules.md` has the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DeviceLimits {
    /// Most keypoints that are extracted and sent, whatever the profile asks for. Default 2048, what maps ask for by
    /// default; twice as many would be twice as many to find.
    pub max_keypoints: usize,
    /// Longest side of the image that is extracted from, pixels. Default 2048: a larger side tells positions more
    /// finely, in pixels that the dither is half of, and takes memory with its square.
    pub max_image_side: u32,
    /// Most words of a vocabulary. Default 512, the most that maps are built with. Each word is as many bytes of every
    /// query as a descriptor has.
    pub max_vocabulary_words: usize,
}

impl Default for DeviceLimits {
    fn default() -> Self {
        Self { max_keypoints: 2048, max_image_side: 2048, max_vocabulary_words: 512 }
    }
}
