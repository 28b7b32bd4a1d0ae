//! A global descriptor of one's own: computed from the image, known to both sides by name.
//!
//! Devices refuse to send one (`veiloc_obfuscation::SealOptions::bounded`): it tells of more than the rows do. Whoever
//! brings one to devices decides there what it may tell; this is how the map, the wire and retrieval take it.

use std::path::Path;

use veiloc::device::{Extractor, Sift, load_gray};
use veiloc::query::{
    AngleBits, CanonicalCamera, Hints, LayoutTurn, PositionRow, Profile, QueryParts, Rows, Scheme,
    SealedQuery, SizeClass,
};
use veiloc::server::{BuildOptions, Input, LocalizeOptions, MapFile, build, localize, write_map};
use veiloc_descriptor::{GlobalDescriptor, GlobalModel, NamedGlobal};

use crate::rendered;

const WIDE: u32 = 16;
const HIGH: u32 = 12;

/// The image made tiny, without its mean: a unit vector times 127.
fn thumbnail(path: &Path) -> GlobalDescriptor {
    let small = load_gray(path).expect("rendered").resized(WIDE, HIGH);
    let mean = small.data().iter().sum::<f32>() / (WIDE * HIGH) as f32;
    let norm = small.data().iter().map(|s| (s - mean).powi(2)).sum::<f32>().sqrt().max(1e-9);
    GlobalDescriptor::new(small.data().iter().map(|s| ((s - mean) / norm * 127.0).round() as i8).collect())
}

#[test]
fn a_map_with_another_global_descriptor_retrieves_and_localizes() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let place = rendered::render(folder.path(), 11).expect("rendered");
    let input = Input::new(&place.posed, &place.folder);
    let (mut model, _) = build(&input, &BuildOptions::default(), &()).expect("built");

    // The map: its images' own thumbnails, and a profile that names the model.
    let named = NamedGlobal::new("thumbnail", (WIDE * HIGH) as usize).expect("in range");
    let kind = model.profile.descriptor_kind();
    model.profile = Profile::new(kind, GlobalModel::Named(named)).expect("fits");
    for image in &mut model.images {
        image.global = thumbnail(&place.folder.join(&image.name));
    }
    let file = folder.path().join("place.vmap");
    write_map(&model, &file).expect("written");
    let map = MapFile::open(&file).expect("opened");
    assert_eq!(map.profile().global_model().name(), "thumbnail");

    let (path, truth) = &place.queries[0];
    let image = veiloc::device::Image::from(load_gray(path).expect("rendered"));
    let camera = CanonicalCamera::for_intrinsics(&place.camera).expect("ordinary");
    let size = SizeClass::for_count(512).rows();
    let features = Sift::default().extract(&image, 2 * size).expect("extracted");
    // As sealing does: what lies beyond the window is dropped.
    let (pinhole, window) = (camera.pinhole(), camera.window(&place.camera));
    let seen =
        |i: usize| pinhole.project(place.camera.unproject(features.keypoints[i].pixel).expect("a ray"));
    let kept: Vec<usize> =
        (0..features.keypoints.len()).filter(|i| window.contains(seen(*i))).take(size).collect();
    assert_eq!(kept.len(), size, "a textured room");
    let rows = kept.iter().map(|i| {
        let p = seen(*i);
        PositionRow::new(p.u - pinhole.principal[0], p.v - pinhole.principal[1]).expect("in the image")
    });
    let parts = |image_global| QueryParts {
        camera,
        scheme: Scheme::Points,
        angle_bits: AngleBits::default(),
        rows: Rows::Points(rows.clone().collect()),
        descriptors: features.descriptors.select(kept.iter().copied()),
        image_global,
        hints: Hints::default(),
        turn: LayoutTurn::default(),
    };
    assert!(SealedQuery::new(map.profile(), parts(None)).is_err(), "the map's comes from the image");
    let query = SealedQuery::new(map.profile(), parts(Some(thumbnail(path)))).expect("it fits");
    let query = SealedQuery::decode(&query.encode()).expect("its own bytes");
    let found = localize(&query, &map, &LocalizeOptions::default()).expect("localized");
    assert!(found.cam_from_world.translation_error(truth) < 0.05, "{}", found.inliers);
    // What is like the query comes first: the nearest map view is among the first three.
    let distance = |name: &str| place.posed.get(name).expect("posed").cam_from_world.translation_error(truth);
    let nearest = place.posed.names().into_iter().min_by(|a, b| distance(a).total_cmp(&distance(b)));
    let first: Vec<String> =
        found.retrieved.iter().take(3).map(|r| map.image(r.image).name().to_owned()).collect();
    assert!(first.contains(&nearest.expect("ten of them")), "{first:?}");
}
