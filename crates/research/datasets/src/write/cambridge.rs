//! Cambridge Landmarks, written.

use std::path::Path;

use super::lists::{make_folder_of, numbers, nvm, save_text};
use super::{Lens, Role, View};
use crate::error::PlaceError;

const HEAD: &str = "Visual Landmark Dataset V1\nImageFile, Camera Position [X Y Z W P Q R]\n\n";

pub(super) fn write(
    root: &Path,
    scene: &str,
    lens: &Lens,
    views: &[View],
    save: &mut dyn FnMut(usize, &Path) -> Result<(), PlaceError>,
) -> Result<(), PlaceError> {
    let folder = root.join(scene);
    let mut lists = [HEAD.to_owned(), HEAD.to_owned()];
    let mut cameras = Vec::new();
    let mut counts = [0; 2];
    for (index, view) in views.iter().enumerate() {
        let side = usize::from(view.role != Role::Map);
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
