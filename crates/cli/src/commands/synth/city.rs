//! `veiloc synth city`: hundreds of rendered rooms in one world.

use std::fs;
use std::path::Path;

use veiloc_features::Progress as _;
use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_geometry::{CameraFromWorld, Intrinsics};
use veiloc_map::colmap::{ColmapImage, ColmapModel, write_text};
use veiloc_synthetic::{PathOptions, RenderOptions, RenderedRoom};

use crate::output::exit::{Exit, Failure, Outcome};
use crate::output::stages::Stages;
use crate::output::targets::OutFolder;
use crate::output::ui::Ui;

/// Render many rooms in one world, some of them similar, to test how maps, retrieval and trust scale.
///
/// Writes `images/`, their true poses as a COLMAP text model in `posed/`, and `map.txt` and `query.txt`, in which the
/// images are listed room by room: the first lines are a smaller city. Every fifth room has the furniture and the
/// prints of the room before it, and differs from it in only a part of the other surfaces.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Output folder; it must be new or empty.
    #[arg(long, value_name = "DIR")]
    out: OutFolder,
    /// Number of rooms.
    #[arg(long, default_value_t = 250, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    rooms: u32,
    /// Map views per room.
    #[arg(long, default_value_t = 40, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=10_000))]
    map_views: u32,
    /// Query views per room.
    #[arg(long, default_value_t = 4, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=10_000))]
    query_views: u32,
    /// For a room that is similar to another: share of the surfaces without print that differ.
    #[arg(long, default_value_t = 0.5, value_name = "SHARE")]
    differing: f64,
    /// Width of an image in pixels; the height is three quarters of it.
    #[arg(long, default_value_t = 320, value_name = "PX", value_parser = clap::value_parser!(u32).range(160..=4096))]
    width: u32,
    /// Seed of the city; equal seeds give equal cities.
    #[arg(long, default_value_t = 0, value_name = "N")]
    seed: u64,
}

/// Distance between rooms in metres: no room reaches into the next.
const PITCH: f64 = 12.0;
/// Rooms per row.
const ROW: u64 = 20;
/// Every room of this number is similar to the room before it.
const SIMILAR_EVERY: u64 = 5;

pub(super) fn run(args: &Args, ui: &Ui) -> Outcome {
    super::check_empty(&args.out)?;
    if !(0.0..=1.0).contains(&args.differing) {
        let wrong = format!("--differing is {}", args.differing);
        return Err(Failure::with_help(wrong, "give a share from 0 to 1"));
    }
    let (width, height) = (args.width, args.width * 3 / 4);
    let focal = f64::from(width) * 0.82;
    let camera = format!(
        "PINHOLE,{width},{height},{focal},{focal},{},{}",
        f64::from(width) / 2.0,
        f64::from(height) / 2.0
    );
    let camera: Intrinsics = camera.parse().map_err(super::refused)?;
    let rooms = u64::from(args.rooms);
    let views = (args.map_views + args.query_views) as usize;
    let progress = Stages::new(ui);
    progress.start("Rendering rooms", rooms as usize * views);
    let (mut posed, mut lists) = (Vec::new(), [String::new(), String::new()]);
    for room in 0..rooms {
        let room_scene = rendered_room(args, room);
        let path = room_scene
            .camera_path(&PathOptions::with_counts(args.map_views as usize, args.query_views as usize));
        let folder = format!("room{room:04}");
        make(&args.out.join("images").join(&folder))?;
        let of_map = path.mapping.iter().enumerate().map(|(k, pose)| (0, format!("m{k:03}"), pose));
        let asking = path.queries.iter().enumerate().map(|(k, pose)| (1, format!("q{k:03}"), pose));
        for (index, (list, view, pose)) in of_map.chain(asking).enumerate() {
            let name = format!("{folder}/{view}.png");
            let file = args.out.join("images").join(&name);
            let seed = args.seed.wrapping_add(room * views as u64 + index as u64);
            let rendered = room_scene.render(pose, &camera, &RenderOptions::with_seed(seed));
            rendered.rgb().save(&file).map_err(|e| super::refused(format!("{}: {e}", file.display())))?;
            lists[list].push_str(&name);
            lists[list].push('\n');
            posed.push((name, in_city(pose, room)));
            progress.advance(1);
        }
    }
    progress.finish();
    let images = (1..).zip(posed).map(|(id, (name, cam_from_world))| ColmapImage {
        id,
        name,
        camera_id: 1,
        cam_from_world,
        points2d: Vec::new(),
    });
    let model = ColmapModel::new(vec![(1, camera)], images.collect(), Vec::new())?;
    let folder = args.out.join("posed");
    make(&folder)?;
    write_text(&model, &folder)?;
    for (name, list) in ["map.txt", "query.txt"].iter().zip(&lists) {
        let file = args.out.join(name);
        fs::write(&file, list).map_err(|e| super::refused(format!("{}: {e}", file.display())))?;
    }
    ui.info(format!("{}: {rooms} rooms, {} views", args.out.display(), rooms as usize * views));
    Ok(Exit::Success)
}

/// Returns a new room, or one that is similar to the room before it.
fn rendered_room(args: &Args, room: u64) -> RenderedRoom {
    let seed = |room: u64| args.seed.wrapping_mul(1_000_003).wrapping_add(room);
    if room % SIMILAR_EVERY == SIMILAR_EVERY - 1 {
        RenderedRoom::similar_to(seed(room - 1), seed(room), args.differing)
    } else {
        RenderedRoom::generate(seed(room))
    }
}

/// Converts a pose in a room to a pose in the city: rooms stand in rows, each rotated by its own angle.
fn in_city(cam_from_room: &CameraFromWorld, room: u64) -> CameraFromWorld {
    // The angles must only differ: multiples of the golden angle.
    let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), room as f64 * 2.399_963_229_728_653);
    let corner = Vector3::new((room % ROW) as f64 * PITCH, (room / ROW) as f64 * PITCH, 0.0);
    let rotation = *cam_from_room.rotation() * turn.inverse();
    CameraFromWorld::new(rotation, cam_from_room.translation() - rotation * corner)
}

fn make(folder: &Path) -> Result<(), Failure> {
    fs::create_dir_all(folder).map_err(|e| super::refused(format!("{}: {e}", folder.display())))
}

#[cfg(test)]
mod tests {
    use veiloc_geometry::Point3;
    use veiloc_geometry::frames::World;

    use super::*;

    #[test]
    fn city_poses_preserve_room_views() {
        let room_scene = RenderedRoom::generate(3);
        let pose = room_scene.camera_path(&PathOptions::with_counts(2, 1)).queries[0];
        for room in [0, 1, 27] {
            let moved = in_city(&pose, room);
            let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), room as f64 * 2.399_963_229_728_653);
            let corner = Vector3::new((room % ROW) as f64 * PITCH, (room / ROW) as f64 * PITCH, 0.0);
            let here = Vector3::new(0.5, -1.0, 2.0);
            let there = turn * here + corner;
            let a = pose.transform(&Point3::<World>::new(here.x, here.y, here.z)).coords;
            let b = moved.transform(&Point3::<World>::new(there.x, there.y, there.z)).coords;
            assert!((a - b).norm() < 1e-9, "{a} {b}");
        }
    }
}
