//! Attacks of a server that knows some positions, against independent computations on synthetic images.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_attacks::{
    AttackError, ClosedFormOptions, DecodedDescriptors, ErrorSummary, GraphOptions, GuidedOptions,
    KnownImage, LineNeighbours, NeighbourLists, Observation, closed_form, errors_px, graph, guided_transfer,
    iterative, lift, server_side, transfer,
};
use veiloc_geometry::{Pencils, Pixel};

fn uniform(n: usize, seed: u64) -> Vec<Pixel> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..n).map(|_| Pixel::new(rng.random_range(0.0..640.0), rng.random_range(0.0..480.0))).collect()
}

/// Half-lines; every `each`-th keypoint has a known position.
fn partly_known(truth: &[Pixel], each: usize) -> Vec<Observation> {
    let sent = lift::dual_convergent(truth, &Pencils::paper(640, 480));
    let known = |(i, (o, p)): (usize, (&Observation, &Pixel))| {
        if i % each == 0 { Observation::Known(*p) } else { *o }
    };
    sent.iter().zip(truth).enumerate().map(known).collect()
}

/// Minimum of the convex function `f` on `[low, high]`, by ternary search.
fn minimise(f: impl Fn(f64) -> f64, mut low: f64, mut high: f64) -> f64 {
    for _ in 0..200 {
        let (a, b) = (low + (high - low) / 3.0, high - (high - low) / 3.0);
        if f(a) < f(b) { high = b } else { low = a }
    }
    f64::midpoint(low, high)
}

#[test]
fn server_side_attack_equals_numeric_least_squares() {
    let truth = uniform(60, 1);
    let sent = partly_known(&truth, 6);
    let lists = NeighbourLists::nearest(&truth, 8);
    let known = |j: u32| matches!(sent[j as usize], Observation::Known(_));
    for lines in [LineNeighbours::Used, LineNeighbours::Ignored] {
        let answers = server_side(&sent, &lists, 640, 480, lines).expect("lists fit");
        let mut compared = 0;
        for (i, o) in sent.iter().enumerate() {
            let Observation::Pencil(row) = *o else {
                assert_eq!(answers[i].pixel, truth[i]);
                continue;
            };
            let any = lists.of(i).iter().any(|j| known(*j));
            let counts = |j: u32| lines == LineNeighbours::Used || !any || known(j);
            let at = |t: f64| row.line.at(t);
            let f = |t: f64| -> f64 {
                lists
                    .of(i)
                    .iter()
                    .filter(|j| counts(**j))
                    .map(|j| sent[*j as usize].distance(at(t)).powi(2))
                    .sum()
            };
            if any {
                let by_search = at(minimise(f, -3000.0, 3000.0));
                assert!(answers[i].pixel.distance(&by_search) < 1e-3, "{i}: {:?} {by_search:?}", answers[i]);
                compared += 1;
            }
        }
        assert!(compared > 20, "{compared}");
    }
}

#[test]
fn iterative_attack_is_exact_on_a_grid() {
    // Each hidden keypoint is the centre of eight known ones, so their mean is its position.
    let truth: Vec<Pixel> = (0..300)
        .map(|i| Pixel::new(17.0 + f64::from(i % 20) * 30.0, 13.0 + f64::from(i / 20) * 30.0))
        .collect();
    let hidden = |i: usize| i % 20 % 3 == 1 && i / 20 % 3 == 1 && i % 20 < 19 && i / 20 < 14;
    let lines = lift::dual_convergent(&truth, &Pencils::paper(640, 480));
    let sent: Vec<Observation> =
        (0..300).map(|i| if hidden(i) { lines[i] } else { Observation::Known(truth[i]) }).collect();
    let answers = iterative(&sent, &NeighbourLists::nearest(&truth, 8), 640, 480).expect("lists fit");
    assert!((0..300).filter(|i| hidden(*i)).count() > 20);
    assert!(errors_px(answers, &truth).iter().all(|e| *e < 1e-9));
}

#[test]
fn estimated_positions_count_as_known() {
    let truth = [
        Pixel::new(100.0, 100.0),
        Pixel::new(140.0, 90.0),
        Pixel::new(115.0, 120.0),
        Pixel::new(150.0, 130.0),
    ];
    let lines = lift::dual_convergent(&truth, &Pencils::paper(640, 480));
    let sent = [Observation::Known(truth[0]), Observation::Known(truth[1]), lines[2], lines[3]];
    // The third keypoint has two known neighbours; the fourth has one of them and the third.
    let lists = NeighbourLists::from_lists(&[vec![], vec![], vec![0, 1, 0, 2], vec![1, 2]]).expect("valid");
    let answers = iterative(&sent, &lists, 640, 480).expect("lists fit");
    let foot = |i: usize, a: Pixel, b: Pixel| {
        let mean = Pixel::new(f64::midpoint(a.u, b.u), f64::midpoint(a.v, b.v));
        lines[i].lines()[0].expect("one line").closest_point(mean)
    };
    let third = foot(2, truth[0], truth[1]);
    assert!(answers[2].distance(&third) < 1e-9, "{answers:?}");
    assert!(answers[3].distance(&foot(3, truth[1], third)) < 1e-9, "{answers:?}");
}

#[test]
fn limits_of_all_and_no_known_positions() {
    let truth = uniform(50, 3);
    let lists = NeighbourLists::nearest(&truth, 5);
    let all = partly_known(&truth, 1);
    assert_eq!(iterative(&all, &lists, 640, 480).as_ref(), Ok(&truth));
    let found = server_side(&all, &lists, 640, 480, LineNeighbours::Ignored).expect("lists fit");
    assert!(found.iter().zip(&truth).all(|(f, t)| f.pixel == *t));

    let none = lift::dual_convergent(&truth, &Pencils::paper(640, 480));
    let plain = closed_form(&none, &lists, 640, 480, &ClosedFormOptions::default()).expect("lists fit");
    assert_eq!(server_side(&none, &lists, 640, 480, LineNeighbours::Ignored).as_ref(), Ok(&plain));
    let plain: Vec<Pixel> = plain.iter().map(|p| p.pixel).collect();
    assert_eq!(iterative(&none, &lists, 640, 480), Ok(plain));

    let no_lists = NeighbourLists::nearest(&truth, 0);
    assert_eq!(iterative(&none, &no_lists, 640, 480), Err(AttackError::NoNeighbours));
    let refused = server_side(&none, &no_lists, 640, 480, LineNeighbours::Used);
    assert_eq!(refused, Err(AttackError::NoNeighbours));
    let refused = iterative(&none[1..], &lists, 640, 480);
    assert_eq!(refused, Err(AttackError::ListCount { observations: 49, lists: 50 }));
}

/// With a third of the positions known the layout tolerates more false neighbours than without.
#[test]
fn known_positions_help_graph_attack_with_false_neighbours() {
    let truth = uniform(700, 5);
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let lists = NeighbourLists::nearest(&truth, 20).corrupted(0.6, &mut rng);
    let median = |sent: &[Observation]| {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let found = graph(sent, &lists, 640, 480, &GraphOptions::default(), &mut rng).expect("lists fit");
        let hidden = (0..truth.len()).filter(|i| i % 3 != 0);
        let errors: Vec<f64> = hidden.map(|i| found.pixels[i].distance(&truth[i])).collect();
        ErrorSummary::of(&errors).median_px
    };
    let with = median(&partly_known(&truth, 3));
    let without = median(&lift::dual_convergent(&truth, &Pencils::paper(640, 480)));
    assert!(with < 10.0 && with < 0.3 * without, "{with}, without {without}");
}

/// A query and a map image of one scene, rotated, scaled and moved. Every other keypoint has a unique descriptor;
/// each of the others shares its descriptor with `copies` keypoints all over the image.
fn alike(copies: usize) -> (Vec<Pixel>, DecodedDescriptors, KnownImage) {
    let truth = uniform(900, 8);
    let moved: Vec<Pixel> = truth
        .iter()
        .map(|p| Pixel::new(1.04 * p.u - 0.05 * p.v + 9.0, 0.05 * p.u + 1.04 * p.v - 14.0))
        .collect();
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let kinds: Vec<[u8; 32]> = (0..900).map(|_| rng.random()).collect();
    let kind = |i: usize| if i.is_multiple_of(2) { i } else { i % (900 / copies) };
    let mut bytes = |_: usize| -> Vec<u8> {
        let mut noisy = |i: usize| kinds[kind(i)].map(|b| b.saturating_add(rng.random_range(0..12)));
        (0..900).flat_map(&mut noisy).collect()
    };
    let of = |bytes: Vec<u8>| DecodedDescriptors::new(&bytes, 32).expect("whole");
    let (query, map) = (of(bytes(0)), of(bytes(1)));
    (truth, query, KnownImage::new(moved, map, 640, 480).expect("one descriptor a keypoint"))
}

#[test]
fn guided_transfer_separates_similar_descriptors() {
    let (truth, query, map) = alike(6);
    let sent = partly_known(&truth, 3);
    let map = [map];
    let guided =
        guided_transfer(&query, &sent, &map, (640, 480), &GuidedOptions::default()).expect("they fit");
    let plain = transfer(&query, &map, (640, 480), 1, 5).expect("they fit").projected(&sent, 640, 480);
    let hidden: Vec<usize> = (0..900).filter(|i| i % 3 != 0).collect();
    let error = |p: Pixel, i: usize| p.distance(&truth[i]);
    let plain = ErrorSummary::of(&hidden.iter().map(|i| error(plain[*i], *i)).collect::<Vec<_>>());
    let accepted: Vec<usize> = hidden.iter().copied().filter(|i| guided[*i].is_accepted()).collect();
    let errors: Vec<f64> = accepted.iter().map(|i| error(guided[*i].pixel.expect("accepted"), *i)).collect();
    let sure = ErrorSummary::of(&errors);
    assert!(plain.under_10px < 0.6, "copies confuse the plain transfer: {plain:?}");
    assert!(accepted.len() > 250 && sure.under_10px > 0.9, "{} {sure:?}", accepted.len());
}

#[test]
fn guided_transfer_without_inliers_has_no_answers() {
    let (truth, query, map) = alike(1);
    let none = lift::dual_convergent(&truth, &Pencils::paper(640, 480));
    let options = GuidedOptions::default();
    let attack =
        |sent: &[Observation], map: &[KnownImage]| guided_transfer(&query, sent, map, (640, 480), &options);
    let answers = attack(&none, std::slice::from_ref(&map)).expect("they fit");
    assert!(answers.iter().all(|a| a.pixel.is_none() && !a.is_accepted()));
    assert!(attack(&none, &[]).expect("no map").iter().all(|a| a.pixel.is_none()));
    let known = attack(&partly_known(&truth, 1), std::slice::from_ref(&map)).expect("they fit");
    assert!(known.iter().zip(&truth).all(|(a, t)| a.pixel == Some(*t) && a.is_accepted()));

    let refused = attack(&none[1..], std::slice::from_ref(&map));
    assert_eq!(refused, Err(AttackError::FrameDescriptors { frame: 0, observations: 899, descriptors: 900 }));
    let two = DecodedDescriptors::new(&[1, 2], 2).expect("whole");
    let other = KnownImage::new(vec![Pixel::new(1.0, 1.0)], two, 640, 480).expect("one");
    assert_eq!(attack(&none, &[other]), Err(AttackError::Dimensions { expected: 32, found: 2 }));
}
