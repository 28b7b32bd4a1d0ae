//! 7Scenes: `<scene>/TrainSplit.txt` and `TestSplit.txt` name sequences, `<scene>/seq-XX/frame-XXXXXX.color.png` are
//! the images. Shotton et al., *Scene Coordinate Regression Forests for Camera Relocalization in RGB-D Images*, CVPR
//! 2013.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use veiloc_geometry::nalgebra::{Matrix3, Vector3};
use veiloc_geometry::{CameraFromWorld, Intrinsics};
use veiloc_map::{PosedImage, PosedImages};
use veiloc_mapping::importers::lines::Line;

use crate::error::DatasetError;
use crate::files::{ImageFiles, MissingImages, size};
use crate::lines::read_text;
use crate::official::is_whole;
use crate::scene::{DatasetQuery, DatasetScene};
use crate::write::lists::{make_folder_of, numbers, quaternion_and_translation, save_text};
use crate::write::view::{DatasetCamera, DatasetView, Split};

const GET: &str = "get the scene from https://www.microsoft.com/en-us/research/project/rgb-d-dataset-7-scenes/ and \
                   unpack its sequences";
const GET_LISTS: &str = "get the lists `pgt/sfm/7scenes` of https://github.com/tsattler/visloc_pseudo_gt_limitations and \
                         name their folder with --pseudo-ground-truth, or take the depth camera's poses with --poses depth";

/// Default focal length of the colour camera, pixels of images 640 wide: the usual value for evaluations with the
/// depth camera's poses.
const FOCAL: f64 = 525.0;

/// Source of the ground-truth poses.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum PoseSource {
    /// Poses of the depth camera, from KinectFusion: `frame-XXXXXX.pose.txt`. The depth camera is mounted beside the
    /// colour camera that took the images, so errors of any method are at least some centimetres.
    Depth,
    /// Poses from structure from motion, in lists `<scene>_train.txt` and `<scene>_test.txt` in this folder: the
    /// pseudo ground truth of Brachmann et al., *On the Limits of Pseudo Ground Truth in Visual Camera
    /// Re-localisation*, ICCV 2021.
    Sfm(PathBuf),
}

impl PoseSource {
    /// The structure-from-motion lists in their usual folders beside the scenes: `pgt_sfm`, and `pgt/sfm/7scenes` as
    /// distributed by the authors.
    pub fn sfm_beside(root: &Path) -> Self {
        let folders = ["pgt_sfm", "pgt/sfm/7scenes"].map(|folder| root.join(folder));
        let [first, _] = &folders;
        Self::Sfm(folders.iter().find(|folder| folder.is_dir()).unwrap_or(first).clone())
    }
}

/// Sorted names of the scenes in a folder: those that have both splits.
///
/// # Errors
/// [`DatasetError`] when the folder cannot be read, or has no scenes.
pub fn scenes(root: &Path) -> Result<Vec<String>, DatasetError> {
    let mut names = Vec::new();
    for entry in std::fs::read_dir(root).map_err(DatasetError::io(root))? {
        let entry = entry.map_err(DatasetError::io(root))?;
        let has = |file: &str| entry.path().join(file).is_file();
        if has("TrainSplit.txt") && has("TestSplit.txt") {
            names.push(entry.file_name().to_string_lossy().into_owned());
        }
    }
    names.sort();
    if names.is_empty() {
        return Err(DatasetError::Missing {
            path: root.to_owned(),
            what: "a scene (a folder with TrainSplit.txt and TestSplit.txt)",
            remedy: GET.to_owned(),
        });
    }
    Ok(names)
}

/// Reads a scene.
///
/// # Errors
/// [`DatasetError`] names what is missing and where to get it, or the invalid line.
pub fn read_scene(
    root: &Path,
    scene: &str,
    truth: &PoseSource,
    missing: MissingImages,
) -> Result<DatasetScene, DatasetError> {
    let folder = root.join(scene);
    let mut found = ImageFiles::new(&folder, missing);
    let mut sides = Vec::new();
    let splits = [sequences(&folder.join("TrainSplit.txt"))?, sequences(&folder.join("TestSplit.txt"))?];
    for (side, list) in ["train", "test"].into_iter().enumerate() {
        sides.push(match truth {
            PoseSource::Depth => by_depth(&folder, &splits[side], &mut found)?,
            PoseSource::Sfm(lists) => {
                let path = lists.join(format!("{scene}_{list}.txt"));
                by_list(&path, &folder, &splits[1 - side], &mut found)?
            }
        });
    }
    let remarks = found.finish(GET)?.into_iter().collect();
    let [mapped, queries] = <[Vec<PosedImage>; 2]>::try_from(sides).expect("two splits");
    let counts = (mapped.len(), queries.len());
    Ok(DatasetScene {
        name: scene.to_owned(),
        images: folder,
        mapped: PosedImages::new(mapped, Vec::new())?,
        queries: queries
            .into_iter()
            .map(|image| DatasetQuery {
                name: image.name,
                camera: image.camera,
                cam_from_world: Some(image.cam_from_world),
                condition: None,
            })
            .collect(),
        is_official: is_whole("7scenes", scene, counts.0, counts.1),
        remarks,
    })
}

/// The folders of the sequences of a split file, which names them `sequence3` or `seq-03`.
fn sequences(path: &Path) -> Result<BTreeSet<String>, DatasetError> {
    let text = read_text(path, "the list of its sequences", GET)?;
    let of = |line: Line<'_>| {
        let name = line.words[0];
        let number = name.strip_prefix("sequence").or_else(|| name.strip_prefix("seq-"));
        let number = number.and_then(|n| n.parse::<u32>().ok());
        let number = number
            .ok_or_else(|| line.fault(format!("{name:?} is not a sequence; write it like sequence3")))?;
        Ok(format!("seq-{number:02}"))
    };
    Line::all(path, &text).map(of).collect()
}

/// All frames of these sequences, with the poses of the depth camera.
fn by_depth(
    folder: &Path,
    sequences: &BTreeSet<String>,
    found: &mut ImageFiles,
) -> Result<Vec<PosedImage>, DatasetError> {
    let mut cameras = Cameras::default();
    let mut images = Vec::new();
    for sequence in sequences {
        let path = folder.join(sequence);
        let mut frames = BTreeSet::new();
        match std::fs::read_dir(&path) {
            Ok(entries) => {
                for entry in entries {
                    let name = entry.map_err(DatasetError::io(&path))?.file_name();
                    frames.extend(name.to_string_lossy().strip_suffix(".pose.txt").map(str::to_owned));
                }
            }
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => {}
            Err(e) => return Err(DatasetError::io(&path)(e)),
        }
        if frames.is_empty() {
            found.find(&format!("{sequence}/frame-000000.color.png"));
        }
        for frame in frames {
            let Some(name) = found.find(&format!("{sequence}/{frame}.color.png")) else { continue };
            let camera = cameras.of(folder, &name, |width| FOCAL * f64::from(width) / 640.0)?;
            let cam_from_world = depth_pose(&path.join(format!("{frame}.pose.txt")))?;
            images.push(PosedImage { name, camera, cam_from_world, seen: Vec::new() });
        }
    }
    Ok(images)
}

/// The inverse of the 4 × 4 camera-to-world matrix of a file.
fn depth_pose(path: &Path) -> Result<CameraFromWorld, DatasetError> {
    let text = read_text(path, "the pose of a frame", GET)?;
    let unusable = |reason: &str| DatasetError::Unusable { path: path.to_owned(), reason: reason.to_owned() };
    let rows = Line::all(path, &text).map(|line| line.numbers::<4>(0, "a number of the matrix"));
    let rows: Vec<[f64; 4]> = rows.collect::<Result<_, _>>()?;
    let [x, y, z, [0.0, 0.0, 0.0, 1.0]] = rows[..] else {
        return Err(unusable("is not a 4 × 4 matrix with 0 0 0 1 as its last row; get the sequence again"));
    };
    let turned = Matrix3::from_fn(|row, column| [x, y, z][row][column]);
    let center = Vector3::new(x[3], y[3], z[3]);
    // The rotation is orthonormalized; the centre is used as given.
    CameraFromWorld::from_matrix(turned.transpose(), Vector3::zeros())
        .map(|pose| CameraFromWorld::new(*pose.rotation(), -(pose.rotation() * center)))
        .ok_or_else(|| unusable("has an invalid rotation; leave the frame out, or get the sequence again"))
}

/// The images of a pseudo-ground-truth list, `name qw qx qy qz tx ty tz focal`, world to camera; none of them may
/// belong to the other split's sequences.
fn by_list(
    path: &Path,
    folder: &Path,
    others: &BTreeSet<String>,
    found: &mut ImageFiles,
) -> Result<Vec<PosedImage>, DatasetError> {
    let text = read_text(path, "the SfM pseudo ground truth", GET_LISTS)?;
    let mut cameras = Cameras::default();
    let mut images = Vec::new();
    for line in Line::all(path, &text) {
        let listed = line.words[0];
        let sequence = listed.split('/').next().unwrap_or_default();
        if others.contains(sequence) {
            return Err(line.fault(format!(
                "{listed} belongs to a sequence of the other split, so a map image would be a query; get lists and splits again"
            ))
            .into());
        }
        let (wxyz, t) = (line.numbers(1, "the quaternion")?, line.numbers(5, "the translation")?);
        let [focal] = line.numbers(8, "the focal length")?;
        let pose = CameraFromWorld::from_quaternion(wxyz, t);
        let cam_from_world = pose.ok_or_else(|| line.fault("the quaternion is not a rotation"))?;
        let Some(name) = found.find(listed) else { continue };
        let camera = cameras.of(folder, &name, |_| focal)?;
        images.push(PosedImage { name, camera, cam_from_world, seen: Vec::new() });
    }
    // The lists are unsorted.
    images.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(images)
}

/// Image sizes by sequence: all frames of a sequence have the same size.
#[derive(Default)]
struct Cameras(BTreeMap<String, (u32, u32)>);

impl Cameras {
    fn of(
        &mut self,
        folder: &Path,
        name: &str,
        focal: impl FnOnce(u32) -> f64,
    ) -> Result<Intrinsics, DatasetError> {
        let sequence = name.split('/').next().unwrap_or_default();
        let path = folder.join(name);
        let (w, h) = match self.0.get(sequence) {
            Some(size) => *size,
            None => *self.0.entry(sequence.to_owned()).or_insert(size(&path)?),
        };
        let params = [focal(w), f64::from(w) / 2.0, f64::from(h) / 2.0];
        Intrinsics::new("SIMPLE_PINHOLE", w, h, &params)
            .map_err(|e| DatasetError::Unusable { path, reason: e.to_string() })
    }
}

/// Writes a scene: sequence 1 has the map images, sequence 2 the queries; poses as matrices and as lists.
pub(crate) fn write(
    root: &Path,
    scene: &str,
    lens: &DatasetCamera,
    views: &[DatasetView],
    save: &mut dyn FnMut(usize, &Path) -> Result<(), DatasetError>,
) -> Result<(), DatasetError> {
    let folder = root.join(scene);
    let mut lists = [String::new(), String::new()];
    let mut counts = [0; 2];
    for (index, view) in views.iter().enumerate() {
        let side = usize::from(view.split != Split::Map);
        let frame = format!("seq-{:02}/frame-{:06}", side + 1, counts[side]);
        counts[side] += 1;
        let image = folder.join(format!("{frame}.color.png"));
        make_folder_of(&image)?;
        save(index, &image)?;
        save_text(&folder.join(format!("{frame}.pose.txt")), &matrix(view))?;
        let list = &mut lists[side];
        write!(list, "{frame}.color.png").expect("a string takes all that is written to it");
        numbers(list, quaternion_and_translation(&view.cam_from_world));
        numbers(list, [lens.focal]);
        list.push('\n');
    }
    for (side, (split, list)) in
        [("TrainSplit.txt", "train"), ("TestSplit.txt", "test")].into_iter().enumerate()
    {
        save_text(&folder.join(split), &format!("sequence{}\n", side + 1))?;
        save_text(&root.join(format!("pgt_sfm/{scene}_{list}.txt")), &lists[side])?;
    }
    Ok(())
}

/// Camera to world, 4 × 4.
fn matrix(view: &DatasetView) -> String {
    let turned = view.cam_from_world.rotation().matrix().transpose();
    let c = view.cam_from_world.center().coords;
    let mut out = String::new();
    for row in 0..3 {
        numbers(&mut out, [turned[(row, 0)], turned[(row, 1)], turned[(row, 2)], c[row]]);
        out.push('\n');
    }
    out.push_str(" 0 0 0 1\n");
    out
}
