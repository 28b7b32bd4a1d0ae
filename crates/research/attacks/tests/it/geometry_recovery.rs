//! The closed form against a numeric minimiser, its singular cases, and the paper's synthetic scene.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_attacks::{
    AttackError, ClosedFormOptions, ErrorSummary, KnownSegment, NeighbourExtent, NeighbourLists, Observation,
    bits_over_prior, closed_form, errors_px, expected_positions, lift, prior_only,
};
use veiloc_geometry::{Layout, Pencils, Pixel, PixelLine};

const SIZE: (u32, u32) = (640, 480);

fn uniform(n: usize, seed: u64) -> Vec<Pixel> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..n).map(|_| Pixel::new(rng.random_range(0.0..640.0), rng.random_range(0.0..480.0))).collect()
}

fn attack(sent: &[Observation], lists: &NeighbourLists) -> Vec<veiloc_attacks::RecoveredKeypoint> {
    closed_form(sent, lists, SIZE.0, SIZE.1, &ClosedFormOptions::default()).expect("lists fit")
}

fn cost(sent: &[Observation], list: &[u32], x: Pixel) -> f64 {
    list.iter().map(|&j| sent[j as usize].distance(x).powi(2)).sum()
}

/// Minimum over a piece of the line: a dense search, then golden section around the best sample.
fn search(f: &dyn Fn(f64) -> f64, low: f64, high: f64) -> f64 {
    let steps = 4000;
    let step = (high - low) / f64::from(steps);
    let start = (0..=steps).map(|i| low + f64::from(i) * step).min_by(|a, b| f(*a).total_cmp(&f(*b)));
    let start = start.expect("samples");
    let (mut a, mut b) = ((start - step).max(low), (start + step).min(high));
    let golden = 0.5 * (5.0_f64.sqrt() - 1.0);
    for _ in 0..100 {
        let (c, d) = (b - golden * (b - a), a + golden * (b - a));
        if f(c) < f(d) { b = d } else { a = c }
    }
    f64::midpoint(a, b)
}

#[test]
fn closed_form_equals_numeric_minimum() {
    let truth = uniform(300, 2);
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let lists = NeighbourLists::nearest(&truth, 12);
    let pencils = Pencils::of_image([640, 480], &Layout::halves(0.9, 1.3).expect("finite"));
    let schemes = [
        lift::random_lines(&truth, &mut rng),
        lift::coordinate_permutation(&truth, &mut rng),
        lift::dual_convergent(&truth, &pencils),
        // Two lines with arbitrary directions: the sweep must not rely on right angles.
        truth
            .iter()
            .map(|&p| {
                let mut through = || PixelLine::through(p, rng.random_range(0.0..3.2));
                let own = through();
                Observation::EitherLine([PixelLine::through(Pixel::new(p.u + 30.0, p.v), 1.0), own])
            })
            .collect(),
    ];
    for (s, sent) in schemes.iter().enumerate() {
        let inside = closed_form(sent, &lists, 640, 480, &ClosedFormOptions::in_image()).expect("lists fit");
        let free = attack(sent, &lists);
        for i in 0..truth.len() {
            let found = KnownSegment::of(&sent[i], 640, 480)
                .into_iter()
                .map(|segment| {
                    let f = |t: f64| cost(sent, lists.of(i), segment.at(t));
                    f(search(&f, segment.near, segment.far))
                })
                .fold(f64::INFINITY, f64::min);
            let answer = cost(sent, lists.of(i), inside[i].pixel);
            assert!((answer - inside[i].cost).abs() < 1e-6 * (1.0 + answer), "scheme {s}: reported cost");
            assert!(
                (answer - found).abs() < 1e-6 * (1.0 + found),
                "scheme {s}, {i}: {answer} against {found}"
            );
            // The whole line includes the segment, and its answer must be a local minimum as well.
            assert!(free[i].cost <= inside[i].cost * (1.0 + 1e-9) + 1e-9, "scheme {s}, {i}");
            assert!(sent[i].distance(free[i].pixel) < 1e-6 * (1.0 + free[i].pixel.distance(&truth[i])));
        }
    }
}

#[test]
fn proposition_1_answer_is_weighted_mean_of_intersections() {
    let truth = uniform(60, 4);
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let sent = lift::random_lines(&truth, &mut rng);
    let lists = NeighbourLists::nearest(&truth, 8);
    for (i, answer) in attack(&sent, &lists).iter().enumerate() {
        let own = sent[i].lines()[0].expect("a line");
        let (mut weights, mut weighted) = (0.0, 0.0);
        for &j in lists.of(i) {
            let other = sent[j as usize].lines()[0].expect("a line");
            let sine = own.direction().perp(&other.direction());
            let crossing = own.intersection(&other).expect("not parallel");
            weights += sine * sine;
            weighted += sine * sine * (crossing.vector() - truth[i].vector()).dot(&own.direction());
        }
        let expected = truth[i].vector() + own.direction() * (weighted / weights);
        assert!((expected - answer.pixel.vector()).norm() < 1e-6);
    }
}

#[test]
fn neighbours_of_one_anchor_give_the_anchor() {
    let pencils = Pencils::paper(640, 480);
    let left: Vec<Pixel> = uniform(200, 6).into_iter().map(|p| Pixel::new(p.u / 2.2, p.v)).collect();
    let sent = lift::dual_convergent(&left, &pencils);
    for answer in attack(&sent, &NeighbourLists::nearest(&left, 20)) {
        assert!(answer.pixel.distance(&Pixel::new(320.0, 0.0)) < 1e-9 && answer.determined);
    }
    // Two equal half-lines: nothing is determined, and the answer is the anchor.
    let twice = [sent[0], sent[0]];
    let lists = NeighbourLists::from_lists(&[vec![1], vec![0]]).expect("valid");
    assert!(attack(&twice, &lists).iter().all(|a| !a.determined && a.pixel == Pixel::new(320.0, 0.0)));
}

#[test]
fn parallel_or_missing_neighbours_give_chord_midpoint() {
    let at = |v: f64| Observation::Line(PixelLine::through(Pixel::new(5.0, v), 0.0));
    let lists = NeighbourLists::from_lists(&[vec![1], vec![0], vec![]]).expect("valid");
    for (answer, v) in attack(&[at(10.0), at(20.0), at(30.0)], &lists).iter().zip([10.0, 20.0, 30.0]) {
        assert!(!answer.determined && answer.pixel.distance(&Pixel::new(320.0, v)) < 1e-9);
    }
}

#[test]
fn invalid_input_does_not_panic() {
    let lists = NeighbourLists::from_lists(&[vec![0]]).expect("valid");
    let refused = closed_form(&[], &lists, 640, 480, &ClosedFormOptions::default());
    assert_eq!(refused, Err(AttackError::ListCount { observations: 0, lists: 1 }));
    let nan = Observation::Line(PixelLine::through(Pixel::new(f64::NAN, 0.0), 0.0));
    let nan_pair = Observation::permuted(Pixel::new(f64::NAN, f64::INFINITY));
    let lists = NeighbourLists::from_lists(&[vec![1], vec![0]]).expect("valid");
    for options in [ClosedFormOptions::default(), ClosedFormOptions::in_image()] {
        let answers = closed_form(&[nan, nan_pair], &lists, 640, 480, &options).expect("lists fit");
        let errors = errors_px(answers.iter().map(|a| a.pixel), &[Pixel::new(1.0, 1.0); 2]);
        assert_eq!(errors, [f64::INFINITY; 2]);
    }
    assert!(closed_form(&[], &NeighbourLists::nearest(&[], 3), 0, 0, &ClosedFormOptions::default()).is_ok());
}

/// The paper's Fig. 4: 1500 evenly spread keypoints, 640 x 480, K = 20, neighbours known.
#[test]
fn synthetic_scene_of_the_paper() {
    let truth = uniform(1500, 4);
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let lists = NeighbourLists::nearest(&truth, 20);
    let schemes = [
        lift::random_lines(&truth, &mut rng),
        lift::coordinate_permutation(&truth, &mut rng),
        lift::dual_convergent(&truth, &Pencils::paper(640, 480)),
    ];
    let rows = schemes.map(|sent| {
        let attacked = errors_px(attack(&sent, &lists).iter().map(|a| a.pixel), &truth);
        let prior = errors_px(prior_only(&sent, 640, 480), &truth);
        let bits = bits_over_prior(&attacked, &prior, 640, 480);
        (ErrorSummary::of(&attacked), ErrorSummary::of(&prior), bits)
    });
    let [(random, _, random_bits), (permuted, ..), (dcl, dcl_guess, dcl_bits)] = rows;
    assert!(random.median_px < 8.0 && random.mean_px < permuted.mean_px, "{random:?} {permuted:?}");
    assert!(permuted.mean_px < 0.3 * dcl.mean_px, "{permuted:?} {dcl:?}");
    // A few keypoints are recovered, but the prior-only baseline is far better than the attack.
    assert!(dcl.under_30px * 1500.0 < 30.0, "{dcl:?}");
    assert!((75.0..105.0).contains(&dcl_guess.mean_px), "{dcl_guess:?}");
    assert!(random_bits > 3.0 && dcl_bits < -1.0, "{random_bits} {dcl_bits}");
}

/// Distance from the observation's line with its ends, by projection.
fn distance_with_ends(observation: &Observation, extent: NeighbourExtent, x: Pixel) -> f64 {
    let Some(mut s) = KnownSegment::hull(observation, SIZE.0, SIZE.1) else { return f64::NAN };
    if extent == NeighbourExtent::HalfLine && s.anchor.is_some() {
        (s.near, s.far) = (0.0, f64::INFINITY);
    } else if extent != NeighbourExtent::Segment {
        (s.near, s.far) = (f64::NEG_INFINITY, f64::INFINITY);
    }
    let along = s.direction.dot(&(x.vector() - s.origin.vector())).max(s.near).min(s.far);
    s.at(along).distance(&x)
}

#[test]
fn distances_to_segment_ends_and_known_positions_are_exact() {
    let truth = uniform(200, 12);
    let mut rng = ChaCha8Rng::seed_from_u64(13);
    let lists = NeighbourLists::nearest(&truth, 10);
    let with_known = |mut sent: Vec<Observation>| {
        (0..truth.len()).step_by(7).for_each(|i| sent[i] = Observation::Known(truth[i]));
        sent
    };
    let schemes = [
        with_known(lift::random_lines(&truth, &mut rng)),
        with_known(lift::dual_convergent(
            &truth,
            &Pencils::of_image([640, 480], &Layout::halves(2.1, 2.0).expect("finite")),
        )),
    ];
    for sent in &schemes {
        for extent in [NeighbourExtent::Line, NeighbourExtent::HalfLine, NeighbourExtent::Segment] {
            let mut options = ClosedFormOptions::in_image();
            options.extent = extent;
            let answers = closed_form(sent, &lists, 640, 480, &options).expect("lists fit");
            for (i, answer) in answers.iter().enumerate() {
                let segment = KnownSegment::hull(&sent[i], 640, 480).expect("one line");
                if let Observation::Known(p) = sent[i] {
                    assert_eq!(answer.pixel, p);
                    continue;
                }
                let f = |t: f64| -> f64 {
                    let x = segment.at(t);
                    lists
                        .of(i)
                        .iter()
                        .map(|&j| distance_with_ends(&sent[j as usize], extent, x).powi(2))
                        .sum()
                };
                let found = f(search(&f, segment.near, segment.far));
                assert!(
                    (answer.cost - found).abs() < 1e-5 * (1.0 + found),
                    "{extent:?} {i}: {answer:?} {found}"
                );
            }
        }
    }
}

#[test]
fn other_anchor_only_uses_other_rays_or_prior() {
    let truth = uniform(600, 14);
    let pencils = Pencils::paper(640, 480);
    let sent = lift::dual_convergent(&truth, &pencils);
    let lists = NeighbourLists::nearest(&truth, 20);
    let answers = closed_form(&sent, &lists, 640, 480, &ClosedFormOptions::informed()).expect("lists fit");
    let prior = expected_positions(&sent, 640, 480);
    let mut alone = 0;
    for i in 0..truth.len() {
        let side = pencils.anchor_of(truth[i]);
        if lists.of(i).iter().all(|&j| pencils.anchor_of(truth[j as usize]) == side) {
            alone += 1;
            assert!(!answers[i].determined && answers[i].pixel.distance(&prior[i]) < 1e-9);
        }
    }
    assert!(alone > 300, "{alone}");
    let informed = ErrorSummary::of(&errors_px(answers.iter().map(|a| a.pixel), &truth));
    let paper = ErrorSummary::of(&errors_px(attack(&sent, &lists).iter().map(|a| a.pixel), &truth));
    assert!(informed.mean_px < 0.5 * paper.mean_px, "{informed:?} {paper:?}");
}

#[test]
fn consensus_rejects_false_neighbours() {
    let truth = uniform(1200, 15);
    let mut rng = ChaCha8Rng::seed_from_u64(16);
    let sent = lift::random_lines(&truth, &mut rng);
    let lists = NeighbourLists::nearest(&truth, 20).corrupted(0.5, &mut rng);
    let median = |options: ClosedFormOptions| {
        let answers = closed_form(&sent, &lists, 640, 480, &options).expect("lists fit");
        ErrorSummary::of(&errors_px(answers.iter().map(|a| a.pixel), &truth)).median_px
    };
    let (all, agreeing) =
        (median(ClosedFormOptions::in_image()), median(ClosedFormOptions::in_image().with_consensus(30.0)));
    assert!(agreeing < 0.4 * all && agreeing < 20.0, "{agreeing} of {all}");
}
