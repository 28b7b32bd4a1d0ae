//! Aachen Day-Night, v1 (a VisualSFM model) and v1.1 (a COLMAP model): `images_upright/`, `3D-models/`, `queries/`.
//! Sattler et al., *Benchmarking 6DOF Outdoor Visual Localization in Changing Conditions*, CVPR 2018; Zhang et al.,
//! *Reference Pose Generation for Long-term Visual Localization via Learned Features and View Synthesis*, IJCV 2021.
//!
//! The poses of its queries are not published: <https://www.visuallocalization.net> evaluates result files.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use veiloc_geometry::{CameraFromWorld, Intrinsics};
use veiloc_map::colmap::{ColmapImage, ColmapModel, read_posed, write_binary};
use veiloc_map::{PosedImage, PosedImages};
use veiloc_mapping::importers::lines::Line;
use veiloc_mapping::importers::poses::nvm::{radial_camera, read_nvm};

use crate::error::DatasetError;
use crate::files::{ImageFiles, MissingImages, size};
use crate::lines::read_text;
use crate::official::is_whole;
use crate::scene::{DatasetQuery, DatasetScene};
use crate::write::lists::{make_folder_of, numbers, nvm, quaternion_and_translation, save_text};
use crate::write::view::{DatasetCamera, DatasetView, Split};

const GET: &str = "get it from https://www.visuallocalization.net/datasets/ (Aachen Day-Night)";

/// A version of the data set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AachenVersion {
    /// 4328 map images: `3D-models/aachen_cvpr2018_db.nvm`. The paper's.
    V1,
    /// 6697 map images: `3D-models/aachen_v_1_1/`.
    V1_1,
}

impl AachenVersion {
    fn model(self, root: &Path) -> PathBuf {
        root.join("3D-models").join(match self {
            Self::V1 => "aachen_cvpr2018_db.nvm",
            Self::V1_1 => "aachen_v_1_1",
        })
    }

    /// Name of the data set.
    pub const fn name(self) -> &'static str {
        match self {
            Self::V1 => "aachen",
            Self::V1_1 => "aachen-v1.1",
        }
    }
}

/// Conditions of queries, as their lists are named.
pub const CONDITIONS: [&str; 2] = ["day", "night"];

/// Reads the data set. `truth`: poses of queries by name, for copies of the data set with known poses
/// ([`read_poses`]).
///
/// # Errors
/// [`DatasetError`] names what is missing and where to get it, or the invalid line.
pub fn read(
    root: &Path,
    version: AachenVersion,
    conditions: &[String],
    truth: Option<&BTreeMap<String, CameraFromWorld>>,
    missing: MissingImages,
) -> Result<DatasetScene, DatasetError> {
    let images = root.join("images_upright");
    let mut found = ImageFiles::new(&images, missing);
    let mut remarks = Vec::new();
    let mapped = match version {
        AachenVersion::V1 => by_nvm(&version.model(root), &images, &mut found, &mut remarks)?,
        AachenVersion::V1_1 => by_colmap(&version.model(root), &mut found)?,
    };
    let mut queries = Vec::new();
    for condition in conditions {
        let path = root.join("queries").join(format!("{condition}_time_queries_with_intrinsics.txt"));
        for (name, camera) in listed_queries(&path)? {
            if let Some(there) = found.find(&name) {
                let cam_from_world = truth.and_then(|truth| truth.get(&name)).copied();
                queries.push(DatasetQuery {
                    name: there,
                    camera,
                    cam_from_world,
                    condition: Some(condition.clone()),
                });
            }
        }
    }
    remarks.extend(found.finish(GET)?);
    let whole = is_whole(version.name(), version.name(), mapped.images().len(), queries.len());
    Ok(DatasetScene { name: version.name().to_owned(), images, mapped, queries, is_official: whole, remarks })
}

fn by_nvm(
    path: &Path,
    folder: &Path,
    found: &mut ImageFiles,
    remarks: &mut Vec<String>,
) -> Result<PosedImages, DatasetError> {
    if !path.is_file() {
        let remedy = format!("{GET}, or evaluate `aachen-v1.1` if this is v1.1");
        return Err(DatasetError::Missing { path: path.to_owned(), what: "the model of v1", remedy });
    }
    let model = read_nvm(path)?;
    remarks.extend(model.remark().into_iter().chain(model.remark_on_odd()));
    let mut images = Vec::new();
    for known in &model.cameras {
        let listed = known.name.strip_prefix("./").unwrap_or(&known.name);
        let Some(name) = found.find(listed) else { continue };
        let camera =
            radial_camera(known.focal, known.distortion, size(&folder.join(&name))?).map_err(|e| {
                DatasetError::Unusable { path: path.to_owned(), reason: format!("{listed}: {e}") }
            })?;
        images.push(PosedImage {
            name,
            camera,
            cam_from_world: known.cam_from_world,
            seen: known.seen.clone(),
        });
    }
    Ok(PosedImages::new(images, model.points)?)
}

fn by_colmap(path: &Path, found: &mut ImageFiles) -> Result<PosedImages, DatasetError> {
    if !path.is_dir() {
        let remedy = format!("{GET}, or evaluate `aachen` if this is v1");
        return Err(DatasetError::Missing { path: path.to_owned(), what: "the model of v1.1", remedy });
    }
    let model = read_posed(path)?;
    let mut images = Vec::new();
    for image in model.images() {
        if let Some(name) = found.find(&image.name) {
            images.push(PosedImage { name, ..image.clone() });
        }
    }
    Ok(PosedImages::new(images, model.points().to_vec())?)
}

/// A list of queries in hloc's format, `name MODEL W H PARAMS…`.
///
/// # Errors
/// [`DatasetError`] naming file and line.
pub fn listed_queries(path: &Path) -> Result<Vec<(String, Intrinsics)>, DatasetError> {
    let remedy = format!("{GET}, or select other conditions with --conditions");
    let text = read_text(path, "the list of queries with their cameras", &remedy)?;
    let mut queries: Vec<(String, Intrinsics)> = Vec::new();
    for line in Line::all(path, &text) {
        let [name, model, ..] = line.words[..] else {
            return Err(line.fault("a query needs its name and its camera").into());
        };
        let (w, h) = (line.number(2, "the width")?, line.number(3, "the height")?);
        let params: Vec<f64> = (4..line.words.len())
            .map(|at| line.number(at, "a parameter of the camera"))
            .collect::<Result<_, _>>()?;
        let camera = Intrinsics::new(model, w, h, &params).map_err(|e| line.fault(e.to_string()))?;
        queries.push((name.to_owned(), camera));
    }
    if queries.is_empty() {
        let reason = format!("has no queries; {GET}");
        return Err(DatasetError::Unusable { path: path.to_owned(), reason });
    }
    Ok(queries)
}

/// Poses of images in the format of result files, `name qw qx qy qz tx ty tz`, world to camera, by name.
///
/// # Errors
/// [`DatasetError`] naming file and line.
pub fn read_poses(path: &Path) -> Result<BTreeMap<String, CameraFromWorld>, DatasetError> {
    let text = read_text(path, "the list of poses", "name another")?;
    let mut poses = BTreeMap::new();
    for line in Line::all(path, &text) {
        let pose = CameraFromWorld::from_quaternion(
            line.numbers(1, "the quaternion")?,
            line.numbers(5, "the translation")?,
        );
        let pose = pose.ok_or_else(|| line.fault("the quaternion is not a rotation"))?;
        if poses.insert(line.words[0].to_owned(), pose).is_some() {
            return Err(line.fault(format!("{} appears twice", line.words[0])).into());
        }
    }
    Ok(poses)
}

/// Writes the data set, with a list of the queries' poses, `queries/poses.txt`, which the published data set does not
/// contain.
pub(crate) fn write(
    root: &Path,
    version: AachenVersion,
    lens: &DatasetCamera,
    views: &[DatasetView],
    save: &mut dyn FnMut(usize, &Path) -> Result<(), DatasetError>,
) -> Result<(), DatasetError> {
    let camera = lens.camera()?;
    let mut mapped = Vec::new();
    let mut queries = [String::new(), String::new()];
    let mut poses = String::new();
    for (index, view) in views.iter().enumerate() {
        let name = match view.split {
            Split::Map => format!("db/{}.png", mapped.len() + 1),
            Split::Query => format!("query/day/phone/{index}.png"),
            Split::NightQuery => format!("query/night/phone/{index}.png"),
        };
        let image = root.join("images_upright").join(&name);
        make_folder_of(&image)?;
        save(index, &image)?;
        if view.split == Split::Map {
            mapped.push((name, view.cam_from_world));
            continue;
        }
        let list = &mut queries[usize::from(view.split == Split::NightQuery)];
        list.push_str(&listed(&name, &camera));
        poses.push_str(&name);
        numbers(&mut poses, quaternion_and_translation(&view.cam_from_world));
        poses.push('\n');
    }
    for (condition, list) in ["day", "night"].into_iter().zip(&queries) {
        if !list.is_empty() {
            save_text(&root.join(format!("queries/{condition}_time_queries_with_intrinsics.txt")), list)?;
        }
    }
    save_text(&root.join("queries/poses.txt"), &poses)?;
    let model = version.model(root);
    match version {
        AachenVersion::V1 => save_text(&model, &nvm(&mapped, lens)),
        AachenVersion::V1_1 => {
            let image = |((name, pose), id): (&(String, _), u32)| ColmapImage {
                id,
                name: name.clone(),
                camera_id: 1,
                cam_from_world: *pose,
                points2d: Vec::new(),
            };
            let images = mapped.iter().zip(1..).map(image).collect();
            let colmap = ColmapModel::new(vec![(1, camera)], images, Vec::new())?;
            Ok(write_binary(&colmap, &model)?)
        }
    }
}

/// A line of a list of queries, `name MODEL W H PARAMS…`.
fn listed(name: &str, camera: &Intrinsics) -> String {
    format!("{name} {}\n", camera.to_string().replace(',', " "))
}
