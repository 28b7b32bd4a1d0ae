//! A rendered room with its map, and frames of a phone in it with the poses of an AR framework: a fixture, made once.

use std::path::{Path, PathBuf};

use veiloc_ar::{ArWorld, CameraFrame, CameraFromAr, PixelFormat};
use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::{Matrix3, Rotation3, Vector3};
use veiloc_geometry::{CameraFromWorld, Intrinsics, Rigid3};
use veiloc_map::{GravityDirection, MapFile, PosedImage, PosedImages};
use veiloc_mapping::{BuildOptions, Input, build};
use veiloc_obfuscation::KnownCamera;
use veiloc_synthetic::{PathOptions, RenderOptions, RenderedRoom};

/// Times of the frames, hundredths of a second.
const TIMES: [u32; 5] = [0, 10, 20, 40, 80];
/// Seeds of the noise of three frames at the first time.
const SEEDS: [u64; 3] = [0, 1, 2];

pub(crate) struct Room {
    folder: PathBuf,
    pub(crate) map: MapFile,
    /// Where the AR world is: its `y` is up, as the map's `z`.
    pub(crate) ar_from_map: Rigid3<ArWorld, World>,
}

/// A frame, as the phone gives it.
pub(crate) struct Frame {
    pub(crate) pixels: Vec<u8>,
    pub(crate) cam_from_map: CameraFromWorld,
    pub(crate) cam_from_ar: CameraFromAr,
}

pub(crate) fn known() -> KnownCamera {
    KnownCamera::calibrated(camera())
}

pub(crate) fn room() -> Room {
    let folder = veiloc_testing::fixture("burst-room", &[], make);
    let up = Rotation3::from_matrix_unchecked(Matrix3::new(
        1.0, 0.0, 0.0, //
        0.0, 0.0, 1.0, //
        0.0, -1.0, 0.0,
    ));
    let turn = Rotation3::from_scaled_axis(Vector3::y() * 0.7) * up;
    let map = MapFile::open(&folder.join("room.vmap")).expect("a map");
    Room { folder, map, ar_from_map: Rigid3::new(turn, Vector3::new(2.0, -1.0, 3.5)) }
}

impl Room {
    /// What a hand-held phone sees after one of [`TIMES`]: it moves by 5 cm and turns by 3 degrees a second.
    pub(crate) fn frame(&self, seconds: f64) -> Frame {
        self.read((100.0 * seconds).round() as u32, 0)
    }

    /// What a phone that rests sees, with noise of one of [`SEEDS`].
    pub(crate) fn frame_at_rest(&self, seed: u64) -> Frame {
        self.read(0, seed)
    }

    fn read(&self, time: u32, seed: u64) -> Frame {
        let [pixels, pose] =
            files(&self.folder, time, seed).map(|file| std::fs::read(file).expect("a frame"));
        let numbers: Vec<f64> = String::from_utf8(pose)
            .expect("text")
            .split(' ')
            .map(|word| word.parse().expect("a number"))
            .collect();
        let [w, x, y, z, tx, ty, tz] = *numbers.as_slice() else { panic!("a pose") };
        let cam_from_map = CameraFromWorld::from_quaternion([w, x, y, z], [tx, ty, tz]).expect("a pose");
        let cam_from_ar = cam_from_map.compose(&self.ar_from_map.inverse());
        Frame { pixels, cam_from_map, cam_from_ar }
    }
}

impl Frame {
    pub(crate) fn camera_frame(&self) -> CameraFrame<'_> {
        CameraFrame::new(PixelFormat::Gray, (400, 300), &self.pixels, 0).expect("a frame")
    }

    /// The same frame with other pixels.
    pub(crate) fn with_pixels(&self, pixels: Vec<u8>) -> Self {
        Self { pixels, ..*self }
    }
}

fn camera() -> Intrinsics {
    "PINHOLE,400,300,330,330,200,150".parse().expect("a camera")
}

/// Gray bytes and pose of a frame.
fn files(folder: &Path, time: u32, seed: u64) -> [PathBuf; 2] {
    ["gray", "pose"].map(|what| folder.join(format!("{time}-{seed}.{what}")))
}

fn make(folder: &Path) {
    let room = RenderedRoom::generate(11);
    let path = room.camera_path(&PathOptions::with_counts(30, 9));
    let image = |(k, pose): (usize, &CameraFromWorld)| {
        let name = format!("{k}.png");
        let view = room.render(pose, &camera(), &RenderOptions::with_seed(100 + k as u64));
        view.rgb().save(folder.join(&name)).expect("written");
        PosedImage { name, camera: camera(), cam_from_world: *pose, seen: Vec::new() }
    };
    let posed = path.mapping[..10].iter().enumerate().map(image).collect();
    let posed = PosedImages::new(posed, Vec::new()).expect("posed");
    let (mut model, _) = build(&Input::new(&posed, folder), &BuildOptions::default(), &()).expect("a map");
    model.down = Some(GravityDirection::new([0.0, 0.0, -1.0]).expect("a direction"));
    veiloc_map::write(&model, &folder.join("room.vmap")).expect("written");

    let moving = TIMES.map(|time| (time, 0));
    for (time, seed) in moving.into_iter().chain(SEEDS[1..].iter().map(|seed| (0, *seed))) {
        let seconds = f64::from(time) / 100.0;
        let step = [0.0, 0.05, 0.0, 0.04, 0.02, -0.02].map(|a_second| a_second * seconds);
        let pose = path.queries[1].perturbed(&step);
        let view = room.render(&pose, &camera(), &RenderOptions::with_seed(u64::from(time) + seed));
        let [w, x, y, z] = pose.quaternion();
        let t = pose.translation();
        let [pixels, text] = files(folder, time, seed);
        std::fs::write(pixels, view.gray().as_raw()).expect("written");
        std::fs::write(text, format!("{w} {x} {y} {z} {} {} {}", t.x, t.y, t.z)).expect("written");
    }
}
