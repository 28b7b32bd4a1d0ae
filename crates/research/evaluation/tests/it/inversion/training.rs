//! A training end to end: it learns, does not depend on threads, and goes on as if it had not been interrupted.

use std::ops::ControlFlow;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_attacks::AttackError;
use veiloc_datasets::problem_files::KeypointImage;
use veiloc_evaluation::EvalError;
use veiloc_evaluation::inversion::{
    Course, Example, Form, InversionTask, Inverter, Known, Sees, Shape, Trained, TrainingState, train,
};
use veiloc_features::ColourImage;
use veiloc_geometry::Pixel;

const SIZE: [u32; 2] = [64, 48];

fn shape(sees: Sees) -> Shape {
    Shape { form: Form::UNet, dimension: 4, width: 6, depth: 2, side: 32, sees }
}

fn three_stages() -> InversionTask {
    let shape = Shape { form: Form::InvSfm, ..shape(Sees::Places) };
    InversionTask::new(shape, None).expect("it can be")
}

fn task(sees: Sees) -> InversionTask {
    let scheme = (sees == Sees::Lines).then(|| "dcl".parse().expect("a scheme"));
    InversionTask::new(shape(sees), scheme).expect("it can be")
}

fn course(steps: usize) -> Course {
    Course { steps, images: 3, learning_rate: 4e-3, weight_decay: 1e-4, validate_every: 20, seed: 1 }
}

/// Patches of colours.
fn image(seed: u32) -> (ColourImage, KeypointImage) {
    let places = (0..150).map(|i| ((i * 37 + seed * 11) % SIZE[0], (i * 23 + seed * 5) % SIZE[1]));
    image_of(seed, places, |x, y| {
        let patch = (x / 16 + 5 * (y / 16) + 3 * seed) * 97 % 251;
        [patch as u8, (255 - patch) as u8, 128]
    })
}

/// Bright on the right, green below: what a descriptor tells says where it belongs.
fn slope(seed: u32) -> (ColourImage, KeypointImage) {
    // Anywhere: on a lattice, wrong places would be told by not being on it.
    let mut rng = ChaCha8Rng::seed_from_u64(seed.into());
    let places = (0..150).map(|_| (rng.random_range(0..SIZE[0]), rng.random_range(0..SIZE[1])));
    image_of(seed, places, |x, y| [(4 * x) as u8, (5 * y) as u8, 40 + (seed % 40) as u8])
}

/// An image of these colours, and keypoints in these places whose descriptors tell the colour.
fn image_of(
    seed: u32,
    places: impl Iterator<Item = (u32, u32)>,
    colour: impl Fn(u32, u32) -> [u8; 3],
) -> (ColourImage, KeypointImage) {
    let colour = &colour;
    let pixels = (0..SIZE[1]).flat_map(|y| (0..SIZE[0]).flat_map(move |x| colour(x, y))).collect();
    let (mut keypoints, mut descriptors) = (Vec::new(), Vec::new());
    for (x, y) in places {
        keypoints.push(Pixel::new(f64::from(x) + 0.5, f64::from(y) + 0.5));
        descriptors.extend(colour(x, y));
        descriptors.push(128);
    }
    let [width, height] = SIZE;
    let descriptors = Some((descriptors, 4));
    let image = ColourImage::new(width, height, pixels).expect("three bytes a pixel");
    (image, KeypointImage { name: format!("image {seed}"), width, height, keypoints, descriptors })
}

fn examples(seeds: std::ops::Range<u32>, task: &InversionTask) -> Vec<Example> {
    let example = |seed| {
        let (image, keypoints) = image(seed);
        Example::new(&image, &keypoints, task).expect("of its length")
    };
    seeds.map(example).collect()
}

fn trained(
    task: &InversionTask,
    course: &Course,
    earlier: Option<TrainingState>,
    stop: usize,
) -> Trained<Inverter> {
    let (training, validation) = (examples(0..6, task), examples(50..52, task));
    let observe = |progress: veiloc_evaluation::inversion::Progress<'_>| {
        if progress.step == stop { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    train(&training, &validation, task, course, earlier, observe).expect("it learns")
}

/// Mean difference of colours, by what is known of places.
fn off(network: &Inverter, known: impl Fn(&KeypointImage) -> Vec<Pixel>, truth_known: bool) -> f64 {
    let (truth, keypoints) = image(77);
    let places = known(&keypoints);
    let known = if truth_known { Known::Places(&places) } else { Known::Nothing };
    let made = network.invert(&keypoints, known, 1).expect("of its length");
    assert_eq!([made.width(), made.height()], [32, 24]);
    let at = |x: u32, y: u32, colour: usize| {
        let pixel = 3 * (2 * y * SIZE[0] + 2 * x) as usize + colour;
        f64::from(truth.data()[pixel])
    };
    let cells = (0..24).flat_map(|y| (0..32).flat_map(move |x| (0..3).map(move |c| (x, y, c))));
    let all: Vec<f64> =
        cells.zip(made.data()).map(|((x, y, c), v)| (at(x, y, c) - f64::from(*v)).abs()).collect();
    all.iter().sum::<f64>() / all.len() as f64
}

#[test]
fn it_learns_colours_and_places_matter() {
    let trained = trained(&task(Sees::Places), &course(500), None, 0);
    let (first, last) = (trained.curve[0], trained.curve[trained.curve.len() - 1]);
    assert_eq!((trained.curve.len(), last.step), (25, 500));
    assert!(last.loss < 0.7 * first.loss && last.judged > first.judged + 1.0, "{:?}", trained.curve);
    let right = off(&trained.network, |image| image.keypoints.clone(), true);
    // The same descriptors at each other's places.
    let wrong = off(&trained.network, |image| image.keypoints.iter().rev().copied().collect(), true);
    assert!(right < 0.6 * wrong && right < 35.0, "{right} {wrong}");
}

#[test]
fn lines_and_bags_are_learned_from_too() {
    for sees in [Sees::Lines, Sees::Bag] {
        let trained = trained(&task(sees), &course(60), None, 0);
        assert!(trained.curve[2].loss < trained.curve[0].loss, "{sees:?} {:?}", trained.curve);
        if sees == Sees::Bag {
            // Places are not looked at.
            let of = |known| trained.network.invert(&image(9).1, known, 1).expect("of its length");
            let places = vec![Pixel::new(3.0, 4.0); 150];
            assert_eq!(
                of(Known::Nothing),
                trained.network.invert(&image(9).1, Known::Nothing, 1).expect("again")
            );
            assert_ne!(
                of(Known::Nothing),
                of(Known::Places(&places)),
                "a place given to it would tell something"
            );
        }
    }
}

#[test]
fn three_stages_learn_colours_and_which_places_are_wrong() {
    let of = |seeds: std::ops::Range<u32>, task: &InversionTask| -> Vec<Example> {
        let example = |seed| {
            let (image, keypoints) = slope(seed);
            Example::new(&image, &keypoints, task).expect("of its length")
        };
        seeds.map(example).collect()
    };
    let task = three_stages();
    let on = |_: veiloc_evaluation::inversion::Progress<'_>| ControlFlow::Continue(());
    let trained =
        train(&of(0..8, &task), &of(50..52, &task), &task, &course(600), None, on).expect("it learns");
    let (first, last) = (trained.curve[0], trained.curve[trained.curve.len() - 1]);
    assert!(last.loss < 0.7 * first.loss && last.judged > first.judged + 1.0, "{:?}", trained.curve);

    // Of another image a third of the descriptors is put where others of them belong.
    let (_, image) = slope(78);
    let moved = |i: usize| i.is_multiple_of(3);
    let place = |i: usize| image.keypoints[if moved(i) { (i + 75) % 150 } else { i }];
    let places: Vec<Pixel> = (0..150).map(place).collect();
    let beliefs = trained.network.beliefs(&image, &places).expect("of its length").expect("it judges");
    let mean = |of: bool| {
        let own: Vec<f32> = (0..150).filter(|i| moved(*i) == of).map(|i| beliefs[i]).collect();
        own.iter().sum::<f32>() / own.len() as f32
    };
    assert!(mean(false) > mean(true) + 0.1, "right {} wrong {}", mean(false), mean(true));
    let beyond = trained.network.beliefs(&image, &[Pixel::new(-9.0, 1.0); 150]).expect("no fault");
    assert!(beyond.expect("it judges").iter().all(|belief| belief.is_nan()), "nothing was placed");
}

#[test]
fn a_u_net_can_learn_from_wrong_places_too_and_judges_none() {
    let plain = trained(&task(Sees::Places), &course(3), None, 0);
    let wrong = task(Sees::Places).with_wrong(50).expect("it is given places");
    assert_ne!(trained(&wrong, &course(3), None, 0).state, plain.state);
    let (_, image) = image(1);
    assert_eq!(plain.network.beliefs(&image, &image.keypoints).expect("no fault"), None);
}

#[test]
fn a_training_in_pieces_on_one_thread_is_the_same_to_the_bit() {
    in_pieces(&task(Sees::Lines));
    in_pieces(&three_stages());
}

fn in_pieces(task: &InversionTask) {
    let whole = trained(task, &course(50), None, 0);
    let one = rayon_of(1, || trained(task, &course(50), None, 13));
    assert_eq!(one.state.step(), 13);
    let state = TrainingState::decode(&one.state.encode()).expect("what was written");
    let pieces = rayon_of(3, || trained(task, &course(50), Some(state), 0));
    assert_eq!(pieces.curve, whole.curve);
    assert_eq!(pieces.state, whole.state);
    assert_eq!(pieces.network.encode(), whole.network.encode());

    let other = Course { seed: 2, ..course(50) };
    let (training, validation) = (examples(0..6, task), examples(50..52, task));
    let refused = train(&training, &validation, task, &other, Some(one.state), |_| ControlFlow::Continue(()));
    assert!(matches!(refused, Err(EvalError::Attack(AttackError::OtherTraining))));
}

fn rayon_of<T: Send>(threads: usize, run: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool").install(run)
}

#[test]
fn files_are_read_back_or_refused() {
    let network = trained(&task(Sees::Lines), &course(1), None, 0).network;
    let bytes = network.encode();
    let again = Inverter::decode(&bytes).expect("what was written");
    assert_eq!((again.shape(), again.scheme()), (network.shape(), network.scheme()));
    assert_eq!(again.encode(), bytes);
    let refused = |bytes: &[u8]| match Inverter::decode(bytes).expect_err("refused") {
        EvalError::Attack(error) => error,
        other => panic!("{other}"),
    };
    for length in (0..60).chain([bytes.len() - 1]) {
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
    assert!(matches!(changed(19, 0x7f), AttackError::Option { name: "width", .. }), "no memory is taken");
    assert!(matches!(changed(28, 7), AttackError::Option { name: "what it sees", .. }));
    assert_eq!(changed(200, bytes[200] ^ 1), AttackError::Checksum);
    let other = trained(&three_stages(), &course(1), None, 0).network;
    let read = Inverter::decode(&other.encode()).expect("what was written");
    assert_eq!((read.shape(), read.encode()), (other.shape(), other.encode()));
    assert!(read.parameters() > 2 * network.parameters(), "three stages");
    let mut taken = other.encode();
    taken[..8].copy_from_slice(&bytes[..8]);
    assert!(matches!(refused(&taken), AttackError::Length { .. }), "one form is not read as another");
}

#[test]
fn what_makes_no_sense_is_refused() {
    let dcl = "dcl".parse().expect("a scheme");
    assert!(InversionTask::new(shape(Sees::Lines), None).is_err(), "lines of what");
    assert!(
        InversionTask::new(shape(Sees::Lines), Some(veiloc_protocol::Scheme::Points)).is_err(),
        "no lines"
    );
    assert!(InversionTask::new(shape(Sees::Bag), Some(dcl)).is_err(), "nothing is seen of it");
    for sees in [Sees::Lines, Sees::Bag] {
        let shape = Shape { form: Form::InvSfm, ..shape(sees) };
        let words = InversionTask::new(shape, (sees == Sees::Lines).then_some(dcl)).expect_err("no places");
        assert!(words.to_string().contains("use --sees places"), "{words}");
        assert!(task(sees).with_wrong(10).is_err());
    }
    assert!(task(Sees::Places).with_wrong(91).is_err() && task(Sees::Bag).with_wrong(0).is_ok());
    assert!(InversionTask::new(Shape { depth: 0, ..shape(Sees::Places) }, None).is_err());
    let task = task(Sees::Places);
    let (colours, mut keypoints) = image(1);
    keypoints.descriptors = Some((vec![1; 150 * 3], 3));
    let words = Example::new(&colours, &keypoints, &task).expect_err("another length").to_string();
    assert!(words.contains("image 1") && words.contains("descriptors of 3"), "{words}");
    keypoints.descriptors = None;
    assert!(Example::new(&colours, &keypoints, &task).is_err(), "none at all");
    let on = |_: veiloc_evaluation::inversion::Progress<'_>| ControlFlow::Continue(());
    let some = examples(0..1, &task);
    assert!(matches!(train(&[], &some, &task, &course(1), None, on), Err(EvalError::Nothing(_))));
    assert!(matches!(train(&some, &[], &task, &course(1), None, on), Err(EvalError::Nothing(_))));
    assert!(matches!(
        veiloc_evaluation::inversion::refuse_shared(&some, &some),
        Err(EvalError::SharedImages { images: 1 })
    ));
}
