//! What a query tells and what an attacker makes of it: for the screen of the device that sealed it.
//!
//! The attacks are the audit's (`veiloc-attacks`), run on what was sealed. Those that need neighbours are told the true ones, which a
//! query does not tell: what is shown is the most that such an attack could recover.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use serde::Serialize;
use veiloc_attacks::{
    ClosedFormOptions, ErrorSummary, GraphOptions, KnownSegment, NeighbourLists, Observation, closed_form,
    errors_px, graph, prior_only,
};
use veiloc_geometry::Pixel;
use veiloc_protocol::{Observations, SealedQuery};

use crate::error::WebError;
use crate::message::{self, floats};
use crate::sealing::Kept;

/// Attacks that can be shown: name and words of the audit's table, and whether true neighbours are told.
pub const ATTACKS: [(&str, &str, bool); 4] = [
    ("prior", "prior-only baseline, from the single line", false),
    ("closed-form", "the paper's attack (closed form)", true),
    ("closed-form-informed", "closed form that knows the scheme", true),
    ("graph", "layout of the neighbour graph", true),
];

/// Neighbours that an oracle tells of each keypoint, as in the audit.
pub const NEIGHBOURS: usize = 20;

#[derive(Serialize)]
struct ShowReply {
    width: u32,
    height: u32,
    /// Segments: `[S, 4]` floats come first.
    segments: usize,
    /// Keypoints that were found, in the image given: `[K, 2]` floats come then.
    keypoints: usize,
    /// Rows that are no decoys: `[R, 2]` floats, in the camera of the query, come last.
    real: usize,
    /// Anchors that lie somewhere.
    anchors: Vec<[f64; 2]>,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct ExhibitReply {
    /// The query's bytes come first; then for each row `[R, 2]` 64-bit floats, little endian, no numbers for a decoy.
    query_bytes: usize,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
struct AttackReply {
    attack: &'static str,
    words: &'static str,
    told_neighbours: bool,
    width: u32,
    height: u32,
    /// `[R, 2]` floats of answers, then `[R, 2]` of the truth.
    count: usize,
    median_px: Option<f64>,
    under_10px: Option<f64>,
    /// Median error of the guess that uses no neighbours.
    guess_median_px: Option<f64>,
}

/// Lines, keypoints found and keypoints sent.
pub fn show(kept: &Kept) -> Vec<u8> {
    let camera = kept.query.camera();
    let sent = kept.query.observations();
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
    let real: Vec<Pixel> = kept.truth.iter().flatten().copied().collect();
    let reply = ShowReply {
        width: camera.width,
        height: camera.height,
        segments: segments.len() / 4,
        keypoints: kept.found.len(),
        real: real.len(),
        anchors,
    };
    let found = kept.found.iter().flatten().copied();
    message::write(&reply, &floats(segments.into_iter().chain(found).chain(flat(&real))))
}

/// All that an attack needs, and the truth it is held against: an attack takes seconds, and the worker that seals has none.
pub fn exhibit(kept: &Kept) -> Vec<u8> {
    let mut bytes = kept.query.encode();
    let query_bytes = bytes.len();
    let truth = kept.truth.iter().flat_map(|truth| truth.map_or([f64::NAN; 2], |p| [p.u, p.v]));
    bytes.extend(truth.flat_map(f64::to_le_bytes));
    message::write(&ExhibitReply { query_bytes }, &bytes)
}

/// What [`exhibit`] wrote: the query, and the keypoint of each row.
fn read_exhibit(query_bytes: usize, bytes: &[u8]) -> Result<(SealedQuery, Vec<Option<Pixel>>), WebError> {
    let wrong = || WebError::Request { reason: "these bytes are no exhibit".to_owned() };
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

/// Answers of an attack, beside the truth. Decoys hide nothing, so they are left out, as in the audit.
///
/// # Errors
/// [`WebError::Option`] for an attack that is not shown; [`WebError::Request`] and [`WebError::Query`] for bytes that are no
/// exhibit; [`WebError::Attack`].
pub fn attack(name: &str, query_bytes: usize, exhibit: &[u8]) -> Result<Vec<u8>, WebError> {
    let known = ATTACKS.iter().find(|attack| attack.0 == name);
    let (attack, words, told_neighbours) = *known.ok_or_else(|| {
        let names = ATTACKS.map(|attack| attack.0).join(", ");
        WebError::Option { name: "attack", reason: format!("{name:?} is not shown; there are {names}") }
    })?;
    let (query, truth) = read_exhibit(query_bytes, exhibit)?;
    let camera = query.camera();
    let (width, height) = (camera.width, camera.height);
    let (observations, truth): (Vec<Observation>, Vec<Pixel>) = Observation::of_sent(&query.observations())
        .into_iter()
        .zip(truth)
        .filter_map(|(observation, truth)| Some((observation, truth?)))
        .unzip();
    let guesses = prior_only(&observations, width, height);
    let answers = match attack {
        "prior" => guesses.clone(),
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
    let of_guess = ErrorSummary::of(&errors_px(guesses, &truth));
    let finite = |number: f64| number.is_finite().then_some(number);
    let reply = AttackReply {
        attack,
        words,
        told_neighbours,
        width,
        height,
        count: truth.len(),
        median_px: finite(errors.median_px),
        under_10px: finite(errors.under_10px),
        guess_median_px: finite(of_guess.median_px),
    };
    Ok(message::write(&reply, &floats(flat(&answers).chain(flat(&truth)))))
}

fn flat(pixels: &[Pixel]) -> impl Iterator<Item = f64> + '_ {
    pixels.iter().flat_map(|pixel| [pixel.u, pixel.v])
}
