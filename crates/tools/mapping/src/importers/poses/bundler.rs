//! Bundler's files (`bundle.out`), which VisualSFM, COLMAP, Metashape and others export.
//!
//! After `# Bundle file v0.3`: the numbers of cameras and points; for each camera `f k1 k2`, three rows of `R`, `t`; for
//! each point position, colour and `n` times `camera key x y`. A pose is world to camera, and the camera looks along its
//! negative z axis (`x` right, `y` up): `P = R X + t`, `p = −P / P_z`, `p' = f (1 + k₁ |p|² + k₂ |p|⁴) p`, from the middle
//! of the image. A camera with focal length 0 has no pose. Names are in a list beside the file, in the order of the cameras:
//! `bundle.out.list.txt`, `bundle.list.txt`, or `list.txt`; `place.list.txt` for `place.bundle.out`, as COLMAP writes them; or
//! the only `.lst`, as RealityCapture writes it.
//!
//! Source: N. Snavely, *Bundler v0.4 User's Manual*, "Output format".

use std::path::{Path, PathBuf};

use veiloc_geometry::nalgebra::{Matrix3, Vector3};
use veiloc_geometry::{CameraFromWorld, Point3};

use super::cameras::Lens;
use super::names::ImageNames;
use super::posed_input::{Poses, faulty, text};
use crate::error::MappingError;
use crate::importers::lines::Line;

pub(super) fn read(path: &Path, names: &ImageNames) -> Result<Poses, MappingError> {
    let list = list_of(path).ok_or_else(|| {
        faulty(
            path,
            "has no list of image names beside it (list.txt or one .lst), in the order of the cameras",
        )
    })?;
    let listed = text(&list)?;
    // A name may be followed by a focal length: `images/a.jpg 0 1520.5`.
    let listed: Vec<&str> =
        listed.lines().map(|line| name_of(line.trim())).filter(|n| !n.is_empty()).collect();
    let content = text(path)?;
    let mut lines = Line::all(path, &content).filter(|line| !line.words[0].starts_with('#'));
    let mut next =
        || lines.next().ok_or_else(|| faulty(path, "ends before its last point; get the file again"));
    let head = next()?;
    let (cameras, points): (usize, usize) =
        (head.number(0, "the number of cameras")?, head.number(1, "the number of points")?);
    if cameras != listed.len() {
        let reason = format!("has {cameras} cameras, and {} has {} names", list.display(), listed.len());
        return Err(faulty(path, reason));
    }
    let mut poses = Poses::default();
    let mut without_file = Vec::new();
    // Of each camera of the file, its place among the images.
    let mut image_of = Vec::with_capacity(listed.len());
    for written in listed {
        let first = next()?;
        let [row_1, row_2, row_3, translation] = [next()?, next()?, next()?, next()?];
        image_of.push(None);
        let camera = first.numbers::<3>(0, "the focal length and distortion").and_then(|lens| {
            if lens[0] == 0.0 {
                return Ok(None);
            }
            let mut rotation = Matrix3::zeros();
            for (row, line) in [&row_1, &row_2, &row_3].into_iter().enumerate() {
                let numbers = line.numbers::<3>(0, "a row of the rotation")?;
                rotation.set_row(row, &Vector3::from(numbers).transpose());
            }
            let translation = Vector3::from(translation.numbers::<3>(0, "the translation")?);
            // The camera's axes, rotated by 180 degrees about x: right, down, forward.
            let turn = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
            let pose = CameraFromWorld::from_matrix(turn * rotation, turn * translation)
                .ok_or_else(|| first.fault("the pose of this camera is no rotation"))?;
            Ok(names.with_size(path, written)?.map(|(name, size)| (name, size, lens, pose)).or_else(|| {
                without_file.push(written.to_owned());
                None
            }))
        });
        let Some(Some((name, size, [focal, k1, k2], pose))) = poses.keep("images", written, camera)? else {
            continue;
        };
        let principal = [0.5 * f64::from(size.0), 0.5 * f64::from(size.1)];
        let lens = Lens { size, focal: [focal; 2], principal, k: [k1, k2, 0.0, 0.0], ..Lens::default() };
        if let Some(camera) = poses.keep("images", written, lens.intrinsics(path))? {
            if let Some(last) = image_of.last_mut() {
                *last = Some(poses.images.len());
            }
            poses.push(name, camera, pose, Vec::new());
        }
    }
    poses.without_file = without_file;
    for _ in 0..u32::try_from(points).map_err(|_| head.fault("there are too many points"))? {
        let (position, _color, views) = (next()?, next()?, next()?);
        let place = position.place();
        let Some(position) = poses.keep("points", &place, position.numbers::<3>(0, "a position"))? else {
            continue;
        };
        let id = poses.points.len() as u32;
        poses.points.push(Point3::from_vector(Vector3::from(position)));
        let count: usize = views.number(0, "the number of views")?;
        for view in 0..count {
            let camera: usize = views.number(1 + 4 * view, "a camera's number")?;
            let image = image_of
                .get(camera)
                .ok_or_else(|| views.fault(format!("is seen by camera {camera}, which does not exist")))?;
            if let Some(image) = image.and_then(|image| poses.images.get_mut(image))
                && image.seen.last() != Some(&id)
            {
                image.seen.push(id);
            }
        }
    }
    Ok(poses)
}

/// The list of image names of a file.
pub(super) fn list_of(path: &Path) -> Option<PathBuf> {
    let beside = |ending: &str| {
        let mut name = path.as_os_str().to_owned();
        name.push(ending);
        PathBuf::from(name)
    };
    let candidates = [beside(".list.txt"), path.with_extension("list.txt"), path.with_file_name("list.txt")];
    // COLMAP writes NAME.bundle.out and NAME.list.txt.
    let name =
        path.file_name().and_then(|name| name.to_str()).and_then(|name| name.strip_suffix(".bundle.out"));
    let of_colmap = name.map(|name| path.with_file_name(format!("{name}.list.txt")));
    candidates.into_iter().chain(of_colmap).find(|list| list.is_file()).or_else(|| only_lst(path))
}

/// The only `.lst` file beside the file, as RealityCapture writes it, or that of its name.
fn only_lst(path: &Path) -> Option<PathBuf> {
    let own = path.with_extension("lst");
    if own.is_file() {
        return Some(own);
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut lists = entries.filter(|path| path.extension().is_some_and(|extension| extension == "lst"));
    lists.next().filter(|_| lists.next().is_none())
}

/// The name at the start of a line of a list; names may contain spaces.
fn name_of(line: &str) -> &str {
    let is_number = |word: &str| word.parse::<f64>().is_ok();
    let mut name = line;
    for _ in 0..2 {
        match name.rsplit_once(char::is_whitespace) {
            Some((rest, last)) if is_number(last) => name = rest.trim_end(),
            _ => break,
        }
    }
    name
}
