//! The server's part: one frame of a session localized from its bytes, and what is known of it then.

use std::collections::BTreeMap;

use crate::results::QueryResult;
use crate::road::{PosedQuery, localize_one};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use veiloc_attacks::{Descriptors, Observation};
use veiloc_geometry::{CameraFromWorld, Pinhole, Pixel, PlanePoint};
use veiloc_localization::{LocalizeOptions, match_query};
use veiloc_map::MapFile;
use veiloc_pose::{ScoreKind, State, estimate_pose};
use veiloc_protocol::{Scheme, SealedQuery};

use super::device::Sealed;
use super::frames::Shown;

/// A frame as the server has it, and how good its pose is.
pub(super) struct Seen {
    /// Its pose against the truth.
    pub(super) result: QueryResult,
    /// What was sent and found out; `None` where the server does not trust its own pose.
    pub(super) posed: Option<Posed>,
}

/// A frame whose pose the server trusts. `[N]`: one entry a row.
pub(super) struct Posed {
    pub(super) camera: Pinhole,
    pub(super) cam_from_world: CameraFromWorld,
    /// `[N]`: what was sent.
    pub(super) lines: Vec<Observation>,
    pub(super) descriptors: Descriptors,
    /// What was sent, all of it.
    pub(super) query: SealedQuery,
    /// `[N]`: where the map point of a row is seen, pixels, and how deep it lies, map units, of those that agree.
    pub(super) known: Vec<Option<(Pixel, f64)>>,
    /// `[N]`: whether a row is of the private region. For judging alone, as the truth.
    pub(super) private: Vec<bool>,
    /// `[N]`: the truth, pixels; `None` of decoys.
    pub(super) truth: Vec<Option<Pixel>>,
}

impl Seen {
    pub(super) fn of(
        sealed: Result<&Sealed, &String>,
        shown: &Shown,
        query: &PosedQuery,
        scheme: Scheme,
        map: &MapFile,
        options: &LocalizeOptions,
    ) -> Self {
        match sealed {
            Ok(sealed) => {
                let result = localize_one(map, &sealed.bytes, query, scheme, ScoreKind::default(), options);
                let trusted = result.state == Some(State::Trusted);
                let posed = if trusted { Posed::of(sealed, shown, map, options) } else { None };
                Self { result, posed }
            }
            Err(error) => {
                let mut result = QueryResult::unsolved(&query.name, scheme, ScoreKind::default());
                result.state = Some(State::NotFound);
                result.failure = Some(error.clone());
                Self { result, posed: None }
            }
        }
    }
}

impl Posed {
    /// `None` where no pose is found.
    fn of(sealed: &Sealed, shown: &Shown, map: &MapFile, options: &LocalizeOptions) -> Option<Self> {
        let query = SealedQuery::decode(&sealed.bytes).ok()?;
        let matched = match_query(&query, map, options).ok()?;
        let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
        let found = estimate_pose(&matched.problem, &options.pose, &mut rng).ok()?;
        let lines = Observation::of_sent(&query.observations());
        let mut best: BTreeMap<usize, (f64, Pixel, f64)> = BTreeMap::new();
        for (c, m) in matched.match_of.iter().enumerate().filter(|(c, _)| found.inliers[*c]) {
            let point = found.cam_from_world.transform(&matched.problem.points[c]);
            let Some(plane) = PlanePoint::from_camera_point(&point) else { continue };
            let weight = matched.problem.prior.as_ref().map_or(0.0, |p| p[c]);
            let at = (weight, matched.problem.camera.project(plane), point.depth());
            let entry = best.entry(matched.rows[*m]).or_insert(at);
            if weight > entry.0 {
                *entry = at;
            }
        }
        let mut known: Vec<Option<(Pixel, f64)>> = vec![None; lines.len()];
        for (row, (_, pixel, depth)) in &best {
            // Rows that share a place share a line, and the server sees that they do.
            for other in (0..lines.len()).filter(|i| lines[*i] == lines[*row]) {
                known[other].get_or_insert((*pixel, *depth));
            }
        }
        let sources = sealed.truth.source.iter().zip(&sealed.truth.pixels);
        Some(Self {
            camera: query.camera(),
            cam_from_world: found.cam_from_world,
            descriptors: Descriptors::of(query.descriptors()),
            known,
            private: sealed
                .truth
                .source
                .iter()
                .map(|source| source.is_some_and(|i| shown.private.get(i) == Some(&true)))
                .collect(),
            truth: sources.map(|(source, pixel)| source.map(|_| *pixel)).collect(),
            lines,
            query,
        })
    }
}
