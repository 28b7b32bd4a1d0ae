//! The network of positions: it learns what can be learned and nothing else, begins as the guess, goes on as if it had not
//! been interrupted, and its files are safe.

use std::ops::ControlFlow;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_attacks::learned::positions::{PositionNetwork, PositionTask, Sees, Told, recover, told, train};
use veiloc_attacks::learned::{Progress, Trained, TrainingOptions, TrainingState};
use veiloc_attacks::{
    AttackError, Descriptors, KnownImage, Observation, bits_over_prior, errors_px, prior_only,
};
use veiloc_geometry::Pixel;
use veiloc_obfuscation::audit::obfuscate_points;
use veiloc_protocol::Scheme;

const DIMENSION: usize = 16;
/// Each some 50 pixels wide.
const THINGS: usize = 8;
const STRIPES: &str = "dcl:axis=138:sectors=24:anchors=-0.62/-0.61+0.92/-1.16";

/// What descriptors of a made-up world say.
#[derive(Clone, Copy, PartialEq)]
enum World {
    /// Where in the image the keypoint is: which of 8 x 6 fields.
    Positions,
    /// Nothing.
    Nothing,
    /// Which of [`THINGS`] it belongs to; each image has its things elsewhere.
    Things,
}

/// Keypoints in 640 x 480 pixels with their descriptors.
fn image(world: World, seed: u64, keypoints: usize) -> KnownImage {
    let mut patterns = ChaCha8Rng::seed_from_u64(77);
    let patterns: Vec<Vec<f64>> =
        (0..48).map(|_| (0..DIMENSION).map(|_| patterns.random_range(0.0..200.0)).collect()).collect();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let things: Vec<Pixel> = (0..THINGS)
        .map(|_| Pixel::new(rng.random_range(40.0..600.0), rng.random_range(40.0..440.0)))
        .collect();
    let (mut points, mut bytes) = (Vec::new(), Vec::new());
    for _ in 0..keypoints {
        let thing = rng.random_range(0..THINGS);
        let p = if world == World::Things {
            let off = |rng: &mut ChaCha8Rng| rng.random_range(-25.0..25.0);
            Pixel::new(things[thing].u + off(&mut rng), things[thing].v + off(&mut rng))
        } else {
            Pixel::new(rng.random_range(0.0..640.0), rng.random_range(0.0..480.0))
        };
        let pattern = match world {
            World::Positions => (p.u / 80.0) as usize + 8 * (p.v / 80.0) as usize,
            World::Nothing => rng.random_range(0..48),
            World::Things => thing,
        };
        bytes.extend(patterns[pattern].iter().map(|x| (x + rng.random_range(0.0..40.0)) as u8));
        points.push(p);
    }
    let descriptors = Descriptors::new(&bytes, DIMENSION).expect("whole descriptors");
    KnownImage::new(points, descriptors, 640, 480).expect("one each")
}

fn images(world: World, seeds: std::ops::Range<u64>) -> Vec<KnownImage> {
    seeds.map(|seed| image(world, seed, 240)).collect()
}

fn task(scheme: &str) -> PositionTask {
    let mut task = PositionTask::new(scheme.parse().expect("a scheme")).expect("it hides positions");
    task.crop = false;
    task
}

fn options(steps: usize) -> TrainingOptions {
    let mut options = TrainingOptions::default();
    (options.steps, options.images, options.keypoints) = (steps, 2, 120);
    (options.width, options.heads, options.layers) = (32, 2, 1);
    (options.learning_rate, options.validate_every, options.dropout) = (4e-3, 40, 0.0);
    options
}

fn trained(world: World, task: &PositionTask, options: &TrainingOptions) -> Trained<PositionNetwork> {
    // Of things the more images the better: in few it learns by heart where they are.
    let count = if world == World::Things { 40 } else { 12 };
    let (training, validation) = (images(world, 0..count), images(world, 50..52));
    train(&training, &validation, task, options, None, |_| ControlFlow::Continue(())).expect("it learns")
}

/// What a network tells about images that nobody has seen.
fn unseen(network: &PositionNetwork, world: World, task: &PositionTask) -> Told {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    told(network, &images(world, 90..94), task, &mut rng).expect("sent").expect("keypoints")
}

#[test]
fn where_descriptors_tell_positions_it_learns_them_and_where_they_tell_nothing_it_guesses() {
    for scheme in ["random-lines", "coordinate-permutation", "dcl:paper", STRIPES] {
        let mut alone = task(scheme);
        alone.sees = Sees::Row;
        let network = trained(World::Positions, &alone, &options(160)).network;
        // A field is 80 pixels wide: along a line of some 500 pixels it leaves a sixth.
        let told = unseen(&network, World::Positions, &alone);
        assert!(told.information > 1.2 && told.bits > told.bits_untrained + 1.0, "{scheme}: {told:?}");
        if !["random-lines", STRIPES].contains(&scheme) {
            continue;
        }
        let nothing = trained(World::Nothing, &alone, &options(80)).network;
        let told = unseen(&nothing, World::Nothing, &alone);
        assert!(told.information.abs() < 0.15 && told.bits_of_mean.abs() < 0.15, "{scheme}: {told:?}");
        // Who is shown the line alone learns nothing from descriptors that tell everything.
        alone.sees = Sees::Line;
        let line = trained(World::Positions, &alone, &options(80)).network;
        let told = unseen(&line, World::Positions, &alone);
        assert!(told.information.abs() < 0.15 && told.bits_of_mean.abs() < 0.15, "{scheme}: {told:?}");
    }
}

#[test]
fn where_only_neighbours_tell_positions_the_set_is_what_tells() {
    let mut shown = task("random-lines");
    let set = unseen(&trained(World::Things, &shown, &options(360)).network, World::Things, &shown);
    shown.sees = Sees::Row;
    let row = unseen(&trained(World::Things, &shown, &options(80)).network, World::Things, &shown);
    let gained = set.information - row.information;
    assert!(row.information < 0.25 && gained > 0.4, "set {set:?}, row {row:?}");
}

/// The attack by itself, as an audit runs it, is what is told.
#[test]
fn the_attack_finds_what_was_told() {
    let task = task("dcl:paper");
    let network = trained(World::Positions, &task, &options(120)).network;
    let victim = image(World::Positions, 93, 240);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let sent = obfuscate_points(victim.keypoints(), 640, 480, &task.scheme, task.angle_bits, &mut rng);
    let sent = Observation::of_sent(&sent.expect("inside"));
    let found = recover(&network, &sent, victim.descriptors(), 640, 480).expect("of one kind");
    let errors = errors_px(found.iter().map(|e| e.pixel), victim.keypoints());
    let guess = errors_px(prior_only(&sent, 640, 480), victim.keypoints());
    let bits = bits_over_prior(&errors, &guess, 640, 480);
    assert!(bits > 0.5, "{bits}");
    let expected = found.iter().map(|e| e.expected_error).sum::<f64>() / found.len() as f64;
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    assert!((expected / mean - 1.0).abs() < 0.4, "it knows how far off it is: {expected} {mean}");
    // On its own line.
    assert!(found.iter().zip(&sent).all(|(e, o)| o.distance(e.pixel) < 1e-6));
}

#[test]
fn before_it_has_learned_it_is_the_guess() {
    for scheme in ["random-lines", "coordinate-permutation", "dcl:paper", STRIPES] {
        let task = task(scheme);
        let mut options = options(1);
        options.learning_rate = 1e-30;
        let network = trained(World::Positions, &task, &options).network;
        let victim = image(World::Positions, 4, 200);
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let sent = obfuscate_points(victim.keypoints(), 640, 480, &task.scheme, task.angle_bits, &mut rng)
            .expect("sent");
        let sent = Observation::of_sent(&sent);
        let found = recover(&network, &sent, victim.descriptors(), 640, 480).expect("of one kind");
        for (estimate, guess) in found.iter().zip(prior_only(&sent, 640, 480)) {
            assert!(estimate.mean.distance(&guess) < 1e-2, "{scheme}: {estimate:?} {guess:?}");
        }
        let told = told(&network, &[victim], &task, &mut rng).expect("sent").expect("keypoints");
        assert!(told.information.abs() < 1e-4 && told.bits_of_mean.abs() < 1e-3, "{scheme}: {told:?}");
        assert!((told.bits - told.bits_untrained).abs() < 0.02, "{scheme}: {told:?}");
    }
}

#[test]
fn a_training_that_was_interrupted_goes_on_as_if_it_had_not_been() {
    let task = {
        let mut task = task("dcl");
        task.crop = true;
        task
    };
    let mut options = options(9);
    (options.validate_every, options.dropout) = (4, 0.1);
    let (training, validation) = (images(World::Positions, 0..3), images(World::Positions, 50..51));
    let run = |earlier: Option<TrainingState>, until: usize| {
        let stop = |p: Progress<'_>| {
            if p.step == until { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        train(&training, &validation, &task, &options, earlier, stop).expect("it learns")
    };
    let whole = run(None, usize::MAX);
    for until in [1, 4, 6] {
        let first = run(None, until);
        assert_eq!(first.state.step(), until);
        let bytes = first.state.encode();
        let again = TrainingState::decode(&bytes).expect("sound");
        assert_eq!(again, first.state);
        let second = run(Some(again), usize::MAX);
        assert_eq!(second.network.encode(), whole.network.encode());
        assert_eq!((second.state, second.curve), (whole.state.clone(), whole.curve.clone()));
    }
    // Neither with other options nor with other images.
    let state = || Some(run(None, 2).state);
    let mut other = options.clone();
    other.learning_rate *= 2.0;
    let refused = |training: &[KnownImage], options: &TrainingOptions, task: &PositionTask| {
        train(training, &validation, task, options, state(), |_| ControlFlow::Continue(()))
            .expect_err("another")
    };
    assert_eq!(refused(&training, &other, &task), AttackError::OtherTraining);
    assert_eq!(refused(&training[..2], &options, &task), AttackError::OtherTraining);
    let mut whole_images = task;
    whole_images.crop = false;
    assert_eq!(refused(&training, &options, &whole_images), AttackError::OtherTraining);

    let bytes = state().expect("a state").encode();
    let refused = |bytes: &[u8]| TrainingState::decode(bytes).expect_err("refused");
    for length in [0, 7, 8, 11, 30, bytes.len() - 1] {
        let error = refused(&bytes[..length]);
        assert!(
            matches!(error, AttackError::NotANetwork { .. } | AttackError::Length { .. }),
            "{length} {error}"
        );
    }
    let changed = |at: usize, to: u8| {
        let mut bytes = bytes.clone();
        bytes[at] = to;
        refused(&bytes)
    };
    assert_eq!(changed(8, 9), AttackError::Version { found: 9, expected: 1 });
    assert!(matches!(changed(50, 0xff), AttackError::Length { .. }), "no memory is taken");
    let middle = bytes.len() / 2;
    assert_eq!(changed(middle, bytes[middle] ^ 1), AttackError::Checksum);
}

#[test]
fn threads_change_nothing() {
    let mut options = options(3);
    options.images = 5;
    let bytes = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| trained(World::Positions, &task("dcl"), &options).network.encode())
    };
    assert_eq!(bytes(1), bytes(3));
}

#[test]
fn what_is_written_is_read_back_and_what_is_damaged_is_refused() {
    let network = trained(World::Positions, &task(STRIPES), &options(1)).network;
    let bytes = network.encode();
    let again = PositionNetwork::decode(&bytes).expect("sound");
    assert_eq!((again.encode(), again.scheme(), again.sees()), (bytes.clone(), network.scheme(), Sees::Set));
    let refused = |bytes: &[u8]| PositionNetwork::decode(bytes).expect_err("refused");
    for length in 0..bytes.len().min(120) {
        let error = refused(&bytes[..length]);
        assert!(
            matches!(error, AttackError::NotANetwork { .. } | AttackError::Length { .. }),
            "{length} {error}"
        );
    }
    assert!(matches!(refused(&[bytes.as_slice(), &[0]].concat()), AttackError::Length { .. }));
    let changed = |at: usize, to: u8| {
        let mut bytes = bytes.clone();
        bytes[at] = to;
        refused(&bytes)
    };
    assert_eq!(changed(8, 7), AttackError::Version { found: 7, expected: 1 });
    assert!(matches!(changed(28, 9), AttackError::Option { name: "what it sees", .. }));
    assert!(matches!(changed(39, 0x7f), AttackError::Option { .. }), "no memory is taken");
    assert_eq!(changed(400, bytes[400] ^ 1), AttackError::Checksum);
    // Not a number, with a checksum that is right.
    let body = bytes.len() - 8;
    let mut poisoned = bytes[..body].to_vec();
    poisoned[body - 4..].copy_from_slice(&f32::NAN.to_le_bytes());
    poisoned.extend(xxhash_rust::xxh3::xxh3_64(&poisoned).to_le_bytes());
    assert_eq!(refused(&poisoned), AttackError::NotFinite);
}

#[test]
fn what_makes_no_sense_is_refused() {
    assert!(matches!(PositionTask::new(Scheme::Points), Err(AttackError::Scheme { .. })));
    let refused = |training: &[KnownImage], task: &PositionTask, options: &TrainingOptions| {
        let none = |_: Progress<'_>| ControlFlow::Continue(());
        train(training, &images(World::Nothing, 1..2), task, options, None, none).expect_err("refused")
    };
    let one = images(World::Nothing, 0..1);
    assert_eq!(refused(&[], &task("dcl"), &options(1)), AttackError::NothingToLearn);
    let mut mirrored = task("dcl");
    mirrored.mirror = true;
    assert!(
        matches!(refused(&one, &mirrored, &options(1)), AttackError::Option { name, .. } if name.contains("descriptor"))
    );
    let mut heads = options(1);
    heads.heads = 5;
    assert!(matches!(refused(&one, &task("dcl"), &heads), AttackError::Option { name: "heads", .. }));

    let network = trained(World::Nothing, &task("dcl"), &options(1)).network;
    let descriptors = one[0].descriptors();
    let row = Observation::permuted(Pixel::new(1.0, 1.0));
    let rows = vec![row; descriptors.len()];
    assert!(matches!(recover(&network, &rows, descriptors, 640, 480), Err(AttackError::Scheme { .. })));
    assert!(matches!(
        recover(&network, &rows[1..], descriptors, 640, 480),
        Err(AttackError::DescriptorCount { .. })
    ));
    let other = Descriptors::new(&[1, 2], 2).expect("one");
    assert!(matches!(recover(&network, &rows[..1], &other, 640, 480), Err(AttackError::Dimensions { .. })));
}
