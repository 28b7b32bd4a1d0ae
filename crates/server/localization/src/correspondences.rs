//! Converts the observations of a query to the correspondences of the estimator.

use veiloc_geometry::PixelLine;
use veiloc_pose::Correspondences;
use veiloc_protocol::Observations;

/// The observations of the matches, in the form of the robust estimator.
#[derive(Debug, Clone, PartialEq)]
pub struct MatchedObservations {
    /// `[N]`, in the order of the matches.
    pub correspondences: Correspondences,
    /// Row of the query of each correspondence, `[N]`.
    pub keypoints: Vec<usize>,
    /// Match of each correspondence, `[N]`, ascending.
    pub match_of: Vec<usize>,
}

/// One correspondence per match; two for coordinate permutation, whose line is either horizontal or vertical.
///
/// At most one of the two is right. They have the same row, by which the estimator recognizes the pair; the other one
/// is an outlier.
///
/// `rows[i]` is the row of match `i`; a row may have several matches.
///
/// # Panics
/// If a row is not in the query.
pub fn observe_matches(observations: &Observations, rows: &[usize]) -> MatchedObservations {
    let once = || (0..rows.len()).collect::<Vec<_>>();
    let (correspondences, match_of): (_, Vec<usize>) = match observations {
        Observations::Points(pixels) => {
            (Correspondences::Points { pixels: rows.iter().map(|&r| pixels[r]).collect() }, once())
        }
        Observations::Lines(lines) => {
            (Correspondences::Lines { lines: rows.iter().map(|&r| lines[r]).collect() }, once())
        }
        Observations::EitherLine(pairs) => {
            let lines: Vec<PixelLine> = rows.iter().flat_map(|&r| pairs[r]).collect();
            (Correspondences::Lines { lines }, (0..rows.len()).flat_map(|i| [i, i]).collect())
        }
        Observations::Anchored { pencils, lines } => (
            Correspondences::Anchored {
                pencils: pencils.clone(),
                lines: rows.iter().map(|&r| (lines[r].anchor, lines[r].angle)).collect(),
            },
            once(),
        ),
    };
    let keypoints = match_of.iter().map(|&m| rows[m]).collect();
    MatchedObservations { correspondences, keypoints, match_of }
}
