//! Sealed queries as bytes.

use prost::Message;
use veiloc_descriptor::{DescriptorKind, Descriptors, GlobalDescriptor, GlobalModel};

use crate::wire::{Format, KindFields, SealedQueryMessage, present, refused};
use crate::{
    AngleBits, CanonicalCamera, CoarseGravity, FocalKnowledge, Hints, LayoutTurn, MessageId, PackId,
    QueryContent, QueryError, RowMatches, Rows, Scheme, SealedIn, SealedQuery, SizeClass,
};

const FORMAT: Format = Format {
    what: "sealed query",
    // 4096 rows, the longest global descriptor, the remaining fields.
    limit: 4096 * (4 + DescriptorKind::MAX_DIM) + GlobalModel::MAX_LEN + 4096,
    version: SealedQuery::VERSION,
    remedy: "update the app that sealed it or the program that reads it, whichever is older, and seal again",
};

impl SealedQuery {
    /// The version of the message.
    pub const VERSION: u32 = 1;

    /// As bytes: one `veiloc.v1.SealedQuery` message. Its length depends only on scheme and layout, angle bits, number
    /// of rows, descriptor kind and global model, or the number of points of the pack.
    pub fn encode(&self) -> Vec<u8> {
        let KindFields { name, dim, encoding, norm } = KindFields::of(self.descriptor_kind());
        let (described, matched) = match &self.content {
            QueryContent::Described { descriptors, global } => {
                let global: Vec<u8> = global.as_codes().iter().map(|code| code.cast_unsigned()).collect();
                (Some((descriptors.packed(), global)), None)
            }
            QueryContent::Matched { pack, matches, .. } => (None, Some((pack, matches))),
        };
        let (descriptors, global) = described.unzip();
        let (scheme, angle, distance) = self.scheme.codes();
        let (focal, width, height) = self.camera.codes();
        let [turn_x, turn_y, turn_z] = self.turn.codes();
        let message = SealedQueryMessage {
            version: Some(Self::VERSION),
            profile_id: Some(self.profile_id.as_bytes().to_vec()),
            scheme: Some(scheme),
            dividing_angle: Some(angle),
            anchor_distance: Some(distance),
            angle_bits: Some(self.angle_bits.get().into()),
            camera_focal: Some(focal),
            camera_width: Some(width),
            camera_height: Some(height),
            rows: Some(self.rows.len() as u32),
            descriptor_name: Some(name),
            descriptor_dim: Some(dim),
            descriptor_encoding: Some(encoding),
            descriptor_norm: Some(norm),
            positions: Some(self.rows.pack(self.scheme, self.angle_bits)),
            descriptors,
            global,
            focal_known: Some(self.hints.focal.code()),
            gravity: Some(CoarseGravity::code(self.hints.gravity)),
            layout: Some(self.scheme.layout_bytes()),
            turn_x: Some(turn_x),
            turn_y: Some(turn_y),
            turn_z: Some(turn_z),
            pack_id: matched.map(|(pack, _)| pack.as_bytes().to_vec()),
            pack_points: matched.map(|(_, matches)| matches.points()),
            candidates: matched.map(|(_, matches)| matches.pack()),
        };
        message.encode_to_vec()
    }

    /// From bytes. Strict: only what [`Self::encode`] writes is accepted, so every accepted message encodes to the same
    /// bytes.
    ///
    /// # Errors
    /// [`QueryError`] naming the wrong field; never a panic, and memory in proportion to the given bytes.
    pub fn decode(bytes: &[u8]) -> Result<Self, QueryError> {
        let query = read(FORMAT.message(bytes)?)?;
        if query.encode() != bytes {
            return Err(QueryError::NotCanonical { what: FORMAT.what });
        }
        Ok(query)
    }
}

fn read(message: SealedQueryMessage) -> Result<SealedQuery, QueryError> {
    let (scheme, angle, distance) = (
        present("scheme", message.scheme)?,
        present("dividing_angle", message.dividing_angle)?,
        present("anchor_distance", message.anchor_distance)?,
    );
    let angle_bits = AngleBits::from_wire(present("angle_bits", message.angle_bits)?)?;
    let camera = CanonicalCamera::from_codes(
        present("camera_focal", message.camera_focal)?,
        present("camera_width", message.camera_width)?,
        present("camera_height", message.camera_height)?,
    )?;
    let count = SizeClass::from_wire(present("rows", message.rows)?)?.rows();
    let kind = KindFields {
        name: present("descriptor_name", message.descriptor_name)?,
        dim: present("descriptor_dim", message.descriptor_dim)?,
        encoding: present("descriptor_encoding", message.descriptor_encoding)?,
        norm: present("descriptor_norm", message.descriptor_norm)?,
    }
    .kind()?;
    let profile_id = id("profile_id", message.profile_id)?;
    let positions = present("positions", message.positions)?;
    let hints = Hints {
        focal: FocalKnowledge::from_code(present("focal_known", message.focal_known)?)?,
        gravity: CoarseGravity::from_code(present("gravity", message.gravity)?)?,
    };
    let scheme = Scheme::with_layout(scheme, angle, distance, &present("layout", message.layout)?)?;
    let turn = LayoutTurn::from_codes([
        present("turn_x", message.turn_x)?,
        present("turn_y", message.turn_y)?,
        present("turn_z", message.turn_z)?,
    ])?;
    scheme.check_turn(turn)?;

    let expected = count * Rows::bits_per_row(scheme, angle_bits) as usize / 8;
    if positions.len() != expected {
        return Err(length("positions", expected, &positions));
    }
    let rows = Rows::unpack(scheme, angle_bits, count, &positions);
    rows.check(scheme, angle_bits, &camera.pinhole(), turn)?;
    let content = if message.pack_id.is_some() {
        let pack = id("pack_id", message.pack_id)?;
        let points = present("pack_points", message.pack_points)?;
        matched(kind, pack, count, points, &present("candidates", message.candidates)?)?
    } else {
        let descriptors = present("descriptors", message.descriptors)?;
        described(kind, count, &descriptors, &present("global", message.global)?)?
    };
    let sealed_in = SealedIn::Unknown;
    Ok(SealedQuery { scheme, angle_bits, camera, rows, content, profile_id, hints, turn, sealed_in })
}

fn matched(
    kind: DescriptorKind,
    pack: PackId,
    count: usize,
    points: u32,
    candidates: &[u8],
) -> Result<QueryContent, QueryError> {
    if points > RowMatches::MAX_POINTS {
        let allowed = "at most 16777216";
        return Err(QueryError::Field { field: "pack_points", value: points, allowed });
    }
    let expected = RowMatches::packed_len(points, count);
    if candidates.len() != expected {
        return Err(length("candidates", expected, candidates));
    }
    Ok(QueryContent::Matched { kind, pack, matches: RowMatches::unpack(points, count, candidates)? })
}

fn described(
    kind: DescriptorKind,
    count: usize,
    descriptors: &[u8],
    global: &[u8],
) -> Result<QueryContent, QueryError> {
    if descriptors.len() != count * kind.packed_len() {
        return Err(length("descriptors", count * kind.packed_len(), descriptors));
    }
    let descriptors = Descriptors::from_packed(kind, descriptors).map_err(|e| refused("descriptors", &e))?;
    // [`Profile::check`](crate::Profile::check) compares its length with the map's.
    if global.is_empty() || global.len() > GlobalModel::MAX_LEN {
        return Err(length("global", global.len().clamp(1, GlobalModel::MAX_LEN), global));
    }
    let global = GlobalDescriptor::new(global.iter().map(|byte| byte.cast_signed()).collect());
    Ok(QueryContent::Described { descriptors, global })
}

fn id(field: &'static str, bytes: Option<Vec<u8>>) -> Result<MessageId, QueryError> {
    let bytes = present(field, bytes)?;
    let id: [u8; 16] = bytes.as_slice().try_into().map_err(|_| length(field, 16, &bytes))?;
    Ok(MessageId::from_bytes(id))
}

fn length(field: &'static str, expected: usize, bytes: &[u8]) -> QueryError {
    QueryError::Length { field, expected, actual: bytes.len() }
}
