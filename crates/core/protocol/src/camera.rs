//! The camera of a sealed query's positions: one of a short list, so that it does not identify a lens (rule L6).

use veiloc_geometry::{Intrinsics, Pinhole, Pixel, PlanePoint};

use crate::QueryError;

/// A pinhole camera from a short list: centred principal point, one focal length from the ladder `2^(k/4)`, width
/// and height multiples of 32.
///
/// Intrinsics are a fingerprint: calibrated to a hundredth of a pixel, they distinguish devices of one model. So the
/// device undoes its distortion, converts each keypoint into a ray and projects the ray into this camera. The ray is
/// the same; rounding the focal length loses nothing and only changes the unit "pixel", by at most 9 %.
///
/// The border of the device's own image would be a fingerprint too: keypoints extend up to it, and so do the extreme
/// angles of lines. So each side is rounded inwards to a multiple of 16 pixels, and keypoints beyond are dropped
/// ([`Window`], rule L11).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct CanonicalCamera {
    /// `k`, quarter octaves.
    focal_step: u8,
    /// Width, units of 32 pixels.
    width_blocks: u16,
    /// Height, units of 32 pixels.
    height_blocks: u16,
}

impl CanonicalCamera {
    /// Pixels of one unit of width and height.
    pub const BLOCK: u32 = 32;
    /// Widest and highest image: 8192 pixels.
    pub const MAX_BLOCKS: u16 = 256;
    /// Allowed steps of the focal length: 16 to 32768 pixels.
    pub const FOCAL_STEPS: std::ops::RangeInclusive<u8> = 16..=60;

    /// The camera for images of a device: the nearest focal length, and the image that contains its [`Self::window`].
    ///
    /// # Errors
    /// [`QueryError::Focal`] and [`QueryError::ImageSize`] for cameras outside of this list; in practice these are
    /// wrong calibrations.
    pub fn for_intrinsics(device: &Intrinsics) -> Result<Self, QueryError> {
        let focal = device.pinhole().mean_focal();
        let step = (4.0 * focal.log2()).round();
        let (first, last) = (f64::from(*Self::FOCAL_STEPS.start()), f64::from(*Self::FOCAL_STEPS.end()));
        if !(first..=last).contains(&step) {
            return Err(QueryError::Focal { focal });
        }
        let focal_step = step as u8;
        let [left, right, top, bottom] = sides(device, focal_of(focal_step));
        let (width, height) = (left.max(right), top.max(bottom));
        let allowed = 1.0..=f64::from(Self::MAX_BLOCKS);
        if !(allowed.contains(&width) && allowed.contains(&height)) {
            return Err(QueryError::ImageSize {
                width: width * f64::from(Self::BLOCK),
                height: height * f64::from(Self::BLOCK),
            });
        }
        Ok(Self { focal_step, width_blocks: width as u16, height_blocks: height as u16 })
    }

    /// The part of this camera's image in which keypoints of a device may be, for the device it was made for.
    pub fn window(self, device: &Intrinsics) -> Window {
        let [left, right, top, bottom] = sides(device, self.focal()).map(|side| side * SIDE);
        let (u, v) = (f64::from(self.width()) / 2.0, f64::from(self.height()) / 2.0);
        Window { u: [u - left, u + right], v: [v - top, v + bottom] }
    }

    /// From the numbers on the wire: step of the focal length, width and height in units of 32 pixels.
    ///
    /// # Errors
    /// [`QueryError::Field`] for a number out of range.
    pub fn from_codes(focal: u32, width: u32, height: u32) -> Result<Self, QueryError> {
        let blocks = |field, value: u32| {
            u16::try_from(value)
                .ok()
                .filter(|b| (1..=Self::MAX_BLOCKS).contains(b))
                .ok_or(QueryError::Field { field, value, allowed: "a number from 1 to 256" })
        };
        let focal_step =
            u8::try_from(focal).ok().filter(|k| Self::FOCAL_STEPS.contains(k)).ok_or(QueryError::Field {
                field: "camera_focal",
                value: focal,
                allowed: "a number from 16 to 60",
            })?;
        let (width_blocks, height_blocks) =
            (blocks("camera_width", width)?, blocks("camera_height", height)?);
        Ok(Self { focal_step, width_blocks, height_blocks })
    }

    /// `(focal, width, height)` as on the wire.
    pub const fn codes(self) -> (u32, u32, u32) {
        (self.focal_step as u32, self.width_blocks as u32, self.height_blocks as u32)
    }

    /// Focal length, pixels.
    pub fn focal(self) -> f64 {
        focal_of(self.focal_step)
    }

    /// Image width, pixels.
    pub const fn width(self) -> u32 {
        self.width_blocks as u32 * Self::BLOCK
    }

    /// Image height, pixels.
    pub const fn height(self) -> u32 {
        self.height_blocks as u32 * Self::BLOCK
    }

    /// The camera as the pose estimator uses it.
    pub fn pinhole(self) -> Pinhole {
        Pinhole {
            width: self.width(),
            height: self.height(),
            focal: [self.focal(); 2],
            principal: [f64::from(self.width()) / 2.0, f64::from(self.height()) / 2.0],
        }
    }
}

/// `2^(step/4)`, bit-identical on every machine.
fn focal_of(step: u8) -> f64 {
    /// `2^(0/4)` to `2^(3/4)`.
    const QUARTERS: [f64; 4] = [1.0, 1.189_207_115_002_721, std::f64::consts::SQRT_2, 1.681_792_830_507_429];
    f64::from(1_u32 << (step / 4).min(31)) * QUARTERS[usize::from(step % 4)]
}

/// A rectangle in the image of a canonical camera, whose sides are multiples of 16 pixels from its centre.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Window {
    u: [f64; 2],
    v: [f64; 2],
}

impl Window {
    /// Whether a pixel lies in it, border included.
    pub fn contains(&self, pixel: Pixel) -> bool {
        (self.u[0]..=self.u[1]).contains(&pixel.u) && (self.v[0]..=self.v[1]).contains(&pixel.v)
    }
}

/// Steps of a side of a window, pixels.
const SIDE: f64 = CanonicalCamera::BLOCK as f64 / 2.0;

/// How far the rectangle that the device shows completely extends from the optical axis, in whole steps at this focal
/// length: left, right, up and down. Sampled over the image, because a border beyond the fold of a distortion has no
/// ray.
fn sides(device: &Intrinsics, focal: f64) -> [f64; 4] {
    const SAMPLES: u32 = 32;
    let at = |i: u32, size: u32| f64::from(size) * f64::from(i) / f64::from(SAMPLES);
    let ray = |i: u32, j: u32| device.unproject(Pixel::new(at(i, device.width), at(j, device.height)));
    // The extent of one line of samples; among the lines whose ends are visible, the smallest extent counts.
    let reach = |seen: &dyn Fn(u32, u32) -> Option<PlanePoint>, of: &dyn Fn(PlanePoint) -> f64| {
        let line = |j: u32| {
            let is_whole = seen(0, j).is_some() && seen(SAMPLES, j).is_some();
            let most = (0..=SAMPLES).filter_map(|i| seen(i, j)).map(of).reduce(f64::max)?;
            Some((is_whole, most))
        };
        let lines: Vec<(bool, f64)> = (0..=SAMPLES).filter_map(line).collect();
        let any_whole = lines.iter().any(|line| line.0);
        lines.iter().filter(|line| line.0 || !any_whole).map(|line| line.1).fold(f64::INFINITY, f64::min)
    };
    let (row, column) = (|i: u32, j: u32| ray(i, j), |i: u32, j: u32| ray(j, i));
    let all =
        [reach(&row, &|p| -p.x), reach(&row, &|p| p.x), reach(&column, &|p| -p.y), reach(&column, &|p| p.y)];
    all.map(|side| if side.is_finite() { (side * focal / SIDE).floor() } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn canonical_camera_covers_the_image() {
        for (text, focal, width, height) in [
            ("SIMPLE_PINHOLE,640,480,525.5,320,240", 512.0, 608, 448),
            ("PINHOLE,1536,1024,1379.74,1382.08,760.6,503.7", 1_448.154_687_870_049, 1600, 1088),
            ("OPENCV,1000,800,900,905,510,390,-0.15,0.05,0.001,-0.0007", 861.077_929_219_003_7, 992, 800),
        ] {
            let device: Intrinsics = text.parse().expect("valid");
            let camera = CanonicalCamera::for_intrinsics(&device).expect("ordinary");
            assert!((camera.focal() - focal).abs() < 1e-9, "{text}: {}", camera.focal());
            assert_eq!((camera.width(), camera.height()), (width, height), "{text}");
            let (a, b, c) = camera.codes();
            assert_eq!(CanonicalCamera::from_codes(a, b, c).expect("own codes"), camera);
            // The window lies in both images, and loses no more than a step and the curvature of the distortion.
            let (pinhole, window) = (camera.pinhole(), camera.window(&device));
            for i in 0..=50 {
                let t = f64::from(i) / 50.0;
                let between = |[a, b]: [f64; 2], t: f64| a + t * (b - a);
                for (u, v) in [(t, 0.0), (t, 1.0), (0.0, t), (1.0, t)] {
                    let corner = Pixel::new(between(window.u, u), between(window.v, v));
                    assert!(pinhole.contains(corner, 0.0) && window.contains(corner), "{text} {corner:?}");
                    let shown = device.project(pinhole.unproject(corner));
                    assert!(device.pinhole().contains(shown, 1e-6), "{text} {corner:?} {shown:?}");
                }
                let edge = device.unproject(Pixel::new(0.0, t * f64::from(device.height))).expect("unfolded");
                let outside = pinhole.project(edge).u;
                assert!((-80.0..window.u[0] + 1e-9).contains(&outside), "{text} {outside}");
            }
        }
    }

    #[test]
    fn focal_lengths_are_quarter_octaves() {
        for step in CanonicalCamera::FOCAL_STEPS {
            let expected = 2_f64.powf(f64::from(step) / 4.0);
            assert!((focal_of(step) / expected - 1.0).abs() < 1e-14);
        }
    }

    #[test]
    fn one_window_per_lens_model() {
        let window = |text: &str| {
            let device: Intrinsics = text.parse().expect("valid");
            let camera = CanonicalCamera::for_intrinsics(&device).expect("ordinary");
            (camera.codes(), camera.window(&device))
        };
        let one = window("SIMPLE_PINHOLE,640,480,525.5,320,240");
        for other in [
            "SIMPLE_PINHOLE,640,480,525.5,320,243",
            "SIMPLE_PINHOLE,640,480,525.5,318,240",
            "SIMPLE_PINHOLE,640,480,520.2,320,240",
            "SIMPLE_RADIAL,640,480,525.5,320,240,-0.01",
        ] {
            assert_eq!(window(other), one, "{other}");
        }
    }

    #[test]
    fn invalid_cameras_are_rejected() {
        let of = |text: &str| CanonicalCamera::for_intrinsics(&text.parse().expect("valid"));
        assert!(matches!(of("SIMPLE_PINHOLE,640,480,1,320,240"), Err(QueryError::Focal { .. })));
        assert!(matches!(of("SIMPLE_PINHOLE,640,480,1e9,320,240"), Err(QueryError::Focal { .. })));
        assert!(matches!(of("SIMPLE_PINHOLE,640,480,500,99999,240"), Err(QueryError::ImageSize { .. })));
        assert!(matches!(of("SIMPLE_PINHOLE,4000000000,480,500,320,240"), Err(QueryError::ImageSize { .. })));
        assert!(CanonicalCamera::from_codes(15, 1, 1).is_err());
        assert!(CanonicalCamera::from_codes(30, 0, 1).is_err());
        assert!(CanonicalCamera::from_codes(30, 1, 257).is_err());
    }
}
