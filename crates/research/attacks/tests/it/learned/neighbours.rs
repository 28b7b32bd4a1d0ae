//! The network that predicts neighbours: it learns, forgets no order, goes on where it stopped, and its file is safe.

use std::ops::ControlFlow;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_attacks::learned::neighbours::{NeighbourNetwork, train};
use veiloc_attacks::learned::{Progress, Trained, TrainingOptions, TrainingState};
use veiloc_attacks::{AttackError, Descriptors, KnownImage, NeighbourLists};
use veiloc_geometry::Pixel;

const DIMENSION: usize = 16;

/// Keypoints in 640 x 480 pixels whose descriptors say which of 6 x 4 fields they are in, and nothing more: two
/// patterns a field, the second its number's neighbour in no linear sense.
fn image(seed: u64, keypoints: usize) -> (Vec<Pixel>, Vec<u8>) {
    // The patterns are those of the world, the same in every image.
    let mut world = ChaCha8Rng::seed_from_u64(77);
    let patterns: Vec<Vec<f64>> =
        (0..48).map(|_| (0..DIMENSION).map(|_| world.random_range(0.0..200.0)).collect()).collect();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut points = Vec::new();
    let mut bytes = Vec::new();
    for _ in 0..keypoints {
        let p = Pixel::new(rng.random_range(0.0..640.0), rng.random_range(0.0..480.0));
        let field = (p.u / 640.0 * 6.0) as usize + 6 * (p.v / 480.0 * 4.0) as usize;
        let pattern = &patterns[2 * field + rng.random_range(0..2)];
        bytes.extend(pattern.iter().map(|x| (x + rng.random_range(0.0..50.0)) as u8));
        points.push(p);
    }
    (points, bytes)
}

fn known(seed: u64) -> KnownImage {
    let (points, bytes) = image(seed, 300);
    let descriptors = Descriptors::new(&bytes, DIMENSION).expect("whole descriptors");
    KnownImage::new(points, descriptors, 640, 480).expect("one each")
}

fn options() -> TrainingOptions {
    let mut options = TrainingOptions::default();
    (options.steps, options.images, options.keypoints) = (80, 1, 96);
    (options.width, options.heads, options.layers) = (24, 2, 1);
    (options.learning_rate, options.validate_every) = (5e-3, 40);
    options
}

fn trained(options: &TrainingOptions) -> Trained<NeighbourNetwork> {
    let training: Vec<KnownImage> = (0..6).map(known).collect();
    train(&training, &[known(50)], 20, options, None, on).expect("something to learn")
}

fn on(_: Progress<'_>) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

#[test]
fn a_training_that_was_interrupted_goes_on_as_if_it_had_not_been() {
    let mut options = options();
    (options.steps, options.validate_every) = (7, 3);
    let whole = trained(&options);
    let training: Vec<KnownImage> = (0..6).map(known).collect();
    let run = |earlier: Option<TrainingState>, until: usize| {
        let stop = |p: Progress<'_>| if p.step == until { ControlFlow::Break(()) } else { on(p) };
        train(&training, &[known(50)], 20, &options, earlier, stop)
    };
    for until in [1, 3, 5] {
        let state = run(None, until).expect("it learns").state;
        let state = TrainingState::decode(&state.encode()).expect("sound");
        let second = run(Some(state), 0).expect("it goes on");
        assert_eq!(second.network.encode(), whole.network.encode(), "{until}");
        assert_eq!(second.curve, whole.curve);
    }
    let state = run(None, 2).expect("it learns").state;
    let other = train(&training, &[known(50)], 21, &options, Some(state), on).expect_err("another");
    assert_eq!(other, AttackError::OtherTraining);
}

#[test]
fn it_learns_which_descriptors_occur_side_by_side() {
    let trained = trained(&options());
    let (points, bytes) = image(99, 300);
    let victim = Descriptors::new(&bytes, DIMENSION).expect("whole");
    let said = trained.network.predict(&victim, 10).expect("the same dimension");
    for i in 0..points.len() {
        assert_eq!(said.of(i).len(), 10);
        assert!(!said.of(i).contains(&(i as u32)), "nobody is his own neighbour");
    }
    let precision = said.precision(&NeighbourLists::nearest(&points, 10));
    // At random 3.3 %. Who knows the field finds 10 of its 12.5 keypoints, of which about half are among the nearest.
    assert!(precision > 0.35, "{precision}");
    let [first, .., last] = trained.curve.as_slice() else { panic!("two looks") };
    assert!(last.loss < first.loss, "{:?}", trained.curve);
    assert!(trained.curve.iter().any(|p| p.step == trained.best_step));
}

#[test]
fn equal_seeds_give_equal_networks() {
    let mut options = options();
    options.steps = 5;
    let bytes = |options: &TrainingOptions| trained(options).network.encode();
    assert_eq!(bytes(&options), bytes(&options));
    let first = bytes(&options);
    options.seed = 1;
    assert_ne!(first, bytes(&options));
}

#[test]
fn the_order_of_the_keypoints_says_nothing() {
    let mut options = options();
    options.steps = 5;
    let network = trained(&options).network;
    // More keypoints than are attended to at a time.
    let (_, bytes) = image(3, 700);
    let turned: Vec<u8> = bytes.chunks(DIMENSION).rev().flatten().copied().collect();
    let lists = |bytes: &[u8]| {
        let descriptors = Descriptors::new(bytes, DIMENSION).expect("whole");
        network.predict(&descriptors, 5).expect("the same dimension")
    };
    let (there, back) = (lists(&bytes), lists(&turned));
    let same = (0..700).filter(|i| {
        let turned: Vec<u32> = back.of(699 - i).iter().map(|j| 699 - j).collect();
        turned == there.of(*i)
    });
    // Sums are rounded in another order, so that two that are nearly as likely may change places.
    let same = same.count();
    assert!(same > 680, "{same} of 700");
}

#[test]
fn what_is_written_is_read_back_and_what_is_damaged_is_refused() {
    let mut options = options();
    options.steps = 1;
    let network = trained(&options).network;
    let bytes = network.encode();
    let again = NeighbourNetwork::decode(&bytes).expect("sound");
    assert_eq!(again.encode(), bytes);
    let (_, descriptors) = image(3, 100);
    let victim = Descriptors::new(&descriptors, DIMENSION).expect("whole");
    assert_eq!(again.predict(&victim, 9), network.predict(&victim, 9));

    let refused = |bytes: &[u8]| NeighbourNetwork::decode(bytes).expect_err("refused");
    for length in 0..bytes.len().min(60) {
        let error = refused(&bytes[..length]);
        assert!(
            matches!(error, AttackError::NotANetwork { .. } | AttackError::Length { .. }),
            "{length} {error}"
        );
    }
    assert!(matches!(refused(&bytes[..bytes.len() - 1]), AttackError::Length { .. }));
    assert!(matches!(refused(&[bytes.as_slice(), &[0]].concat()), AttackError::Length { .. }));
    let changed = |at: usize, to: u8| {
        let mut bytes = bytes.clone();
        bytes[at] = to;
        refused(&bytes)
    };
    assert!(matches!(changed(0, b'X'), AttackError::NotANetwork { .. }));
    assert_eq!(changed(8, 9), AttackError::Version { found: 9, expected: 1 });
    assert!(matches!(changed(20, 7), AttackError::Option { name: "heads", .. }), "24 by 7");
    assert!(matches!(changed(27, 0xff), AttackError::Option { name: "layers", .. }), "no memory is taken");
    assert_eq!(changed(200, bytes[200] ^ 1), AttackError::Checksum);
    assert_eq!(changed(bytes.len() - 1, bytes[bytes.len() - 1] ^ 1), AttackError::Checksum);
}

#[test]
fn what_makes_no_sense_is_refused() {
    let refused = |training: &[KnownImage], options: &TrainingOptions| {
        train(training, &[known(1)], 20, options, None, on).expect_err("refused")
    };
    assert_eq!(refused(&[], &options()), AttackError::NothingToLearn);
    let none = train(&[known(0)], &[], 20, &options(), None, on).expect_err("nothing to judge by");
    assert_eq!(none, AttackError::NothingToLearn);
    let small = Descriptors::new(&[1, 2], 2).expect("one");
    let small = KnownImage::new(vec![Pixel::new(1.0, 1.0)], small, 9, 9).expect("one each");
    let dimensions = AttackError::Dimensions { expected: DIMENSION, found: 2 };
    assert_eq!(refused(&[known(0), small.clone()], &options()), dimensions);
    let network = trained(&{
        let mut options = options();
        options.steps = 1;
        options
    })
    .network;
    assert_eq!(
        network.predict(small.descriptors(), 5),
        Err(AttackError::Dimensions { expected: DIMENSION, found: 2 })
    );
    let with = |set: &dyn Fn(&mut TrainingOptions)| {
        let mut options = options();
        set(&mut options);
        refused(&[known(0)], &options).to_string()
    };
    assert!(with(&|o| o.steps = 0).contains("steps"));
    assert!(with(&|o| o.heads = 5).contains("heads"));
    assert!(with(&|o| o.dropout = 1.0).contains("dropout"));
    assert!(with(&|o| o.learning_rate = f64::NAN).contains("learning_rate"));
    assert!(with(&|o| o.learning_rate = 1e30).contains("not finite"));
}
