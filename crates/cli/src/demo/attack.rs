//! The demo's attacks, beside the prior-only baseline: those that need the map's images or several sealed queries of a
//! view, and, with the true neighbours from an oracle, the paper's attack and the layout of the whole graph. They run
//! as in `veiloc attack`.

use rand::SeedableRng;
use rand_chacha::ChaCha20Rng;
use veiloc_datasets::problem_files::{KeypointImage, seed_for};
use veiloc_evaluation::attack_evaluation::{
    Attack, AttackDocument, AttackEvaluation, ImageGroup, ShownImage, ShownImages, evaluate_attacks,
};
use veiloc_features::{Image, Progress};
use veiloc_map::MapFile;
use veiloc_obfuscation::audit::options_for;
use veiloc_obfuscation::{SealError, Sealer};
use veiloc_protocol::Scheme;

use crate::demo::error::DemoError;
use crate::demo::options::DemoOptions;
use crate::demo::scene::RenderedScene;

/// Number of queries for the graph attack and for several sealed queries, which take seconds per image: the one that is drawn.
const SHOWN: usize = 1;
/// Sealed queries per image.
const SEALS: usize = 8;

/// The figures, and the drawings for the report.
pub(crate) struct AttackResults {
    pub(crate) document: AttackDocument,
    /// Positions that attacks recovered from the first query.
    pub(crate) shown: Option<ShownImage>,
}

/// Attacks every hidden view under every scheme that hides positions.
pub(crate) fn attack_all(
    scene: &RenderedScene,
    map: &MapFile,
    options: &DemoOptions,
    progress: &dyn Progress,
) -> Result<AttackResults, DemoError> {
    progress.start("Extracting query keypoints", scene.query_list.len());
    let mut images = Vec::new();
    for name in &scene.query_list {
        images.push(sent_keypoints(scene, map, name, options.seed)?);
        progress.advance(1);
    }
    let mut evaluation = AttackEvaluation {
        schemes: options.schemes.clone(),
        attacks: vec![Attack::CLOSED_FORM],
        seed: options.seed,
        ..AttackEvaluation::default()
    };
    let group = |images: &[KeypointImage]| {
        vec![ImageGroup { name: "hidden views".to_owned(), images: images.to_vec() }]
    };
    evaluation.groups = group(&images);
    let mut drawn = ShownImages::with_limit(1);
    let mut document =
        evaluate_attacks(&evaluation, "Attacking queries", progress, &mut |trial| drawn.add(trial))?;
    // An operator of the map has its images.
    images.truncate(SHOWN);
    progress.start("Extracting map keypoints", scene.map_list.len());
    for name in &scene.map_list {
        images.push(sent_keypoints(scene, map, name, options.seed)?);
        progress.advance(1);
    }
    evaluation.attacks = vec![Attack::TRANSFER, Attack::RESTING_CAMERA, Attack::GRAPH];
    evaluation.frames = vec![SEALS];
    evaluation.images = Some(SHOWN);
    evaluation.groups = group(&images);
    let mut slow_drawn = ShownImages::with_limit(1);
    let stage = "Computing the layout of the neighbour graph";
    let slow = evaluate_attacks(&evaluation, stage, progress, &mut |trial| slow_drawn.add(trial))?;
    let mut shown = drawn.shown.pop();
    let more = slow_drawn.shown.pop().map_or_else(Vec::new, |shown| shown.schemes);
    for (scheme, more) in shown.iter_mut().flat_map(|shown| &mut shown.schemes).zip(more) {
        scheme.attacks.extend(more.attacks.into_iter().filter(|attack| attack.attack != Attack::PRIOR));
    }
    for row in slow.attacks.into_iter().filter(|row| row.attack != Attack::PRIOR) {
        let after = document.attacks.iter().rposition(|r| r.scheme == row.scheme);
        document.attacks.insert(after.map_or(document.attacks.len(), |i| i + 1), row);
    }
    Ok(AttackResults { document, shown })
}

/// Returns the keypoints of one query, in the camera of the query.
///
/// Decoys are left out: they hide nothing, so recovering one is no success.
fn sent_keypoints(
    scene: &RenderedScene,
    map: &MapFile,
    name: &str,
    seed: u64,
) -> Result<KeypointImage, DemoError> {
    let path = scene.images.join(name);
    let sealer = Sealer::new(map.profile(), options_for(Scheme::default()))?;
    let extracted = sealer.extract(Image::open(&path).map_err(SealError::from)?, scene.camera)?;
    let mut rng = ChaCha20Rng::seed_from_u64(seed_for(seed, &[name, "sent"]));
    let (query, truth) = sealer
        .seal_with_truth(extracted, &mut rng)
        .map_err(|source| DemoError::Seal { name: name.to_owned(), source })?;
    let real: Vec<usize> = (0..query.len()).filter(|row| truth.source[*row].is_some()).collect();
    let descriptors = query.descriptors().map(|rows| rows.to_owned().select(real.iter().copied()));
    Ok(KeypointImage {
        name: name.to_owned(),
        width: query.camera().width,
        height: query.camera().height,
        keypoints: real.iter().map(|row| truth.pixels[*row]).collect(),
        descriptors,
    })
}
