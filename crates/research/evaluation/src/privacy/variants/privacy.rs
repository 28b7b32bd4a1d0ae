//! The judges of privacy: what attackers get out of what one image sends.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use veiloc_attacks::{
    Descriptors, GraphOptions, NeighbourLists, NeighbourPredictor, Transfer, errors_px, graph, prior_only,
};
use veiloc_geometry::{Anchor, PencilLine, Pixel};
use veiloc_protocol::Observations;

use super::sent::Sent;
use veiloc_datasets::problem_files::KeypointImage;
use veiloc_datasets::problem_files::seed_for;

use crate::EvalError;

/// One attack on one image. Errors are those of true keypoints, `[kept]`; decoys have none.
pub(super) struct AttackErrors {
    pub(super) attack: String,
    /// Pixels.
    pub(super) errors: Vec<f64>,
    /// What is left when each anchor's answers are scaled about it as fits the truth best, pixels.
    pub(super) shape: Vec<f64>,
}

/// All attacks on one image.
pub(super) struct Judgement {
    pub(super) attacks: Vec<AttackErrors>,
    /// Predicted neighbours: how many are true, and how many there are; `None` without a predictor.
    pub(super) predicted: Option<(f64, f64)>,
    /// Expected share of true ones when they are drawn at random.
    pub(super) by_lot: f64,
}

/// What attackers hold beside what was sent.
pub(super) struct Attackers<'a> {
    pub(super) k: usize,
    /// Percent of the oracle's neighbours that are replaced at random, one graph attack each.
    pub(super) corrupt: &'a [f64],
    pub(super) transfer: Option<&'a Transfer>,
    pub(super) predictor: Option<&'a NeighbourPredictor>,
    pub(super) seed: u64,
}

/// Runs every attack on one image.
pub(super) fn judge(
    sent: &Sent,
    image: &KeypointImage,
    attackers: &Attackers<'_>,
) -> Result<Judgement, EvalError> {
    let (width, height) = (image.width, image.height);
    let truth = &sent.truth[..sent.kept.len()];
    let mut attacks = Vec::new();
    let mut push = |attack: String, answers: &[Pixel]| {
        let answers = &answers[..truth.len()];
        let errors = errors_px(answers.iter().copied(), truth);
        attacks.push(AttackErrors { attack, errors, shape: shape_errors(sent, answers, truth) });
    };
    push("guess".to_owned(), &prior_only(&sent.observations, width, height));
    let nearest = NeighbourLists::nearest(&sent.truth, attackers.k);
    for &percent in attackers.corrupt {
        // The same lists and starts whatever else is sent, as far as the rows are the same.
        let rng = |what: &str| {
            ChaCha8Rng::seed_from_u64(seed_for(attackers.seed, &[&image.name, what, &percent.to_string()]))
        };
        let told = nearest.corrupted(percent / 100.0, &mut rng("corrupted"));
        let options = GraphOptions::default();
        let answer = graph(&sent.observations, &told, width, height, &options, &mut rng("graph"))?;
        push(graph_name(percent), &answer.pixels);
    }
    if let Some(transfer) = attackers.transfer {
        push("transfer".to_owned(), &transfer.projected(&sent.observations, width, height));
    }
    let entries = |lists: &NeighbourLists| (0..lists.len()).map(|i| lists.of(i).len()).sum::<usize>() as f64;
    let predicted = match attackers.predictor {
        Some(predictor) => {
            let (bytes, dimension) = &sent.descriptors;
            let said = predictor.predict(&Descriptors::new(bytes, *dimension)?, attackers.k)?;
            let count = entries(&said);
            (count > 0.0).then(|| (said.precision(&nearest) * count, count))
        }
        None => None,
    };
    let rows = sent.truth.len() as f64;
    let by_lot = entries(&nearest) / rows.max(1.0) / (rows - 1.0).max(1.0);
    Ok(Judgement { attacks, predicted, by_lot })
}

/// Name of the graph attack with this percentage of false neighbours.
pub(super) fn graph_name(percent: f64) -> String {
    if percent > 0.0 { format!("graph-{percent}") } else { "graph".to_owned() }
}

/// Errors after the answers of each anchor were scaled about it: all half-lines of one anchor scaled together have the
/// same neighbours, so that scale is all that a side without neighbours on the other can hide. An image whose shape is
/// known to a scale shows what it shows.
///
/// The scale is the one of least absolute error: the median of `truth / answer`, weighted by `answer`.
fn shape_errors(sent: &Sent, answers: &[Pixel], truth: &[Pixel]) -> Vec<f64> {
    let Observations::Anchored { lines, .. } = &sent.observed else {
        return errors_px(answers.iter().copied(), truth);
    };
    // Answers move along their line, away from the anchor.
    let placed: Vec<Option<PencilLine>> =
        lines.iter().map(|line| sent.pencils.along(line.anchor, line.angle)).collect();
    let along = |i: usize, p: Pixel| {
        placed[i].map_or(f64::NAN, |line| line.direction.dot(&(p.vector() - line.origin.vector())))
    };
    let scale = Anchor::BOTH.map(|anchor| {
        let mut ratios: Vec<(f64, f64)> = (0..truth.len())
            .filter(|i| lines[*i].anchor == anchor)
            .map(|i| (along(i, truth[i]), along(i, answers[i])))
            .filter(|(_, answer)| *answer > 1e-6)
            .map(|(truth, answer)| (truth / answer, answer))
            .collect();
        ratios.sort_by(|a, b| a.0.total_cmp(&b.0));
        let half = ratios.iter().map(|r| r.1).sum::<f64>() / 2.0;
        let mut below = 0.0;
        let middle = ratios.iter().find(|r| {
            below += r.1;
            below >= half
        });
        middle.map_or(1.0, |r| r.0)
    });
    let scaled = answers.iter().zip(lines).zip(&placed).map(|((p, line), placed)| {
        let (Some(PencilLine { origin, .. }), by) = (placed, scale[line.anchor.index()]) else { return *p };
        Pixel::new(origin.u + by * (p.u - origin.u), origin.v + by * (p.v - origin.v))
    });
    errors_px(scaled, truth)
}

#[cfg(test)]
mod tests {
    use super::super::sent::tests::image;
    use super::*;

    #[test]
    fn a_layout_of_the_wrong_scale_has_the_right_shape() {
        let image = image();
        let sent =
            Sent::of(&"crop=0.5+bits=16".parse().expect("well written"), &image, None, 1).expect("sent");
        let scale = [0.8, 1.25];
        let answers: Vec<Pixel> = sent
            .truth
            .iter()
            .map(|p| {
                let anchor = sent.pencils.anchor_of(*p);
                let (o, by) = (sent.pencils.position(anchor).expect("at the edge"), scale[anchor.index()]);
                Pixel::new(o.u + by * (p.u - o.u), o.v + by * (p.v - o.v))
            })
            .collect();
        let raw = errors_px(answers.iter().copied(), &sent.truth);
        let shape = shape_errors(&sent, &answers, &sent.truth);
        assert!(raw.iter().sum::<f64>() > 20.0 * raw.len() as f64);
        assert!(shape.iter().all(|e| *e < 0.2), "{shape:?}");
    }

    #[test]
    fn decoys_are_attacked_with_the_rest_but_not_counted() {
        let image = image();
        let sent =
            Sent::of(&"random=100+decoys=100".parse().expect("well written"), &image, None, 1).expect("sent");
        let attackers = Attackers { k: 10, corrupt: &[0.0, 40.0], transfer: None, predictor: None, seed: 3 };
        let judged = judge(&sent, &image, &attackers).expect("it runs");
        let names: Vec<&str> = judged.attacks.iter().map(|a| a.attack.as_str()).collect();
        assert_eq!(names, ["guess", "graph", "graph-40"]);
        assert!(judged.attacks.iter().all(|a| a.errors.len() == 100 && a.shape.len() == 100));
        assert!((judged.by_lot - 10.0 / 199.0).abs() < 1e-12 && judged.predicted.is_none());
        let again = judge(&sent, &image, &attackers).expect("it runs");
        assert!(judged.attacks.iter().zip(&again.attacks).all(|(a, b)| a.errors == b.errors), "equal seeds");
    }
}
