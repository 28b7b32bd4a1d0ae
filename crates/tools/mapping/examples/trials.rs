//! Prints the self-test of a map: `cargo run --release -p veiloc-mapping --example trials -- place.vmap`.
#![expect(clippy::print_stdout, reason = "a program")]

use std::path::Path;
use std::time::Instant;

use veiloc_map::MapFile;
use veiloc_mapping::calibration::{SelfTestOptions, self_test};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    for path in std::env::args().skip(1) {
        let model = MapFile::open(Path::new(&path))?.to_model();
        let started = Instant::now();
        let test = self_test(&model, &SelfTestOptions::default(), &())?;
        println!("{path}: {} images, scale {:.3}, {:?}", test.images, test.scale, started.elapsed());
        for s in &test.schemes {
            println!(
                "{:<24} localized {} trusted {} within {:?} {:?}, medians {:.3} deg {:.5}, noise {:.2}",
                s.scheme.name(),
                s.localized,
                s.trusted,
                s.within_of_scale,
                s.within,
                s.median_rotation_deg,
                s.median_translation,
                s.median_noise_px
            );
            println!("   before {:.2?} {:.2?}", s.before.center, s.before.pose);
            println!("   after  {:.2?} {:.2?}", s.after.center, s.after.pose);
            let c = s.calibration;
            println!(
                "   a {:.2}, s_r {:.4} deg, s_t {:.6} ({:.5} of the scale)",
                c.factor,
                c.rotation_floor.to_degrees(),
                c.translation_floor,
                c.translation_floor / test.scale
            );
        }
    }
    Ok(())
}
