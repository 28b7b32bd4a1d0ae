//! Whether a JPEG file is complete.

use std::borrow::Cow;

/// The decoder fills the missing part of a truncated JPEG with gray and reports success; so this walks its segments to
/// the end marker. Extraneous bytes between segments, which some cameras write, are left out, as libjpeg does.
///
/// Segments are skipped by their length, because a preview inside one has its own end marker. Within the coded samples,
/// `FF 00` is a sample and `FF D0`..`FF D7` a restart.
///
/// # Errors
/// What is wrong, and where.
pub(crate) fn complete_jpeg(bytes: &[u8]) -> Result<Cow<'_, [u8]>, String> {
    const START_OF_SCAN: u8 = 0xDA;
    const END: u8 = 0xD9;
    let mut at = 2;
    let mut in_scan = false;
    // Without the extraneous bytes before `copied`; empty if there are none.
    let (mut whole, mut copied) = (Vec::new(), 0);
    while let Some(&[first, marker]) = bytes.get(at..at + 2) {
        match (first, marker) {
            (0xFF, END) if whole.is_empty() => return Ok(Cow::Borrowed(bytes)),
            (0xFF, END) => {
                whole.extend_from_slice(&bytes[copied..]);
                return Ok(Cow::Owned(whole));
            }
            (0xFF, 0xFF) => at += 1,
            (0xFF, 0x00 | 0x01 | 0xD0..=0xD7) => at += 2,
            (0xFF, _) => {
                let Some(&[high, low]) = bytes.get(at + 2..at + 4) else { break };
                let length = usize::from(u16::from_be_bytes([high, low]));
                if length < 2 {
                    return Err(format!("the segment at byte {at} has a length of {length}"));
                }
                at += 2 + length;
                in_scan = marker == START_OF_SCAN;
            }
            _ if in_scan => at += 1,
            _ => {
                let rest = &bytes[at..];
                let next = rest.windows(2).position(|pair| pair[0] == 0xFF && pair[1] != 0);
                let Some(length) = next else {
                    return Err(format!(
                        "no segment follows at byte {at}, and the end of the image is missing"
                    ));
                };
                whole.extend_from_slice(&bytes[copied..at]);
                at += length;
                copied = at;
            }
        }
    }
    Err("the end of the image is missing".to_owned())
}
