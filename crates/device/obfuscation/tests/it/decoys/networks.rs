//! Decoys among rows that real networks extract from real images.

use std::path::Path;

use veiloc_descriptor::{Encoding, Vocabulary};
use veiloc_features::Extractor as _;
use veiloc_features::learned::{Learned, Models};
use veiloc_protocol::Profile;
use veiloc_testdata::real_data_test;

use crate::decoys::measures::{check_measures, of_blends, share_counted};
use crate::decoys::{Image, sealed_rows, within};

/// Twenty images of a room and ten of a facade.
fn images(data: &Path, learned: &Learned) -> Vec<Image> {
    let mut images = Vec::new();
    for (scene, count) in [("redkitchen", 20), ("herzjesu", 10)] {
        let list = data.join(scene).join("map.txt");
        let list = std::fs::read_to_string(&list).unwrap_or_else(|e| panic!("{}: {e}", list.display()));
        let names: Vec<&str> = list.lines().filter_map(|line| line.split_whitespace().next()).collect();
        for name in names.iter().step_by(names.len() / count).take(count) {
            let image = veiloc_features::load_gray(&data.join(scene).join("images").join(name));
            let image = veiloc_features::Image::from(image.expect("an image"));
            let size = [image.width(), image.height()];
            images.push(Image { size, features: learned.extract(&image, 1024).expect("extracted") });
        }
    }
    images
}

fn models(data: &Path) -> Models {
    Models::new(vec![data.join("../weights/xfeat")])
}

fn check_decoys(data: &Path, name: &str) {
    let learned = models(data).open(name, None).expect("a file beside the data");
    let images = images(data, &learned);
    let words = images[0].features.descriptors.select(0..8);
    let profile = Profile::vlad(Vocabulary::new(words).expect("eight words"));
    for count in [40, 100] {
        let rows = sealed_rows(&images, count, &profile);
        check_measures(
            &format!("{name} of {count} keypoints"),
            &rows,
            &within(of_blends(learned.kind(), &rows)),
        );
        let share = share_counted(name, &rows, count);
        let is_small = learned.kind().encoding() == Encoding::Coarse;
        // The measure detects the number where it is visible.
        assert!(if is_small || count > learned.kind().dim() { share < 0.5 } else { share > 0.1 }, "{share}");
    }
}

#[real_data_test]
fn xfeat_decoy_auc_matches_documentation(data: &Path) {
    check_decoys(data, "xfeat");
}

#[real_data_test]
fn xfeat_compact_decoy_auc_matches_documentation(data: &Path) {
    check_decoys(data, "xfeat-compact");
}
