//! The frames of the device before sealing: the trajectory of the queries, and frames of a stationary camera.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_datasets::problem_files::seed_for;
use veiloc_features::{Features, GrayImage, Image, Progress, load_gray};
use veiloc_geometry::{CameraFromWorld, Intrinsics, Pixel};
use veiloc_map::MapFile;
use veiloc_obfuscation::audit::options_for;
use veiloc_obfuscation::{KnownPlace, PackUse, SealError, Sealer};
use veiloc_protocol::Scheme;
use veiloc_synthetic::problems::normal;

use super::super::private_region::person;
use super::super::spread::spread;
use super::{Motion, SESSION_SENSOR, SessionsEvaluation};
use crate::pipeline::{PosedQuery, SceneMap, SimulatedGravity};
use crate::{EvalError, sequence_of};

/// A frame as the device has it.
#[derive(Clone)]
pub(super) struct DeviceFrame {
    pub(super) name: String,
    /// Index of its query.
    pub(super) query: usize,
    pub(super) features: Features,
    pub(super) camera: Intrinsics,
    /// Its true pose.
    pub(super) cam_from_world: CameraFromWorld,
    /// `[N]` of the features: whether they belong to the private region, whether or not they are sent.
    pub(super) private: Vec<bool>,
}

/// The map, and the frames that sessions seal.
pub(super) struct Recording<'a> {
    pub(super) evaluation: &'a SessionsEvaluation,
    pub(super) map: SceneMap,
    pub(super) gravity: SimulatedGravity,
    pub(super) queries: Vec<PosedQuery>,
    /// One frame per query.
    pub(super) trajectory: Vec<DeviceFrame>,
    /// Indices of the attacked queries.
    pub(super) attacked: Vec<usize>,
    /// The pack of the map that devices have, and what they send with it.
    pub(super) place: Option<(KnownPlace, PackUse)>,
    /// For each attacked query the frames of a stationary camera; empty if no attack combines them.
    pub(super) static_frames: Vec<Vec<DeviceFrame>>,
}

impl<'a> Recording<'a> {
    /// Builds the map and extracts all frames.
    pub(super) fn new(
        evaluation: &'a SessionsEvaluation,
        progress: &dyn Progress,
    ) -> Result<Self, EvalError> {
        let scene = &evaluation.scene;
        let queries = scene.queries()?;
        let attacked = attacked(evaluation, &poses_of(&queries))?;
        let gravity = SimulatedGravity::of(&scene.posed, &scene.map_list, SESSION_SENSOR)?;
        let input = scene.map_input(&scene.map_list);
        let map = SceneMap::build(&input, &scene.build, true, scene.keep_map.as_deref(), None, progress)?;
        let place = |usage| Ok((KnownPlace::new(map.file.pack()?.0)?, usage));
        let place = evaluation.pack.map(place).transpose().map_err(|e: SealError| e)?;
        let (trajectory, static_frames) = (Vec::new(), Vec::new());
        let mut recording =
            Self { evaluation, map, gravity, queries, trajectory, attacked, place, static_frames };
        progress.start("Extracting queries", recording.queries.len());
        for query in 0..recording.queries.len() {
            recording.trajectory.push(recording.own_frame(query)?);
            progress.advance(1);
        }
        progress.finish();
        if evaluation.motions.contains(&Motion::Static) {
            progress.start("Extracting frames of a stationary camera", recording.attacked.len());
            for &query in &recording.attacked {
                recording.static_frames.push(recording.stationary_frames(query)?);
                progress.advance(1);
            }
            progress.finish();
        }
        Ok(recording)
    }

    /// The frame of a query's own image.
    fn own_frame(&self, query: usize) -> Result<DeviceFrame, EvalError> {
        let (name, path) = (&self.queries[query].name, &self.queries[query].path);
        let mut frame = self.extracted(query, name, load_gray(path)?)?;
        let pixels: Vec<Pixel> = frame.features.keypoints.iter().map(|k| k.pixel).collect();
        frame.private = person(&pixels, self.evaluation.private, self.evaluation.scene.seed, name);
        Ok(frame)
    }

    /// Frames of a stationary camera: the image itself, and copies with new sensor noise.
    fn stationary_frames(&self, query: usize) -> Result<Vec<DeviceFrame>, EvalError> {
        let image = load_gray(&self.queries[query].path)?;
        let again = (1..self.evaluation.longest()).map(|k| {
            let name = format!("{} again {k}", self.queries[query].name);
            let mut rng = ChaCha8Rng::seed_from_u64(seed_for(self.evaluation.scene.seed, &[&name, "sensor"]));
            self.extracted(query, &name, with_noise(&image, self.evaluation.sensor_noise, &mut rng))
        });
        std::iter::once(Ok(self.trajectory[query].clone())).chain(again).collect()
    }

    fn extracted(&self, query: usize, name: &str, image: GrayImage) -> Result<DeviceFrame, EvalError> {
        let PosedQuery { path, camera, cam_from_world, .. } = &self.queries[query];
        let sealer = Sealer::new(self.map_file().profile(), options_for(Scheme::default()))?;
        let extracted = sealer.extract(Image::from(image).named(path), *camera)?;
        let (features, camera) = (extracted.features().clone(), extracted.camera().intrinsics);
        let (name, cam_from_world) = (name.to_owned(), *cam_from_world);
        Ok(DeviceFrame { name, query, features, camera, cam_from_world, private: Vec::new() })
    }

    /// The map as a server opens it.
    pub(super) fn map_file(&self) -> &MapFile {
        &self.map.file
    }

    /// Frames that an attack on a frame of the trajectory combines with it, in the order of their use.
    pub(super) fn others(&self, own: usize, motion: Motion) -> Vec<usize> {
        let mut frames: Vec<usize> = match motion {
            Motion::Walking => {
                let (longest, poses) = (self.evaluation.longest(), poses_of(&self.queries));
                let before = sequence_of(&poses, own, longest, self.evaluation.max_distance);
                // The nearest first.
                before.unwrap_or_default().into_iter().rev().collect()
            }
            Motion::Turning | Motion::Visiting | Motion::Static => (0..self.queries.len()).collect(),
        };
        frames.retain(|frame| *frame != own);
        frames
    }
}

fn poses_of(queries: &[PosedQuery]) -> Vec<CameraFromWorld> {
    queries.iter().map(|query| query.cam_from_world).collect()
}

/// The same image with new sensor noise, gray levels of 255.
fn with_noise(image: &GrayImage, noise: f64, rng: &mut impl Rng) -> GrayImage {
    let one = |v: &f32| (f64::from(*v) * 255.0 + noise * normal(rng)).round().clamp(0.0, 255.0) as u8;
    let bytes: Vec<u8> = image.data().iter().map(one).collect();
    GrayImage::from_luma8(image.width(), image.height(), &bytes).expect("as many samples as before")
}

/// The attacked images: those with enough frames.
fn attacked(evaluation: &SessionsEvaluation, poses: &[CameraFromWorld]) -> Result<Vec<usize>, EvalError> {
    let longest = evaluation.longest();
    let has_enough = |i: &usize| {
        evaluation.motions.iter().all(|motion| match motion {
            Motion::Static => true,
            Motion::Turning | Motion::Visiting => poses.len() >= longest,
            Motion::Walking => sequence_of(poses, *i, longest, evaluation.max_distance).is_some(),
        })
    };
    let able: Vec<usize> = (0..poses.len()).filter(has_enough).collect();
    if able.is_empty() {
        return Err(EvalError::DataSet(format!(
            "no query has {longest} frames: the list has {} images, and those within {} map units of the next are a trajectory; \
             use fewer frames, a longer --max-distance, or only --motion static",
            poses.len(),
            evaluation.max_distance
        )));
    }
    let count = evaluation.attacked.map(|n| n.max(1));
    Ok(spread(able.len(), count).into_iter().map(|k| able[k]).collect())
}
