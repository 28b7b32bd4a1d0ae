//! Levenberg–Marquardt for any parameters: a pose, a pose with a focal length, the poses of a rig.

/// The end of a descent.
#[derive(Debug, Clone, Copy)]
pub struct DescentResult<At, Here> {
    /// The parameters.
    pub at: At,
    /// The linearization there.
    pub here: Here,
}

/// When to stop.
#[derive(Debug, Clone, Copy)]
pub struct Convergence {
    /// Maximum number of steps.
    pub steps: usize,
    /// The descent ends after a step that gains, or is predicted to gain, no more than this share of the loss (and of
    /// 1).
    pub min_gain: f64,
}

impl Convergence {
    /// For descents that include the focal length.
    pub const OF_FOCAL: Self = Self { steps: 25, min_gain: 1e-9 };
}

/// Damping of the first step, and its bounds.
const INITIAL_DAMPING: f64 = 1e-4;
const MIN_DAMPING: f64 = 1e-10;
const MAX_DAMPING: f64 = 1e8;

/// Descends from a start; never returns a larger loss.
///
/// `look` linearizes at given parameters, and `loss` reads the loss of a linearization. `step` solves for the next
/// parameters under a damping and returns the gain that the quadratic model predicts, or infinity to skip this test;
/// `None` when there is no valid step.
pub fn levenberg_marquardt<At, Here>(
    start: At,
    convergence: Convergence,
    look: impl Fn(&At) -> Here,
    loss: impl Fn(&Here) -> f64,
    step: impl Fn(&At, &Here, f64) -> Option<(At, f64)>,
) -> DescentResult<At, Here> {
    let (mut here, mut at, mut damping) = (look(&start), start, INITIAL_DAMPING);
    for _ in 0..convergence.steps {
        let least = |here: &Here| convergence.min_gain * (1.0 + loss(here).abs());
        let next = step(&at, &here, damping);
        // The predicted gain; if it is too small, this is the last step.
        let last = next.as_ref().map_or(f64::INFINITY, |(_, promised)| *promised) <= least(&here);
        let there = next.map(|(next, _)| {
            let there = look(&next);
            (next, there)
        });
        let Some((next, there)) = there.filter(|(_, there)| loss(there) < loss(&here)) else {
            damping *= 10.0;
            if last || damping > MAX_DAMPING {
                break;
            }
            continue;
        };
        let gained = loss(&here) - loss(&there);
        (at, here) = (next, there);
        damping = (damping * 0.1).max(MIN_DAMPING);
        if last || gained <= least(&here) {
            break;
        }
    }
    DescentResult { at, here }
}
