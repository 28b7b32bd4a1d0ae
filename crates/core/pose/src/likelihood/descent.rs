//! Levenberg–Marquardt, whatever it is that moves: a pose, a pose with a focal length, the poses of a rig.

/// Where a descent came to.
#[derive(Debug, Clone, Copy)]
pub struct Descended<At, Here> {
    /// The place.
    pub at: At,
    /// What is known there.
    pub here: Here,
}

/// How long to descend.
#[derive(Debug, Clone, Copy)]
pub struct Convergence {
    /// Steps at most.
    pub steps: usize,
    /// A step that gains, or promises, no more than this share of the loss (and of 1) is the last.
    pub least_gain: f64,
}

impl Convergence {
    /// Where the focal length moves too.
    pub const OF_FOCAL: Self = Self { steps: 25, least_gain: 1e-9 };
}

/// Damping of the first step, and its bounds.
const FIRST: f64 = 1e-4;
const LEAST: f64 = 1e-10;
const MOST: f64 = 1e8;

/// Descends from a start; never to a larger loss.
///
/// `look` tells what is known at a place (its derivatives), `loss` reads the loss off that. `step` solves for the next place
/// under a damping and tells what the quadratic model promises to gain there, infinite when that is not asked; `None` when
/// there is no such place.
pub fn levenberg_marquardt<At, Here>(
    start: At,
    convergence: Convergence,
    look: impl Fn(&At) -> Here,
    loss: impl Fn(&Here) -> f64,
    step: impl Fn(&At, &Here, f64) -> Option<(At, f64)>,
) -> Descended<At, Here> {
    let (mut here, mut at, mut damping) = (look(&start), start, FIRST);
    for _ in 0..convergence.steps {
        let least = |here: &Here| convergence.least_gain * (1.0 + loss(here).abs());
        let next = step(&at, &here, damping);
        // What the quadratic model promises; when that is too little, this is the last step.
        let last = next.as_ref().map_or(f64::INFINITY, |(_, promised)| *promised) <= least(&here);
        let there = next.map(|(next, _)| {
            let there = look(&next);
            (next, there)
        });
        let Some((next, there)) = there.filter(|(_, there)| loss(there) < loss(&here)) else {
            damping *= 10.0;
            if last || damping > MOST {
                break;
            }
            continue;
        };
        let gained = loss(&here) - loss(&there);
        (at, here) = (next, there);
        damping = (damping * 0.1).max(LEAST);
        if last || gained <= least(&here) {
            break;
        }
    }
    Descended { at, here }
}
