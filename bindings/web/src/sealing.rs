//! From a canvas's pixels to a sealed query, with the roads of the library and nothing of its own.

use std::collections::BTreeMap;
use std::path::Path;
use std::rc::Rc;

use rand_chacha::ChaCha20Rng;
use serde::Serialize;
use veiloc_features::{Features, GrayImage, Image, guessed_camera_of};
use veiloc_geometry::{Intrinsics, IntrinsicsError, Pixel};
use veiloc_obfuscation::{Orientation, SealOptions, Session, extract_loaded, seal as seal_features};
use veiloc_protocol::{AngleBits, FocalKnowledge, Profile, QueryError, SealedQuery, SizeClass};

use crate::error::WebError;
use crate::message;
use crate::request::Seal;

/// What messages call an image that has no file.
const NAME: &str = "the image";

/// A sealed query and what it hides: for steps, and for the device's own screen.
pub struct Kept {
    pub(crate) query: SealedQuery,
    profile: Rc<Profile>,
    /// Where keypoints were found, pixels of the image that was given.
    pub(crate) found: Vec<[f64; 2]>,
    /// Of each row the keypoint in the camera of the query; `None` for a decoy.
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
    /// Width, height and focal length of the camera it is told in, pixels.
    camera: [f64; 3],
    focal: &'static str,
    /// Rows of each step that could fix a pose.
    steps: Vec<usize>,
    /// Why it could not fix a pose, and must not be sent.
    lopsided: Option<String>,
    frames: Option<u32>,
    starts: Option<u32>,
}

#[derive(Serialize)]
struct StepReply {
    rows: usize,
}

/// Seals an image of red, green, blue and alpha bytes.
///
/// # Errors
/// [`WebError`]; the session has not changed then.
pub fn seal(
    asked: &Seal,
    pixels: &[u8],
    profile: Rc<Profile>,
    session: Option<&mut Session>,
    rng: &mut ChaCha20Rng,
) -> Result<Kept, WebError> {
    let image = Image::from(GrayImage::from_rgba8(asked.width, asked.height, pixels)?);
    let (camera, focal) = camera(asked)?;
    let options = options(asked)?.with_focal(focal);
    let (features, camera) = extract_loaded(image, Path::new(NAME), &camera, &profile, &options)?;
    let scale = [
        f64::from(asked.width) / f64::from(camera.width),
        f64::from(asked.height) / f64::from(camera.height),
    ];
    let found = features.keypoints.iter().map(|k| [k.pixel.u * scale[0], k.pixel.v * scale[1]]).collect();
    let known = features.clone();
    let mut told = None;
    let query = match session {
        Some(session) => {
            let held = held(asked)?;
            let query = session.seal(features, &camera, &profile, &options, &held, rng)?;
            told = Some((session.frames(), session.starts()));
            query
        }
        None => seal_features(features, &camera, &profile, &options, rng)?,
    };
    let truth = truth(&query, known, &camera);
    Ok(Kept { query, profile, found, truth, session: told })
}

impl Kept {
    pub(crate) fn reply(&self, handle: u32) -> Vec<u8> {
        let camera = self.query.camera();
        let can_fix = |class: &SizeClass| {
            let part = self.query.first_rows(*class, &self.profile);
            part.is_ok_and(|part| part.check_sides().is_ok())
        };
        let reply = SealReply {
            query: handle,
            rows: self.query.len(),
            keypoints: self.found.len(),
            scheme: self.query.scheme().to_string(),
            camera: [f64::from(camera.width), f64::from(camera.height), camera.mean_focal()],
            focal: self.query.focal_known().name(),
            steps: self.query.step_sizes().filter(can_fix).map(SizeClass::rows).collect(),
            lopsided: self.query.check_sides().err().map(|lopsided| lopsided.to_string()),
            frames: self.session.map(|session| session.0),
            starts: self.session.map(|session| session.1),
        };
        message::write(&reply, &self.query.encode())
    }

    /// Its first rows, as bytes to send.
    ///
    /// # Errors
    /// [`WebError::Option`] for a number of rows that is no step; [`WebError::Query`] for more than it has.
    pub fn step(&self, rows: usize) -> Result<Vec<u8>, WebError> {
        let class = SizeClass::from_rows(rows)
            .ok_or_else(|| WebError::Option { name: "rows", reason: format!("{rows} rows are no step") })?;
        let part = self.query.first_rows(class, &self.profile)?;
        Ok(message::write(&StepReply { rows: part.len() }, &part.encode()))
    }
}

fn camera(asked: &Seal) -> Result<(Intrinsics, FocalKnowledge), WebError> {
    let Some(text) = &asked.camera else {
        let camera = guessed_camera_of(Path::new(NAME), (asked.width, asked.height))?;
        return Ok((camera, FocalKnowledge::Unknown));
    };
    let wrong = |e: IntrinsicsError| WebError::Camera { text: text.clone(), reason: e.to_string() };
    Ok((text.parse().map_err(wrong)?, FocalKnowledge::Calibrated))
}

fn options(asked: &Seal) -> Result<SealOptions, WebError> {
    let wrong = |name, reason: String| WebError::Option { name, reason };
    let mut options = match &asked.scheme {
        Some(scheme) => {
            SealOptions::new(scheme.parse().map_err(|e: QueryError| wrong("scheme", e.to_string()))?)?
        }
        None => SealOptions::default(),
    };
    if let Some(bits) = asked.angle_bits {
        options =
            options.with_angle_bits(AngleBits::new(bits).map_err(|e| wrong("angleBits", e.to_string()))?);
    }
    if let Some(most) = asked.max_keypoints {
        options = options.with_max_keypoints(most);
    }
    Ok(options)
}

fn held(asked: &Seal) -> Result<Orientation, WebError> {
    let wrong = |name| WebError::Option { name, reason: "it is no direction".to_owned() };
    let held = match asked.orientation {
        Some(quaternion) => Orientation::from_quaternion(quaternion).ok_or_else(|| wrong("orientation"))?,
        None => Orientation::unknown(),
    };
    match asked.down {
        Some(down) => held.with_down(down).ok_or_else(|| wrong("down")),
        None => Ok(held),
    }
}

/// Where the keypoint of each row is. Descriptors leave as they are, so they tell the device which row is whose: what a program
/// for devices is built without (`ground-truth`) is not needed for it.
fn truth(query: &SealedQuery, known: Features, camera: &Intrinsics) -> Vec<Option<Pixel>> {
    let descriptors = known.descriptors.settled();
    let mut places: BTreeMap<&[u8], Pixel> = BTreeMap::new();
    let pinhole = query.camera();
    for (i, keypoint) in known.keypoints.iter().enumerate() {
        if let Some(point) = camera.unproject(keypoint.pixel) {
            places.entry(descriptors.row(i)).or_insert_with(|| pinhole.project(point));
        }
    }
    let rows = query.descriptors();
    (0..query.len()).map(|row| places.get(rows.row(row)).copied()).collect()
}
