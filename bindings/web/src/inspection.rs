//! Shows the content of a query and the result of attacks on it, on the screen of the device that sealed it.
//!
//! The attacks are those of the audit (`veiloc-attacks`). Attacks that need neighbours get the true ones, which a query
//! does not
//! contain: the page shows an upper bound on what such an attack recovers.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use serde::Serialize;
use veiloc_attacks::{
    ClosedFormOptions, ErrorSummary, GraphOptions, KnownSegment, NeighbourLists, Observation, closed_form,
    errors_px, graph, prior_median,
};
use veiloc_geometry::Pixel;
use veiloc_protocol::{Observations, SealedQuery};

use crate::error::WebError;
use crate::message::{self, floats};
use crate::sealing::StoredQuery;

/// The attacks: name and label in the audit's table, and whether the attack gets the true neighbours.
pub const ATTACKS: [(&str, &str, bool); 4] = [
    ("prior", "prior-only baseline, from the single line", false),
    ("closed-form", "the paper's attack (closed form)", true),
    ("closed-form-informed", "closed form that knows the scheme", true),
    ("graph", "layout of the neighbour graph", true),
];

/// Number of true neighbours of each keypoint that an attack gets, as in the audit.
pub const NEIGHBOURS: usize = 20;

#[derive(Serialize)]
struct ShowReply {
    width: u32,
    height: u32,
    /// Number of segments: the payload begins with `[S, 4]` floats.
    segments: usize,
    /// Number of keypoints found, in the original image: `[K, 2]` floats follow.
    keypoints: usize,
    /// Number of rows that are not decoys: `[R, 2]` floats, in the camera of the query, come last.
    real: usize,
    /// Anchors at a finite position.
    anchors: Vec<[f64; 2]>,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct ExhibitReply {
    /// Bytes of the query, which come first; then `[R, 2]` 64-bit floats, little endian, NaN for a decoy.
    query_bytes: usize,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct AttackReply {
    attack: &'static str,
    words: &'static str,
    true_neighbours: bool,
    width: u32,
    height: u32,
    /// `[R, 2]` floats of recovered keypoints, then `[R, 2]` of true keypoints.
    count: usize,
    median_px: Option<f64>,
    under_10px: Option<f64>,
    /// Median error of the prior-only baseline.
    prior_median_px: Option<f64>,
}

/// The reply to `Show`: lines, keypoints found and keypoints sent.
pub fn show(stored: &StoredQuery) -> Vec<u8> {
    let camera = stored.query.camera();
    let sent = stored.query.observations();
    let anchors = match &sent {
        Observations::Anchored { pencils, .. } => {
            pencils.anchors().filter_map(|anchor| pencils.position(anchor)).map(|p| [p.u, p.v]).collect()
        }
        _ => Vec::new(),
    };
    let observations = Observation::of_sent(&sent);
    let segments: Vec<f64> = observations
        .iter()
        .flat_map(|observation| KnownSegment::of(observation, camera.width, camera.height))
        .filter(|segment| !segment.is_empty())
        .flat_map(|segment| {
            let (a, b) = (segment.at(segment.near), segment.at(segment.far));
            [a.u, a.v, b.u, b.v]
        })
        .collect();
    let real: Vec<Pixel> = stored.truth.iter().flatten().copied().collect();
    let reply = ShowReply {
        width: camera.width,
        height: camera.height,
        segments: segments.len() / 4,
        keypoints: stored.found.len(),
        real: real.len(),
        anchors,
    };
    let found = stored.found.iter().flatten().copied();
    message::write(&reply, &floats(segments.into_iter().chain(found).chain(flat(&real))))
}

/// The input of an attack, with the true keypoints. Attacks take seconds, so they run in another worker than sealing.
pub fn exhibit(stored: &StoredQuery) -> Vec<u8> {
    let mut bytes = stored.query.encode();
    let query_bytes = bytes.len();
    let truth = stored.truth.iter().flat_map(|truth| truth.map_or([f64::NAN; 2], |p| [p.u, p.v]));
    bytes.extend(truth.flat_map(f64::to_le_bytes));
    message::write(&ExhibitReply { query_bytes }, &bytes)
}

/// Reads the output of [`exhibit`]: the query, and the keypoint of each row.
fn read_exhibit(query_bytes: usize, bytes: &[u8]) -> Result<(SealedQuery, Vec<Option<Pixel>>), WebError> {
    let wrong = || WebError::Request { reason: "the payload is not an exhibit".to_owned() };
    let (query, truth) = bytes.split_at_checked(query_bytes).ok_or_else(wrong)?;
    let query = SealedQuery::decode(query)?;
    let (numbers, rest) = truth.as_chunks::<16>();
    if numbers.len() != query.len() || !rest.is_empty() {
        return Err(wrong());
    }
    let number = |bytes: &[u8]| bytes.try_into().map_or(f64::NAN, f64::from_le_bytes);
    let pixel = |both: &[u8; 16]| {
        let pixel = Pixel::new(number(&both[..8]), number(&both[8..]));
        (pixel.u.is_finite() && pixel.v.is_finite()).then_some(pixel)
    };
    Ok((query, numbers.iter().map(pixel).collect()))
}

/// The keypoints that an attack recovers, and the true ones. Decoys hide no keypoint, so they are skipped, as in the
/// audit.
///
/// # Errors
/// [`WebError::Option`] for an unknown attack; [`WebError::Request`] and [`WebError::Query`] when the payload is not an
/// exhibit; [`WebError::Attack`].
pub fn attack(name: &str, query_bytes: usize, exhibit: &[u8]) -> Result<Vec<u8>, WebError> {
    let known = ATTACKS.iter().find(|attack| attack.0 == name);
    let (attack, words, true_neighbours) = *known.ok_or_else(|| {
        let names = ATTACKS.map(|attack| attack.0).join(", ");
        WebError::Option {
            name: "attack",
            reason: format!("unknown attack {name:?}; the attacks are {names}"),
        }
    })?;
    let (query, truth) = read_exhibit(query_bytes, exhibit)?;
    let camera = query.camera();
    let (width, height) = (camera.width, camera.height);
    let (observations, truth): (Vec<Observation>, Vec<Pixel>) = Observation::of_sent(&query.observations())
        .into_iter()
        .zip(truth)
        .filter_map(|(observation, truth)| Some((observation, truth?)))
        .unzip();
    let prior_answers = prior_median(&observations, width, height);
    let answers = match attack {
        "prior" => prior_answers.clone(),
        "graph" => {
            let neighbours = NeighbourLists::nearest(&truth, NEIGHBOURS);
            let mut rng = ChaCha8Rng::seed_from_u64(0);
            graph(&observations, &neighbours, width, height, &GraphOptions::default(), &mut rng)?.pixels
        }
        _ => {
            let neighbours = NeighbourLists::nearest(&truth, NEIGHBOURS);
            let options = match attack {
                "closed-form" => ClosedFormOptions::default(),
                _ => ClosedFormOptions::informed(),
            };
            let found = closed_form(&observations, &neighbours, width, height, &options)?;
            found.iter().map(|answer| answer.pixel).collect()
        }
    };
    let errors = ErrorSummary::of(&errors_px(answers.iter().copied(), &truth));
    let prior_errors = ErrorSummary::of(&errors_px(prior_answers, &truth));
    let finite = |number: f64| number.is_finite().then_some(number);
    let reply = AttackReply {
        attack,
        words,
        true_neighbours,
        width,
        height,
        count: truth.len(),
        median_px: finite(errors.median_px),
        under_10px: finite(errors.under_10px),
        prior_median_px: finite(prior_errors.median_px),
    };
    Ok(message::write(&reply, &floats(flat(&answers).chain(flat(&truth)))))
}

fn flat(pixels: &[Pixel]) -> impl Iterator<Item = f64> + '_ {
    pixels.iter().flat_map(|pixel| [pixel.u, pixel.v])
}
