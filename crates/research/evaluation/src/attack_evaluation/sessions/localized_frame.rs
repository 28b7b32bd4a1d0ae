//! The server: one frame of a session localized from its bytes, and the resulting knowledge.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use veiloc_attacks::{DecodedDescriptors, Observation};
use veiloc_geometry::{CameraFromWorld, Pinhole, Pixel};
use veiloc_localization::{LocalizeOptions, match_query};
use veiloc_map::MapFile;
use veiloc_pose::{ScoreKind, State, estimate_pose};
use veiloc_protocol::{Scheme, SealedQuery};

use super::super::inliers::{likeliest_by_row, projected_inliers};
use super::device::Sealed;
use super::recording::{DeviceFrame, Recording};
use crate::pipeline::localize_one;
use crate::results::QueryResult;

/// A frame as the server has it, with the error of its pose.
pub(super) struct LocalizedFrame {
    /// Its pose compared with the truth.
    pub(super) result: QueryResult,
    /// The query with its pose and known points; `None` if the server does not trust its own pose.
    pub(super) posed: Option<TrustedFrame>,
}

/// A frame whose pose the server trusts. `[N]`: one entry per row.
pub(super) struct TrustedFrame {
    pub(super) camera: Pinhole,
    pub(super) cam_from_world: CameraFromWorld,
    /// `[N]`: the sent observations.
    pub(super) lines: Vec<Observation>,
    pub(super) descriptors: DecodedDescriptors,
    /// The sealed query.
    pub(super) query: SealedQuery,
    /// `[N]`: position and depth of the map point of each row that agrees with the pose, pixels and map units.
    pub(super) known: Vec<Option<(Pixel, f64)>>,
    /// `[N]`: whether a row belongs to the private region. For measuring errors only, like the truth.
    pub(super) private: Vec<bool>,
    /// `[N]`: true positions, pixels; `None` for decoys.
    pub(super) truth: Vec<Option<Pixel>>,
}

impl Recording<'_> {
    /// Localizes sealed frames from their bytes.
    pub(super) fn localize(
        &self,
        sealed: &[Result<Sealed, String>],
        shown: &[DeviceFrame],
        scheme: Scheme,
    ) -> Vec<LocalizedFrame> {
        let (map, options, score) = (self.map_file(), self.evaluation.scene.localize(), ScoreKind::default());
        let localize = |(sealed, shown): (&Result<Sealed, String>, &DeviceFrame)| {
            let query = &self.queries[shown.query];
            match sealed {
                Ok(sealed) => {
                    let result = localize_one(map, &sealed.bytes, query, scheme, score, options);
                    let trusted = result.state == Some(State::Trusted);
                    let posed = trusted.then(|| TrustedFrame::of(sealed, shown, map, options)).flatten();
                    LocalizedFrame { result, posed }
                }
                Err(error) => {
                    let mut result = QueryResult::unsolved(&query.name, scheme, score);
                    result.state = Some(State::NotFound);
                    result.failure = Some(error.clone());
                    LocalizedFrame { result, posed: None }
                }
            }
        };
        sealed.par_iter().zip(shown).map(localize).collect()
    }
}

impl TrustedFrame {
    /// `None` where no pose is found.
    fn of(sealed: &Sealed, shown: &DeviceFrame, map: &MapFile, options: &LocalizeOptions) -> Option<Self> {
        let query = SealedQuery::decode(&sealed.bytes).ok()?;
        let matched = match_query(&query, map, options).ok()?;
        let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
        let found = estimate_pose(&matched.problem, &options.pose, &mut rng).ok()?;
        let lines = Observation::of_sent(&query.observations());
        let inliers = projected_inliers(&matched.problem, &found, |c| matched.rows[matched.match_of[c]]);
        let mut known: Vec<Option<(Pixel, f64)>> = vec![None; lines.len()];
        for (row, at) in likeliest_by_row(&inliers) {
            // Rows with equal positions have equal lines, and the server can see that.
            for other in (0..lines.len()).filter(|i| lines[*i] == lines[row]) {
                known[other].get_or_insert(at);
            }
        }
        // A match query has none, and its frames are matched by points.
        let descriptors = match query.descriptors() {
            Some(rows) => DecodedDescriptors::of(rows),
            None => DecodedDescriptors::new(&vec![0; lines.len()], 1).ok()?,
        };
        let sources = sealed.truth.source.iter().zip(&sealed.truth.pixels);
        Some(Self {
            camera: query.camera(),
            cam_from_world: found.cam_from_world,
            descriptors,
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
