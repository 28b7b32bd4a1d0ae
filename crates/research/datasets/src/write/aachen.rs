//! Aachen Day-Night, written, with a list of the queries' poses, `queries/poses.txt`, which the published one keeps back.

use std::path::Path;

use veiloc_geometry::Intrinsics;
use veiloc_map::colmap::{ColmapImage, ColmapModel, write_binary};

use super::lists::{make_folder_of, numbers, nvm, quaternion_and_translation, save_text};
use super::{Lens, Role, View};
use crate::error::PlaceError;

/// How the model of the map images is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Model {
    /// v1.
    Nvm,
    /// v1.1.
    Colmap,
}

pub(super) fn write(
    root: &Path,
    model: Model,
    lens: &Lens,
    views: &[View],
    save: &mut dyn FnMut(usize, &Path) -> Result<(), PlaceError>,
) -> Result<(), PlaceError> {
    let camera = lens.camera()?;
    let mut mapped = Vec::new();
    let mut queries = [String::new(), String::new()];
    let mut poses = String::new();
    for (index, view) in views.iter().enumerate() {
        let name = match view.role {
            Role::Map => format!("db/{}.png", mapped.len() + 1),
            Role::Query => format!("query/day/phone/{index}.png"),
            Role::NightQuery => format!("query/night/phone/{index}.png"),
        };
        let image = root.join("images_upright").join(&name);
        make_folder_of(&image)?;
        save(index, &image)?;
        if view.role == Role::Map {
            mapped.push((name, view.cam_from_world));
            continue;
        }
        let list = &mut queries[usize::from(view.role == Role::NightQuery)];
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
    let models = root.join("3D-models");
    match model {
        Model::Nvm => save_text(&models.join("aachen_cvpr2018_db.nvm"), &nvm(&mapped, lens)),
        Model::Colmap => {
            let image = |((name, pose), id): (&(String, _), u32)| ColmapImage {
                id,
                name: name.clone(),
                camera_id: 1,
                cam_from_world: *pose,
                points2d: Vec::new(),
            };
            let images = mapped.iter().zip(1..).map(image).collect();
            let colmap = ColmapModel::new(vec![(1, camera)], images, Vec::new())?;
            Ok(write_binary(&colmap, &models.join("aachen_v_1_1"))?)
        }
    }
}

/// A line of a list of queries, `name MODEL W H PARAMS…`.
fn listed(name: &str, camera: &Intrinsics) -> String {
    format!("{name} {}\n", camera.to_string().replace(',', " "))
}
