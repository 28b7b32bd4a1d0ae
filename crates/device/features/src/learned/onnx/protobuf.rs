//! Protocol buffers, as far as ONNX files need them: reading the fields of a message, and appending fields.

/// A field of a message.
pub(crate) struct Field<'a> {
    /// Its number.
    pub(crate) number: u64,
    /// Its content, for a length-delimited field.
    pub(crate) payload: Option<&'a [u8]>,
    /// Its value, for a varint field.
    pub(crate) value: Option<u64>,
    /// The whole field with its tag.
    pub(crate) whole: &'a [u8],
}

/// The fields of a message in their order; `None` when the bytes are not a message.
pub(crate) fn fields(message: &[u8]) -> Option<Vec<Field<'_>>> {
    let mut all = Vec::new();
    let mut rest = message;
    while !rest.is_empty() {
        let begin = rest;
        let tag = varint(&mut rest)?;
        let mut value = None;
        let payload = match tag & 7 {
            0 => {
                value = Some(varint(&mut rest)?);
                None
            }
            1 => rest.split_off(..8).map(|_| None)?,
            2 => {
                let length = usize::try_from(varint(&mut rest)?).ok()?;
                Some(rest.split_off(..length)?)
            }
            5 => rest.split_off(..4).map(|_| None)?,
            _ => return None,
        };
        all.push(Field { number: tag >> 3, payload, value, whole: &begin[..begin.len() - rest.len()] });
    }
    Some(all)
}

/// A sequence of varints.
pub(crate) fn varints(mut packed: &[u8]) -> Option<Vec<u64>> {
    let mut all = Vec::new();
    while !packed.is_empty() {
        all.push(varint(&mut packed)?);
    }
    Some(all)
}

/// The first text with this field number; `None` when there is none, or the bytes are not a message.
pub(crate) fn text(message: &[u8], number: u64) -> Option<&str> {
    let all = fields(message)?;
    let payload = all.iter().find(|field| field.number == number)?.payload?;
    std::str::from_utf8(payload).ok()
}

fn varint(rest: &mut &[u8]) -> Option<u64> {
    let mut value = 0_u64;
    for shift in (0..64).step_by(7) {
        let byte = *rest.split_off_first()?;
        value |= u64::from(byte & 0x7f) << shift;
        if byte < 0x80 {
            return Some(value);
        }
    }
    None
}

fn put_varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

/// Appends a varint field.
pub(crate) fn put_number(out: &mut Vec<u8>, number: u64, value: u64) {
    put_varint(out, number << 3);
    put_varint(out, value);
}

/// Appends a length-delimited field.
pub(crate) fn put(out: &mut Vec<u8>, number: u64, payload: &[u8]) {
    put_varint(out, number << 3 | 2);
    put_varint(out, payload.len() as u64);
    out.extend_from_slice(payload);
}
