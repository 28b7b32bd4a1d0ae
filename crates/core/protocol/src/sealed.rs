//! The sealed query: the only thing about an image that leaves the device.

use veiloc_descriptor::{DescriptorView, Descriptors, GlobalDescriptor};
use veiloc_geometry::Pinhole;

use crate::{
    AngleBits, CanonicalCamera, CoarseGravity, FocalKnowledge, Hints, LayoutTurn, Observations, Profile,
    ProfileId, QueryError, Rows, Scheme, SizeClass,
};

/// What a device sends to be localized.
///
/// Per row: a few bits about the position, as the scheme says ([`Rows`]), and a descriptor. For the image: the
/// scheme, one of few cameras and how well its focal length is known, a global descriptor, the name of the profile, and
/// which way is down if the device says so. There is no field for a keypoint, a scale, an orientation, a strength, a time
/// or a device.
///
/// Built by `veiloc-obfuscation` on the device and by [`Self::decode`] on the server. What was decoded encodes to
/// the same bytes again: a message has no second form in which something could hide.
#[derive(Clone, PartialEq)]
pub struct SealedQuery {
    pub(crate) scheme: Scheme,
    pub(crate) angle_bits: AngleBits,
    pub(crate) camera: CanonicalCamera,
    pub(crate) rows: Rows,
    pub(crate) descriptors: Descriptors,
    pub(crate) global: GlobalDescriptor,
    pub(crate) profile_id: ProfileId,
    pub(crate) hints: Hints,
    pub(crate) turn: LayoutTurn,
}

/// What a sealed query is put together from. Row `i` of `rows` and of `descriptors` are one keypoint's.
#[derive(Debug, Clone, PartialEq)]
pub struct QueryParts {
    /// The camera the rows are told in.
    pub camera: CanonicalCamera,
    /// The scheme the rows were made with: the device's choice.
    pub scheme: Scheme,
    /// Bits of an angle.
    pub angle_bits: AngleBits,
    /// `[N]`, N a [`SizeClass`]
    pub rows: Rows,
    /// `[N, dim]`
    pub descriptors: Descriptors,
    /// The global descriptor where the map's comes from the image; `None` where it is summed up from the rows.
    pub image_global: Option<GlobalDescriptor>,
    /// What the device says of its camera.
    pub hints: Hints,
    /// How the layout is turned against the camera.
    pub turn: LayoutTurn,
}

impl SealedQuery {
    /// Puts a query together from obfuscated rows.
    ///
    /// The order of the rows and the making of the codes are the caller's duty (rules L2, L3, L9); clients use
    /// `veiloc_obfuscation::seal`. With a vocabulary the global descriptor is made here, from the descriptors that are
    /// sent and nothing else, so that it tells nothing that they do not.
    ///
    /// # Errors
    /// [`QueryError::Mismatch`] when rows are not of the scheme, when descriptors or global descriptor are not the
    /// profile's, when there are not as many descriptors as rows, or when that number is no [`SizeClass`];
    /// [`QueryError::Row`] for a row outside the image; [`QueryError::Field`] for a turn under another scheme than `dcl`.
    pub fn new(profile: &Profile, parts: QueryParts) -> Result<Self, QueryError> {
        let QueryParts { camera, scheme, angle_bits, rows, descriptors, image_global, hints, turn } = parts;
        let mismatch =
            |what, expected: String, actual: String| QueryError::Mismatch { what, expected, actual };
        if !rows.belong_to(scheme) {
            return Err(mismatch("scheme", scheme.to_string(), format!("{rows:?}")));
        }
        let (expected, actual) = (profile.descriptor_kind(), descriptors.kind());
        if expected != actual {
            return Err(mismatch("descriptor kind", format!("{expected:?}"), format!("{actual:?}")));
        }
        if descriptors.len() != rows.len() {
            return Err(mismatch("descriptors", rows.len().to_string(), descriptors.len().to_string()));
        }
        if SizeClass::from_rows(rows.len()).is_none() {
            return Err(mismatch("rows", "a size class".to_owned(), rows.len().to_string()));
        }
        turn.check(scheme)?;
        // The global descriptor is made of what is sent, to the bit.
        let descriptors = descriptors.settled();
        rows.check(scheme, angle_bits, &camera.pinhole(), turn)?;
        let model = profile.global_model();
        let told = image_global.as_ref().map_or_else(|| "none".to_owned(), |g| format!("{} codes", g.len()));
        let global = match (model.of_rows(descriptors.view()), image_global) {
            (Some(of_rows), None) => of_rows,
            (None, Some(of_image)) if of_image.len() == model.global_len() => of_image,
            (Some(_), Some(_)) => {
                return Err(mismatch("global descriptor of the image", "none".to_owned(), told));
            }
            (None, _) => {
                let expected = format!("{} codes of {}", model.global_len(), model.name());
                return Err(mismatch("global descriptor of the image", expected, told));
            }
        };
        let profile_id = profile.id();
        Ok(Self { scheme, angle_bits, camera, rows, descriptors, global, profile_id, hints, turn })
    }

    /// How positions were obfuscated.
    pub const fn scheme(&self) -> Scheme {
        self.scheme
    }

    /// Bits of an angle on the wire.
    pub const fn angle_bits(&self) -> AngleBits {
        self.angle_bits
    }

    /// The camera the positions are told in.
    pub fn camera(&self) -> Pinhole {
        self.camera.pinhole()
    }

    /// The same as its place in the list of cameras.
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

    /// `[N, dim]`, in the order of the rows.
    pub fn descriptors(&self) -> DescriptorView<'_> {
        self.descriptors.view()
    }

    /// How well the focal length of [`Self::camera`] is known.
    pub const fn focal_known(&self) -> FocalKnowledge {
        self.hints.focal
    }

    /// Which way is down in the camera, if the device said so.
    pub const fn gravity(&self) -> Option<CoarseGravity> {
        self.hints.gravity
    }

    /// How the layout of `dcl` is turned against the camera; not at all but in later frames of a session.
    pub const fn turn(&self) -> LayoutTurn {
        self.turn
    }

    /// For retrieval; made as the profile's [`GlobalModel`](veiloc_descriptor::GlobalModel) says.
    pub const fn global(&self) -> &GlobalDescriptor {
        &self.global
    }

    /// What it was sealed with. [`Profile::check`] tells whether that fits a map.
    pub const fn profile_id(&self) -> ProfileId {
        self.profile_id
    }

    /// What is known of each row's position.
    pub fn observations(&self) -> Observations {
        self.rows
            .observations(self.scheme, self.angle_bits, &self.camera.pinhole(), self.turn)
            .expect("the constructors refuse rows of another scheme")
    }
}

// Counts only: whatever is logged of a query must be harmless (rule L8).
impl std::fmt::Debug for SealedQuery {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "SealedQuery({}, {} rows)", self.scheme.name(), self.rows.len())
    }
}
