//! Cameras and frames.

use std::ffi::c_char;

use veiloc_ar::{CameraFrame, FrameMask, MaskKind, PixelFormat, QuarterTurns};
use veiloc_features::{Mask, guessed_camera_of};
use veiloc_geometry::Intrinsics;
use veiloc_obfuscation::{KnownCamera, SealError};
use veiloc_protocol::FocalKnowledge;

use crate::pointers;
use crate::status::{Failure, VeilocStatus, guarded};

/// Bytes of a pixel.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VeilocPixelFormat {
    /// One byte: gray, or the first plane of YUV 420 (the other planes are not needed).
    Gray = 0,
    /// Red, green, blue, ignored.
    Rgba = 1,
    /// Blue, green, red, ignored.
    Bgra = 2,
}

/// How well the focal length is known.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VeilocFocal {
    /// Calibrated: what ARKit and ARCore give.
    Calibrated = 0,
    /// From the EXIF data of an image.
    Exif = 1,
    /// A guess.
    Unknown = 2,
}

/// Which values of a mask hide a pixel.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VeilocMaskKind {
    /// All but 0: ARKit's `segmentationBuffer`, the categories of MediaPipe's multiclass segmenter.
    Marked = 0,
    /// 51 and more: a confidence, 255 for certain.
    Confidence = 1,
    /// Person (10) and vehicle (9) of ARCore's scene semantics.
    ArcoreSemantics = 2,
    /// Below 128: black hides, as in mask files of COLMAP.
    DarkHides = 3,
}

/// Pixels of a frame of which nothing is sent: a byte for each, of any resolution. It shows the same as the frame, before the frame is
/// turned. A mask that hides nothing is none; one that hides all is refused.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct VeilocMask {
    /// The first byte of the first row.
    pub bytes: *const u8,
    /// How many bytes may be read.
    pub length: usize,
    /// A `VeilocMaskKind`.
    pub kind: u32,
    /// Pixels of a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Bytes from one row to the next; 0 when rows follow each other without a gap.
    pub row_stride: usize,
    /// How far beyond what is marked is hidden, too, as a share of the mask's longer side; 0 for 0.02.
    pub margin: f32,
}

/// A frame of the camera: bytes that stay where the camera wrote them.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct VeilocFrame {
    /// The first byte of the first row.
    pub bytes: *const u8,
    /// How many bytes may be read.
    pub length: usize,
    /// A `VeilocPixelFormat`.
    pub format: u32,
    /// Pixels of a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Bytes from one row to the next; 0 when rows follow each other without a gap.
    pub row_stride: usize,
    /// Clockwise degrees that turn the frame upright, a multiple of 90. Poses are those of the turned camera: 0 for
    /// the poses of ARKit and of ARCore's `Camera.getPose()`, the rotation of the display for AR Foundation and
    /// `getDisplayOrientedPose()`.
    pub turn_degrees: i32,
    /// People and what else must not be sent; null for none.
    pub mask: *const VeilocMask,
}

/// A camera of COLMAP's models. The size is that of the frame as the sensor gives it, before it is turned.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct VeilocCamera {
    /// Name of the model, for example `PINHOLE` (fx, fy, cx, cy), `OPENCV` (and k1, k2, p1, p2).
    pub model: *const c_char,
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Parameters in COLMAP's order, pixels; the centre of the first pixel is at (0.5, 0.5).
    pub params: [f64; 16],
    /// How many of them the model has.
    pub param_count: u32,
    /// A `VeilocFocal`.
    pub focal: u32,
}

/// A calibrated camera without distortion, from the numbers of ARKit's and ARCore's intrinsics. Focal lengths and
/// principal point in pixels of the frame.
#[unsafe(no_mangle)]
pub extern "C" fn veiloc_camera_pinhole(
    width: u32,
    height: u32,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
) -> VeilocCamera {
    let mut params = [0.0; 16];
    params[..4].copy_from_slice(&[fx, fy, cx, cy]);
    let model = c"PINHOLE".as_ptr();
    VeilocCamera { model, width, height, params, param_count: 4, focal: VeilocFocal::Calibrated as u32 }
}

/// The camera of a part of the image, `width` x `height` pixels with its first pixel at column `x`, row `y`: for
/// passthrough cameras of headsets, whose smaller images are parts of the sensor's. `out` may be `camera`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn veiloc_camera_cropped(
    camera: *const VeilocCamera,
    x: u32,
    y: u32,
    width: u32,
    height: u32,
    out: *mut VeilocCamera,
) -> VeilocStatus {
    guarded(|| {
        // SAFETY: the contract of the crate.
        let whole = *unsafe { pointers::reference(camera, "camera") }?;
        // SAFETY: as above.
        let known = unsafe { whole.known() }?;
        let part = known.intrinsics.cropped(x, y, width, height);
        let part = part.map_err(|e| Failure::new(VeilocStatus::Argument, e))?;
        let mut cropped = VeilocCamera { width, height, ..whole };
        cropped.params[..part.model.params().len()].copy_from_slice(part.model.params());
        // SAFETY: as above.
        unsafe { pointers::give(out, cropped, "out") }
    })
}

impl VeilocFrame {
    /// What its mask hides.
    ///
    /// # Safety
    /// `mask` is null or valid, and its bytes are valid for reads of `length` bytes during the call.
    pub(crate) unsafe fn hidden(&self) -> Result<Option<Mask>, Failure> {
        // SAFETY: the caller guarantees it.
        let Some(mask) = (unsafe { pointers::optional(self.mask) }) else { return Ok(None) };
        // SAFETY: as above.
        let bytes = unsafe { pointers::slice(mask.bytes, mask.length, "frame.mask.bytes") }?;
        let kind = MaskKind::ALL.get(mask.kind as usize).copied();
        let kind = kind
            .ok_or_else(|| Failure::new(VeilocStatus::Argument, format!("no kind of mask {}", mask.kind)))?;
        let margin = if mask.margin == 0.0 { FrameMask::MARGIN } else { mask.margin };
        let (size, row_stride) = ((mask.width, mask.height), mask.row_stride);
        let mask = FrameMask { kind, size, bytes, row_stride, margin };
        Ok(mask.of_frame((self.width, self.height)).map_err(SealError::from)?)
    }

    /// The frame of the caller.
    ///
    /// # Safety
    /// `bytes` is null or valid for reads of `length` bytes during the call.
    pub(crate) unsafe fn frame<'a>(&self) -> Result<CameraFrame<'a>, Failure> {
        // SAFETY: the caller guarantees it.
        let bytes = unsafe { pointers::slice(self.bytes, self.length, "frame.bytes") }?;
        let format = match self.format {
            0 => PixelFormat::Gray,
            1 => PixelFormat::Rgba,
            2 => PixelFormat::Bgra,
            other => {
                return Err(Failure::new(VeilocStatus::Argument, format!("no pixel format {other}")));
            }
        };
        let turns = QuarterTurns::from_degrees(self.turn_degrees).ok_or_else(|| {
            Failure::new(
                VeilocStatus::Argument,
                format!("frame.turn_degrees is {}, no multiple of 90", self.turn_degrees),
            )
        })?;
        let frame = CameraFrame::new(format, (self.width, self.height), bytes, self.row_stride);
        Ok(frame.map_err(SealError::from)?.turned(turns))
    }
}

/// The camera of a frame; for null, one with a guessed focal length.
///
/// # Safety
/// `camera` is null or valid, and so is its model's name.
pub(crate) unsafe fn camera(
    camera: *const VeilocCamera,
    frame: &VeilocFrame,
) -> Result<KnownCamera, Failure> {
    // SAFETY: the caller guarantees it.
    let Some(camera) = (unsafe { pointers::optional(camera) }) else {
        let guess = guessed_camera_of("the frame".as_ref(), (frame.width, frame.height));
        let intrinsics = guess.map_err(SealError::from)?;
        return Ok(KnownCamera { intrinsics, focal: FocalKnowledge::Unknown });
    };
    // SAFETY: as above.
    unsafe { camera.known() }
}

impl VeilocCamera {
    /// # Safety
    /// The model's name is null or valid.
    unsafe fn known(&self) -> Result<KnownCamera, Failure> {
        let argument = |text: String| Failure::new(VeilocStatus::Argument, text);
        // SAFETY: the caller guarantees it.
        let model = unsafe { pointers::text(self.model, "camera.model") }?;
        let model = model.ok_or_else(|| argument("camera.model is null".to_owned()))?;
        let params = self.params.get(..self.param_count as usize);
        let params = params.ok_or_else(|| argument("camera.param_count is above 16".to_owned()))?;
        let intrinsics = Intrinsics::new(model, self.width, self.height, params)
            .map_err(|e| Failure::new(VeilocStatus::Image, e))?;
        let focal = match self.focal {
            0 => FocalKnowledge::Calibrated,
            1 => FocalKnowledge::Exif,
            2 => FocalKnowledge::Unknown,
            other => return Err(argument(format!("camera.focal is {other}"))),
        };
        Ok(KnownCamera { intrinsics, focal })
    }
}
