//! Attacks the user's own images under every scheme that hides positions.
//!
//! `cargo run --release -p veiloc --features audit --example attack_own_images -- IMAGE…` (without images: on a
//! rendered scene)
#![expect(clippy::print_stdout, reason = "an example talks to its terminal")]

mod rendered;

use std::error::Error;
use std::path::{Path, PathBuf};

use veiloc::audit::{
    Attack, AttackDocument, AttackEvaluation, ImageGroup, attacks_table, evaluate_attacks,
    keypoints_of_images,
};
use veiloc::device::Sift;
use veiloc::protocol::ExtractionLimits;

fn main() -> Result<(), Box<dyn Error>> {
    let images = std::env::args_os().skip(1).map(PathBuf::from).collect();
    println!("{}", attacks_table(&run(images)?));
    Ok(())
}

/// Attacks these images, or, without images, those of a rendered scene.
pub(crate) fn run(mut images: Vec<PathBuf>) -> Result<AttackDocument, Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    if images.is_empty() {
        println!("no images given: attacking an image of a rendered scene");
        images = rendered_images(folder.path())?;
    }
    attack(&images)
}

fn rendered_images(folder: &Path) -> Result<Vec<PathBuf>, Box<dyn Error>> {
    Ok(rendered::render(folder, 11)?.queries.into_iter().take(1).map(|(path, _)| path).collect())
}

/// The paper's attack and the layout of the neighbour graph, both with true neighbours, beside the prior-only
/// baseline.
fn attack(images: &[PathBuf]) -> Result<AttackDocument, Box<dyn Error>> {
    let limits = ExtractionLimits { max_keypoints: 512, ..ExtractionLimits::default() };
    let images = keypoints_of_images(images, &Sift::for_sealing(), limits, &())?;
    let evaluation = AttackEvaluation {
        groups: vec![ImageGroup { name: "own images".to_owned(), images }],
        attacks: vec![Attack::CLOSED_FORM, Attack::GRAPH],
        ..AttackEvaluation::default()
    };
    Ok(evaluate_attacks(&evaluation, "Attacking", &(), &mut |_| {})?)
}
