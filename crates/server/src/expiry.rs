//! Until when a certificate is valid: the one thing of X.509 that its server has to know beside its bytes.
//!
//! `Certificate ::= SEQUENCE { tbs SEQUENCE { [0] version OPTIONAL, serial, signature, issuer, validity SEQUENCE { notBefore,
//! notAfter }, … } … }` (RFC 5280, 4.1); times are `UTCTime` or `GeneralizedTime`, always in UTC and with seconds.

/// Seconds since 1970; `None` for bytes that are no certificate.
pub(crate) fn not_after(der: &[u8]) -> Option<i64> {
    let (_, certificate, _) = element(der, SEQUENCE)?;
    let (_, mut fields, _) = element(certificate, SEQUENCE)?;
    if let Some((_, _, rest)) = element(fields, VERSION) {
        fields = rest;
    }
    for kind in [INTEGER, SEQUENCE, SEQUENCE] {
        fields = element(fields, kind)?.2;
    }
    let (_, validity, _) = element(fields, SEQUENCE)?;
    let (_, _, rest) = any(validity)?;
    let (kind, text, _) = any(rest)?;
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
    let (month, day) = (two(0)?, two(2)?);
    let in_range = (1..=12).contains(&month) && (1..=31).contains(&day);
    in_range.then_some(days(year, month, day) * 86_400 + two(4)? * 3600 + two(6)? * 60 + two(8)?)
}

const INTEGER: u8 = 0x02;
const SEQUENCE: u8 = 0x30;
const VERSION: u8 = 0xA0;
const UTC_TIME: u8 = 0x17;
const GENERALIZED_TIME: u8 = 0x18;

fn number(digits: &str) -> Option<i64> {
    digits.bytes().all(|c| c.is_ascii_digit()).then(|| digits.parse().ok())?
}

/// Tag, content, and what follows.
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

/// Days from 1970-01-01 in the Gregorian calendar (H. Hinnant, `days_from_civil`).
fn days(year: i64, month: i64, day: i64) -> i64 {
    let year = if month <= 2 { year - 1 } else { year };
    let of_era = year.rem_euclid(400);
    let of_year = (153 * ((month + 9) % 12) + 2) / 5 + day - 1;
    year.div_euclid(400) * 146_097 + of_era * 365 + of_era / 4 - of_era / 100 + of_year - 719_468
}

#[cfg(test)]
mod tests {
    use rustls::pki_types::CertificateDer;
    use rustls::pki_types::pem::PemObject as _;

    use super::*;

    #[test]
    fn the_calendar_is_right() {
        // `date -u -d DATE +%s`
        for (date, seconds) in [
            ((1970, 1, 1), 0),
            ((2000, 2, 29), 951_782_400),
            ((2026, 11, 22), 1_795_305_600),
            ((2100, 3, 1), 4_107_542_400),
        ] {
            assert_eq!(days(date.0, date.1, date.2) * 86_400, seconds, "{date:?}");
        }
    }

    #[test]
    fn the_end_of_a_certificate_is_read_and_no_bytes_break_it() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/cert.pem");
        let der = CertificateDer::from_pem_file(path).expect("a certificate");
        // `openssl x509 -enddate -noout -in cert.pem`
        assert_eq!(not_after(&der), Some(4_948_872_643));
        for length in 0..der.len() {
            not_after(&der[..length]);
        }
        let mut broken = der.to_vec();
        for at in 0..broken.len().min(300) {
            for value in [0, 0x7F, 0x80, 0x84, 0xFF] {
                let kept = std::mem::replace(&mut broken[at], value);
                not_after(&broken);
                broken[at] = kept;
            }
        }
    }
}
