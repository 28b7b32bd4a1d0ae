//! Validity and names of a certificate: the only X.509 fields that the server needs.
//!
//! `Certificate ::= SEQUENCE { tbs SEQUENCE { [0] version OPTIONAL, serial, signature, issuer, validity SEQUENCE {
//! notBefore, notAfter }, … } … }` (RFC 5280, 4.1); times are `UTCTime` or `GeneralizedTime`, always in UTC and with
//! seconds.

use crate::auth::Timestamp;

/// What the server reads of a certificate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Certificate<'a> {
    /// Begin of validity, seconds since 1970.
    pub(crate) begins: i64,
    /// End of validity, seconds since 1970.
    pub(crate) ends: i64,
    /// Name of the issuer, encoded.
    pub(crate) issuer: &'a [u8],
    /// Its own name, encoded.
    pub(crate) subject: &'a [u8],
}

/// Reads a certificate; `None` if the bytes are none.
pub(crate) fn certificate(der: &[u8]) -> Option<Certificate<'_>> {
    let (_, certificate, _) = element(der, SEQUENCE)?;
    let (_, mut fields, _) = element(certificate, SEQUENCE)?;
    if let Some((_, _, rest)) = element(fields, VERSION) {
        fields = rest;
    }
    for kind in [INTEGER, SEQUENCE] {
        fields = element(fields, kind)?.2;
    }
    let (_, issuer, fields) = element(fields, SEQUENCE)?;
    let (_, validity, fields) = element(fields, SEQUENCE)?;
    let (_, subject, _) = element(fields, SEQUENCE)?;
    let (kind, text, rest) = any(validity)?;
    let begins = time(kind, text)?;
    let (kind, text, _) = any(rest)?;
    Some(Certificate { begins, ends: time(kind, text)?, issuer, subject })
}

/// A time, seconds since 1970.
fn time(kind: u8, text: &[u8]) -> Option<i64> {
    let digits = std::str::from_utf8(text.strip_suffix(b"Z")?).ok()?;
    let (year, rest) = match kind {
        UTC_TIME => {
            let (year, rest) = digits.split_at_checked(2)?;
            let year = number(year)?;
            (if year < 50 { 2000 + year } else { 1900 + year }, rest)
        }
        GENERALIZED_TIME => {
            let (year, rest) = digits.split_at_checked(4)?;
            (number(year)?, rest)
        }
        _ => return None,
    };
    if rest.len() != 10 {
        return None;
    }
    let two = |at: usize| number(rest.get(at..at + 2)?);
    let timestamp = Timestamp::of_calendar([year, two(0)?, two(2)?], [two(4)?, two(6)?, two(8)?])?;
    Some(timestamp.unix())
}

const INTEGER: u8 = 0x02;
const SEQUENCE: u8 = 0x30;
const VERSION: u8 = 0xA0;
const UTC_TIME: u8 = 0x17;
const GENERALIZED_TIME: u8 = 0x18;

fn number(digits: &str) -> Option<i64> {
    digits.bytes().all(|c| c.is_ascii_digit()).then(|| digits.parse().ok())?
}

/// Splits off one element: tag, content, and the rest.
fn any(der: &[u8]) -> Option<(u8, &[u8], &[u8])> {
    let (&[tag, first], rest) = der.split_first_chunk::<2>()?;
    let (length, rest) = match first {
        0..=0x7F => (usize::from(first), rest),
        // Lengths of one to four bytes.
        0x81..=0x84 => {
            let (bytes, rest) = rest.split_at_checked(usize::from(first & 0x7F))?;
            (bytes.iter().fold(0, |length, byte| length << 8 | usize::from(*byte)), rest)
        }
        _ => return None,
    };
    let (content, rest) = rest.split_at_checked(length)?;
    Some((tag, content, rest))
}

fn element(der: &[u8], tag: u8) -> Option<(u8, &[u8], &[u8])> {
    any(der).filter(|(found, _, _)| *found == tag)
}

#[cfg(test)]
mod tests {
    use rustls::pki_types::CertificateDer;
    use rustls::pki_types::pem::PemObject as _;

    use super::*;

    #[test]
    fn certificates_are_read_and_any_bytes_are_accepted() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../server/service/tests/data/cert.pem");
        let der = CertificateDer::from_pem_file(path).expect("a certificate");
        // `openssl x509 -dates -noout -in cert.pem`; it is its own issuer.
        let read = certificate(&der).expect("a certificate");
        assert_eq!((read.begins, read.ends), (4_948_872_643 - 36_500 * 86_400, 4_948_872_643));
        assert_eq!(read.issuer, read.subject);
        for length in 0..der.len() {
            certificate(&der[..length]);
        }
        let mut broken = der.to_vec();
        for at in 0..broken.len().min(300) {
            for value in [0, 0x7F, 0x80, 0x84, 0xFF] {
                let original = std::mem::replace(&mut broken[at], value);
                certificate(&broken);
                broken[at] = original;
            }
        }
    }
}
