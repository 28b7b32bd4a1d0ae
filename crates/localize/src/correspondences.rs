//! From what the query tells about a row to what the estimator wants to know about a match.

use veiloc_geometry::{PixelLine, Point3, frames::World};
use veiloc_map::MapFile;
use veiloc_query::Observations;
use veiloc_robust::Correspondences;

use crate::matching::PointMatch;

/// Correspondences, map points, and the match each of them came from, `[N]` each.
pub(crate) struct Expanded {
    pub(crate) observations: Correspondences,
    pub(crate) points: Vec<Point3<World>>,
    pub(crate) match_of: Vec<usize>,
}

/// One correspondence a match; two for coordinate permutation, whose line is either horizontal or vertical.
///
/// Of those two at most one is right. The estimator takes the other for what it is to it, an outlier.
pub(crate) fn expand(observations: &Observations, matches: &[PointMatch], map: &MapFile) -> Expanded {
    let once = || (0..matches.len()).collect::<Vec<_>>();
    let (observations, match_of) = match observations {
        Observations::Points(pixels) => {
            (Correspondences::Points { pixels: matches.iter().map(|m| pixels[m.query]).collect() }, once())
        }
        Observations::Lines(lines) => {
            (Correspondences::Lines { lines: matches.iter().map(|m| lines[m.query]).collect() }, once())
        }
        Observations::EitherLine(pairs) => {
            let lines: Vec<PixelLine> = matches.iter().flat_map(|m| pairs[m.query]).collect();
            (Correspondences::Lines { lines }, (0..matches.len()).flat_map(|i| [i, i]).collect())
        }
        Observations::Anchored { anchors, lines } => (
            Correspondences::Anchored {
                anchors: *anchors,
                lines: matches.iter().map(|m| (lines[m.query].anchor, lines[m.query].angle)).collect(),
            },
            once(),
        ),
    };
    let points = match_of.iter().map(|&i| map.point(matches[i].point)).collect();
    Expanded { observations, points, match_of }
}
