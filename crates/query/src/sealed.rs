//! The sealed query: the only thing about an image that leaves the device.

use prost::Message;
use veiloc_descriptor::{DescriptorKind, DescriptorView, Descriptors, GlobalDescriptor, Vocabulary};
use veiloc_geometry::Pinhole;

use crate::profile::descriptor_kind;
use crate::wire::{SealedQueryMessage, VERSION, parse, present};
use crate::{
    AngleBits, CanonicalCamera, Observations, Profile, ProfileId, QueryError, Rows, Scheme, SizeClass,
};

/// Longest global descriptor: one of the largest vocabulary.
const MAX_GLOBAL_BYTES: usize = Vocabulary::MAX_LEN * 128;
/// Most bytes a sealed query may have: 4096 rows, the longest global descriptor, the fields around them.
const MAX_BYTES: usize = 4096 * (4 + 128) + MAX_GLOBAL_BYTES + 4096;

/// What a device sends to be localized.
///
/// Per row: a few bits about the position, as the scheme says ([`Rows`]), and a descriptor. For the image: the
/// scheme, one of few cameras, a global descriptor that is computed from the rows' own descriptors, and the name
/// of the profile. There is no field for a keypoint, a scale, an orientation, a strength, a time or a device.
///
/// Built by `veiloc-obfuscation` on the device and by [`Self::decode`] on the server. What was decoded encodes to
/// the same bytes again: a message has no second form in which something could hide.
#[derive(Clone, PartialEq)]
pub struct SealedQuery {
    scheme: Scheme,
    angle_bits: AngleBits,
    camera: CanonicalCamera,
    rows: Rows,
    descriptors: Descriptors,
    global: GlobalDescriptor,
    profile_id: ProfileId,
}

impl SealedQuery {
    /// Puts a query together from obfuscated rows. Row `i` of `rows` and of `descriptors` are one keypoint's.
    ///
    /// The order of the rows and the making of the codes are the caller's duty (rules L2, L3, L9); clients use
    /// `veiloc_obfuscation::seal`. The global descriptor is made here, from the descriptors that are sent and
    /// nothing else, so that it tells nothing that they do not.
    ///
    /// # Errors
    /// [`QueryError::Mismatch`] when rows are not of the profile's scheme, when there are not as many descriptors as
    /// rows, or when that number is no [`SizeClass`]; [`QueryError::Row`] for a row outside the image.
    pub fn new(
        profile: &Profile,
        camera: CanonicalCamera,
        rows: Rows,
        descriptors: Descriptors,
    ) -> Result<Self, QueryError> {
        let mismatch =
            |what, expected: String, actual: String| QueryError::Mismatch { what, expected, actual };
        if !rows.belong_to(profile.scheme()) {
            return Err(mismatch("scheme", profile.scheme().to_string(), format!("{rows:?}")));
        }
        if descriptors.kind() != profile.descriptor_kind() {
            let (expected, actual) = (profile.descriptor_kind(), descriptors.kind());
            return Err(mismatch("descriptor kind", format!("{expected:?}"), format!("{actual:?}")));
        }
        if descriptors.len() != rows.len() {
            return Err(mismatch("descriptors", rows.len().to_string(), descriptors.len().to_string()));
        }
        if SizeClass::from_rows(rows.len()).is_none() {
            return Err(mismatch("rows", "a size class".to_owned(), rows.len().to_string()));
        }
        rows.check([camera.width(), camera.height()], profile.angle_bits())?;
        Ok(Self {
            scheme: profile.scheme(),
            angle_bits: profile.angle_bits(),
            camera,
            global: profile.vocabulary().aggregate(descriptors.view()),
            rows,
            descriptors,
            profile_id: profile.id(),
        })
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

    /// For retrieval; aggregated from [`Self::descriptors`].
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
            .observations(self.scheme, self.angle_bits, [self.camera.width(), self.camera.height()])
            .expect("the constructors refuse rows of another scheme")
    }

    /// As bytes: one `veiloc.v1.SealedQuery` message. Its length depends on scheme, angle bits, number of rows and
    /// vocabulary size only.
    pub fn encode(&self) -> Vec<u8> {
        let (scheme, angle, distance) = self.scheme.codes();
        let (focal, width, height) = self.camera.codes();
        let message = SealedQueryMessage {
            version: Some(VERSION),
            profile_id: Some(self.profile_id.as_bytes().to_vec()),
            scheme: Some(scheme),
            dividing_angle: Some(angle),
            anchor_distance: Some(distance),
            angle_bits: Some(self.angle_bits.get().into()),
            camera_focal: Some(focal),
            camera_width: Some(width),
            camera_height: Some(height),
            rows: Some(self.rows.len() as u32),
            descriptor_kind: Some(self.descriptors.kind().v1_code().unwrap_or_default()),
            positions: Some(self.rows.pack(self.angle_bits)),
            descriptors: Some(self.descriptors.as_bytes().to_vec()),
            global: Some(self.global.as_codes().iter().map(|code| code.cast_unsigned()).collect()),
        };
        message.encode_to_vec()
    }

    /// From bytes. Strict: only what [`Self::encode`] writes is read, so whatever is accepted encodes to the very
    /// same bytes.
    ///
    /// # Errors
    /// [`QueryError`] naming the field that is wrong; never a panic, and memory in proportion to the bytes given.
    pub fn decode(bytes: &[u8]) -> Result<Self, QueryError> {
        let message: SealedQueryMessage =
            parse("sealed query", bytes, MAX_BYTES, |m: &SealedQueryMessage| m.version)?;
        let scheme = Scheme::from_codes(
            present("scheme", message.scheme)?,
            present("dividing_angle", message.dividing_angle)?,
            present("anchor_distance", message.anchor_distance)?,
        )?;
        let angle_bits = AngleBits::from_wire(present("angle_bits", message.angle_bits)?)?;
        let camera = CanonicalCamera::from_codes(
            present("camera_focal", message.camera_focal)?,
            present("camera_width", message.camera_width)?,
            present("camera_height", message.camera_height)?,
        )?;
        let count = SizeClass::from_wire(present("rows", message.rows)?)?.rows();
        let kind = descriptor_kind(present("descriptor_kind", message.descriptor_kind)?)?;

        let id = present("profile_id", message.profile_id)?;
        let id: [u8; 16] = id.as_slice().try_into().map_err(|_| length("profile_id", 16, &id))?;
        let positions = present("positions", message.positions)?;
        let expected = count * Rows::bits_per_row(scheme, angle_bits) as usize / 8;
        if positions.len() != expected {
            return Err(length("positions", expected, &positions));
        }
        let rows = Rows::unpack(scheme, angle_bits, count, &positions);
        rows.check([camera.width(), camera.height()], angle_bits)?;
        let descriptors = present("descriptors", message.descriptors)?;
        if descriptors.len() != count * kind.dim() {
            return Err(length("descriptors", count * kind.dim(), &descriptors));
        }
        let descriptors = Descriptors::new(kind, descriptors)
            .map_err(|e| QueryError::Descriptor { what: "descriptors", reason: e.to_string() })?;
        let global = global_descriptor(kind, &present("global", message.global)?)?;

        let query = Self {
            scheme,
            angle_bits,
            camera,
            rows,
            descriptors,
            global,
            profile_id: ProfileId::from_bytes(id),
        };
        if query.encode() != bytes {
            return Err(QueryError::NotCanonical { what: "sealed query" });
        }
        Ok(query)
    }
}

// Counts only: whatever is logged of a query must be harmless (rule L8).
impl std::fmt::Debug for SealedQuery {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "SealedQuery({}, {} rows)", self.scheme.name(), self.rows.len())
    }
}

fn length(field: &'static str, expected: usize, bytes: &[u8]) -> QueryError {
    QueryError::Length { field, expected, actual: bytes.len() }
}

fn global_descriptor(kind: DescriptorKind, bytes: &[u8]) -> Result<GlobalDescriptor, QueryError> {
    let dim = kind.dim();
    if bytes.is_empty() || bytes.len() > MAX_GLOBAL_BYTES || !bytes.len().is_multiple_of(dim) {
        let expected = bytes.len().div_ceil(dim).clamp(1, MAX_GLOBAL_BYTES / dim) * dim;
        return Err(length("global", expected, bytes));
    }
    Ok(GlobalDescriptor::new(bytes.iter().map(|byte| byte.cast_signed()).collect()))
}
