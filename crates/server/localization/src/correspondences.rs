//! From what the query tells about a row to what the estimator wants to know about a match.

use veiloc_geometry::PixelLine;
use veiloc_pose::Correspondences;
use veiloc_protocol::Observations;

/// What a query tells about its matches, as the robust estimator takes it.
#[derive(Debug, Clone, PartialEq)]
pub struct MatchedObservations {
    /// `[N]`, in the order of the matches.
    pub correspondences: Correspondences,
    /// The row of the query each correspondence belongs to, `[N]`.
    pub keypoints: Vec<usize>,
    /// The match each correspondence came from, `[N]`, rising.
    pub match_of: Vec<usize>,
}

/// One correspondence a match; two for coordinate permutation, whose line is either horizontal or vertical.
///
/// Of those two at most one is right: they share their row, which is how the estimator knows. It takes the other for what
/// it is to it, an outlier.
///
/// `rows[i]` is the row of the query that match `i` belongs to; a row may have several matches.
///
/// # Panics
/// When a row is not in the query.
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
