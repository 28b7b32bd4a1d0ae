//! The graph attack on keypoints with known positions.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_attacks::{
    AttackError, ErrorSummary, GraphOptions, NeighbourLists, Observation, errors_px, graph, lift, prior_only,
};
use veiloc_geometry::{Layout, Pencils, Pixel, PixelLine};

fn uniform(n: usize, seed: u64) -> Vec<Pixel> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..n).map(|_| Pixel::new(rng.random_range(0.0..640.0), rng.random_range(0.0..480.0))).collect()
}

/// Three clusters and few keypoints between them: densities differ by a factor of ten.
fn clusters(n: usize, seed: u64) -> Vec<Pixel> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..n)
        .map(|k| {
            let mut about = |c: f64, s: f64| c + s * (rng.random::<f64>() + rng.random::<f64>() - 1.0);
            match k % 4 {
                0 => Pixel::new(about(150.0, 90.0), about(330.0, 90.0)),
                1 => Pixel::new(about(330.0, 90.0), about(150.0, 80.0)),
                2 => Pixel::new(about(500.0, 70.0), about(350.0, 90.0)),
                _ => Pixel::new(rng.random_range(0.0..640.0), rng.random_range(0.0..480.0)),
            }
        })
        .collect()
}

fn attacked(sent: &[Observation], lists: &NeighbourLists, truth: &[Pixel]) -> (ErrorSummary, f64) {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let answer = graph(sent, lists, 640, 480, &GraphOptions::default(), &mut rng).expect("lists fit");
    (ErrorSummary::of(&errors_px(answer.pixels, truth)), answer.false_share)
}

#[test]
fn graph_attack_recovers_half_lines_with_true_neighbours() {
    let pencils = Pencils::paper(640, 480);
    for (truth, mean, median) in [(uniform(800, 4), 4.0, 3.0), (clusters(800, 5), 6.0, 5.0)] {
        let sent = lift::dual_convergent(&truth, &pencils);
        let prior = ErrorSummary::of(&errors_px(prior_only(&sent, 640, 480), &truth));
        let (found, false_share) = attacked(&sent, &NeighbourLists::nearest(&truth, 20), &truth);
        assert!(prior.mean_px > 55.0, "{prior:?}");
        assert!(found.mean_px < mean && found.median_px < median, "{found:?}");
        assert!(false_share < 0.05, "{false_share}");
    }
}

#[test]
fn graph_attack_tolerates_20_percent_false_neighbours() {
    let truth = uniform(600, 6);
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let lists = NeighbourLists::nearest(&truth, 20).corrupted(0.2, &mut rng);
    let schemes = [
        lift::dual_convergent(
            &truth,
            &Pencils::of_image([640, 480], &Layout::halves(0.7, 1.5).expect("finite")),
        ),
        lift::random_lines(&truth, &mut rng),
        lift::coordinate_permutation(&truth, &mut rng),
    ];
    for (s, sent) in schemes.iter().enumerate() {
        let (found, false_share) = attacked(sent, &lists, &truth);
        assert!(found.mean_px < 8.0 && found.under_10px > 0.9, "scheme {s}: {found:?}");
        assert!((false_share - 0.2).abs() < 0.05, "{false_share}");
    }
}

#[test]
fn random_neighbours_give_no_information() {
    let truth = uniform(600, 7);
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let lists = NeighbourLists::nearest(&truth, 20).corrupted(1.0, &mut rng);
    let sent = lift::dual_convergent(&truth, &Pencils::paper(640, 480));
    let (found, false_share) = attacked(&sent, &lists, &truth);
    assert!(found.mean_px > 60.0, "random neighbours carry no information: {found:?}");
    assert!(false_share > 0.5, "{false_share}");
}

#[test]
fn known_positions_stay_fixed_and_reduce_errors() {
    let truth = uniform(400, 8);
    let sent = lift::dual_convergent(&truth, &Pencils::paper(640, 480));
    let known: Vec<Observation> = sent
        .iter()
        .zip(&truth)
        .enumerate()
        .map(|(i, (o, p))| if i % 3 == 0 { Observation::Known(*p) } else { *o })
        .collect();
    let lists = NeighbourLists::nearest(&truth, 20);
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let answer = graph(&known, &lists, 640, 480, &GraphOptions::default(), &mut rng).expect("lists fit");
    for i in (0..truth.len()).step_by(3) {
        assert!(answer.pixels[i].distance(&truth[i]) < 1e-9);
    }
    let errors: Vec<f64> = errors_px(answer.pixels, &truth)
        .into_iter()
        .enumerate()
        .filter(|(i, _)| i % 3 != 0)
        .map(|(_, e)| e)
        .collect();
    let (without, _) = attacked(&sent, &lists, &truth);
    let with = ErrorSummary::of(&errors);
    assert!(with.mean_px < 6.0 && with.mean_px < without.mean_px + 1.0, "{with:?} {without:?}");
}

#[test]
fn equal_seeds_give_equal_answers_and_invalid_input_no_panic() {
    let truth = uniform(300, 9);
    let sent = lift::dual_convergent(&truth, &Pencils::paper(640, 480));
    let lists = NeighbourLists::nearest(&truth, 10);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        pool.install(|| graph(&sent, &lists, 640, 480, &GraphOptions::default(), &mut rng))
    };
    assert_eq!(run(1), run(3));

    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let mut options = GraphOptions::default();
    options.sweeps = 3;
    let refused = graph(&sent[1..], &lists, 640, 480, &options, &mut rng);
    assert_eq!(refused, Err(AttackError::ListCount { observations: 299, lists: 300 }));
    let initialized = options.clone().with_initial_positions(truth[1..].to_vec());
    let refused = graph(&sent, &lists, 640, 480, &initialized, &mut rng);
    assert_eq!(refused, Err(AttackError::InitialPositionCount { observations: 300, positions: 299 }));
    let nothing = graph(&[], &NeighbourLists::nearest(&[], 3), 640, 480, &options, &mut rng).expect("empty");
    assert!(nothing.pixels.is_empty());
    // A line outside the image, a NaN line, rows without neighbours, and rows that list themselves.
    let odd = [
        Observation::Line(PixelLine::through(Pixel::new(f64::NAN, 0.0), 0.0)),
        Observation::Line(PixelLine::through(Pixel::new(0.0, -50.0), 0.0)),
        sent[0],
        Observation::Known(Pixel::new(f64::NAN, 1.0)),
    ];
    let lists = NeighbourLists::from_lists(&[vec![0, 1, 1], vec![2], vec![], vec![2, 0]]).expect("valid");
    let answer = graph(&odd, &lists, 640, 480, &options, &mut rng).expect("answered");
    assert_eq!(answer.pixels.len(), 4);
}

#[test]
fn initial_positions_help_with_many_false_neighbours() {
    let truth = uniform(600, 9);
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let lists = NeighbourLists::nearest(&truth, 20).corrupted(0.5, &mut rng);
    let sent = lift::dual_convergent(&truth, &Pencils::paper(640, 480));
    let mut off = || rng.random_range(-20.0..20.0);
    let initial: Vec<Pixel> = truth.iter().map(|p| Pixel::new(p.u + off(), p.v + off())).collect();
    let median = |options: &GraphOptions| {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let answer = graph(&sent, &lists, 640, 480, options, &mut rng).expect("lists fit");
        ErrorSummary::of(&errors_px(answer.pixels, &truth)).median_px
    };
    let alone = median(&GraphOptions::default());
    let initialized = median(&GraphOptions::default().with_initial_positions(initial));
    assert!(initialized < 0.2 * alone && initialized < 25.0, "{initialized}, alone {alone}");
}

/// A detector that finds several orientations at one position sends a row for each. The attack recognises their equal
/// lines and merges the rows into one keypoint.
#[test]
fn rows_with_one_position_are_merged() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let mut truth = clusters(700, 7);
    // One to four additional rows for a third of the positions.
    for i in (0..700).step_by(3) {
        truth.extend(std::iter::repeat_n(truth[i], rng.random_range(1..5)));
    }
    let sent = lift::dual_convergent(&truth, &Pencils::paper(640, 480));
    let (found, _) = attacked(&sent, &NeighbourLists::nearest(&truth, 20), &truth);
    assert!(found.median_px < 2.4 && found.under_5px > 0.87, "{found:?}");
}
