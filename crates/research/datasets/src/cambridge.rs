//! Cambridge Landmarks: `<scene>/dataset_train.txt` and `dataset_test.txt` list images with their poses,
//! `<scene>/reconstruction.nvm` has the cameras. Kendall et al., *PoseNet*, ICCV 2015.

use std::collections::BTreeMap;
use std::path::Path;

use veiloc_geometry::{CameraFromWorld, Intrinsics};
use veiloc_map::{PosedImage, PosedImages};
use veiloc_mapping::importers::lines::{Line, pose_at};
use veiloc_mapping::importers::poses::nvm::{NvmModel, radial_camera, read_nvm};

use crate::error::DatasetError;
use crate::files::{ImageFiles, MissingImages, size};
use crate::lines::read_text;
use crate::official::is_whole;
use crate::scene::{DatasetQuery, DatasetScene};
use crate::write::lists::{make_folder_of, numbers, nvm, save_text};
use crate::write::view::{DatasetCamera, DatasetView, Split};

const GET: &str =
    "get the scene from https://www.repository.cam.ac.uk (Cambridge Landmarks) and unpack it whole";

/// First lines of a list of images.
const HEAD: &str = "Visual Landmark Dataset V1\nImageFile, Camera Position [X Y Z W P Q R]\n\n";

/// Scenes that the paper leaves out because of their many geometric outliers, like earlier works.
pub const EXCLUDED_SCENES: [&str; 2] = ["GreatCourt", "Street"];

/// Sorted names of the scenes in a folder: those that have both lists.
///
/// # Errors
/// [`DatasetError`] when the folder cannot be read, or has no scenes.
pub fn scenes(root: &Path) -> Result<Vec<String>, DatasetError> {
    let mut names = Vec::new();
    for entry in std::fs::read_dir(root).map_err(DatasetError::io(root))? {
        let entry = entry.map_err(DatasetError::io(root))?;
        let has = |file: &str| entry.path().join(file).is_file();
        if has("dataset_train.txt") && has("dataset_test.txt") {
            names.push(entry.file_name().to_string_lossy().into_owned());
        }
    }
    names.sort();
    if names.is_empty() {
        return Err(DatasetError::Missing {
            path: root.to_owned(),
            what: "a scene (a folder with dataset_train.txt and dataset_test.txt)",
            remedy: GET.to_owned(),
        });
    }
    Ok(names)
}

/// An image of a list.
#[derive(Debug, Clone, PartialEq)]
pub struct ListedImage {
    /// Its name, relative to the scene's folder.
    pub name: String,
    /// Its pose.
    pub cam_from_world: CameraFromWorld,
}

/// Reads a list: three head lines, then `path x y z qw qx qy qz`: camera centre, and the quaternion that rotates the
/// world into the camera. The part of a path before the scene's folder (`D:/…/GreatCourt/`) belongs to the authors'
/// machine and is removed.
///
/// # Errors
/// [`DatasetError`] names file and line.
pub fn read_list(path: &Path, scene: &str) -> Result<Vec<ListedImage>, DatasetError> {
    let text = read_text(path, "the list of its images", GET)?;
    let mut listed = Vec::new();
    for line in Line::all(path, &text) {
        if line.words[0] == "Visual" || line.words[0].starts_with("ImageFile") {
            continue;
        }
        let at = line.words.len().checked_sub(7).filter(|at| *at > 0);
        let at = at.ok_or_else(|| line.fault("an image needs its path, x y z and a quaternion"))?;
        let path = line.words[..at].join(" ").replace('\\', "/");
        let name = path.rsplit_once(&format!("/{scene}/")).map_or(path.as_str(), |(_, tail)| tail);
        let pose = pose_at(line.numbers(at, "the position")?, line.numbers(at + 3, "the quaternion")?);
        let cam_from_world = pose.ok_or_else(|| line.fault("the quaternion is not a rotation"))?;
        listed.push(ListedImage { name: name.to_owned(), cam_from_world });
    }
    if listed.is_empty() {
        let reason = format!("has no images; {GET}");
        return Err(DatasetError::Unusable { path: path.to_owned(), reason });
    }
    Ok(listed)
}

/// Reads a scene. Cameras are those of its `reconstruction.nvm`, or `camera` for all images.
///
/// # Errors
/// [`DatasetError`] names what is missing and where to get it, or the invalid line.
pub fn read_scene(
    root: &Path,
    scene: &str,
    camera: Option<&Intrinsics>,
    missing: MissingImages,
) -> Result<DatasetScene, DatasetError> {
    let folder = root.join(scene);
    let lists = ["dataset_train.txt", "dataset_test.txt"].map(|file| read_list(&folder.join(file), scene));
    let [mapped, queries] = lists;
    let (mapped, queries) = (mapped?, queries?);
    let model = match camera {
        Some(_) => NvmModel::default(),
        None => model(&folder)?,
    };
    let by_stem: BTreeMap<&str, usize> =
        model.cameras.iter().enumerate().map(|(at, camera)| (stem(&camera.name), at)).collect();
    let mut found = ImageFiles::new(&folder, missing);
    let mut posed = |listed: &ListedImage| -> Result<Option<PosedImage>, DatasetError> {
        let Some(name) = found.find(&listed.name) else { return Ok(None) };
        let (camera, seen) = if let Some(camera) = camera {
            (*camera, Vec::new())
        } else {
            let path = folder.join("reconstruction.nvm");
            let known = by_stem.get(stem(&listed.name)).map(|at| &model.cameras[*at]);
            let known = known.ok_or_else(|| DatasetError::Unusable {
                path: path.clone(),
                reason: format!("has no camera of {}; {GET}, or give --camera", listed.name),
            })?;
            let camera = radial_camera(known.focal, known.distortion, size(&folder.join(&name))?)
                .map_err(|e| DatasetError::Unusable { path, reason: format!("{}: {e}", listed.name) })?;
            (camera, known.seen.clone())
        };
        Ok(Some(PosedImage { name, camera, cam_from_world: listed.cam_from_world, seen }))
    };
    let mut side = |listed: &[ListedImage]| -> Result<Vec<PosedImage>, DatasetError> {
        listed.iter().filter_map(|image| posed(image).transpose()).collect()
    };
    let (mapped, queries) = (side(&mapped)?, side(&queries)?);
    let mut remarks: Vec<String> = found.finish(GET)?.into_iter().collect();
    remarks.extend(model.remark().into_iter().chain(model.remark_on_odd()));
    let counts = (mapped.len(), queries.len());
    Ok(DatasetScene {
        name: scene.to_owned(),
        images: folder,
        mapped: PosedImages::new(mapped, model.points)?,
        queries: queries
            .into_iter()
            .map(|image| DatasetQuery {
                name: image.name,
                camera: image.camera,
                cam_from_world: Some(image.cam_from_world),
                condition: None,
            })
            .collect(),
        is_official: is_whole("cambridge", scene, counts.0, counts.1),
        remarks,
    })
}

fn model(folder: &Path) -> Result<NvmModel, DatasetError> {
    let path = folder.join("reconstruction.nvm");
    if !path.is_file() {
        return Err(DatasetError::Missing {
            path,
            what: "the model, which has the focal lengths,",
            remedy: format!("{GET}, or give all images one camera with --camera"),
        });
    }
    Ok(read_nvm(&path)?)
}

/// A name without its extension: lists have `.png` where models have `.jpg`.
fn stem(name: &str) -> &str {
    name.rsplit_once('.').map_or(name, |(stem, _)| stem)
}

/// Writes a scene.
pub(crate) fn write(
    root: &Path,
    scene: &str,
    lens: &DatasetCamera,
    views: &[DatasetView],
    save: &mut dyn FnMut(usize, &Path) -> Result<(), DatasetError>,
) -> Result<(), DatasetError> {
    let folder = root.join(scene);
    let mut lists = [HEAD.to_owned(), HEAD.to_owned()];
    let mut cameras = Vec::new();
    let mut counts = [0; 2];
    for (index, view) in views.iter().enumerate() {
        let side = usize::from(view.split != Split::Map);
        counts[side] += 1;
        let name = format!("seq{}/frame{:05}.png", side + 1, counts[side]);
        let image = folder.join(&name);
        make_folder_of(&image)?;
        save(index, &image)?;
        let list = &mut lists[side];
        list.push_str(&name);
        let c = view.cam_from_world.center().coords;
        numbers(list, [c.x, c.y, c.z]);
        numbers(list, view.cam_from_world.quaternion());
        list.push('\n');
        cameras.push((name, view.cam_from_world));
    }
    save_text(&folder.join("dataset_train.txt"), &lists[0])?;
    save_text(&folder.join("dataset_test.txt"), &lists[1])?;
    save_text(&folder.join("reconstruction.nvm"), &nvm(&cameras, lens))
}
