//! The camera of a sealed query's positions: one of a short list, so that it does not identify a lens (rule L6).

use veiloc_geometry::{Intrinsics, Pinhole, Pixel, PlanePoint};

use crate::QueryError;

/// A pinhole camera from a short list: centred principal point, one focal length from the ladder `2^(k/4)`, width
/// and height multiples of 32.
///
/// Intrinsics are a fingerprint: calibrated to a hundredth of a pixel, they distinguish devices of one model. So the
/// device undoes its distortion, converts each keypoint into a ray and projects the ray into this camera. The ray is
/// the same; another focal length loses nothing and only changes the unit "pixel", by at most a fifth.
///
/// The border of the device's own image would be a fingerprint too: keypoints extend up to it, and so do the extreme
/// angles of lines. So keypoints are sent from a rectangle of one of six sizes per octave of the field of view, and
/// those beyond are dropped ([`Window`], rule L11).
///
/// One number of the lens chooses everything: the largest rectangle of the list that the image shows completely. Focal
/// length, width and height follow from this rectangle and the number of pixels of the image. They have no thresholds
/// of their own, so that neither all three together, nor queries from an image that is scaled to other sizes, tell more
/// than one of six classes.
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

    /// The camera for images of a device: the image that contains its [`Self::window`], and a focal length near that of
    /// the device.
    ///
    /// # Errors
    /// [`QueryError::Focal`], [`QueryError::OpticalAxis`] and [`QueryError::ImageSize`] for cameras outside of this
    /// list; in practice these are wrong calibrations.
    pub fn for_intrinsics(device: &Intrinsics) -> Result<Self, QueryError> {
        let frame = Frame::of(device)?;
        let step = frame.focal_step(device);
        let (first, last) = (f64::from(*Self::FOCAL_STEPS.start()), f64::from(*Self::FOCAL_STEPS.end()));
        if !(first..=last).contains(&step) {
            return Err(QueryError::Focal { focal: device.pinhole().mean_focal() });
        }
        let focal_step = step as u8;
        let most = |[low, high]: [f64; 2]| f64::max(-low, high);
        let [width, height] = [frame.x, frame.y].map(|side| {
            (2.0 * most(side) * focal_of(focal_step) / f64::from(Self::BLOCK) - TOLERANCE).ceil()
        });
        let allowed = 1.0..=f64::from(Self::MAX_BLOCKS);
        if !(allowed.contains(&width) && allowed.contains(&height)) {
            return Err(QueryError::ImageSize {
                width: width * f64::from(Self::BLOCK),
                height: height * f64::from(Self::BLOCK),
            });
        }
        Ok(Self { focal_step, width_blocks: width as u16, height_blocks: height as u16 })
    }

    /// Whether images of a device whose own camera this is may be sent in the image of `other`: cameras of one model, of which
    /// one is a step of the list beside the other.
    pub fn is_near(self, other: Self) -> bool {
        const MOST: f64 = 1.25;
        let view =
            |camera: Self| [camera.width(), camera.height()].map(|side| f64::from(side) / camera.focal());
        let ratios = [0, 1].map(|i| view(self)[i] / view(other)[i]);
        self.focal_step.abs_diff(other.focal_step) <= 1
            && ratios.iter().all(|r| (1.0 / MOST..=MOST).contains(r))
    }

    /// The part of this camera's image in which keypoints of a device may be. The device is one that it was made for, or
    /// one like it ([`Self::is_near`]), whose window may be cut.
    ///
    /// # Errors
    /// As [`Self::for_intrinsics`].
    pub fn window(self, device: &Intrinsics) -> Result<Window, QueryError> {
        let frame = Frame::of(device)?;
        let of = |[low, high]: [f64; 2], size: u32| {
            let (size, middle) = (f64::from(size), f64::from(size) / 2.0);
            let [low, high] = [low, high].map(|end| middle + end * self.focal());
            [low.max(0.0) - TOLERANCE, high.min(size) + TOLERANCE]
        };
        Ok(Window { u: of(frame.x, self.width()), v: of(frame.y, self.height()) })
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

/// A rectangle in the image of a canonical camera, of one of six sizes per octave.
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

/// Half the longer side of a window on the plane `z = 1`, times any power of two. Six per octave, chosen so that cameras
/// in wide use lose little: among them are the whole image of a camera whose focal length is assumed (1.2 times the
/// longer side, 10/24), and of one with 0.8 times the longer side (15/24).
const HALF_SIDES: [f64; 6] = [10.0 / 24.0, 11.25 / 24.0, 12.5 / 24.0, 13.75 / 24.0, 15.0 / 24.0, 17.0 / 24.0];
/// The longer side of a window over the shorter one. The shape of the image alone chooses, not the lens.
const ASPECTS: [f64; 8] = [1.0, 5.0 / 4.0, 4.0 / 3.0, 3.0 / 2.0, 16.0 / 9.0, 2.0, 5.0 / 2.0, 10.0 / 3.0];
/// Where the middle of a window may be, in halves of the window's side from the optical axis. Only an image that was
/// cut out of another one far from its middle has another than 0: an offset below a tenth of the image never does.
const SHIFTS: [f64; 5] = [0.0, 0.5, -0.5, 1.0, -1.0];
/// For rounding errors: of a size relative to it, and of a position in pixels.
const TOLERANCE: f64 = 1e-9;

/// The part of the view from which keypoints are sent, and which size of the list it has.
struct Frame {
    /// Left and right end on the plane `z = 1`.
    x: [f64; 2],
    /// Upper and lower end.
    y: [f64; 2],
    /// Half the longer side.
    half: f64,
    /// The next larger half in the list.
    next: f64,
    /// Longer side over shorter side.
    aspect: f64,
}

impl Frame {
    /// The largest rectangle of the list that the device shows completely.
    fn of(device: &Intrinsics) -> Result<Self, QueryError> {
        let (long, short) = (device.width.max(device.height), device.width.min(device.height).max(1));
        let shape = f64::from(long) / f64::from(short);
        let distance = |aspect: &f64| (shape / aspect).ln().abs();
        let aspect = ASPECTS.into_iter().min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(1.0);
        // Lengths in units of half the longer side.
        let [x_unit, y_unit] =
            if device.width >= device.height { [1.0, 1.0 / aspect] } else { [1.0 / aspect, 1.0] };
        let [left, right, top, bottom] = extents(device);
        // The largest half for which the window around this middle is inside of both ends.
        let largest = |low: f64, high: f64, shift: f64, unit: f64| {
            let end = |extent: f64, part: f64| match part > 0.0 {
                true => extent / (part * unit),
                false if extent >= 0.0 => f64::INFINITY,
                false => 0.0,
            };
            end(low, 1.0 - shift).min(end(high, 1.0 + shift))
        };
        let mut best: Option<Self> = None;
        for x_shift in SHIFTS {
            for y_shift in SHIFTS {
                let fits = largest(left, right, x_shift, x_unit).min(largest(top, bottom, y_shift, y_unit));
                let Some((half, next)) = step_below(fits) else { continue };
                if best.as_ref().is_none_or(|best| half > best.half) {
                    let ends =
                        |shift: f64, unit: f64| [(shift - 1.0) * unit * half, (shift + 1.0) * unit * half];
                    best =
                        Some(Self { x: ends(x_shift, x_unit), y: ends(y_shift, y_unit), half, next, aspect });
                }
            }
        }
        best.ok_or(QueryError::OpticalAxis)
    }

    /// The step of the focal length at which this rectangle has about as many pixels as in the image of the device. It
    /// depends on the size of the image, and on the lens only through the rectangle.
    fn focal_step(&self, device: &Intrinsics) -> f64 {
        let (long, short) = (device.width.max(device.height), device.width.min(device.height));
        let pixels = f64::from(long).min(f64::from(short) * self.aspect);
        // The list does not say where between two of its sizes the lens lies: the geometric mean.
        (4.0 * (0.5 * pixels / (self.half * self.next).sqrt()).log2()).round()
    }
}

/// The largest half side of the list that is not above this one, and the next larger one; `None` if there is none.
fn step_below(half: f64) -> Option<(f64, f64)> {
    let half = half * (1.0 + TOLERANCE);
    if !(half.is_finite() && half > f64::from(f32::MIN_POSITIVE)) {
        return None;
    }
    let mut octave = 1.0;
    while half < octave * HALF_SIDES[0] {
        octave *= 0.5;
    }
    while half >= 2.0 * octave * HALF_SIDES[0] {
        octave *= 2.0;
    }
    let index = HALF_SIDES.iter().rposition(|side| octave * side <= half)?;
    let next = HALF_SIDES.get(index + 1).copied().unwrap_or(2.0 * HALF_SIDES[0]);
    Some((octave * HALF_SIDES[index], octave * next))
}

/// How far the rectangle that the device shows completely extends from the optical axis on the plane `z = 1`: left,
/// right, up and down. Sampled over the image, because a border beyond the fold of a distortion has no ray.
fn extents(device: &Intrinsics) -> [f64; 4] {
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
    [reach(&row, &|p| -p.x), reach(&row, &|p| p.x), reach(&column, &|p| -p.y), reach(&column, &|p| p.y)]
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    fn seen_as(device: &Intrinsics) -> (CanonicalCamera, Window) {
        let camera = CanonicalCamera::for_intrinsics(device).expect("ordinary");
        (camera, camera.window(device).expect("ordinary"))
    }

    #[test]
    fn canonical_camera_covers_the_image() {
        for (text, focal, width, height) in [
            ("SIMPLE_PINHOLE,640,480,512,320,240", 512.0, 640, 480),
            ("SIMPLE_PINHOLE,640,480,768,320,240", 724.077_343_935_024_6, 608, 480),
            ("SIMPLE_PINHOLE,640,480,525.5,320,240", 512.0, 608, 448),
            ("PINHOLE,1536,1024,1379.74,1382.08,760.6,503.7", 1_448.154_687_870_049, 1536, 1024),
            ("OPENCV,1000,800,900,905,510,390,-0.15,0.05,0.001,-0.0007", 861.077_929_219_003_7, 928, 736),
            // Cut out of an image of 640 x 480: the optical axis is at a third of its width and two of its height.
            ("SIMPLE_PINHOLE,480,360,525.5,160,240", 608.874_042_881_393_2, 672, 512),
        ] {
            let device: Intrinsics = text.parse().expect("valid");
            let (camera, window) = seen_as(&device);
            assert!((camera.focal() - focal).abs() < 1e-9, "{text}: {}", camera.focal());
            assert_eq!((camera.width(), camera.height()), (width, height), "{text}");
            let (a, b, c) = camera.codes();
            assert_eq!(CanonicalCamera::from_codes(a, b, c).expect("own codes"), camera);
            // The window lies in both images, and is not much smaller than the image of the device.
            let pinhole = camera.pinhole();
            for i in 0..=50 {
                let t = f64::from(i) / 50.0;
                let between = |[a, b]: [f64; 2], t: f64| a + t * (b - a);
                for (u, v) in [(t, 0.0), (t, 1.0), (0.0, t), (1.0, t)] {
                    let corner = Pixel::new(between(window.u, u), between(window.v, v));
                    assert!(pinhole.contains(corner, 1e-6) && window.contains(corner), "{text} {corner:?}");
                    let shown = device.project(pinhole.unproject(corner));
                    assert!(device.pinhole().contains(shown, 1e-6), "{text} {corner:?} {shown:?}");
                }
            }
            let [w, h] = [window.u, window.v].map(|[low, high]| (high - low) / camera.focal());
            let own = device.pinhole();
            let whole = [f64::from(own.width) / own.focal[0], f64::from(own.height) / own.focal[1]];
            assert!(w * h > 0.55 * whole[0] * whole[1], "{text}: {w} x {h} of {whole:?}");
        }
    }

    #[test]
    fn focal_lengths_are_quarter_octaves() {
        for step in CanonicalCamera::FOCAL_STEPS {
            let expected = 2_f64.powf(f64::from(step) / 4.0);
            assert!((focal_of(step) / expected - 1.0).abs() < 1e-14);
        }
    }

    /// All that the bytes of queries show of a lens, when the device scales its images to each of these sides: codes and
    /// windows, as text.
    fn shown(of: &dyn Fn(&Intrinsics) -> String, lens: &Intrinsics, sides: &[u32]) -> String {
        let longer = f64::from(lens.width.max(lens.height));
        let scaled = |side: &u32| {
            let to = |own: u32| (f64::from(own) * (f64::from(*side) / longer).min(1.0)).round() as u32;
            of(&lens.resized(to(lens.width), to(lens.height)))
        };
        sides.iter().map(scaled).collect()
    }

    /// Sizes of images of phones and cameras, as they are or scaled down.
    const SIZES: [(u32, u32); 3] = [(1600, 1200), (1536, 1024), (1080, 1920)];

    /// Rules L6 and L11: for each image size, whatever sides the profiles request, and all queries together.
    #[test]
    fn six_classes_of_lenses_per_octave() {
        let sent = |lens: &Intrinsics| format!("{:?}", seen_as(lens));
        // The leak: codes and sides of the window each rounded by themselves.
        let rounded_alone = |lens: &Intrinsics| {
            let focal = lens.pinhole().mean_focal();
            let step = (4.0 * focal.log2()).round();
            format!("{step} {:?}", extents(lens).map(|side| (side * 2_f64.powf(step / 4.0) / 16.0).floor()))
        };
        const LENSES: u32 = 80;
        let one = [1600];
        let many: Vec<u32> = (0..5).map(|k| 301 + 307 * k).collect();
        for (width, height) in SIZES {
            let classes = |of: &dyn Fn(&Intrinsics) -> String, sides: &[u32]| {
                let seen: BTreeSet<String> = (0..LENSES)
                    .map(|k| {
                        let focal =
                            f64::from(width.max(height)) * 0.7 * 2_f64.powf(f64::from(k) / f64::from(LENSES));
                        let principal = [f64::from(width) / 2.0, f64::from(height) / 2.0];
                        let params = [focal, principal[0], principal[1], -0.02];
                        let lens = Intrinsics::new("SIMPLE_RADIAL", width, height, &params);
                        shown(of, &lens.expect("valid"), sides)
                    })
                    .collect();
                seen.len()
            };
            // Both ends of the octave lie within one class.
            assert!(classes(&sent, &one) <= 7, "{width} x {height}: {}", classes(&sent, &one));
            assert_eq!(classes(&sent, &many), classes(&sent, &one), "{width} x {height}");
            let leak = [&one[..], &many].map(|sides| classes(&rounded_alone, sides));
            assert!(leak[0] > 20 && leak[1] > leak[0], "the measure does not see the leak: {leak:?}");
        }
    }

    /// Devices of one model: focal length and distortion differ by a percent, the principal point by pixels.
    #[test]
    fn one_class_per_lens_model() {
        let window = |text: &str| seen_as(&text.parse().expect("valid"));
        let one = window("SIMPLE_PINHOLE,640,480,525.5,320,240");
        for other in [
            "SIMPLE_PINHOLE,640,480,525.5,320,243",
            "SIMPLE_PINHOLE,640,480,525.5,318,240",
            "SIMPLE_PINHOLE,640,480,520.2,320,240",
            "SIMPLE_PINHOLE,640,480,531.0,326,235",
            "SIMPLE_RADIAL,640,480,525.5,320,240,-0.01",
        ] {
            assert_eq!(window(other), one, "{other}");
        }
        assert_ne!(window("SIMPLE_PINHOLE,640,480,600,320,240"), one);
    }

    #[test]
    fn invalid_cameras_are_rejected() {
        let of = |text: &str| CanonicalCamera::for_intrinsics(&text.parse().expect("valid"));
        assert!(matches!(of("SIMPLE_PINHOLE,640,480,1,320,240"), Err(QueryError::Focal { .. })));
        assert!(matches!(of("SIMPLE_PINHOLE,640,480,1e9,320,240"), Err(QueryError::Focal { .. })));
        assert!(matches!(of("SIMPLE_PINHOLE,640,480,500,99999,240"), Err(QueryError::OpticalAxis)));
        assert!(matches!(of("SIMPLE_PINHOLE,640,480,500,320,-3"), Err(QueryError::OpticalAxis)));
        assert!(matches!(
            of("SIMPLE_PINHOLE,40000,30000,30000,20000,15000"),
            Err(QueryError::ImageSize { .. })
        ));
        assert!(CanonicalCamera::from_codes(15, 1, 1).is_err());
        assert!(CanonicalCamera::from_codes(30, 0, 1).is_err());
        assert!(CanonicalCamera::from_codes(30, 1, 257).is_err());
    }
}
