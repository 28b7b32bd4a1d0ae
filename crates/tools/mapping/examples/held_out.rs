//! Coverage on images that are not in the map, with the estimator's covariances, the default calibration, and the map's
//! own calibration:
//!
//! `cargo run --release -p veiloc-mapping --example held_out -- POSED IMAGES MAP_LIST QUERY_LIST`
//!
//! The query list `every-N-from-K` leaves every Nth image of `MAP_LIST` out, from the Kth on, and uses it as a query.
#![expect(clippy::print_stdout, reason = "the table is the product")]

use std::path::Path;

use rand::SeedableRng;
use rand_chacha::ChaCha20Rng;
use rayon::prelude::*;
use veiloc_features::Image;
use veiloc_geometry::nalgebra::{Matrix3, Matrix6, Vector3, Vector6};
use veiloc_localization::{LocalizeOptions, localize};
use veiloc_map::{CovarianceCalibration, MapFile, colmap};
use veiloc_mapping::calibration::{SelfTestOptions, self_test};
use veiloc_mapping::{BuildOptions, Input, build};
use veiloc_obfuscation::{SealOptions, Sealer};
use veiloc_protocol::Scheme;

type Failure = Box<dyn std::error::Error + Send + Sync>;

/// Squared normalized errors of the centre and of the pose.
fn squared(covariance: &[[f64; 6]; 6], step: &[f64; 6]) -> Option<[f64; 2]> {
    let pose = Matrix6::from_fn(|i, j| covariance[i][j]).cholesky()?;
    let center = Matrix3::from_fn(|i, j| covariance[3 + i][3 + j]).cholesky()?;
    let (step, shift) = (Vector6::from(*step), Vector3::new(step[3], step[4], step[5]));
    Some([shift.dot(&center.solve(&shift)), step.dot(&pose.solve(&step))])
}

fn shares(all: &[[f64; 2]], which: usize, radii: [f64; 3]) -> String {
    let share =
        |r: f64| 100.0 * all.iter().filter(|d| d[which] <= r).count() as f64 / all.len().max(1) as f64;
    radii.map(|r| format!("{:3.0}", share(r))).join(" ")
}

fn names(path: &str) -> Result<Vec<String>, Failure> {
    let text = std::fs::read_to_string(path)?;
    Ok(text.lines().map(str::trim).filter(|l| !l.is_empty()).map(str::to_owned).collect())
}

fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [posed, images, map_list, query_list] = &arguments[..] else {
        return Err("POSED IMAGES MAP_LIST QUERY_LIST".into());
    };
    let (posed, images) = (colmap::read_posed(Path::new(posed))?, Path::new(images));
    let mut mapped = if map_list == "all" { posed.names() } else { names(map_list)? };
    let queries = match query_list.strip_prefix("every-").and_then(|q| q.split_once("-from-")) {
        Some((step, from)) => {
            let (step, from): (usize, usize) = (step.parse()?, from.parse()?);
            let out = |i: usize| i % step == from % step;
            let queries = (0..mapped.len()).filter(|i| out(*i)).map(|i| mapped[i].clone()).collect();
            let mut index = 0;
            mapped.retain(|_| {
                index += 1;
                !out(index - 1)
            });
            queries
        }
        None => names(query_list)?,
    };
    let input = Input::new(&posed, images).with_names(&mapped);
    let (mut model, _) = build(&input, &BuildOptions::default(), &())?;
    model.self_test = Some(self_test(&model, &SelfTestOptions::default(), &())?);
    let map = MapFile::of_model(&model)?;
    for scheme in Scheme::ALL {
        let options = SealOptions::new(scheme).unwrap_or_else(|_| SealOptions::unprotected_points());
        let sealer = Sealer::new(map.profile(), options)?;
        let found: Vec<[Option<[f64; 2]>; 3]> = queries
            .par_iter()
            .enumerate()
            .filter_map(|(index, name)| {
                let image = posed.get(name)?;
                let photo = Image::open(&images.join(name)).ok()?;
                let extracted = sealer.extract(photo, image.camera).ok()?;
                let query = sealer.seal(extracted, &mut ChaCha20Rng::seed_from_u64(index as u64)).ok()?;
                let found = localize(&query, &map, &LocalizeOptions::default()).ok()?;
                if index == 0 {
                    println!("  {} pairs of a query: {:.1?}", found.pairs, found.times);
                }
                found.confidence.is_trusted().then(|| {
                    let step = found.cam_from_world.step_to(&image.cam_from_world);
                    let default = CovarianceCalibration::unmeasured(found.confidence.distance);
                    [
                        found.own_covariance,
                        default.apply(&found.own_covariance, &found.camera_covariance),
                        found.covariance,
                    ]
                    .map(|c| squared(&c, &step))
                })
            })
            .collect();
        println!("{} {}: {} of {} trusted", images.display(), scheme.name(), found.len(), queries.len());
        for (k, what) in ["own", "default", "calibrated"].into_iter().enumerate() {
            let all: Vec<[f64; 2]> = found.iter().filter_map(|f| f[k]).collect();
            println!(
                "  {what:<10} centre {}   pose {}",
                shares(&all, 0, [2.366, 6.251, 11.345]),
                shares(&all, 1, [5.348, 10.645, 16.812])
            );
            // Pools the results of all folds.
            for [center, pose] in all {
                println!("  # {} {what} {center:.4} {pose:.4}", scheme.name());
            }
        }
    }
    Ok(())
}
