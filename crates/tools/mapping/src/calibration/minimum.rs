//! Minimum of a smooth function of three variables without derivatives: the simplex method of Nelder and Mead (*A
//! simplex method for function minimization*, Computer Journal 1965).

type Point = [f64; 3];

/// Returns the best point found from `start`, with initial steps of this size. NaN counts as infinite.
pub(crate) fn minimum(value: impl Fn(&Point) -> f64, start: Point, size: f64) -> Point {
    let value = |p: &Point| {
        let v = value(p);
        if v.is_nan() { f64::INFINITY } else { v }
    };
    let mut simplex: Vec<(f64, Point)> = vec![(value(&start), start)];
    for axis in 0..3 {
        let mut corner = start;
        corner[axis] += size;
        simplex.push((value(&corner), corner));
    }
    for _ in 0..MAX_STEPS {
        simplex.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (best, worst) = (simplex[0], simplex[3]);
        let extent =
            simplex.iter().flat_map(|c| (0..3).map(|k| (c.1[k] - best.1[k]).abs())).fold(0.0, f64::max);
        if extent < TOLERANCE {
            break;
        }
        let middle: Point = std::array::from_fn(|k| simplex[..3].iter().map(|c| c.1[k]).sum::<f64>() / 3.0);
        let along = |t: f64| -> (f64, Point) {
            let p = std::array::from_fn(|k| middle[k] + t * (worst.1[k] - middle[k]));
            (value(&p), p)
        };
        let reflected = along(-1.0);
        let next = if reflected.0 < best.0 {
            let further = along(-2.0);
            Some(if further.0 < reflected.0 { further } else { reflected })
        } else if reflected.0 < simplex[2].0 {
            Some(reflected)
        } else {
            let inside = along(if reflected.0 < worst.0 { -0.5 } else { 0.5 });
            (inside.0 < worst.0.min(reflected.0)).then_some(inside)
        };
        if let Some(next) = next {
            simplex[3] = next;
        } else {
            for corner in &mut simplex[1..] {
                corner.1 = std::array::from_fn(|k| f64::midpoint(best.1[k], corner.1[k]));
                corner.0 = value(&corner.1);
            }
        }
    }
    simplex.sort_by(|a, b| a.0.total_cmp(&b.0));
    simplex[0].1
}

const MAX_STEPS: usize = 400;
const TOLERANCE: f64 = 1e-5;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn simplex_finds_minimum_of_curved_valleys_and_walls() {
        let bowl = |p: &Point| (p[0] - 1.0).powi(2) + 3.0 * (p[1] + 2.0).powi(2) + 0.1 * (p[2] - 5.0).powi(4);
        let found = minimum(bowl, [0.0; 3], 1.0);
        assert!(
            (found[0] - 1.0).abs() < 1e-3 && (found[1] + 2.0).abs() < 1e-3 && (found[2] - 5.0).abs() < 0.1
        );
        let bent = |p: &Point| (1.0 - p[0]).powi(2) + 20.0 * (p[1] - p[0] * p[0]).powi(2) + p[2] * p[2];
        let found = minimum(bent, [-1.0, 1.0, 1.0], 0.5);
        assert!((found[0] - 1.0).abs() < 1e-2 && (found[1] - 1.0).abs() < 1e-2, "{found:?}");
        let wall = |p: &Point| if p[0] < 0.5 { f64::NAN } else { p.iter().map(|x| x * x).sum() };
        assert!((minimum(wall, [2.0, 1.0, 1.0], 0.5)[0] - 0.5).abs() < 0.05);
    }
}
