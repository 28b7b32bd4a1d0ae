//! `--need 25cm,2deg`: the precision that a caller needs.

use std::str::FromStr;

use veiloc_map::MapFile;
use veiloc_pose::Precision;

use crate::output::exit::Failure;

/// A precision, before the map's unit is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Need {
    precision: Precision,
    /// Whether the position is in metres, not in map units.
    in_metres: bool,
}

/// Units of length, in metres, longest names first.
const LENGTHS: [(&str, f64); 3] = [("mm", 0.001), ("cm", 0.01), ("m", 1.0)];

impl FromStr for Need {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let refuse = || {
            format!(
                "{text:?}: expected a position, an orientation or both, as in 25cm,2deg or 0.25,2deg or 2deg"
            )
        };
        let number = |digits: &str| {
            digits.trim().parse::<f64>().ok().filter(|n| n.is_finite() && *n > 0.0).ok_or_else(refuse)
        };
        let (mut position, mut rotation, mut in_metres) = (None, None, false);
        for part in text.split(',').map(str::trim) {
            if let Some(degrees) = part.strip_suffix("deg").or_else(|| part.strip_suffix('°')) {
                if rotation.replace(number(degrees)?).is_some() {
                    return Err(refuse());
                }
                continue;
            }
            let unit =
                LENGTHS.into_iter().find_map(|(name, metres)| Some((part.strip_suffix(name)?, metres)));
            let (digits, scale) = unit.unwrap_or((part, 1.0));
            in_metres = unit.is_some();
            if position.replace(scale * number(digits)?).is_some() {
                return Err(refuse());
            }
        }
        let [position, rotation_deg] = [position, rotation].map(|limit| limit.unwrap_or(f64::INFINITY));
        Ok(Self { precision: Precision { position, rotation_deg }, in_metres })
    }
}

impl Need {
    /// The precision in the units of a map.
    ///
    /// # Errors
    /// [`Failure`]: the position is in metres, and the unit of the map is not known.
    pub(crate) fn in_map(need: Option<Self>, map: &MapFile) -> Result<Precision, Failure> {
        match need {
            Some(need) if need.in_metres && !map.is_metric() => Err(Failure::with_help(
                "--need: the unit of the map is not known",
                "give the position in map units, as in 0.25,2deg, or build the map with --metres if its unit is the metre",
            )),
            need => Ok(need.map_or(Precision::ANY, |need| need.precision)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_and_degrees_are_read() {
        for (text, position, rotation_deg, in_metres) in [
            ("25cm,2deg", 0.25, 2.0, true),
            ("2°, 5mm", 0.005, 2.0, true),
            ("0.3", 0.3, f64::INFINITY, false),
            ("1.5m", 1.5, f64::INFINITY, true),
            ("3deg", f64::INFINITY, 3.0, false),
        ] {
            let precision = Precision { position, rotation_deg };
            assert_eq!(text.parse(), Ok(Need { precision, in_metres }), "{text}");
        }
        for text in ["", "cm", "-1cm", "nan", "0", "inf", "1cm,2cm", "2deg,3deg", "1cm,2deg,3", "25 feet"] {
            assert!(text.parse::<Need>().is_err(), "{text:?}");
        }
    }
}
