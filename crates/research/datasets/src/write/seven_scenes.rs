//! 7Scenes, written: sequence 1 is the map's, sequence 2 the queries'; poses both as matrices and as lists.

use std::fmt::Write as _;
use std::path::Path;

use super::lists::{make_folder_of, numbers, quaternion_and_translation, save_text};
use super::{Lens, Role, View};
use crate::error::PlaceError;

pub(super) fn write(
    root: &Path,
    scene: &str,
    lens: &Lens,
    views: &[View],
    save: &mut dyn FnMut(usize, &Path) -> Result<(), PlaceError>,
) -> Result<(), PlaceError> {
    let folder = root.join(scene);
    let mut lists = [String::new(), String::new()];
    let mut counts = [0; 2];
    for (index, view) in views.iter().enumerate() {
        let side = usize::from(view.role != Role::Map);
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
fn matrix(view: &View) -> String {
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
