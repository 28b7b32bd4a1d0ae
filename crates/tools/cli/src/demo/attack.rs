//! The demo's attacks, beside the guess they must beat: those of somebody who has the map's images or several seals of a
//! view, and, told the true neighbours by an oracle, the paper's and the layout of the whole graph. Run as `veiloc attack` runs them.

use rand::SeedableRng;
use rand_chacha::ChaCha20Rng;
use veiloc_datasets::problem_files::{KeypointImage, seed_for};
use veiloc_evaluation::audit::{
    Attack, AttackDocument, AttackEvaluation, AttackObserver, AttackTrial, ImageGroup, Stage, attack_groups,
};
use veiloc_features::Progress;
use veiloc_map::MapFile;
use veiloc_obfuscation::audit::options_for;
use veiloc_obfuscation::{extract, seal_with_truth};
use veiloc_protocol::Scheme;
use veiloc_report::{AttackedBy, AttackedScheme};

use crate::demo::error::DemoError;
use crate::demo::options::DemoOptions;
use crate::demo::place::RenderedPlace;

/// Queries that the graph attack and several seals work on: they take seconds an image. The first of them is drawn.
const SHOWN: usize = 2;
/// Seals of one image.
const SEALS: usize = 8;

/// The figures, and the drawings for the report.
pub(crate) struct Attacked {
    pub(crate) document: AttackDocument,
    /// What attacks made of the first query.
    pub(crate) drawn: Vec<AttackedScheme>,
}

/// Attacks every hidden view under every scheme that hides positions.
pub(crate) fn attack_all(
    place: &RenderedPlace,
    map: &MapFile,
    options: &DemoOptions,
    progress: &dyn Progress,
) -> Result<Attacked, DemoError> {
    progress.start("Extracting what queries send", place.query_list.len());
    let mut images = Vec::new();
    let mut drawn = Vec::new();
    for name in &place.query_list {
        images.push(sent_of(place, map, name, options.seed)?);
        progress.advance(1);
    }
    let mut evaluation = AttackEvaluation {
        schemes: options.schemes.clone(),
        attacks: vec![Attack::CLOSED_FORM],
        seed: options.seed,
        ..AttackEvaluation::default()
    };
    let group =
        |images: &[KeypointImage]| ImageGroup { name: "hidden views".to_owned(), images: images.to_vec() };
    let shown = place.query_list.first().map_or("", String::as_str);
    let mut watched = Watched { shown, drawn: &mut drawn, stage: Stage::new(progress, "Attacking queries") };
    let mut document = attack_groups(&evaluation, vec![group(&images)], &mut watched)?;
    // Whoever runs the map has its images.
    images.truncate(SHOWN);
    progress.start("Extracting what the map shows", place.map_list.len());
    for name in &place.map_list {
        images.push(sent_of(place, map, name, options.seed)?);
        progress.advance(1);
    }
    evaluation.attacks = vec![Attack::TRANSFER, Attack::RESTING_CAMERA, Attack::GRAPH];
    evaluation.frames = vec![SEALS];
    evaluation.images = Some(SHOWN);
    watched.stage = Stage::new(progress, "Laying out the graph of neighbours");
    let slow = attack_groups(&evaluation, vec![group(&images)], &mut watched)?;
    progress.finish();
    for row in slow.attacks.into_iter().filter(|row| row.attack != Attack::PRIOR) {
        let after = document.attacks.iter().rposition(|r| r.scheme == row.scheme);
        document.attacks.insert(after.map_or(document.attacks.len(), |i| i + 1), row);
    }
    Ok(Attacked { document, drawn })
}

/// The keypoints that one view sends, in the camera it sends them in.
///
/// Decoys hide nothing, so they are left out: to recover one is no success.
fn sent_of(place: &RenderedPlace, map: &MapFile, name: &str, seed: u64) -> Result<KeypointImage, DemoError> {
    let path = place.images.join(name);
    let (profile, options) = (map.profile(), options_for(Scheme::default()));
    let (features, camera) = extract(&path, &place.camera, profile, &options)?;
    let mut rng = ChaCha20Rng::seed_from_u64(seed_for(seed, &[name, "sent"]));
    let (query, truth) = seal_with_truth(features, &camera, profile, &options, &mut rng)
        .map_err(|source| DemoError::Seal { name: name.to_owned(), source })?;
    let real: Vec<usize> = (0..query.len()).filter(|row| truth.source[*row].is_some()).collect();
    let descriptors = query.descriptors().to_owned().select(real.iter().copied());
    Ok(KeypointImage {
        name: name.to_owned(),
        width: query.camera().width,
        height: query.camera().height,
        keypoints: real.iter().map(|row| truth.pixels[*row]).collect(),
        descriptors: Some((descriptors.as_bytes().to_vec(), descriptors.kind().dim())),
    })
}

/// Keeps what is drawn while attacks run.
struct Watched<'a> {
    /// The image that is drawn.
    shown: &'a str,
    drawn: &'a mut Vec<AttackedScheme>,
    stage: Stage<'a>,
}

impl AttackObserver for Watched<'_> {
    fn advance(&mut self, _done: usize, total: usize) {
        self.stage.advance(total);
    }

    fn saw(&mut self, trial: &AttackTrial<'_>) {
        if trial.image.name != self.shown {
            return;
        }
        let scheme = trial.scheme.to_string();
        let at = self.drawn.iter().position(|s| s.scheme == scheme).unwrap_or_else(|| {
            self.drawn.push(AttackedScheme {
                scheme,
                truth: trial.image.keypoints.clone(),
                size: (trial.image.width, trial.image.height),
                guessed: Vec::new(),
                attacks: Vec::new(),
            });
            self.drawn.len() - 1
        });
        let (attack, answers) = (trial.attack, trial.answers.to_vec());
        if attack == Attack::PRIOR {
            self.drawn[at].guessed = answers;
        } else {
            // Neighbours are those of an oracle here, for attacks that ask for them.
            self.drawn[at].attacks.push(AttackedBy { attack, told: attack.needs.neighbours, answers });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use veiloc_geometry::Pixel;

    #[test]
    fn every_attack_is_drawn_beside_the_guess() {
        let image = veiloc_datasets::problem_files::synthetic_image(300, 3);
        let mut drawn = Vec::new();
        let evaluation = AttackEvaluation {
            schemes: vec![Scheme::default()],
            attacks: vec![Attack::CLOSED_FORM, Attack::GRAPH],
            seed: 1,
            ..AttackEvaluation::default()
        };
        let shown = image.name.clone();
        let group = ImageGroup { name: "one".to_owned(), images: vec![image] };
        let mut watched = Watched { shown: &shown, drawn: &mut drawn, stage: Stage::new(&(), "") };
        attack_groups(&evaluation, vec![group], &mut watched).expect("it runs");
        let shown = &drawn[0];
        let near = |answers: &[Pixel]| {
            let hits = answers.iter().zip(&shown.truth).filter(|(a, t)| a.distance(t) < 30.0);
            hits.count() as f64 / shown.truth.len() as f64
        };
        let names: Vec<&str> = shown.attacks.iter().map(|by| by.attack.name).collect();
        assert_eq!(names, [Attack::CLOSED_FORM.name, Attack::GRAPH.name]);
        let graph = near(&shown.attacks[1].answers);
        assert!(graph > 0.8 && near(&shown.guessed) < 0.5 && shown.attacks[1].told, "{graph}");
    }
}
