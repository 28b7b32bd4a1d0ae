//! A distributed build gives the same map as a single process, with complete, duplicate and missing shares.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use veiloc_descriptor::DescriptorKind;
use veiloc_features::{Compact, Extractor, Extractors, FeatureError, Features, Image};
use veiloc_map::{MapModel, PosedImage, PosedImages};
use veiloc_mapping::build_cache::FolderCache;
use veiloc_mapping::{BuildOptions, BuildStage, Input, StageShare, build, prepare};
use veiloc_synthetic::{PathOptions, RenderOptions, RenderedRoom};

/// A rendered scene of this many views, in `folder`.
fn rendered(folder: &Path, views: usize) -> PosedImages {
    let room = RenderedRoom::generate(11);
    let camera = "PINHOLE,320,240,262.4,262.4,160,120".parse().expect("a camera");
    let path = room.camera_path(&PathOptions::with_counts(views, 0));
    let images = path.mapping.iter().enumerate().map(|(k, pose)| {
        let name = format!("{k:03}.png");
        let view = room.render(pose, &camera, &RenderOptions::with_seed(k as u64));
        view.rgb().save(folder.join(&name)).expect("written");
        PosedImage { name, camera, cam_from_world: *pose, seen: Vec::new() }
    });
    PosedImages::new(images.collect(), Vec::new()).expect("posed")
}

/// Counts the extracted images, without the pattern of the build cache.
struct Counting {
    inner: Compact,
    images: Arc<AtomicUsize>,
}

impl Extractor for Counting {
    fn kind(&self) -> DescriptorKind {
        self.inner.kind()
    }

    fn extract(&self, image: &Image, max_keypoints: usize) -> Result<Features, FeatureError> {
        if (image.width(), image.height()) == (320, 240) {
            self.images.fetch_add(1, Ordering::Relaxed);
        }
        self.inner.extract(image, max_keypoints)
    }

    fn support_radius(&self) -> f64 {
        self.inner.support_radius()
    }
}

fn counting() -> (BuildOptions, Arc<AtomicUsize>) {
    let images = Arc::new(AtomicUsize::new(0));
    let mut options = BuildOptions::default();
    options.extractors =
        Extractors::default().with(Counting { inner: Compact::default(), images: Arc::clone(&images) });
    (options, images)
}

#[test]
fn distributed_build_equals_single_process_build() {
    let images = tempfile::tempdir().expect("a folder");
    let posed = rendered(images.path(), 14);
    let input = Input::new(&posed, images.path());
    let (options, extracted) = counting();
    let (alone, _) = build(&input, &options, &()).expect("built");
    assert_eq!(extracted.swap(0, Ordering::Relaxed), 14);

    let work = tempfile::tempdir().expect("a folder");
    let share = |stage, part, of| {
        let cache = FolderCache::in_folder(work.path(), &options).expect("a folder");
        let share = StageShare::new(part, of).expect("a share");
        let done = prepare(&input, &cache, &options, stage, share, &()).expect("prepared");
        cache.finish().expect("kept");
        done
    };
    let built = || -> MapModel {
        let cache = FolderCache::in_folder(work.path(), &options).expect("a folder");
        let (map, _) = build(&input.with_cache(&cache), &options, &()).expect("built");
        cache.finish().expect("kept");
        map
    };

    // Three workers, two with the same share and one without any.
    let done: Vec<_> = [0, 1, 1].map(|part| share(BuildStage::Features, part, 3)).to_vec();
    assert_eq!(done.iter().map(|d| (d.done, d.of_all)).collect::<Vec<_>>(), [(5, 14), (5, 14), (5, 14)]);
    assert_eq!(extracted.load(Ordering::Relaxed), 10);
    for stage in [BuildStage::FirstPairs, BuildStage::Pairs] {
        let done: Vec<_> = (0..2).map(|part| share(stage, part, 2)).collect();
        assert!(done[0].of_all > 10 && done[0].done + done[1].done == done[0].of_all, "{done:?}");
    }
    assert_eq!(built(), alone);
    assert_eq!(extracted.load(Ordering::Relaxed), 14, "missing entries are computed once");

    // A damaged entry costs only time.
    let features = std::fs::read_dir(work.path().join("features")).expect("a folder").next().expect("a file");
    std::fs::write(features.expect("a file").path(), b"not features").expect("written");
    std::fs::write(work.path().join("matches-0.bin"), [7; 1000]).expect("written");
    assert_eq!(built(), alone);
    assert_eq!(extracted.load(Ordering::Relaxed), 15);
}

#[test]
fn added_image_reuses_cached_features() {
    let images = tempfile::tempdir().expect("a folder");
    let posed = rendered(images.path(), 8);
    let names: Vec<String> = posed.images().iter().map(|image| image.name.clone()).collect();
    let work = tempfile::tempdir().expect("a folder");
    let (options, extracted) = counting();
    for (count, fresh) in [(7, 7), (8, 1), (8, 0)] {
        let cache = FolderCache::in_folder(work.path(), &options).expect("a folder");
        let input = Input::new(&posed, images.path()).with_names(&names[..count]);
        let (map, _) = build(&input.with_cache(&cache), &options, &()).expect("built");
        assert_eq!((map.images.len(), extracted.swap(0, Ordering::Relaxed)), (count, fresh));
    }
}
