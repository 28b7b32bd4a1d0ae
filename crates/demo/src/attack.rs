//! The demo's attacks, beside the guess they must beat: those of somebody who has the map's images or several seals of a
//! view, and, told the true neighbours by an oracle, the paper's and the layout of the whole graph. Run as `veiloc attack` runs them.

use rand::SeedableRng;
use rand_chacha::ChaCha20Rng;
use veiloc_audit::{
    Attack, AttackDocument, AttackEvaluation, AttackObserver, AttackTrial, ImageGroup, Stage, attack_groups,
};
use veiloc_datasets::{KeypointImage, seed_for};
use veiloc_features::Progress;
use veiloc_geometry::Pixel;
use veiloc_map::MapFile;
use veiloc_obfuscation::audit::options_for;
use veiloc_obfuscation::{extract, seal_with_truth};
use veiloc_query::Scheme;
use veiloc_report::{QueryPanel, SchemePanel};

use crate::error::DemoError;
use crate::options::DemoOptions;
use crate::place::{RenderedPlace, image};

/// Queries whose images the report shows, and that the graph attack and several seals work on: they take seconds an image.
const SHOWN: usize = 2;
/// Seals of one image.
const SEALS: usize = 8;

/// The figures, and the images for the report.
pub(crate) struct Attacked {
    pub(crate) document: AttackDocument,
    pub(crate) panels: Vec<QueryPanel>,
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
    let mut panels = Vec::new();
    for (index, name) in place.query_list.iter().enumerate() {
        let (sent, panel) = sent_of(place, map, name, options.seed)?;
        images.push(sent);
        if index < SHOWN {
            panels.push(panel);
        }
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
    let mut watched = Watched { panels: &mut panels, stage: Stage::new(progress, "Attacking queries") };
    let mut document = attack_groups(&evaluation, vec![group(&images)], &mut watched)?;
    // Whoever runs the map has its images.
    images.truncate(SHOWN);
    progress.start("Extracting what the map shows", place.map_list.len());
    for name in &place.map_list {
        images.push(sent_of(place, map, name, options.seed)?.0);
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
    Ok(Attacked { document, panels })
}

/// The keypoints that one view sends, in the camera it sends them in, and the panel with what the camera saw.
///
/// Decoys hide nothing, so they are left out: to recover one is no success.
fn sent_of(
    place: &RenderedPlace,
    map: &MapFile,
    name: &str,
    seed: u64,
) -> Result<(KeypointImage, QueryPanel), DemoError> {
    let path = place.images.join(name);
    let (profile, options) = (map.profile(), options_for(Scheme::default()));
    let (features, camera) = extract(&path, &place.camera, profile, &options)?;
    let keypoints = features.keypoints.iter().map(|k| k.pixel).collect();
    let mut rng = ChaCha20Rng::seed_from_u64(seed_for(seed, &[name, "sent"]));
    let (query, truth) = seal_with_truth(features, &camera, profile, &options, &mut rng)
        .map_err(|source| DemoError::Seal { name: name.to_owned(), source })?;
    let real: Vec<usize> = (0..query.len()).filter(|row| truth.source[*row].is_some()).collect();
    let descriptors = query.descriptors().to_owned().select(real.iter().copied());
    let sent = KeypointImage {
        name: name.to_owned(),
        width: query.camera().width,
        height: query.camera().height,
        keypoints: real.iter().map(|row| truth.pixels[*row]).collect(),
        descriptors: Some((descriptors.as_bytes().to_vec(), descriptors.kind().dim())),
    };
    let panel = QueryPanel { name: name.to_owned(), image: image(&path)?, keypoints, schemes: Vec::new() };
    Ok((sent, panel))
}

/// Fills the panels while attacks run.
struct Watched<'a> {
    panels: &'a mut [QueryPanel],
    stage: Stage<'a>,
}

impl AttackObserver for Watched<'_> {
    fn advance(&mut self, _done: usize, total: usize) {
        self.stage.advance(total);
    }

    fn saw(&mut self, trial: &AttackTrial<'_>) {
        let Some(panel) = self.panels.iter_mut().find(|p| p.name == trial.image.name) else { return };
        let scheme = trial.scheme.to_string();
        let at = panel.schemes.iter().position(|s| s.scheme == scheme).unwrap_or_else(|| {
            panel.schemes.push(SchemePanel {
                scheme,
                sent: trial.sent.clone(),
                truth: trial.image.keypoints.clone(),
                recovered: Vec::new(),
                guessed: Vec::new(),
                size: (trial.image.width, trial.image.height),
            });
            panel.schemes.len() - 1
        });
        let answers: Vec<Pixel> = trial.answers.to_vec();
        // Drawn is the strongest attack that was run: it is told as much as the paper's, and shows what that is worth.
        if trial.attack == Attack::PRIOR {
            panel.schemes[at].guessed = answers;
        } else if trial.attack == Attack::GRAPH {
            panel.schemes[at].recovered = answers;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn panels_show_the_graph_attack() {
        let image = veiloc_datasets::synthetic_image(300, 3);
        let mut panels = vec![QueryPanel {
            name: image.name.clone(),
            image: image::RgbImage::new(4, 4),
            keypoints: image.keypoints.clone(),
            schemes: Vec::new(),
        }];
        let evaluation = AttackEvaluation {
            schemes: vec![Scheme::default()],
            attacks: vec![Attack::CLOSED_FORM, Attack::GRAPH],
            seed: 1,
            ..AttackEvaluation::default()
        };
        let group = ImageGroup { name: "one".to_owned(), images: vec![image] };
        let mut watched = Watched { panels: &mut panels, stage: Stage::new(&(), "") };
        attack_groups(&evaluation, vec![group], &mut watched).expect("it runs");
        let shown = &panels[0].schemes[0];
        let near = |answers: &[Pixel]| {
            let hits = answers.iter().zip(&shown.truth).filter(|(a, t)| a.distance(t) < 30.0);
            hits.count() as f64 / shown.truth.len() as f64
        };
        assert!(near(&shown.recovered) > 0.8 && near(&shown.guessed) < 0.5, "{}", near(&shown.recovered));
    }
}
