//! A small scene, rendered once per test program, and the `veiloc` binary to run on it.
#![allow(dead_code, reason = "each test program uses a part")]
#![expect(unreachable_pub, reason = "a module of each test program, not of the crate")]

pub mod documented;

use std::collections::BTreeMap;
use std::fs;
use std::panic::Location;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, SystemTime};

use serde_json::Value;
use veiloc_geometry::{CameraFromWorld, Intrinsics};
use veiloc_map::colmap::{ColmapImage, ColmapModel, write_text};
use veiloc_synthetic::{PathOptions, RenderOptions};
use veiloc_testing::{copy_folder, fixture};

/// A lens with some distortion, so that the pipeline includes undistortion.
pub const CAMERA: &str = "SIMPLE_RADIAL,400,300,330,201,149,-0.04";
/// Map views: a third of the trajectory around the room, so that neighbours overlap.
pub const MAP_VIEWS: usize = 10;
/// Query views, within the same third.
pub const QUERIES: usize = 3;
/// How far the pose of a query may be from the true one (map units). Every seal draws other lines: of 300 seals of each
/// query no trusted pose was further than 0.03 under `dcl` and 0.045 under `random-lines`, in the map or a region of it.
pub const POSITION_TOLERANCE: f64 = 0.05;
/// Few keypoints, to save time.
pub const EXTRACTION: [&str; 4] = ["--max-keypoints", "512", "--query-keypoints", "512"];

/// A folder with an operator's files, and the map that the binary built from them:
///
/// ```text
/// images/          map-00.png …, query-0.png …
/// posed/           COLMAP text model with the poses of all
/// map.txt          list of the map's images
/// queries.txt      list of the others
/// place.vmap       the map
/// place.vprofile   its profile
/// ```
pub struct TestScene {
    pub folder: PathBuf,
    /// True poses of all images.
    pub poses: Vec<(String, CameraFromWorld)>,
}

/// A rendered scene with its map `scene.vmap` and its profile `scene.vprofile`, in a separate folder for each test
/// file, because the tests write into it.
#[track_caller]
pub fn scene() -> &'static TestScene {
    static SCENES: Mutex<BTreeMap<&str, &TestScene>> = Mutex::new(BTreeMap::new());
    let mut scenes = SCENES.lock().unwrap_or_else(PoisonError::into_inner);
    scenes.entry(Location::caller().file()).or_insert_with(|| {
        let whole = fixture("cli-place", &[Path::new(env!("CARGO_BIN_EXE_veiloc"))], |folder| {
            let scene = TestScene::render(folder.to_owned());
            let mut build = "map build --posed posed --images images --list map.txt -o place.vmap".to_owned();
            build.extend(EXTRACTION.map(|word| format!(" {word}")));
            scene.run(&build).succeeded();
            scene.run("map profile place.vmap -o place.vprofile").succeeded();
        });
        let folder = fresh_folder();
        copy_folder(&whole, &folder).expect("copied");
        Box::leak(Box::new(TestScene {
            folder,
            poses: views(&veiloc_synthetic::RenderedRoom::generate(11)).concat(),
        }))
    })
}

/// Views of another room, beside the scene of the tests: `other/images`, `other/posed`, `other/list.txt`.
#[track_caller]
pub fn render_out_of_map_images(count: usize) {
    let folder = &scene().folder;
    let camera: Intrinsics = CAMERA.parse().expect("a camera");
    let other = veiloc_synthetic::RenderedRoom::generate(12);
    let path = other.camera_path(&PathOptions::with_counts(4, count));
    fs::create_dir_all(folder.join("other/images")).expect("folder");
    let mut images = Vec::new();
    for (id, pose) in (1_u32..).zip(&path.queries) {
        let name = format!("negative-{id}.png");
        let view = other.render(pose, &camera, &RenderOptions::with_seed(u64::from(id)));
        view.rgb().save(folder.join("other/images").join(&name)).expect("written");
        images.push(ColmapImage { id, name, camera_id: 1, cam_from_world: *pose, points2d: Vec::new() });
    }
    let names: Vec<String> = images.iter().map(|image| image.name.clone()).collect();
    scene().write("other/list.txt", names.join("\n"));
    let model = ColmapModel::new(vec![(1, camera)], images, Vec::new()).expect("a model");
    write_text(&model, &folder.join("other/posed")).expect("written");
}

/// An empty folder, for commands that need no scene.
pub fn folder() -> TestScene {
    TestScene { folder: fresh_folder(), poses: Vec::new() }
}

/// A static is never dropped, so the folder stays until a later run of the tests removes it.
fn fresh_folder() -> PathBuf {
    let parent = Path::new(env!("CARGO_TARGET_TMPDIR"));
    for entry in fs::read_dir(parent).into_iter().flatten().flatten() {
        let ours = entry.file_name().to_string_lossy().starts_with("veiloc-place-");
        let written = entry.metadata().and_then(|m| m.modified()).unwrap_or_else(|_| SystemTime::now());
        if ours && written.elapsed().is_ok_and(|age| age > Duration::from_secs(3600)) {
            let _ = fs::remove_dir_all(entry.path());
        }
    }
    tempfile::Builder::new().prefix("veiloc-place-").tempdir_in(parent).expect("temporary folder").keep()
}

impl TestScene {
    fn render(folder: PathBuf) -> Self {
        let camera: Intrinsics = CAMERA.parse().expect("a camera");
        fs::create_dir_all(folder.join("images")).expect("folder");
        let scene = veiloc_synthetic::RenderedRoom::generate(11);
        let [map_poses, query_poses] = views(&scene);
        write_list(&folder.join("map.txt"), &map_poses);
        write_list(&folder.join("queries.txt"), &query_poses);
        let poses = [map_poses, query_poses].concat();
        for (seed, (name, pose)) in (1..).zip(&poses) {
            let view = scene.render(pose, &camera, &RenderOptions::with_seed(seed));
            view.rgb().save(folder.join("images").join(name)).expect("written");
        }
        let images = poses.iter().zip(1..).map(|((name, pose), id)| ColmapImage {
            id,
            name: name.clone(),
            camera_id: 1,
            cam_from_world: *pose,
            points2d: Vec::new(),
        });
        let model = ColmapModel::new(vec![(1, camera)], images.collect(), Vec::new()).expect("a model");
        write_text(&model, &folder.join("posed")).expect("written");
        Self { folder, poses }
    }

    /// The true pose of an image.
    pub fn pose_of(&self, name: &str) -> CameraFromWorld {
        self.poses.iter().find(|(n, _)| n == name).expect("an image of the scene").1
    }

    /// Distance between the camera centre of a found pose and that of the image (map units).
    pub fn position_error(&self, image: &str, found: &CameraFromWorld) -> f64 {
        found.translation_error(&self.pose_of(image))
    }

    /// A path in the scene's folder.
    pub fn path(&self, relative: impl AsRef<Path>) -> PathBuf {
        self.folder.join(relative)
    }

    /// Reads a file of the scene.
    pub fn read(&self, relative: &str) -> Vec<u8> {
        fs::read(self.path(relative)).unwrap_or_else(|e| panic!("{relative}: {e}"))
    }

    /// Writes a file into the scene's folder and creates its parent folders.
    pub fn write(&self, relative: &str, bytes: impl AsRef<[u8]>) {
        let path = self.path(relative);
        fs::create_dir_all(path.parent().expect("a parent")).expect("folder");
        fs::write(path, bytes).expect("written");
    }

    /// `veiloc` with these arguments, separated by spaces, run in the scene's folder.
    pub fn command(&self, arguments: &str) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_veiloc"));
        command.args(arguments.split_whitespace()).current_dir(&self.folder);
        command.env_remove("NO_COLOR").env_remove("CLICOLOR_FORCE").env_remove("FORCE_COLOR");
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    /// Runs [`Self::command`] to its end.
    pub fn run(&self, arguments: &str) -> Run {
        let output = self.command(arguments).output().expect("the binary runs");
        Run::of(arguments, &output)
    }

    /// Seals an image of the scene with its profile; `scheme` is empty for the default.
    pub fn seal(&self, image: &str, scheme: &str, out: &str) -> Run {
        let scheme = if scheme.is_empty() { String::new() } else { format!("--scheme {scheme}") };
        self.run(&format!("seal images/{image} --camera {CAMERA} --profile place.vprofile {scheme} -o {out}"))
            .succeeded()
    }
}

/// Names and poses of the map's images, and of the queries.
fn views(scene: &veiloc_synthetic::RenderedRoom) -> [Vec<(String, CameraFromWorld)>; 2] {
    let path = scene.camera_path(&PathOptions::with_counts(3 * MAP_VIEWS, 3 * QUERIES));
    let mapping = path.mapping[..MAP_VIEWS].iter().enumerate();
    let queries = path.queries[..QUERIES].iter().enumerate();
    [
        mapping.map(|(i, p)| (format!("map-{i:02}.png"), *p)).collect(),
        queries.map(|(i, p)| (format!("query-{i}.png"), *p)).collect(),
    ]
}

fn write_list(path: &Path, poses: &[(String, CameraFromWorld)]) {
    let names: Vec<&str> = poses.iter().map(|(name, _)| name.as_str()).collect();
    fs::write(path, names.join("\n")).expect("written");
}

/// Result of a run of the binary.
pub struct Run {
    /// The command line.
    pub command: String,
    /// `None` if a signal ended it.
    pub code: Option<i32>,
    pub stdout: String,
    pub stderr: String,
}

impl Run {
    /// The end of a command, checked.
    pub fn of(arguments: &str, output: &Output) -> Self {
        let text = |bytes: &[u8]| String::from_utf8(bytes.to_vec()).expect("the binary writes UTF-8");
        let run = Self {
            command: format!("veiloc {arguments}"),
            code: output.status.code(),
            stdout: text(&output.stdout),
            stderr: text(&output.stderr),
        };
        run.is_sound();
        run
    }

    /// Checks what holds for every command: no panic, no signal, only documented exit codes, no colour into a pipe.
    fn is_sound(&self) {
        assert!(matches!(self.code, Some(0..=2 | 4)), "{self}");
        for text in [&self.stdout, &self.stderr] {
            assert!(!text.contains("panicked"), "{self}");
            assert!(!text.contains('\u{1b}'), "terminal codes in a pipe: {self}");
        }
    }

    /// Exit code 0.
    pub fn succeeded(self) -> Self {
        assert_eq!(self.code, Some(0), "{self}");
        self
    }

    /// The command ended with 1, and printed all these words, wherever its lines are broken.
    #[track_caller]
    pub fn refused(self, expected_words: &[&str]) -> Self {
        let words: Vec<&str> =
            self.stderr.split_whitespace().filter(|word| !["│", "×"].contains(word)).collect();
        let text = words.join(" ");
        assert!(
            self.code == Some(1) && expected_words.iter().all(|word| text.contains(word)),
            "{expected_words:?}: {self}"
        );
        self
    }

    /// Stdout as exactly one JSON document; stderr contains no JSON.
    pub fn json(&self) -> Value {
        let document = serde_json::from_str(&self.stdout).unwrap_or_else(|e| panic!("{e}\n{self}"));
        assert!(!self.stderr.contains('{'), "data on stderr: {self}");
        document
    }
}

impl std::fmt::Display for Run {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "`{}` ended with {:?}\n--- stdout\n{}\n--- stderr\n{}",
            self.command, self.code, self.stdout, self.stderr
        )
    }
}

/// The pose of an object `{"q": [w, x, y, z], "t": [x, y, z]}`.
pub fn pose(object: &Value) -> CameraFromWorld {
    let numbers = |key: &str| -> Vec<f64> {
        let list = object[key].as_array().unwrap_or_else(|| panic!("no list {key}: {object}"));
        list.iter().map(|number| number.as_f64().expect("a number")).collect()
    };
    let (q, t) = (numbers("q").try_into(), numbers("t").try_into());
    CameraFromWorld::from_quaternion(q.expect("four numbers"), t.expect("three numbers")).expect("a pose")
}

/// The names of a JSON object's fields, sorted.
pub fn keys(object: &Value) -> Vec<&str> {
    let mut keys: Vec<&str> = object.as_object().expect("an object").keys().map(String::as_str).collect();
    keys.sort_unstable();
    keys
}
