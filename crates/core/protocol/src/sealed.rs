//! The sealed query: all that a device sends about an image.

use veiloc_descriptor::{DescriptorKind, DescriptorView, Descriptors, GlobalDescriptor};
use veiloc_geometry::Pinhole;

use crate::{
    AngleBits, CanonicalCamera, CoarseGravity, FocalKnowledge, Hints, LayoutTurn, Observations, PackId,
    Profile, ProfileId, QueryError, RowMatches, Rows, Scheme, SealedIn, SizeClass,
};

/// What a device sends to be localized.
///
/// Per row: a few bits about the position, as the scheme defines ([`Rows`]), and a descriptor or, in a *match query*, the
/// points that the device found in a [`Pack`](crate::Pack). Per image: the scheme, one of a few cameras and how well its
/// focal length is known, a global descriptor of rows with descriptors, the id of the profile, and optionally the gravity
/// direction. It has no field for a keypoint, a scale, an orientation, a strength, a time or a device.
///
/// `veiloc-obfuscation` builds it on the device, [`Self::decode`] on the server. A decoded query encodes to the same
/// bytes again: the encoding is canonical, so that nothing can be hidden in it. Two queries are equal if they have equal
/// bytes.
#[derive(Clone)]
pub struct SealedQuery {
    pub(crate) scheme: Scheme,
    pub(crate) angle_bits: AngleBits,
    pub(crate) camera: CanonicalCamera,
    pub(crate) rows: Rows,
    pub(crate) content: QueryContent,
    pub(crate) profile_id: ProfileId,
    pub(crate) hints: Hints,
    pub(crate) turn: LayoutTurn,
    /// Not sent, and unknown where the query was read.
    pub(crate) sealed_in: SealedIn,
}

/// What the rows of a query show.
#[derive(Clone, PartialEq)]
pub enum QueryContent {
    /// Descriptors, for the server to match.
    Described {
        /// `[N, dim]`, in the order of the rows.
        descriptors: Descriptors,
        /// For retrieval, as defined by the profile's [`GlobalModel`](veiloc_descriptor::GlobalModel).
        global: GlobalDescriptor,
    },
    /// No descriptors: the points that the device found in the pack of the map (rule L16).
    Matched {
        /// The kind of the profile.
        kind: DescriptorKind,
        /// The pack.
        pack: PackId,
        /// `[N]`
        matches: RowMatches,
    },
}

/// What the rows of a query show, before it is assembled.
#[derive(Debug, Clone, PartialEq)]
pub enum SentContent {
    /// Descriptors.
    Described {
        /// `[N, dim]`
        descriptors: Descriptors,
        /// The global descriptor where the map's is computed from the image; `None` where it is computed from the rows.
        image_global: Option<GlobalDescriptor>,
    },
    /// What the device found in a pack.
    Matched {
        /// The pack.
        pack: PackId,
        /// `[N]`
        matches: RowMatches,
    },
}

/// The parts of a sealed query. Row `i` of `rows` and of `content` belong to one keypoint.
#[derive(Debug, Clone, PartialEq)]
pub struct QueryParts {
    /// The camera of the rows.
    pub camera: CanonicalCamera,
    /// The scheme of the rows: the device's choice.
    pub scheme: Scheme,
    /// Bits of an angle.
    pub angle_bits: AngleBits,
    /// `[N]`, N a [`SizeClass`]
    pub rows: Rows,
    /// What the rows show.
    pub content: SentContent,
    /// What the query says about its camera.
    pub hints: Hints,
    /// Rotation of the layout relative to the camera.
    pub turn: LayoutTurn,
}

impl SealedQuery {
    /// Assembles a query from obfuscated rows.
    ///
    /// The caller is responsible for the order of the rows and the choice of the codes (rules L2, L3, L9); clients use
    /// `veiloc_obfuscation::Sealer`. With a vocabulary, the global descriptor is computed here from the descriptors that
    /// are sent, so that it reveals nothing beyond them.
    ///
    /// # Errors
    /// [`QueryError::Mismatch`] when rows are not of the scheme, when descriptors or global descriptor are not the
    /// profile's, when there are not as many descriptors as rows, or when that number is not a [`SizeClass`];
    /// [`QueryError::Row`] for a row outside the image; [`QueryError::Field`] for a turn under another scheme than
    /// `dcl`.
    pub fn new(profile: &Profile, parts: QueryParts) -> Result<Self, QueryError> {
        let QueryParts { camera, scheme, angle_bits, rows, content, hints, turn } = parts;
        let mismatch =
            |what, expected: String, actual: String| QueryError::Mismatch { what, expected, actual };
        if !rows.belong_to(scheme) {
            return Err(mismatch("scheme", scheme.to_string(), format!("{rows:?}")));
        }
        if SizeClass::from_rows(rows.len()).is_none() {
            return Err(mismatch("rows", "a size class".to_owned(), rows.len().to_string()));
        }
        scheme.check_turn(turn)?;
        rows.check(scheme, angle_bits, &camera.pinhole(), turn)?;
        let profile_id = profile.id();
        let (descriptors, image_global) = match content {
            SentContent::Described { descriptors, image_global } => (descriptors, image_global),
            SentContent::Matched { pack, matches } => {
                let candidates = matches.rows().len();
                if candidates != rows.len() {
                    return Err(mismatch("candidates", rows.len().to_string(), candidates.to_string()));
                }
                let content = QueryContent::Matched { kind: profile.descriptor_kind(), pack, matches };
                let sealed_in = SealedIn::Unknown;
                return Ok(Self {
                    scheme,
                    angle_bits,
                    camera,
                    rows,
                    content,
                    profile_id,
                    hints,
                    turn,
                    sealed_in,
                });
            }
        };
        let (expected, actual) = (profile.descriptor_kind(), descriptors.kind());
        if expected != actual {
            return Err(mismatch("descriptor kind", format!("{expected:?}"), format!("{actual:?}")));
        }
        if descriptors.len() != rows.len() {
            return Err(mismatch("descriptors", rows.len().to_string(), descriptors.len().to_string()));
        }
        // The global descriptor is computed from exactly what is sent.
        let descriptors = descriptors.as_decoded();
        let model = profile.global_model();
        let given = image_global.as_ref().map_or_else(|| "none".to_owned(), |g| format!("{} codes", g.len()));
        let global = match (model.of_rows(descriptors.view()), image_global) {
            (Some(of_rows), None) => of_rows,
            (None, Some(of_image)) if of_image.len() == model.global_len() => of_image,
            (Some(_), Some(_)) => {
                return Err(mismatch("global descriptor of the image", "none".to_owned(), given));
            }
            (None, _) => {
                let expected = format!("{} codes of {}", model.global_len(), model.name());
                return Err(mismatch("global descriptor of the image", expected, given));
            }
        };
        let content = QueryContent::Described { descriptors, global };
        let sealed_in = SealedIn::Unknown;
        Ok(Self { scheme, angle_bits, camera, rows, content, profile_id, hints, turn, sealed_in })
    }

    /// How positions were obfuscated.
    pub const fn scheme(&self) -> Scheme {
        self.scheme
    }

    /// Bits of an angle on the wire.
    pub const fn angle_bits(&self) -> AngleBits {
        self.angle_bits
    }

    /// The camera of the positions.
    pub fn camera(&self) -> Pinhole {
        self.camera.pinhole()
    }

    /// The same as an entry of the list of cameras.
    pub const fn canonical_camera(&self) -> CanonicalCamera {
        self.camera
    }

    /// Number of rows, decoys included.
    pub const fn len(&self) -> usize {
        self.rows.len()
    }

    /// Never true: the smallest size class has 256 rows.
    pub const fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// What the rows show.
    pub const fn content(&self) -> &QueryContent {
        &self.content
    }

    /// `[N, dim]`, in the order of the rows; `None` in a match query.
    pub fn descriptors(&self) -> Option<DescriptorView<'_>> {
        match &self.content {
            QueryContent::Described { descriptors, .. } => Some(descriptors.view()),
            QueryContent::Matched { .. } => None,
        }
    }

    /// How well the focal length of [`Self::camera`] is known.
    pub const fn focal_known(&self) -> FocalKnowledge {
        self.hints.focal
    }

    /// The gravity direction in the camera, if the query has one.
    pub const fn gravity(&self) -> Option<CoarseGravity> {
        self.hints.gravity
    }

    /// Rotation of the layout of `dcl` relative to the camera; identity except in later frames of a session.
    pub const fn turn(&self) -> LayoutTurn {
        self.turn
    }

    /// With which other queries it was sealed, as far as this device knows; it is not sent.
    pub const fn sealed_in(&self) -> SealedIn {
        self.sealed_in
    }

    /// As [`Self::sealed_in`] says.
    #[must_use]
    pub fn with_sealed_in(self, sealed_in: SealedIn) -> Self {
        Self { sealed_in, ..self }
    }

    /// The kind of the descriptors, of the query or of its pack.
    pub const fn descriptor_kind(&self) -> DescriptorKind {
        match &self.content {
            QueryContent::Described { descriptors, .. } => descriptors.kind(),
            QueryContent::Matched { kind, .. } => *kind,
        }
    }

    /// The global descriptor for retrieval, as defined by the profile's
    /// [`GlobalModel`](veiloc_descriptor::GlobalModel); `None` in a match query.
    pub const fn global(&self) -> Option<&GlobalDescriptor> {
        match &self.content {
            QueryContent::Described { global, .. } => Some(global),
            QueryContent::Matched { .. } => None,
        }
    }

    /// The profile it was sealed with. [`Profile::check`] tests whether it belongs to a map.
    pub const fn profile_id(&self) -> ProfileId {
        self.profile_id
    }

    /// The observation of each row's position.
    pub fn observations(&self) -> Observations {
        self.rows
            .observations(self.scheme, self.angle_bits, &self.camera.pinhole(), self.turn)
            .expect("the constructors reject rows of another scheme")
    }
}

impl PartialEq for SealedQuery {
    fn eq(&self, other: &Self) -> bool {
        let Self { scheme, angle_bits, camera, rows, content, profile_id, hints, turn, sealed_in: _ } = self;
        (scheme, angle_bits, camera, rows) == (&other.scheme, &other.angle_bits, &other.camera, &other.rows)
            && (content, profile_id) == (&other.content, &other.profile_id)
            && (hints, turn) == (&other.hints, &other.turn)
    }
}

// Counts only: everything that is logged about a query must be harmless (rule L8).
impl std::fmt::Debug for QueryContent {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Described { .. } => "Described",
            Self::Matched { .. } => "Matched",
        })
    }
}

impl std::fmt::Debug for SealedQuery {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "SealedQuery({}, {} rows)", self.scheme.name(), self.rows.len())
    }
}
