//! Drawings of what was localized: from queries, answers and maps, which no document holds.

use veiloc_evaluation::DrawnQuery;
use veiloc_localization::Localization;
use veiloc_map::{MapFile, PointId};
use veiloc_protocol::SealedQuery;

use super::data::{PlaceView, QueryDrawing, RowState, SentDrawing};
use crate::undistort::undistorted;

/// Map points kept for drawing; more only make the file larger.
const MOST_POINTS: usize = 24_000;

impl PlaceView {
    /// Of a map; every so-and-so-many-th of its points where it has many.
    pub fn of_map(name: &str, map: &MapFile) -> Self {
        let step = map.point_count().div_ceil(MOST_POINTS).max(1);
        let points = (0..map.point_count()).step_by(step);
        Self {
            name: name.to_owned(),
            points: points.map(|i| map.point(PointId(i as u32)).coords.into()).collect(),
            mapping: map.images().map(|image| *image.cam_from_world()).collect(),
            up: map.down().map(|down| down.in_world().map(|x| -x)),
        }
    }
}

impl SentDrawing {
    /// Of a sealed query, and its pose where it has one.
    pub fn of(query: &SealedQuery, found: Option<&Localization>, map: &MapFile) -> Self {
        let camera = query.camera();
        let mut rows = vec![RowState::Unmatched; query.len()];
        let mut projected = Vec::new();
        if let Some(found) = found {
            for pair in &found.matched {
                let Some(state) = rows.get_mut(pair.row) else { continue };
                match (pair.agrees, *state) {
                    (true, RowState::Unmatched | RowState::Disagrees) => *state = RowState::Agrees,
                    (false, RowState::Unmatched) => *state = RowState::Disagrees,
                    _ => {}
                }
                let seen = found.cam_from_world.transform(&map.point(pair.point));
                if pair.agrees && seen.depth() > 0.0 {
                    let at = seen.coords / seen.depth();
                    projected.push(camera.project(veiloc_geometry::PlanePoint::new(at.x, at.y)));
                }
            }
        }
        Self {
            scheme: query.scheme().to_string(),
            sent: query.observations(),
            size: (camera.width, camera.height),
            rows,
            projected,
        }
    }
}

impl QueryDrawing {
    /// Of a query of an evaluation, its image with it where that is wanted and can be read.
    pub fn of(drawn: &DrawnQuery, place: usize, map: &MapFile, with_image: bool) -> Self {
        let camera = drawn.sent.first().map(|sent| sent.query.camera());
        let image = camera.filter(|_| with_image).and_then(|camera| {
            let image = image::open(&drawn.path).ok()?.to_rgb8();
            Some(undistorted(&image, &drawn.camera, &camera))
        });
        let sent = drawn.sent.iter().map(|sent| SentDrawing::of(&sent.query, sent.found.as_ref(), map));
        Self { place, name: drawn.name.clone(), image, sent: sent.collect() }
    }
}
