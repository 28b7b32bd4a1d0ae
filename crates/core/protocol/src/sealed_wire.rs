//! Sealed queries as bytes, in all versions.

use prost::Message;
use veiloc_descriptor::{DescriptorKind, Descriptors, GlobalDescriptor, GlobalModel, Vocabulary};

use crate::profile_wire::kind_of_version_1;
use crate::wire::{
    KindFields, SealedQueryMessage, SealedQueryMessageV4, message, present, refused, version_of,
};
use crate::{
    AngleBits, AngleForm, CanonicalCamera, CoarseGravity, FocalKnowledge, Hints, LayoutTurn, ProfileId,
    QueryError, Rows, Scheme, SealedQuery, SizeClass, WireVersion,
};

/// Most bytes a sealed query may have: 4096 rows, the longest global descriptor, the fields around them.
const MAX_BYTES: usize = 4096 * (4 + DescriptorKind::MAX_DIM) + GlobalModel::MAX_LEN + 4096;
const WHAT: &str = "sealed query";

impl SealedQuery {
    /// As bytes: one `SealedQuery` message of [`Self::version`], `veiloc.v1` to `veiloc.v4`. Its length depends on version,
    /// scheme, angle bits, number of rows, descriptor kind and global model only.
    pub fn encode(&self) -> Vec<u8> {
        let kind = self.descriptors.kind();
        let global = self.global.as_codes().iter().map(|code| code.cast_unsigned()).collect();
        let (scheme, angle, distance) = self.scheme.codes();
        let (focal, width, height) = self.camera.codes();
        let message = SealedQueryMessageV4 {
            version: Some(self.version.number()),
            profile_id: Some(self.profile_id.as_bytes().to_vec()),
            scheme: Some(scheme),
            dividing_angle: Some(angle),
            anchor_distance: Some(distance),
            angle_bits: Some(self.angle_bits.get().into()),
            camera_focal: Some(focal),
            camera_width: Some(width),
            camera_height: Some(height),
            rows: Some(self.rows.len() as u32),
            descriptor_name: None,
            descriptor_dim: None,
            descriptor_encoding: None,
            descriptor_norm: None,
            positions: Some(self.rows.pack(self.scheme, AngleForm::of(self.version), self.angle_bits)),
            descriptors: Some(self.descriptors.packed()),
            global: Some(global),
            focal_known: None,
            gravity: None,
            layout: None,
            turn_x: None,
            turn_y: None,
            turn_z: None,
        };
        match self.version {
            WireVersion::V1 => {
                let code = kind.v1_code().expect("a query of version 1 is made of descriptors it knows");
                in_version_1(message, code).encode_to_vec()
            }
            WireVersion::V2 | WireVersion::V3 | WireVersion::V4 => {
                let KindFields { name, dim, encoding, norm } = KindFields::of(kind);
                let (hints, is_last) = (self.version >= WireVersion::V3, self.version >= WireVersion::V4);
                let [x, y, z] = self.turn.codes().map(|code| is_last.then_some(code));
                let message = SealedQueryMessageV4 {
                    descriptor_name: Some(name),
                    descriptor_dim: Some(dim),
                    descriptor_encoding: Some(encoding),
                    descriptor_norm: Some(norm),
                    focal_known: hints.then(|| self.hints.focal.code()),
                    gravity: hints.then(|| CoarseGravity::code(self.hints.gravity)),
                    layout: is_last.then(|| self.scheme.layout_bytes()),
                    turn_x: x,
                    turn_y: y,
                    turn_z: z,
                    ..message
                };
                message.encode_to_vec()
            }
        }
    }

    /// From bytes of any version. Strict: only what [`Self::encode`] writes is read, so whatever is accepted encodes
    /// to the very same bytes.
    ///
    /// # Errors
    /// [`QueryError`] naming the field that is wrong; never a panic, and memory in proportion to the bytes given.
    pub fn decode(bytes: &[u8]) -> Result<Self, QueryError> {
        let version = version_of(WHAT, bytes, MAX_BYTES, &WireVersion::ALL)?;
        let query = match version {
            WireVersion::V1 => {
                let message: SealedQueryMessage = message(WHAT, bytes)?;
                let code = present("descriptor_kind", message.descriptor_kind);
                let kind = move || kind_of_version_1(code?);
                read(version, in_version_4(message), kind)?
            }
            WireVersion::V2 | WireVersion::V3 | WireVersion::V4 => {
                let mut message: SealedQueryMessageV4 = message(WHAT, bytes)?;
                let (name, dim) = (message.descriptor_name.take(), message.descriptor_dim);
                let (encoding, norm) = (message.descriptor_encoding, message.descriptor_norm);
                let kind = || {
                    let fields = KindFields {
                        name: present("descriptor_name", name)?,
                        dim: present("descriptor_dim", dim)?,
                        encoding: present("descriptor_encoding", encoding)?,
                        norm: present("descriptor_norm", norm)?,
                    };
                    fields.kind()
                };
                read(version, message, kind)?
            }
        };
        if query.encode() != bytes {
            return Err(QueryError::NotCanonical { what: WHAT });
        }
        Ok(query)
    }
}

/// All fields but those of the kind.
fn read(
    version: WireVersion,
    message: SealedQueryMessageV4,
    kind: impl FnOnce() -> Result<DescriptorKind, QueryError>,
) -> Result<SealedQuery, QueryError> {
    let (scheme, angle, distance) = (
        present("scheme", message.scheme)?,
        present("dividing_angle", message.dividing_angle)?,
        present("anchor_distance", message.anchor_distance)?,
    );
    let (scheme, turn) = if version == WireVersion::V4 {
        let layout = present("layout", message.layout)?;
        let turn = LayoutTurn::from_codes([
            present("turn_x", message.turn_x)?,
            present("turn_y", message.turn_y)?,
            present("turn_z", message.turn_z)?,
        ])?;
        if layout.is_empty() && turn.is_none() {
            // What version 3 can say has no second form here.
            return Err(QueryError::NotCanonical { what: WHAT });
        }
        (Scheme::with_layout(scheme, angle, distance, &layout)?, turn)
    } else {
        (Scheme::from_codes(scheme, angle, distance)?, LayoutTurn::default())
    };
    let form = AngleForm::of(version);
    let angle_bits = AngleBits::from_wire(present("angle_bits", message.angle_bits)?)?;
    let camera = CanonicalCamera::from_codes(
        present("camera_focal", message.camera_focal)?,
        present("camera_width", message.camera_width)?,
        present("camera_height", message.camera_height)?,
    )?;
    let count = SizeClass::from_wire(present("rows", message.rows)?)?.rows();
    let kind = kind()?;

    let id = present("profile_id", message.profile_id)?;
    let id: [u8; 16] = id.as_slice().try_into().map_err(|_| length("profile_id", 16, &id))?;
    let positions = present("positions", message.positions)?;
    let expected = count * Rows::bits_per_row(scheme, form, angle_bits) as usize / 8;
    if positions.len() != expected {
        return Err(length("positions", expected, &positions));
    }
    let rows = Rows::unpack(scheme, form, angle_bits, count, &positions);
    rows.check(scheme, form, angle_bits, &camera.pinhole(), turn)?;
    let descriptors = present("descriptors", message.descriptors)?;
    if descriptors.len() != count * kind.packed_len() {
        return Err(length("descriptors", count * kind.packed_len(), &descriptors));
    }
    let descriptors = Descriptors::from_packed(kind, &descriptors).map_err(|e| refused("descriptors", &e))?;
    let global = global_descriptor(version, kind, &present("global", message.global)?)?;
    let profile_id = ProfileId::from_bytes(id);
    let hints = match version {
        WireVersion::V1 | WireVersion::V2 => Hints::default(),
        WireVersion::V3 | WireVersion::V4 => Hints {
            focal: FocalKnowledge::from_code(present("focal_known", message.focal_known)?)?,
            gravity: CoarseGravity::from_code(present("gravity", message.gravity)?)?,
        },
    };
    Ok(SealedQuery {
        version,
        scheme,
        angle_bits,
        camera,
        rows,
        descriptors,
        global,
        profile_id,
        hints,
        turn,
    })
}

/// Version 1 is summed up from rows by a vocabulary, and so a whole number of rows long; later ones may be anything, and
/// [`Profile::check`](crate::Profile::check) tells whether it is what the map has.
fn global_descriptor(
    version: WireVersion,
    kind: DescriptorKind,
    bytes: &[u8],
) -> Result<GlobalDescriptor, QueryError> {
    let (unit, most) = match version {
        WireVersion::V1 => (kind.dim(), Vocabulary::MAX_LEN * kind.dim()),
        WireVersion::V2 | WireVersion::V3 | WireVersion::V4 => (1, GlobalModel::MAX_LEN),
    };
    if bytes.is_empty() || bytes.len() > most || !bytes.len().is_multiple_of(unit) {
        return Err(length("global", bytes.len().div_ceil(unit).clamp(1, most / unit) * unit, bytes));
    }
    Ok(GlobalDescriptor::new(bytes.iter().map(|byte| byte.cast_signed()).collect()))
}

fn in_version_1(message: SealedQueryMessageV4, descriptor_kind: u32) -> SealedQueryMessage {
    SealedQueryMessage {
        version: message.version,
        profile_id: message.profile_id,
        scheme: message.scheme,
        dividing_angle: message.dividing_angle,
        anchor_distance: message.anchor_distance,
        angle_bits: message.angle_bits,
        camera_focal: message.camera_focal,
        camera_width: message.camera_width,
        camera_height: message.camera_height,
        rows: message.rows,
        descriptor_kind: Some(descriptor_kind),
        positions: message.positions,
        descriptors: message.descriptors,
        global: message.global,
    }
}

fn in_version_4(message: SealedQueryMessage) -> SealedQueryMessageV4 {
    SealedQueryMessageV4 {
        version: message.version,
        profile_id: message.profile_id,
        scheme: message.scheme,
        dividing_angle: message.dividing_angle,
        anchor_distance: message.anchor_distance,
        angle_bits: message.angle_bits,
        camera_focal: message.camera_focal,
        camera_width: message.camera_width,
        camera_height: message.camera_height,
        rows: message.rows,
        descriptor_name: None,
        descriptor_dim: None,
        descriptor_encoding: None,
        descriptor_norm: None,
        positions: message.positions,
        descriptors: message.descriptors,
        global: message.global,
        focal_known: None,
        gravity: None,
        layout: None,
        turn_x: None,
        turn_y: None,
        turn_z: None,
    }
}

fn length(field: &'static str, expected: usize, bytes: &[u8]) -> QueryError {
    QueryError::Length { field, expected, actual: bytes.len() }
}
