//! The expected ± over a place, from above.

use std::fmt::Write as _;

use maud::{Markup, html};
use veiloc_geometry::nalgebra::Vector3;

use crate::numbers::LengthUnit;
use crate::page::figure;
use crate::scene::SceneView;
use crate::top_view::{Plan, TopView, page_axes};

/// Classes of a heat map, best first.
const CLASSES: usize = 4;
const CLASS_NAMES: [&str; CLASSES] = ["h0", "h1", "h2", "h3"];

/// The expected ± of positions on the ground.
#[derive(Debug, Clone, Default)]
pub struct HeatMap {
    /// The cells.
    pub cells: Vec<HeatCell>,
}

/// A square of ground.
#[derive(Debug, Clone)]
pub struct HeatCell {
    /// Its corners in the map, in order around it.
    pub corners: [[f64; 3]; 4],
    /// Expected ± of the position of a camera there, map units; `None` if it is not expected to be localized in any direction.
    pub sd: Option<f64>,
    /// Share of the directions in which it is expected to be localized, 0 to 1.
    pub share: f64,
}

/// The drawings with their legends; empty without cells.
pub(crate) fn section(heat: &HeatMap, scene: &SceneView, unit: LengthUnit) -> Markup {
    let (right, up) = page_axes(scene);
    let view = TopView { points: &scene.points, right, up, cameras: &scene.cameras };
    let Some(plan) = Plan::new(&view, &[]).filter(|_| !heat.cells.is_empty()) else { return html! {} };
    let bounds = bounds(heat);
    let of_sd = |cell: &HeatCell| cell.sd.map(|sd| bounds.iter().take_while(|bound| sd > **bound).count());
    let of_share =
        |cell: &HeatCell| cell.sd.map(|_| SHARES.iter().take_while(|bound| cell.share < **bound).count());
    let deviations: [String; CLASSES] = std::array::from_fn(|at| match at {
        at if at == CLASSES - 1 => format!("± above {}", unit.with_unit(bounds[at - 1])),
        at => format!("± up to {}", unit.with_unit(bounds[at])),
    });
    let shares: [String; CLASSES] = std::array::from_fn(|at| match at {
        0 => format!("{:.0} % or more of the directions", 100.0 * SHARES[0]),
        at if at == CLASSES - 1 => format!("fewer than {:.0} %", 100.0 * SHARES[at - 1]),
        at => format!("{:.0} to {:.0} %", 100.0 * SHARES[at], 100.0 * SHARES[at - 1]),
    });
    let drawing = |name: &str, words: &[String; CLASSES], of: &dyn Fn(&HeatCell) -> Option<usize>| {
        let image = html! {
            svg viewBox=(plan.view_box()) role="img" aria-label={ (name) ", from above" } {
                (cells(heat, &plan, of))
                (plan.ground(&view))
                (plan.scale_bar(unit))
            }
        };
        html! { div { (figure(&image, &html! { b { (name) "." } })) (legend(heat, words, of)) } }
    };
    html! {
        p {
            "A level camera stands on the ground near the images and looks in twelve directions. It is expected to be localized where it \
             sees the map's points from directions and distances like those of the images, as exactly as these points determine its \
             pose. The scale is that of the map's own images, localized in the map without them. Obstacles between images are not \
             known. Dots are map points, triangles the images of the map."
        }
        div.two {
            (drawing("Expected ± of the position, median of the directions that are localized", &deviations, &of_sd))
            (drawing("Share of the directions that are localized", &shares, &of_share))
        }
    }
}

/// Bounds between the classes of shares, best first.
const SHARES: [f64; CLASSES - 1] = [0.75, 0.5, 0.25];

/// The cells, a path for each class; a cell without a class is not localized.
fn cells(heat: &HeatMap, plan: &Plan, of: &dyn Fn(&HeatCell) -> Option<usize>) -> Markup {
    let path = |class: Option<usize>| {
        let mut d = String::new();
        for cell in heat.cells.iter().filter(|cell| of(cell) == class) {
            for (at, corner) in cell.corners.iter().enumerate() {
                let q = plan.project(Vector3::from(*corner));
                let _ = write!(d, "{}{:.1} {:.1}", if at == 0 { 'M' } else { 'L' }, q.x, q.y);
            }
            d.push('Z');
        }
        d
    };
    html! {
        @for (at, class) in CLASS_NAMES.into_iter().enumerate() { path class={ "heat " (class) } d=(path(Some(at))) {} }
        path.heat.lost d=(path(None)) {}
    }
}

/// The classes with their shares of the ground.
fn legend(heat: &HeatMap, words: &[String; CLASSES], of: &dyn Fn(&HeatCell) -> Option<usize>) -> Markup {
    let share = |class: Option<usize>| {
        let count = heat.cells.iter().filter(|cell| of(cell) == class).count();
        format!("{:.0} %", 100.0 * count as f64 / heat.cells.len().max(1) as f64)
    };
    let entry = |class: &str, words: &str, share: &str| {
        html! {
            li {
                svg viewBox="0 0 14 14" aria-hidden="true" { rect class={ "heat " (class) } width="14" height="14" {} }
                (words) " (" (share) ")"
            }
        }
    };
    html! {
        ul.legend {
            @for (at, class) in CLASS_NAMES.into_iter().enumerate() { (entry(class, &words[at], &share(Some(at)))) }
            (entry("lost", "not localized", &share(None)))
        }
    }
}

/// Bounds between the classes of ±, each twice the one before; the first is a round number near the lower quartile.
fn bounds(heat: &HeatMap) -> [f64; CLASSES - 1] {
    let mut all: Vec<f64> = heat.cells.iter().filter_map(|cell| cell.sd).filter(|sd| *sd > 0.0).collect();
    all.sort_by(f64::total_cmp);
    let quartile = all.get(all.len() / 4).copied().unwrap_or(1.0);
    let power = 10f64.powf(quartile.log10().floor());
    let first = [5.0, 2.0, 1.0].into_iter().map(|m| m * power).find(|m| *m <= quartile).unwrap_or(power);
    [first, 2.0 * first, 4.0 * first]
}

#[cfg(test)]
mod tests {
    use super::*;
    use veiloc_geometry::CameraFromWorld;

    fn cell(x: f64, sd: Option<f64>, share: f64) -> HeatCell {
        HeatCell {
            corners: [[x, 0.0, 0.0], [x + 1.0, 0.0, 0.0], [x + 1.0, 1.0, 0.0], [x, 1.0, 0.0]],
            sd,
            share,
        }
    }

    #[test]
    fn every_cell_is_drawn_in_the_class_of_its_value() {
        let heat = HeatMap {
            cells: vec![
                cell(0.0, Some(0.02), 1.0),
                cell(1.0, Some(0.025), 0.6),
                cell(2.0, Some(0.2), 0.5),
                cell(3.0, None, 0.0),
            ],
        };
        assert_eq!(bounds(&heat), [0.02, 0.04, 0.08]);
        let scene = SceneView {
            points: vec![[0.0, 0.0, 1.0], [4.0, 1.0, 1.0]],
            cameras: vec![CameraFromWorld::identity()],
            up: Some([0.0, 0.0, 1.0]),
            ..SceneView::default()
        };
        let drawn = section(&heat, &scene, LengthUnit::Metres).into_string();
        let figures: Vec<&str> = drawn.split("<figure").skip(1).collect();
        let cells = |figure: usize, class: &str| {
            let path = figures[figure]
                .split("<path ")
                .find(|path| path.starts_with(&format!("class=\"heat {class}\"")));
            path.expect("a path").split('>').next().expect("its start").matches('Z').count()
        };
        assert_eq!(["h0", "h1", "h2", "h3", "lost"].map(|class| cells(0, class)), [1, 1, 0, 1, 1], "{drawn}");
        assert_eq!(["h0", "h1", "h2", "h3", "lost"].map(|class| cells(1, class)), [1, 2, 0, 0, 1], "{drawn}");
        for words in
            ["± up to 2 cm (25 %)", "± up to 4 cm (25 %)", "± above 8 cm (25 %)", "50 to 75 % (50 %)"]
        {
            assert!(drawn.contains(words), "{words}: {drawn}");
        }
        assert!(section(&HeatMap::default(), &scene, LengthUnit::Map).0.is_empty());
    }
}
