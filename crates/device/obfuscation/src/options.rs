//! What the device decides: the scheme, how much it sends, and how far it follows a profile.

use veiloc_descriptor::{GlobalModel, Vocabulary};
use veiloc_features::{Extractors, SharedGlobal};
use veiloc_protocol::{AngleBits, DclLayout, ExtractionLimits, Profile, Scheme};

use crate::{KnownPlace, PackUse, SealError};

/// How an image is sealed. The device decides all of it; no option comes from a profile.
///
/// `points` hides nothing. It has a constructor of its own, so that it cannot be selected by accident:
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
    sends_gravity: bool,
    only_balanced: bool,
    extractors: Extractors,
    image_global: Option<SharedGlobal>,
    place: Option<(KnownPlace, PackUse)>,
}

/// `dcl` with its default layout, 12-bit angles, as many keypoints as the profile requests within
/// [`DeviceLimits::default`]; gravity is sent where it is known, features are SIFT ([`Extractors::for_sealing`]), and no
/// global descriptor of the image is sent.
impl Default for SealOptions {
    fn default() -> Self {
        Self {
            scheme: Scheme::default(),
            angle_bits: AngleBits::default(),
            max_keypoints: None,
            limits: DeviceLimits::default(),
            sends_gravity: true,
            only_balanced: false,
            extractors: Extractors::for_sealing(),
            image_global: None,
            place: None,
        }
    }
}

impl SealOptions {
    /// With a scheme that hides positions, everything else as [`Self::default`].
    ///
    /// # Errors
    /// [`SealError::Unprotected`] for `points`, [`SealError::OnlyForTables`] for `dcl:random`.
    pub fn new(scheme: Scheme) -> Result<Self, SealError> {
        match scheme {
            Scheme::Points => Err(SealError::Unprotected),
            Scheme::Dcl(DclLayout::Random) => Err(SealError::OnlyForTables),
            Scheme::RandomLines | Scheme::CoordinatePermutation | Scheme::Dcl(_) => {
                Ok(Self { scheme, ..Self::default() })
            }
        }
    }

    /// **No protection**: positions are sent unchanged. The baseline of evaluations, and for scenes whose images the
    /// server may see.
    pub fn unprotected_points() -> Self {
        Self { scheme: Scheme::Points, ..Self::default() }
    }

    /// These options with another number of bits per angle.
    #[must_use]
    pub const fn with_angle_bits(mut self, angle_bits: AngleBits) -> Self {
        self.angle_bits = angle_bits;
        self
    }

    /// These options with at most this many keypoints, the strongest usable ones: what is not sent cannot leak.
    ///
    /// A number between two size classes is rounded down to the smaller one; below the smallest class, decoys fill the
    /// query up (L5). `docs/results/privacy.md` reports what fewer keypoints cost and gain. This choice of the device replaces
    /// [`DeviceLimits::max_keypoints`]; the profile's limit still applies.
    #[must_use]
    pub const fn with_max_keypoints(mut self, most: usize) -> Self {
        self.max_keypoints = Some(most);
        self
    }

    /// These options with other limits on what a profile may request.
    #[must_use]
    pub const fn with_limits(mut self, limits: DeviceLimits) -> Self {
        self.limits = limits;
        self
    }

    /// These options without gravity: it is not sent, also where it is known.
    #[must_use]
    pub const fn without_gravity(mut self) -> Self {
        self.sends_gravity = false;
        self
    }

    /// These options with [`SealError::Unbalanced`] for an image whose query could not determine a pose
    /// ([`SealedQuery::check_sides`](veiloc_protocol::SealedQuery::check_sides)); a session has not changed then, so
    /// another image costs nothing.
    #[must_use]
    pub const fn only_balanced(mut self) -> Self {
        self.only_balanced = true;
        self
    }

    /// These options with other extractors than SIFT alone: those that a program has for sealing
    /// ([`Extractors::sealing`]). The profile selects one by its descriptor kind; a kind without an extractor is an
    /// error.
    #[must_use]
    pub fn with_extractors(mut self, extractors: Extractors) -> Self {
        self.extractors = extractors;
        self
    }

    /// **The owner's consent** to send a global descriptor of the image made by this extractor, where the map requests
    /// exactly this model.
    ///
    /// It reveals more than the rows do: the lighting, and parts of the image without keypoints (decision 0024,
    /// `docs/reference/privacy-rules.md`, rule L14). No profile and no server can give this consent, and for a map that requests none,
    /// none is computed.
    #[must_use]
    pub fn with_image_global(mut self, extractor: SharedGlobal) -> Self {
        self.image_global = Some(extractor);
        self
    }

    /// These options with the pack of the place: nothing is sent that the place does not explain
    /// (`docs/guide/pack.md`). `PackUse` says what is sent of the rest.
    #[must_use]
    pub fn with_place(mut self, place: KnownPlace, usage: PackUse) -> Self {
        self.place = Some((place, usage));
        self
    }

    /// The place of the pack.
    ///
    /// # Errors
    /// [`SealError::PackOfOtherMap`] when it is of another map than the profile, and [`SealError::PackTooLarge`].
    pub(crate) fn place(&self, profile: &Profile) -> Result<Option<KnownPlace>, SealError> {
        let Some((place, _)) = &self.place else { return Ok(None) };
        let (rows, allowed) = (place.pack().row_count(), self.limits.max_pack_rows);
        if rows > allowed {
            return Err(SealError::PackTooLarge { rows, allowed });
        }
        if place.pack().profile() != profile {
            return Err(SealError::PackOfOtherMap);
        }
        Ok(Some(place.clone()))
    }

    /// What is sent of the rows that the place explains.
    pub(crate) fn pack_use(&self) -> PackUse {
        self.place.as_ref().map_or_else(PackUse::default, |(_, usage)| *usage)
    }

    /// The extractor of the global descriptor that this profile requests; `None` where the server computes it from the
    /// rows.
    ///
    /// # Errors
    /// [`SealError::GlobalOfImage`] when the owner did not consent to this model.
    pub(crate) fn image_global(&self, profile: &Profile) -> Result<Option<&SharedGlobal>, SealError> {
        match profile.global_model() {
            GlobalModel::Vlad(_) => Ok(None),
            GlobalModel::Named(requested) => match &self.image_global {
                Some(own) if own.model() == *requested => Ok(Some(own)),
                _ => Err(SealError::GlobalOfImage {
                    name: requested.name().to_owned(),
                    codes: requested.dim(),
                }),
            },
        }
    }

    /// The feature extractors.
    pub const fn extractors(&self) -> &Extractors {
        &self.extractors
    }

    /// Whether gravity is sent where it is known.
    pub(crate) const fn sends_gravity(&self) -> bool {
        self.sends_gravity
    }

    /// Whether only queries that can determine a pose are sealed.
    pub(crate) const fn is_only_balanced(&self) -> bool {
        self.only_balanced
    }

    /// How positions are hidden.
    pub const fn scheme(&self) -> Scheme {
        self.scheme
    }

    /// Bits of an angle on the wire.
    pub const fn angle_bits(&self) -> AngleBits {
        self.angle_bits
    }

    /// How much of an image is extracted: what the profile requests, within the limits of the device.
    ///
    /// # Errors
    /// [`SealError::VocabularyTooLarge`] when the profile's vocabulary exceeds the limit of the device,
    /// [`SealError::NoneAllowed`] when the options allow no keypoint.
    pub(crate) fn bounded(&self, profile: &Profile) -> Result<ExtractionLimits, SealError> {
        if self.max_keypoints == Some(0) {
            return Err(SealError::NoneAllowed);
        }
        let requested = profile.limits();
        let words = profile.vocabulary().map_or(0, Vocabulary::len);
        let allowed = self.limits.max_vocabulary_words;
        if words > allowed {
            return Err(SealError::VocabularyTooLarge { words, allowed });
        }
        // More than is sent: some keypoints of the image fall outside of the canonical camera's image.
        let most = self.max_keypoints.unwrap_or(0).max(self.limits.max_keypoints);
        Ok(ExtractionLimits {
            max_keypoints: requested.max_keypoints.min(u32::try_from(most).unwrap_or(u32::MAX)),
            max_image_side: DeviceLimits::image_side(
                requested.max_image_side.min(self.limits.max_image_side),
            ),
        })
    }

    /// The largest number of keypoints that is sent.
    pub(crate) fn most(&self, profile: &Profile) -> usize {
        let own = self.max_keypoints.unwrap_or(self.limits.max_keypoints);
        own.min(profile.limits().max_keypoints as usize)
    }
}

/// How far a device follows a profile, which comes from another party. `docs/reference/privacy-rules.md` has the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DeviceLimits {
    /// Most keypoints that are extracted and sent, whatever the profile requests. Default 2048, the default request of
    /// maps; twice as many would reveal twice as many to an attacker.
    pub max_keypoints: usize,
    /// Longest side of the image for extraction, pixels; the largest of [`Self::IMAGE_SIDES`] that exceeds neither this
    /// limit nor the profile's is used. Default 2048: a larger side gives finer positions while the dither stays half a
    /// pixel, and memory grows with its square.
    pub max_image_side: u32,
    /// Most words of a vocabulary. Default 512, the most that maps are built with. Each word adds as many bytes to
    /// every query as a descriptor has.
    pub max_vocabulary_words: usize,
    /// Most rows of a pack. Default 2^20, some 33 MB of compact descriptors; the search takes time in proportion.
    pub max_pack_rows: usize,
}

impl DeviceLimits {
    /// The sizes that a device scales its images to, pixels of the longest side: a list of its own, so that a profile
    /// chooses among few sizes and not any (rule L6).
    pub const IMAGE_SIDES: [u32; 13] =
        [64, 144, 240, 360, 480, 640, 1024, 1600, 2048, 3072, 4096, 6144, 8192];

    /// The largest of [`Self::IMAGE_SIDES`] that is not above `most`; the smallest if all are.
    fn image_side(most: u32) -> u32 {
        let [smallest, ..] = Self::IMAGE_SIDES;
        Self::IMAGE_SIDES.into_iter().rfind(|side| *side <= most).unwrap_or(smallest)
    }
}

impl Default for DeviceLimits {
    fn default() -> Self {
        Self { max_keypoints: 2048, max_image_side: 2048, max_vocabulary_words: 512, max_pack_rows: 1 << 20 }
    }
}
