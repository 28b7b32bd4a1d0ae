//! Seals the pixels of a canvas with the library's functions.

use std::collections::BTreeMap;
use std::path::Path;
use std::rc::Rc;

use rand_chacha::ChaCha20Rng;
use serde::Serialize;
use veiloc_features::{
    ColourImage, Features, FrameMask, GrayImage, Image, Mask, MaskKind, PersonSegmenter, exif_camera_of,
    exif_turns_of, guessed_camera_of,
};
use veiloc_geometry::{Intrinsics, IntrinsicsError, Pixel, QuarterTurns};
use veiloc_obfuscation::{
    DeviceLimits, Extracted, KnownCamera, KnownPlace, Orientation, PackUse, SealError, SealOptions, Sealer,
    Session,
};
use veiloc_protocol::{
    AngleBits, CoarseGravity, FocalKnowledge, Pack, Profile, QueryError, SealedQuery, SizeClass,
};

use crate::error::WebError;
use crate::message;
use crate::request;

/// Name of the image in messages, as it has no file.
const NAME: &str = "the image";

/// The features of an image, until they are sealed.
pub struct StoredFeatures {
    extracted: Extracted,
    /// Keypoints, pixels of the original image.
    found: Vec<[f64; 2]>,
    /// Share of the image that is hidden.
    hidden: f64,
}

/// A sealed query and the keypoints it hides, for later steps and for the device's own screen.
pub struct StoredQuery {
    pub(crate) query: SealedQuery,
    sealer: Rc<Sealer>,
    /// Keypoints that were found, pixels of the original image.
    pub(crate) found: Vec<[f64; 2]>,
    /// Keypoint of each row in the camera of the query; `None` for a decoy.
    pub(crate) truth: Vec<Option<Pixel>>,
    /// Frames and starts of the session.
    session: Option<(u32, u32)>,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct SealReply {
    query: u32,
    rows: usize,
    keypoints: usize,
    scheme: String,
    /// Width, height and focal length of the query's camera, pixels.
    camera: [f64; 3],
    focal: &'static str,
    /// Rows of each step that can determine a pose.
    steps: Vec<usize>,
    /// Why the query cannot determine a pose, and so must not be sent.
    unbalanced: Option<String>,
    frames: Option<u32>,
    starts: Option<u32>,
}

#[derive(Serialize)]
struct ExifReply {
    /// As a COLMAP camera; `None` when EXIF gives no focal length.
    camera: Option<String>,
    /// Whether there is one: head of a call to `Seal`.
    exif: bool,
    /// Degrees clockwise by which it is turned for display.
    turn: u16,
}

#[derive(Serialize)]
struct ExtractReply {
    extracted: u32,
    keypoints: usize,
    hidden: f64,
}

#[derive(Serialize)]
struct StepReply {
    rows: usize,
}

/// The reply to `Exif`: the camera of an image file whose decoded image has this size.
pub fn exif(file: &[u8], size: (u32, u32)) -> Vec<u8> {
    let camera = exif_camera_of(Path::new(NAME), file, size).ok().map(|camera| camera.to_string());
    let turn = exif_turns_of(file).degrees();
    message::write(&ExifReply { exif: camera.is_some(), camera, turn }, &[])
}

/// A device that seals for a map. `pack`: its bytes, read where the request says that there is one.
///
/// # Errors
/// [`WebError`].
pub fn sealer(request: &request::Sealer, pack: &[u8], profile: &Profile) -> Result<Sealer, WebError> {
    let send = request.send.as_deref().map(str::parse::<PackUse>).transpose();
    let wrong = |reason: String| WebError::Option { name: "send", reason };
    let send = send.map_err(|e| wrong(e.to_string()))?;
    let options = match (request.pack, send) {
        (true, send) => {
            let place = KnownPlace::new(Pack::decode(pack).map_err(WebError::Pack)?)?;
            options(request)?.with_place(place, send.unwrap_or_default())
        }
        (false, Some(_)) => return Err(wrong("it says what is sent with a pack; give the pack".to_owned())),
        (false, None) => options(request)?,
    };
    Ok(Sealer::new(profile, options)?)
}

/// What the mask of a request hides of the image.
fn hidden(request: &request::Extract, bytes: &[u8]) -> Result<Option<Mask>, WebError> {
    let Some(request::Mask { width, height, kind, margin }) = &request.mask else { return Ok(None) };
    let kind = kind
        .parse::<MaskKind>()
        .map_err(|e| WebError::Option { name: "mask.kind", reason: e.to_string() })?;
    let (size, margin) = ((*width, *height), margin.unwrap_or(FrameMask::MARGIN));
    let mask = FrameMask { kind, size, bytes, row_stride: 0, margin };
    Ok(mask.of_frame((request.width, request.height))?)
}

/// The people of an image of red, green, blue and alpha bytes.
fn people(
    request: &request::Extract,
    pixels: &[u8],
    segmenter: &PersonSegmenter,
) -> Result<Option<Mask>, WebError> {
    let wrong = || WebError::Option { name: "turn", reason: "must be a multiple of 90".to_owned() };
    let turns = QuarterTurns::from_degrees(request.turn).ok_or_else(wrong)?;
    let colours = pixels.chunks_exact(4).flat_map(|pixel| pixel[..3].iter().copied());
    let image = ColourImage::new(request.width, request.height, colours.collect())?;
    Ok(segmenter.mask(&image, turns, FrameMask::MARGIN)?)
}

/// Extracts the features of an image of red, green, blue and alpha bytes.
///
/// # Errors
/// [`WebError`].
pub fn extract(
    request: &request::Extract,
    pixels: &[u8],
    sealer: &Sealer,
    segmenter: Option<&PersonSegmenter>,
) -> Result<StoredFeatures, WebError> {
    let size = (request.width, request.height);
    let length = u64::from(size.0) * u64::from(size.1) * 4;
    let (pixels, mask) = match &request.mask {
        Some(_) => {
            pixels.split_at(usize::try_from(length).map_or(pixels.len(), |length| length.min(pixels.len())))
        }
        None => (pixels, &[][..]),
    };
    let mut image = Image::from(GrayImage::from_rgba8(size.0, size.1, pixels)?);
    let people = segmenter.map(|segmenter| people(request, pixels, segmenter)).transpose()?.flatten();
    let hidden = match (hidden(request, mask)?, people) {
        (Some(mask), Some(people)) => Some(mask.and(&people)?),
        (mask, people) => mask.or(people),
    };
    if let Some(hidden) = &hidden {
        image = image.without(hidden)?;
    }
    let (orientation, gravity) = (orientation(request)?, gravity(request)?);
    let extracted = sealer.extract(image, camera(request)?)?;
    let camera = extracted.camera().intrinsics;
    let scale = [
        f64::from(request.width) / f64::from(camera.width),
        f64::from(request.height) / f64::from(camera.height),
    ];
    let keypoints = &extracted.features().keypoints;
    let found = keypoints.iter().map(|k| [k.pixel.u * scale[0], k.pixel.v * scale[1]]).collect();
    let extracted = extracted.with_orientation(orientation).with_gravity(gravity);
    Ok(StoredFeatures { extracted, found, hidden: hidden.map_or(0.0, |mask| mask.share()) })
}

impl StoredFeatures {
    pub(crate) fn reply(&self, handle: u32) -> Vec<u8> {
        let (keypoints, hidden) = (self.found.len(), self.hidden);
        message::write(&ExtractReply { extracted: handle, keypoints, hidden }, &[])
    }

    /// Seals them.
    ///
    /// # Errors
    /// [`SealError`]; the session has not changed then.
    pub fn seal(
        self,
        sealer: Rc<Sealer>,
        session: Option<&mut Session>,
        rng: &mut ChaCha20Rng,
    ) -> Result<StoredQuery, SealError> {
        let Self { extracted, found, .. } = self;
        let (known, camera) = (extracted.features().clone(), extracted.camera().intrinsics);
        let (query, session) = match session {
            Some(session) => {
                let query = sealer.in_session(session).seal(extracted, rng)?;
                (query, Some((session.frames(), session.starts())))
            }
            None => (sealer.seal(extracted, rng)?, None),
        };
        let truth = keypoints_of_rows(&query, known, &camera);
        Ok(StoredQuery { query, sealer, found, truth, session })
    }
}

impl StoredQuery {
    pub(crate) fn reply(&self, handle: u32) -> Vec<u8> {
        let camera = self.query.camera();
        let reply = SealReply {
            query: handle,
            rows: self.query.len(),
            keypoints: self.found.len(),
            scheme: self.query.scheme().to_string(),
            camera: [f64::from(camera.width), f64::from(camera.height), camera.mean_focal()],
            focal: self.query.focal_known().name(),
            steps: self.query.useful_steps(self.sealer.profile()).map(SizeClass::rows).collect(),
            unbalanced: self.query.check_sides().err().map(|unbalanced| unbalanced.to_string()),
            frames: self.session.map(|session| session.0),
            starts: self.session.map(|session| session.1),
        };
        message::write(&reply, &self.query.encode())
    }

    /// The first rows of the query, as bytes to send.
    ///
    /// # Errors
    /// [`WebError::Option`] when `rows` is not a step; [`WebError::Query`] when the query has fewer rows.
    pub fn step(&self, rows: usize) -> Result<Vec<u8>, WebError> {
        let class = SizeClass::from_rows(rows).ok_or_else(|| WebError::Option {
            name: "rows",
            reason: format!("{rows} is not a step; use one of the query's steps"),
        })?;
        let part = self.query.first_rows(class, self.sealer.profile())?;
        Ok(message::write(&StepReply { rows: part.len() }, &part.encode()))
    }
}

fn camera(request: &request::Extract) -> Result<KnownCamera, WebError> {
    let Some(text) = &request.camera else {
        let intrinsics = guessed_camera_of(Path::new(NAME), (request.width, request.height))?;
        return Ok(KnownCamera { intrinsics, focal: FocalKnowledge::Unknown });
    };
    let wrong = |e: IntrinsicsError| WebError::Camera { text: text.clone(), reason: e.to_string() };
    let focal = if request.exif { FocalKnowledge::Exif } else { FocalKnowledge::Calibrated };
    Ok(KnownCamera { intrinsics: text.parse().map_err(wrong)?, focal })
}

fn options(request: &request::Sealer) -> Result<SealOptions, WebError> {
    let wrong = |name, reason: String| WebError::Option { name, reason };
    let mut options = match &request.scheme {
        Some(scheme) => {
            SealOptions::new(scheme.parse().map_err(|e: QueryError| wrong("scheme", e.to_string()))?)?
        }
        None => SealOptions::default(),
    };
    if let Some(bits) = request.angle_bits {
        options =
            options.with_angle_bits(AngleBits::new(bits).map_err(|e| wrong("angleBits", e.to_string()))?);
    }
    if let Some(most) = request.max_keypoints {
        options = options.with_max_keypoints(most);
    }
    if let Some(most) = request.max_image_side {
        options = options.with_limits(DeviceLimits { max_image_side: most, ..DeviceLimits::default() });
    }
    Ok(if request.send_gravity == Some(false) { options.without_gravity() } else { options })
}

fn gravity(request: &request::Extract) -> Result<Option<CoarseGravity>, WebError> {
    let sd_deg = request.down_sd_deg.unwrap_or(CoarseGravity::TRACKING_SD_DEG);
    let gravity = request.down.map(|down| CoarseGravity::new(down, sd_deg)).transpose();
    gravity.map_err(|e| WebError::Option { name: "down", reason: e.to_string() })
}

fn orientation(request: &request::Extract) -> Result<Orientation, WebError> {
    let wrong = |name| WebError::Option {
        name,
        reason: "must be a rotation or direction that is not zero".to_owned(),
    };
    let orientation = match request.orientation {
        Some(quaternion) => Orientation::from_quaternion(quaternion).ok_or_else(|| wrong("orientation"))?,
        None => Orientation::unknown(),
    };
    match request.down {
        Some(down) => orientation.with_down(down).ok_or_else(|| wrong("down")),
        None => Ok(orientation),
    }
}

/// The keypoint of each row. The query holds the descriptors unchanged, so they identify the row's keypoint; the
/// feature `ground-truth`, which device programs are built without, is not needed. A match query has no descriptors, so
/// its rows are not known.
fn keypoints_of_rows(query: &SealedQuery, known: Features, camera: &Intrinsics) -> Vec<Option<Pixel>> {
    let descriptors = known.descriptors.as_decoded();
    let mut pixel_of: BTreeMap<&[u8], Pixel> = BTreeMap::new();
    let pinhole = query.camera();
    for (i, keypoint) in known.keypoints.iter().enumerate() {
        if let Some(point) = camera.unproject(keypoint.pixel) {
            pixel_of.entry(descriptors.row(i)).or_insert_with(|| pinhole.project(point));
        }
    }
    let Some(rows) = query.descriptors() else { return vec![None; query.len()] };
    (0..query.len()).map(|row| pixel_of.get(rows.row(row)).copied()).collect()
}
