//! Errors of the camera that a device assumes.

use std::fmt;
use std::str::FromStr;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_datasets::problem_files::seed_for;
use veiloc_geometry::Intrinsics;

/// An error of one parameter, written as parameter, sign and size.
///
/// | text | effect |
/// |---|---|
/// | `f+3%`, `fx-3%`, `fy+3%` | both focal lengths, or one of them, are 3 % too long or too short |
/// | `f~10%` | both focal lengths are multiplied or divided by 1.1, both equally likely |
/// | `cx+5%`, `cy-5%` | the principal point is off by 5 % of the image's width or height |
/// | `k1-0.2` | the first radial term of the distortion is 0.2 too small |
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraError {
    parameter: Parameter,
    /// Percent, or the difference for [`Parameter::K1`].
    size: f64,
    /// Whether the focal length is too long or too short at random.
    is_random: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Parameter {
    F,
    Fx,
    Fy,
    Cx,
    Cy,
    K1,
}

impl Parameter {
    const ALL: [(&str, Self); 6] = [
        ("fx", Self::Fx),
        ("fy", Self::Fy),
        ("f", Self::F),
        ("cx", Self::Cx),
        ("cy", Self::Cy),
        ("k1", Self::K1),
    ];
}

/// The largest error of a focal length or principal point, percent.
const MAX_PERCENT: f64 = 50.0;

impl FromStr for CameraError {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let read = || {
            let (name, parameter) = Parameter::ALL.into_iter().find(|(name, _)| text.starts_with(name))?;
            let signed = &text[name.len()..];
            let is_random = signed.starts_with('~');
            if !signed.starts_with(['+', '-']) && (!is_random || parameter != Parameter::F) {
                return None;
            }
            let signed = signed.trim_start_matches('~');
            let number = if parameter == Parameter::K1 { signed } else { signed.strip_suffix('%')? };
            let size: f64 = number.parse().ok()?;
            let most = if parameter == Parameter::K1 { 1.0 } else { MAX_PERCENT };
            (size != 0.0 && size.abs() <= most && !(is_random && size < 0.0)).then_some(Self {
                parameter,
                size,
                is_random,
            })
        };
        read().ok_or_else(|| {
            format!(
                "an error of a camera is expected: f, fx, fy, cx or cy with a signed percentage of at most {MAX_PERCENT}, \
                 f~N% for either sign, or k1 with a signed number of at most 1"
            )
        })
    }
}

impl fmt::Display for CameraError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name =
            Parameter::ALL.into_iter().find(|(_, own)| *own == self.parameter).map_or("", |(name, _)| name);
        let percent = if self.parameter == Parameter::K1 { "" } else { "%" };
        if self.is_random {
            write!(f, "{name}~{}{percent}", self.size)
        } else {
            write!(f, "{name}{:+}{percent}", self.size)
        }
    }
}

impl CameraError {
    /// The camera with this error; `None` for a camera whose model has no such parameter. Only a random sign depends on
    /// `name` and `seed`.
    pub(super) fn applied(&self, camera: &Intrinsics, name: &str, seed: u64) -> Option<Intrinsics> {
        let factor = 1.0 + self.size / 100.0;
        if self.parameter == Parameter::F {
            let words = [name, &format!("focal-{}", self.size)];
            let is_shorter =
                self.is_random && !ChaCha8Rng::seed_from_u64(seed_for(seed, &words)).random::<bool>();
            return Some(camera.zoomed(if is_shorter { factor.recip() } else { factor }));
        }
        let params = camera.model.params();
        let distortion: &[f64] = match camera.model.name() {
            "SIMPLE_PINHOLE" | "PINHOLE" => &[],
            "SIMPLE_RADIAL" | "RADIAL" => &params[3..],
            "OPENCV" => &params[4..],
            _ => return None,
        };
        let pinhole = camera.pinhole();
        let ([mut fx, mut fy], [mut cx, mut cy]) = (pinhole.focal, pinhole.principal);
        let mut terms = [0.0; 4];
        terms[..distortion.len()].copy_from_slice(distortion);
        match self.parameter {
            Parameter::F => {}
            Parameter::Fx => fx *= factor,
            Parameter::Fy => fy *= factor,
            Parameter::Cx => cx += self.size / 100.0 * f64::from(camera.width),
            Parameter::Cy => cy += self.size / 100.0 * f64::from(camera.height),
            Parameter::K1 => terms[0] += self.size,
        }
        let [k1, k2, p1, p2] = terms;
        Intrinsics::new("OPENCV", camera.width, camera.height, &[fx, fy, cx, cy, k1, k2, p1, p2]).ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(error: &str, camera: &str, seed: u64) -> Option<String> {
        let camera: Intrinsics = camera.parse().expect("a camera");
        error
            .parse::<CameraError>()
            .expect(error)
            .applied(&camera, "a", seed)
            .map(|camera| camera.to_string())
    }

    #[test]
    fn one_parameter_is_wrong() {
        let of =
            |error: &str| with(error, "SIMPLE_RADIAL,640,480,500,320,240,0.1", 0).expect("a known model");
        assert_eq!(of("f+10%"), "SIMPLE_RADIAL,640,480,550,320,240,0.1");
        assert_eq!(of("fy-10%"), "OPENCV,640,480,500,450,320,240,0.1,0,0,0");
        assert_eq!(of("cx+5%"), "OPENCV,640,480,500,500,352,240,0.1,0,0,0");
        assert_eq!(of("cy-5%"), "OPENCV,640,480,500,500,320,216,0.1,0,0,0");
        assert_eq!(of("k1-0.5"), "OPENCV,640,480,500,500,320,240,-0.4,0,0,0");
        assert_eq!(with("k1-0.5", "FOV,640,480,500,500,320,240,0.9", 0), None);
    }

    #[test]
    fn random_focal_length_is_too_long_or_too_short() {
        let of = |seed| with("f~25%", "SIMPLE_PINHOLE,640,480,500,320,240", seed).expect("a known model");
        let longer = (0..20).filter(|seed| of(*seed).contains(",625,")).count();
        let shorter = (0..20).filter(|seed| of(*seed).contains(",400,")).count();
        assert!(longer > 4 && shorter > 4 && longer + shorter == 20, "{longer} {shorter}");
    }
}
