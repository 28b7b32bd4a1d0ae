//! A training end to end: it learns, does not depend on threads, and goes on as if it had not been interrupted.

use std::ops::ControlFlow;

use veiloc_datasets::KeypointImage;
use veiloc_features::ColourImage;
use veiloc_geometry::Pixel;
use veiloc_inversion::{
    Course, Example, InversionError, InversionTask, Inverter, Known, Sees, Shape, Trained, TrainingState,
    train,
};
use veiloc_training::TrainingError;

const SIZE: [u32; 2] = [64, 48];

fn shape(sees: Sees) -> Shape {
    Shape { dimension: 4, width: 6, depth: 2, side: 32, sees }
}

fn task(sees: Sees) -> InversionTask {
    let scheme = (sees == Sees::Lines).then(|| "dcl".parse().expect("a scheme"));
    InversionTask::new(shape(sees), scheme).expect("it can be")
}

fn course(steps: usize) -> Course {
    Course { steps, images: 3, learning_rate: 4e-3, weight_decay: 1e-4, validate_every: 20, seed: 1 }
}

/// Patches of colours, and keypoints all over it whose descriptors tell the colour.
fn image(seed: u32) -> (ColourImage, KeypointImage) {
    let colour = |x: u32, y: u32| {
        let patch = (x / 16 + 5 * (y / 16) + 3 * seed) * 97 % 251;
        [patch as u8, (255 - patch) as u8, 128]
    };
    let pixels = (0..SIZE[1]).flat_map(|y| (0..SIZE[0]).flat_map(move |x| colour(x, y))).collect();
    let (mut keypoints, mut descriptors) = (Vec::new(), Vec::new());
    for i in 0..150 {
        let (x, y) = ((i * 37 + seed * 11) % SIZE[0], (i * 23 + seed * 5) % SIZE[1]);
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
    let observe = |progress: veiloc_inversion::Progress<'_>| {
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
fn a_training_in_pieces_on_one_thread_is_the_same_to_the_bit() {
    let task = task(Sees::Lines);
    let whole = trained(&task, &course(50), None, 0);
    let one = rayon_of(1, || trained(&task, &course(50), None, 13));
    assert_eq!(one.state.step(), 13);
    let state = TrainingState::decode(&one.state.encode()).expect("what was written");
    let pieces = rayon_of(3, || trained(&task, &course(50), Some(state), 0));
    assert_eq!(pieces.curve, whole.curve);
    assert_eq!(pieces.state, whole.state);
    assert_eq!(pieces.network.encode(), whole.network.encode());

    let other = Course { seed: 2, ..course(50) };
    let (training, validation) = (examples(0..6, &task), examples(50..52, &task));
    let refused =
        train(&training, &validation, &task, &other, Some(one.state), |_| ControlFlow::Continue(()));
    assert!(matches!(refused, Err(InversionError::Training(TrainingError::OtherTraining))));
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
        InversionError::Training(error) => error,
        other => panic!("{other}"),
    };
    for length in (0..60).chain([bytes.len() - 1]) {
        let error = refused(&bytes[..length]);
        assert!(
            matches!(error, TrainingError::NotANetwork { .. } | TrainingError::Length { .. }),
            "{length} {error}"
        );
    }
    let changed = |at: usize, to: u8| {
        let mut bytes = bytes.clone();
        bytes[at] = to;
        refused(&bytes)
    };
    assert_eq!(changed(8, 9), TrainingError::Version { found: 9, expected: 1 });
    assert!(matches!(changed(19, 0x7f), TrainingError::Option { name: "width", .. }), "no memory is taken");
    assert!(matches!(changed(28, 7), TrainingError::Option { name: "what it sees", .. }));
    assert_eq!(changed(200, bytes[200] ^ 1), TrainingError::Checksum);
}

#[test]
fn what_makes_no_sense_is_refused() {
    let dcl = "dcl".parse().expect("a scheme");
    assert!(InversionTask::new(shape(Sees::Lines), None).is_err(), "lines of what");
    assert!(InversionTask::new(shape(Sees::Lines), Some(veiloc_query::Scheme::Points)).is_err(), "no lines");
    assert!(InversionTask::new(shape(Sees::Bag), Some(dcl)).is_err(), "nothing is seen of it");
    assert!(InversionTask::new(Shape { depth: 0, ..shape(Sees::Places) }, None).is_err());
    let task = task(Sees::Places);
    let (colours, mut keypoints) = image(1);
    keypoints.descriptors = Some((vec![1; 150 * 3], 3));
    let words = Example::new(&colours, &keypoints, &task).expect_err("another length").to_string();
    assert!(words.contains("image 1") && words.contains("descriptors of 3"), "{words}");
    keypoints.descriptors = None;
    assert!(Example::new(&colours, &keypoints, &task).is_err(), "none at all");
    let on = |_: veiloc_inversion::Progress<'_>| ControlFlow::Continue(());
    let some = examples(0..1, &task);
    assert!(matches!(train(&[], &some, &task, &course(1), None, on), Err(InversionError::Nothing(_))));
    assert!(matches!(train(&some, &[], &task, &course(1), None, on), Err(InversionError::Nothing(_))));
    assert!(matches!(
        veiloc_inversion::refuse_shared(&some, &some),
        Err(InversionError::Shared { images: 1 })
    ));
}
