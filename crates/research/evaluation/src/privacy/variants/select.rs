//! Which keypoints a device sends under a variant.

use std::collections::BTreeSet;

use rand::Rng;
use rand::seq::SliceRandom;
use veiloc_attacks::{KnownSegment, Observation};
use veiloc_geometry::{Anchor, Pencils, Pixel};

use super::variant::{Keep, Variant};

/// Keypoints nearer than this to an anchor, pixels, have no useful angle and are dropped, as a device drops them.
const ANCHOR_CLEARANCE: f64 = 1.0;

/// The keypoints that are sent, rising indices.
///
/// `ratios[i]`: the smallest distance ratio of a match of keypoint `i`, infinite without a match; `None` where nothing is
/// known of matches, and then `known` leaves nothing out.
pub(super) fn select(
    variant: &Variant,
    keypoints: &[Pixel],
    size: (u32, u32),
    pencils: &Pencils,
    ratios: Option<&[f64]>,
    rng: &mut impl Rng,
) -> Vec<usize> {
    let mut shuffled: Vec<usize> = (0..keypoints.len()).collect();
    shuffled.shuffle(rng);
    let crop = Anchor::BOTH.map(|_| variant.crop + (1.0 - variant.crop) * rng.random::<f64>());
    let admitted = |i: &usize| {
        let p = keypoints[*i];
        let known = match (variant.known, ratios) {
            (Some(limit), Some(ratios)) => ratios[*i] <= limit,
            _ => true,
        };
        let clear = Anchor::BOTH.iter().all(|a| pencils.distance(*a, p) > ANCHOR_CLEARANCE);
        known
            && clear
            && pencils.clearance(p) >= variant.gap
            && (variant.crop >= 1.0 || along(pencils, p, size) <= crop[pencils.anchor_of(p).index()])
    };
    let order: Vec<usize> = match variant.keep {
        Keep::Random(_) => shuffled,
        Keep::All | Keep::First(_) => (0..keypoints.len()).collect(),
    };
    let mut kept: Vec<usize> = Vec::new();
    let mut cells = BTreeSet::new();
    for i in order.into_iter().filter(admitted) {
        let p = keypoints[i];
        let crowded =
            variant.spacing > 0.0 && kept.iter().any(|j| keypoints[*j].distance(&p) < variant.spacing);
        let cell = |x: f64| (x / variant.cell).floor() as i64;
        let taken = variant.cell > 0.0 && !cells.insert((cell(p.u), cell(p.v)));
        if !crowded && !taken {
            kept.push(i);
        }
    }
    match variant.keep {
        Keep::First(n) | Keep::Random(n) => kept.truncate(n),
        Keep::All => {}
    }
    kept.sort_unstable();
    kept
}

/// How far out on its half-line a keypoint is, as a share of the way from the anchor to the image's border.
fn along(pencils: &Pencils, p: Pixel, size: (u32, u32)) -> f64 {
    let anchor = pencils.anchor_of(p);
    let ray = Observation::anchored(pencils, anchor, pencils.angle_of(anchor, p));
    let far = KnownSegment::hull(&ray, size.0, size.1).map_or(f64::INFINITY, |s| s.far);
    pencils.distance(anchor, p) / far
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    const SIZE: (u32, u32) = (640, 480);

    fn keypoints() -> Vec<Pixel> {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let mut draw = || Pixel::new(rng.random_range(0.0..640.0), rng.random_range(0.0..480.0));
        let mut all: Vec<Pixel> = (0..600).map(|_| draw()).collect();
        // Two orientations of one keypoint.
        all.push(all[5]);
        all
    }

    fn selected(text: &str, ratios: Option<&[f64]>, seed: u64) -> Vec<usize> {
        let variant: Variant = text.parse().expect("well written");
        let pencils = Pencils::paper(SIZE.0, SIZE.1);
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        select(&variant, &keypoints(), SIZE, &pencils, ratios, &mut rng)
    }

    #[test]
    fn spacing_is_kept_and_nothing_more_is_left_out() {
        let all = keypoints();
        for text in ["spacing=12", "spacing=32", "spacing=12+random=1000"] {
            let kept = selected(text, None, 3);
            let spacing = if text.contains("32") { 32.0 } else { 12.0 };
            let near =
                |i: usize| kept.iter().filter(|j| **j != i && all[**j].distance(&all[i]) < spacing).count();
            assert!(kept.iter().all(|i| near(*i) == 0), "{text}");
            assert!((0..all.len()).filter(|i| !kept.contains(i)).all(|i| near(i) > 0), "{text}");
        }
        assert_eq!(selected("spacing=12", None, 3)[0], 0, "the strongest stays");
        assert_ne!(selected("spacing=12", None, 3), selected("spacing=12+random=1000", None, 3));
    }

    #[test]
    fn counts_cells_and_gaps_are_what_they_say() {
        let all = keypoints();
        assert_eq!(selected("first=128", None, 1), (0..128).collect::<Vec<_>>());
        let drawn = selected("random=128", None, 1);
        assert_eq!(drawn.len(), 128);
        assert!(drawn.windows(2).all(|w| w[0] < w[1]) && drawn != selected("random=128", None, 2));
        assert_eq!(drawn, selected("random=128", None, 1), "equal seeds");
        assert!(drawn.iter().all(|i| selected("random=300", None, 1).contains(i)), "nested");
        assert_eq!(selected("dcl", None, 1).len(), all.len());

        let cells = selected("cell=80", None, 1);
        let of = |i: &usize| ((all[*i].u / 80.0) as u32, (all[*i].v / 80.0) as u32);
        assert_eq!(cells.iter().map(of).collect::<BTreeSet<_>>().len(), cells.len());
        assert_eq!((0..all.len()).map(|i| of(&i)).collect::<BTreeSet<_>>().len(), cells.len());

        let gap = selected("gap=30", None, 1);
        let outside = (0..all.len()).filter(|i| (all[*i].u - 320.0).abs() >= 30.0).collect::<Vec<_>>();
        assert_eq!(gap, outside);
    }

    #[test]
    fn only_what_the_map_knows_is_sent() {
        let ratios: Vec<f64> =
            (0..keypoints().len()).map(|i| if i % 3 == 0 { 0.7 } else { f64::INFINITY }).collect();
        assert_eq!(selected("known=0.8", Some(&ratios), 1), (0..601).step_by(3).collect::<Vec<_>>());
        assert!(selected("known=0.6", Some(&ratios), 1).is_empty());
        assert_eq!(selected("known=0.6", None, 1).len(), 601);
    }

    #[test]
    fn a_crop_is_the_side_of_the_image_scaled_about_its_anchor() {
        let (all, pencils) = (keypoints(), Pencils::paper(SIZE.0, SIZE.1));
        for seed in 0..20 {
            let kept = selected("crop=0.5", None, seed);
            for anchor in Anchor::BOTH {
                let own = |i: &usize| pencils.anchor_of(all[*i]) == anchor;
                // The image's half, scaled by λ about (320, 0) or (320, 480): |u − 320| ≤ 320 λ, |v − v0| ≤ 480 λ.
                let v0 = pencils.position(anchor).expect("at the edge").v;
                let least = |i: usize| ((all[i].u - 320.0).abs() / 320.0).max((all[i].v - v0).abs() / 480.0);
                let inside = kept.iter().copied().filter(own).map(least).fold(0.0, f64::max);
                let outside =
                    (0..all.len()).filter(|i| own(i) && !kept.contains(i)).map(least).fold(1.0, f64::min);
                assert!(
                    (0.0..=1.0).contains(&inside) && outside >= 0.5 && inside < outside,
                    "{inside} {outside}"
                );
            }
        }
    }
}
