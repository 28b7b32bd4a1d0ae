//! L11, the image border: keypoints lie up to the border of the device's own image. The extreme angles would reveal the
//! border's position, and so the lens. Measured on the sent angles of two lenses of one model.

use super::common;

use common::*;
use veiloc_geometry::{Anchor, Intrinsics, Pixel};

/// Images of each lens.
const IMAGES: u64 = 250;
const KEYPOINTS: usize = 2048;

/// Keypoints all over the device's image, up to its border.
fn keypoints(seed: u64) -> Vec<Pixel> {
    uniform_pixels(KEYPOINTS, seed)
        .into_iter()
        .map(|p| Pixel::new((p.u - 2.0) * 640.0 / 636.0, (p.v - 2.0) * 480.0 / 476.0))
        .collect()
}

/// The largest angle at each anchor: the line nearest to the image's upper or lower border.
fn extremes(angles: impl Iterator<Item = (usize, f64)>) -> [f64; 2] {
    angles.fold([0.0; 2], |mut most, (anchor, angle)| {
        most[anchor] = f64::max(most[anchor], angle);
        most
    })
}

/// ROC AUC of telling two lenses apart by a value: the probability that it is larger for lens `a`; 0.5 is chance.
fn auc(a: &[f64], b: &[f64]) -> f64 {
    let wins: f64 = a
        .iter()
        .flat_map(|x| {
            b.iter().map(move |y| {
                if x > y {
                    1.0
                } else if x == y {
                    0.5
                } else {
                    0.0
                }
            })
        })
        .sum();
    let auc = wins / (a.len() * b.len()) as f64;
    auc.max(1.0 - auc)
}

fn sent(lens: &Intrinsics, seed: u64) -> [f64; 2] {
    let features = features_at(&keypoints(seed), seed);
    let query = seal(features, lens, &profile(), &options("dcl:paper"), &mut rng(seed)).expect("sealed");
    extremes(angles(&query.observations()).into_iter())
}

/// The same for a camera that covers everything the lens shows.
fn uncut(lens: &Intrinsics, seed: u64) -> [f64; 2] {
    let anchors = ImageAnchors::new(640, 480);
    let ladder: Intrinsics = "SIMPLE_PINHOLE,640,480,512,320,240".parse().expect("valid");
    let angle = |p: Pixel| {
        let seen = ladder.pinhole().project(lens.unproject(p).expect("a ray"));
        let anchor = anchors.anchor_of(seen);
        (anchor.index(), anchors.angle_of(anchor, seen))
    };
    extremes(keypoints(seed).into_iter().map(angle))
}

/// The mean extreme of five queries of a session, by both anchors: lenses with a shifted centre differ in the
/// difference, lenses of another focal length in the sum.
fn numbers(of: impl Fn(u64) -> [f64; 2], first: u64) -> [Vec<f64>; 2] {
    let all: Vec<[f64; 2]> = (0..IMAGES).map(|k| of(first + k)).collect();
    let session = |f: &dyn Fn(&[f64; 2]) -> f64| {
        all.chunks(5).map(|five| five.iter().map(f).sum::<f64>() / five.len() as f64).collect()
    };
    let (first, second) = (Anchor::FIRST.index(), Anchor::SECOND.index());
    [session(&|e| e[first] - e[second]), session(&|e| e[first] + e[second])]
}

#[test]
fn l11_image_border_identifies_no_lens() {
    let lens = |text: &str| -> Intrinsics { text.parse().expect("valid") };
    let own = lens("SIMPLE_PINHOLE,640,480,525,320,240");
    for (k, other) in ["SIMPLE_PINHOLE,640,480,525,320,243", "SIMPLE_PINHOLE,640,480,519.75,320,240"]
        .into_iter()
        .enumerate()
    {
        let description = other;
        let other = lens(other);
        let of = |f: &dyn Fn(&Intrinsics, u64) -> [f64; 2]| {
            let (a, b) = (numbers(|seed| f(&own, seed), 1), numbers(|seed| f(&other, seed), 5_000));
            [0, 1].map(|number| auc(&a[number], &b[number]))
        };
        let (leak, real) = (of(&uncut), of(&sent));
        assert!(leak[k] > 0.9, "the measure does not see the leak: {leak:?}");
        eprintln!("after five queries, {description}: {leak:.2?} without the window, {real:.2?} as sent");
        // Fifty sessions per lens: the AUC at chance is 0.5 ± 0.06, and the larger of the two values counts.
        assert!(real[0].max(real[1]) < 0.67, "{real:?} after five queries");
    }
}
