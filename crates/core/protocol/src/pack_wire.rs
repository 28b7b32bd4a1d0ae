//! Packs as bytes. The encoding is canonical, and ends with the checksum of what is before, which is the id.

use prost::Message;
use veiloc_descriptor::Descriptors;

use crate::bits::{BitReader, BitWriter};
use crate::wire::{Format, PackMessage, present, refused};
use crate::{Pack, PackId, Profile, QueryError, RowMatches};

const FORMAT: Format = Format {
    what: "pack",
    limit: 1 << 28,
    version: Pack::VERSION,
    remedy: "fetch the pack again; if its version stays the same, update the app or the service, whichever is older",
};

impl Pack {
    /// The version of the message.
    pub const VERSION: u32 = 1;

    /// As bytes: one `veiloc.v1.Pack` message.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = self.without_checksum();
        let checksum = PackMessage { checksum: Some(self.id.as_bytes().to_vec()), ..PackMessage::default() };
        bytes.extend(checksum.encode_to_vec());
        bytes
    }

    pub(crate) fn computed_id(&self) -> PackId {
        PackId::of(&self.without_checksum())
    }

    fn without_checksum(&self) -> Vec<u8> {
        let bits = RowMatches::point_bits(self.points);
        let mut row_points = BitWriter::with_capacity(self.point_of_row.len() * bits as usize / 8 + 1);
        self.point_of_row.iter().for_each(|point| row_points.write(*point, bits));
        let message = PackMessage {
            version: Some(Self::VERSION),
            profile: Some(self.profile.encode()),
            points: Some(self.points),
            images: Some(self.images.iter().flat_map(|rows| (rows.len() as u32).to_le_bytes()).collect()),
            row_points: Some(row_points.finish()),
            descriptors: Some(self.descriptors.packed()),
            checksum: None,
        };
        message.encode_to_vec()
    }

    /// From bytes; an accepted message encodes to the same bytes again.
    ///
    /// # Errors
    /// [`QueryError`] naming the wrong field; never a panic, and memory in proportion to the given bytes.
    pub fn decode(bytes: &[u8]) -> Result<Self, QueryError> {
        let pack = read(FORMAT.message(bytes)?)?;
        let found = pack.computed_id();
        if found != pack.id {
            return Err(QueryError::Descriptor { what: "pack", reason: "its checksum is wrong".to_owned() });
        }
        if pack.encode() != bytes {
            return Err(QueryError::NotCanonical { what: FORMAT.what });
        }
        Ok(pack)
    }
}

fn read(message: PackMessage) -> Result<Pack, QueryError> {
    let profile = Profile::decode(&present("profile", message.profile)?)?;
    let points = present("points", message.points)?;
    let counts = present("images", message.images)?;
    let row_points = present("row_points", message.row_points)?;
    let descriptors = present("descriptors", message.descriptors)?;
    let checksum = present("checksum", message.checksum)?;
    let length = |field, expected, actual: usize| Err(QueryError::Length { field, expected, actual });
    let Ok(checksum) = <[u8; 16]>::try_from(checksum.as_slice()) else {
        return length("checksum", 16, checksum.len());
    };
    if !counts.len().is_multiple_of(4) {
        return length("images", counts.len() / 4 * 4, counts.len());
    }
    let kind = profile.descriptor_kind();
    let descriptors = Descriptors::from_packed(kind, &descriptors).map_err(|e| refused("descriptors", &e))?;
    let (mut images, mut end) = (Vec::with_capacity(counts.len() / 4), 0_usize);
    for count in counts.as_chunks::<4>().0 {
        let from = end;
        end = end.saturating_add(u32::from_le_bytes(*count) as usize);
        images.push(from..end);
    }
    if end != descriptors.len() {
        return length(
            "descriptors",
            end.saturating_mul(kind.packed_len()),
            descriptors.len() * kind.packed_len(),
        );
    }
    let bits = RowMatches::point_bits(points);
    let expected = (end * bits as usize).div_ceil(8);
    if row_points.len() != expected {
        return length("row_points", expected, row_points.len());
    }
    let mut reader = BitReader::new(&row_points);
    let point_of_row = (0..end).map(|_| reader.read(bits)).collect();
    let pack = Pack { profile, points, images, point_of_row, descriptors, id: PackId::from_bytes(checksum) };
    pack.check()?;
    Ok(pack)
}
