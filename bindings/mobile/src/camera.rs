//! Cameras and frames.

use veiloc_ar::{CameraFrame, FrameMask, PixelFormat, QuarterTurns};
use veiloc_features::guessed_camera_of;
use veiloc_geometry::Intrinsics;
use veiloc_obfuscation::{KnownCamera, SealError};
use veiloc_protocol::FocalKnowledge;

use crate::error::VeilocException;

/// Bytes of a pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, uniffi::Enum)]
pub enum FrameFormat {
    /// One byte: gray, or the first plane of YUV 420 (the other planes are not needed).
    Gray,
    /// Red, green, blue, ignored.
    Rgba,
    /// Blue, green, red, ignored.
    Bgra,
}

/// How the bytes of a frame are arranged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, uniffi::Record)]
pub struct FrameLayout {
    /// Bytes of a pixel.
    pub format: FrameFormat,
    /// Pixels of a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Bytes from one row to the next; 0 when rows follow each other without a gap.
    #[uniffi(default = 0)]
    pub row_stride: u32,
    /// Clockwise degrees that turn the frame upright, a multiple of 90. Poses are those of the turned camera: 0 for
    /// the poses of ARKit and of ARCore's `Camera.getPose()`, the rotation of the display for
    /// `getDisplayOrientedPose()`.
    #[uniffi(default = 0)]
    pub turn_degrees: i32,
}

/// Which values of a mask hide a pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, uniffi::Enum)]
pub enum MaskKind {
    /// All but 0: ARKit's `segmentationBuffer`, the categories of MediaPipe's multiclass segmenter.
    Marked,
    /// 51 and more: a confidence, 255 for certain.
    Confidence,
    /// Person (10) and vehicle (9) of ARCore's scene semantics.
    ArcoreSemantics,
    /// Below 128: black hides, as in mask files of COLMAP.
    DarkHides,
}

/// Pixels of a frame of which nothing is sent: a byte for each, of any resolution. It shows the same as the frame, before the frame is
/// turned. A mask that hides nothing is none; one that hides all is refused.
#[derive(Clone, PartialEq, uniffi::Record)]
pub struct Mask {
    /// Which values hide.
    pub kind: MaskKind,
    /// Pixels of a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// The rows.
    pub bytes: Vec<u8>,
    /// Bytes from one row to the next; 0 when rows follow each other without a gap.
    #[uniffi(default = 0)]
    pub row_stride: u32,
    /// How far beyond what is marked is hidden, too, as a share of the mask's longer side. Default 0.02.
    #[uniffi(default = None)]
    pub margin: Option<f32>,
}

/// How well the focal length is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, uniffi::Enum)]
pub enum Focal {
    /// Calibrated: what ARKit and ARCore give.
    Calibrated,
    /// From the EXIF data of an image.
    Exif,
    /// A guess.
    Unknown,
}

/// A camera of COLMAP's models. The size is that of the frame as the sensor gives it, before it is turned.
#[derive(Debug, Clone, PartialEq, uniffi::Record)]
pub struct Camera {
    /// Name of the model, for example `PINHOLE` (fx, fy, cx, cy), `OPENCV` (and k1, k2, p1, p2).
    pub model: String,
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Parameters in COLMAP's order, pixels; the centre of the first pixel is at (0.5, 0.5).
    pub params: Vec<f64>,
    /// How well the focal length is known.
    pub focal: Focal,
}

/// A calibrated camera without distortion, from the numbers of ARKit's and ARCore's intrinsics: focal lengths and
/// principal point in pixels of the frame.
#[uniffi::export]
pub fn pinhole_camera(width: u32, height: u32, fx: f64, fy: f64, cx: f64, cy: f64) -> Camera {
    let (model, params) = ("PINHOLE".to_owned(), vec![fx, fy, cx, cy]);
    Camera { model, width, height, params, focal: Focal::Calibrated }
}

/// The camera of a part of the image, `width` × `height` pixels with its first pixel at column `x`, row `y`: for
/// passthrough cameras of headsets, whose smaller images are parts of the sensor's.
///
/// # Errors
/// [`VeilocException::Argument`] when the part is empty or not within the image.
#[uniffi::export]
pub fn cropped_camera(
    camera: Camera,
    x: u32,
    y: u32,
    width: u32,
    height: u32,
) -> Result<Camera, VeilocException> {
    let part = camera.intrinsics()?.cropped(x, y, width, height).map_err(VeilocException::argument)?;
    Ok(Camera { width, height, params: part.model.params().to_vec(), ..camera })
}

impl Camera {
    fn intrinsics(&self) -> Result<Intrinsics, VeilocException> {
        let intrinsics = Intrinsics::new(&self.model, self.width, self.height, &self.params);
        intrinsics.map_err(|e| VeilocException::Image(e.to_string()))
    }
}

impl Mask {
    /// What it hides of a frame.
    pub(crate) fn hidden(
        mask: Option<Self>,
        layout: FrameLayout,
    ) -> Result<Option<veiloc_features::Mask>, VeilocException> {
        let Some(Self { kind, width, height, bytes, row_stride, margin }) = mask else { return Ok(None) };
        let kind = match kind {
            MaskKind::Marked => veiloc_ar::MaskKind::Marked,
            MaskKind::Confidence => veiloc_ar::MaskKind::Confidence,
            MaskKind::ArcoreSemantics => veiloc_ar::MaskKind::ArcoreSemantics,
            MaskKind::DarkHides => veiloc_ar::MaskKind::DarkHides,
        };
        let (size, row_stride, margin) =
            ((width, height), row_stride as usize, margin.unwrap_or(FrameMask::MARGIN));
        let mask = FrameMask { kind, size, bytes: &bytes, row_stride, margin };
        Ok(mask.of_frame((layout.width, layout.height)).map_err(SealError::from)?)
    }
}

impl FrameLayout {
    pub(crate) fn frame(self, bytes: &[u8]) -> Result<CameraFrame<'_>, VeilocException> {
        let format = match self.format {
            FrameFormat::Gray => PixelFormat::Gray,
            FrameFormat::Rgba => PixelFormat::Rgba,
            FrameFormat::Bgra => PixelFormat::Bgra,
        };
        let turns = QuarterTurns::from_degrees(self.turn_degrees).ok_or_else(|| {
            VeilocException::argument(format!("a turn of {} degrees, no multiple of 90", self.turn_degrees))
        })?;
        let frame = CameraFrame::new(format, (self.width, self.height), bytes, self.row_stride as usize);
        Ok(frame.map_err(SealError::from)?.turned(turns))
    }
}

/// The camera of a frame; without one, a guess.
pub(crate) fn known_camera(
    camera: Option<Camera>,
    layout: FrameLayout,
) -> Result<KnownCamera, VeilocException> {
    let Some(camera) = camera else {
        let guess = guessed_camera_of("the frame".as_ref(), (layout.width, layout.height));
        let intrinsics = guess.map_err(SealError::from)?;
        return Ok(KnownCamera { intrinsics, focal: FocalKnowledge::Unknown });
    };
    let intrinsics = camera.intrinsics()?;
    let focal = match camera.focal {
        Focal::Calibrated => FocalKnowledge::Calibrated,
        Focal::Exif => FocalKnowledge::Exif,
        Focal::Unknown => FocalKnowledge::Unknown,
    };
    Ok(KnownCamera { intrinsics, focal })
}
