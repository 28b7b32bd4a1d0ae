//! Tests for the rules L1–L9 of the design, named after them. Every test also builds the leak and checks that its own
//! measure detects it: a test that cannot fail proves nothing.

use super::common;

use std::collections::BTreeSet;
use std::f64::consts::{FRAC_PI_2, PI};

use common::{
    ImageAnchors, angles, camera, correlation, features_at, options, profile, rng, seal, seal_with_truth,
    uniform_pixels,
};
use rand::Rng;
use veiloc_descriptor::Descriptors;
use veiloc_features::Features;
use veiloc_geometry::{Anchor, Intrinsics, Pixel, PixelLine};
use veiloc_obfuscation::{Extracted, SealError, Sealer, obfuscate_points};
use veiloc_protocol::{
    AngleBits, CanonicalCamera, CoarseGravity, FocalKnowledge, Observations, Scheme, SizeClass,
};

const LINE_SCHEMES: [&str; 3] = ["random-lines", "coordinate-permutation", "dcl"];

/// L1: the sent values must not reveal the distance from the anchor. The leak: the plain product `x × a`, whose norm is
/// that distance.
#[test]
fn l1_line_reveals_no_distance_from_anchor() {
    let anchors = ImageAnchors::new(640, 480);
    let mut rng = rng(1);
    // Radius and angle are drawn independently.
    let pixels: Vec<Pixel> = (0..4096)
        .map(|i| {
            let anchor = Anchor::BOTH[i % 2];
            let direction = anchors.ray_direction(anchor, rng.random_range(0.05..1.5));
            let p = anchors.position(anchor).vector() + direction * rng.random_range(10.0..310.0);
            Pixel::new(p.x, p.y)
        })
        .collect();
    let (query, truth) = seal_with_truth(
        features_at(&pixels, 1),
        &camera(),
        &profile().with_limits(limits(4096)).expect("allowed"),
        &options("dcl:paper").with_max_keypoints(4096),
        &mut rng,
    )
    .expect("sealed");
    let radius = |p: Pixel| anchors.position(anchors.anchor_of(p)).distance(&p);

    let sent: Vec<(f64, f64)> = angles(&query.observations())
        .iter()
        .zip(&truth.pixels)
        .map(|((_, angle), pixel)| (*angle, radius(*pixel)))
        .collect();
    let leak: Vec<(f64, f64)> = truth
        .pixels
        .iter()
        .map(|&x| {
            let product = x.homogeneous().cross(&anchors.position(anchors.anchor_of(x)).homogeneous());
            (product.xy().norm(), radius(x))
        })
        .collect();
    assert!(correlation(&leak) > 0.999, "the measure does not see the leak");
    assert!(correlation(&sent).abs() < 0.06, "{}", correlation(&sent));

    // The message holds only anchor and angle: 14 bits per row, all of which are checked here.
    assert_eq!(common::bytes_of_field(&query.encode(), common::POSITIONS).len(), 4096 * 14 / 8);
    for ((anchor, angle), pixel) in angles(&query.observations()).iter().zip(&truth.pixels) {
        let anchor = Anchor::BOTH[*anchor];
        let dither = (0.71 / radius(*pixel)).min(1.0).asin();
        let off = (anchors.angle_of(anchor, *pixel) - angle).abs();
        assert!(off <= dither + PI / 4096.0 || anchors.signed_side(*pixel).abs() < 0.51, "{off}");
    }
}

/// L2: extractors with integer positions put keypoints on a lattice, and an exact angle identifies the lattice point.
#[test]
fn l2_angle_identifies_no_pixel() {
    let small: Intrinsics = "SIMPLE_PINHOLE,160,128,128,80,64".parse().expect("valid");
    let anchors = ImageAnchors::new(160, 128);
    let mut rng = rng(2);
    let lattice: Vec<Pixel> =
        (0..160 * 128).map(|i| Pixel::new(f64::from(i % 160) + 0.5, f64::from(i / 160) + 0.5)).collect();
    let pixels: Vec<Pixel> = (0..256).map(|_| lattice[rng.random_range(0..lattice.len())]).collect();
    let (query, truth) =
        seal_with_truth(features_at(&pixels, 2), &small, &profile(), &options("dcl"), &mut rng)
            .expect("sealed");
    let sent = angles(&query.observations());

    // The attacker takes the lattice point whose exact angle is nearest.
    let by_angle: Vec<(usize, f64, Pixel)> = lattice
        .iter()
        .map(|&p| {
            let anchor = anchors.anchor_of(p);
            (anchor.index(), anchors.angle_of(anchor, p), p)
        })
        .collect();
    let named = |sent_values: &dyn Fn(usize) -> (usize, f64)| -> usize {
        (0..256)
            .filter(|&row| {
                let (anchor, angle) = sent_values(row);
                let nearest = by_angle
                    .iter()
                    .filter(|(a, ..)| *a == anchor)
                    .min_by(|a, b| (a.1 - angle).abs().total_cmp(&(b.1 - angle).abs()))
                    .expect("every side has lattice points");
                nearest.2 == truth.pixels[row]
            })
            .count()
    };
    let exact = |row: usize| {
        let anchor = anchors.anchor_of(truth.pixels[row]);
        (anchor.index(), anchors.angle_of(anchor, truth.pixels[row]))
    };
    let bits = AngleBits::default();
    let undithered = |row: usize| (exact(row).0, bits.angle_of(bits.code_of(exact(row).1)));
    let (leak, half_leak, real) = (named(&exact), named(&undithered), named(&|row| sent[row]));
    assert!(leak > 128, "the measure does not see the leak: {leak} of 256 pixels named");
    assert!(half_leak > 2 * real.max(4), "dither does nothing: {half_leak} against {real}");
    assert!(real <= 8, "{real} of 256 pixels named");
}

/// L3: extractors scan the image row by row.
#[test]
fn l3_rows_are_shuffled() {
    let mut pixels = uniform_pixels(512, 3);
    pixels.sort_by(|a, b| a.v.total_cmp(&b.v));
    let rank = |order: &[Option<usize>]| -> f64 {
        let pairs: Vec<(f64, f64)> =
            order.iter().enumerate().filter_map(|(row, s)| s.map(|s| (row as f64, s as f64))).collect();
        correlation(&pairs)
    };
    let unshuffled: Vec<Option<usize>> = (0..512).map(Some).collect();
    assert!(rank(&unshuffled) > 0.999, "the measure does not see the leak");
    for scheme in ["points", "random-lines", "coordinate-permutation", "dcl"] {
        let order = |seed| {
            let features = features_at(&pixels, 3);
            let sealed = seal_with_truth(features, &camera(), &profile(), &options(scheme), &mut rng(seed));
            sealed.expect("sealed").1.source
        };
        let (first, second) = (order(1), order(2));
        assert!(rank(&first).abs() < 0.15, "{scheme}: {}", rank(&first));
        assert_ne!(first, second, "{scheme}: another generator, another order");
        let selected: BTreeSet<usize> = first.iter().copied().flatten().collect();
        assert_eq!(selected.len(), 512, "{scheme}: each keypoint once");
    }
}

/// L4: strength, scale and orientation leave no trace; two images that differ only in them give the same bytes.
#[test]
fn l4_strength_scale_and_orientation_are_not_sent() {
    let plain = features_at(&uniform_pixels(256, 4), 4);
    let mut other = plain.clone();
    for (i, keypoint) in other.keypoints.iter_mut().enumerate() {
        keypoint.scale *= 3.0;
        keypoint.orientation = 0.1;
        keypoint.response = 500.0 - i as f32; // the same order
    }
    for scheme in LINE_SCHEMES {
        let bytes = |f: &Features| {
            seal(f.clone(), &camera(), &profile(), &options(scheme), &mut rng(4)).expect("sealed").encode()
        };
        assert_eq!(bytes(&plain), bytes(&other), "{scheme}");
        // The leak: the octave in a field that is sent, the first value of the descriptor.
        let leaky = |f: &Features| {
            let dim = f.descriptors.kind().dim();
            let mut rows = f.descriptors.as_bytes().to_vec();
            for (row, keypoint) in rows.chunks_exact_mut(dim).zip(&f.keypoints) {
                row[0] = keypoint.scale.log2() as u8;
            }
            let descriptors = Descriptors::new(f.descriptors.kind(), rows).expect("whole rows");
            bytes(&Features { descriptors, keypoints: f.keypoints.clone(), global: None })
        };
        assert_ne!(leaky(&plain), leaky(&other), "the measure does not see the leak");

        // Strength decides which keypoints are selected, but not the order of the rows.
        let (_, truth) = seal_with_truth(plain.clone(), &camera(), &profile(), &options(scheme), &mut rng(4))
            .expect("sealed");
        let strength = |source: usize| f64::from(plain.keypoints[source].response);
        let sent_values = |order: &[usize]| -> f64 {
            let pairs: Vec<_> = order.iter().enumerate().map(|(row, s)| (row as f64, strength(*s))).collect();
            correlation(&pairs).abs()
        };
        let order: Vec<usize> = truth.source.into_iter().flatten().collect();
        let mut strongest_first = order.clone();
        strongest_first.sort_by(|a, b| strength(*b).total_cmp(&strength(*a)));
        assert!(sent_values(&strongest_first) > 0.25, "the measure does not see the leak");
        assert!(sent_values(&order) < 0.2, "{scheme}: {}", sent_values(&order));
    }
}

/// L4 for the steps of a progressive query: the order of rows is independent of strength. The leak: the strongest
/// first, which would reveal the strongest keypoints to the server.
#[test]
fn l4_first_rows_are_not_stronger() {
    let features = features_at(&uniform_pixels(1024, 8), 8);
    let profile = profile();
    // The strength is a rank here: the mean of 256 random ranks of 1024 is 511.5 ± 16.
    let mean = |rows: &[usize]| rows.iter().sum::<usize>() as f64 / rows.len() as f64;
    for scheme in LINE_SCHEMES {
        let (query, truth) =
            seal_with_truth(features.clone(), &camera(), &profile, &options(scheme), &mut rng(8))
                .expect("sealed");
        let ranks: Vec<usize> = truth.source.into_iter().flatten().collect();
        let mut strongest = ranks.clone();
        strongest.sort_unstable();
        assert!(mean(&strongest[..256]) < 200.0, "the measure does not see the leak");
        let first = query.first_rows(SizeClass::Rows256, &profile).expect("it has 1024");
        assert!(
            first.descriptors().expect("rows").to_owned()
                == features.descriptors.select(ranks[..256].iter().copied())
        );
        assert!((mean(&ranks[..256]) - 511.5).abs() < 80.0, "{scheme}: {}", mean(&ranks[..256]));
    }
}

/// L5: only one of five size classes depends on the number of keypoints, and nothing marks a decoy.
#[test]
fn l5_size_reveals_only_the_class_and_decoys_are_unmarked() {
    for scheme in LINE_SCHEMES {
        let sealed = |count: usize| {
            let features = features_at(&uniform_pixels(count, 5), count as u64);
            seal_with_truth(features, &camera(), &profile(), &options(scheme), &mut rng(5)).expect("sealed")
        };
        let lengths: BTreeSet<usize> =
            [8, 60, 255, 256, 300, 511].into_iter().map(|n| sealed(n).0.encode().len()).collect();
        assert_eq!(lengths.len(), 1, "{scheme}: {lengths:?}");
        assert_ne!(
            sealed(512).0.encode().len(),
            *lengths.first().expect("one"),
            "the measure does not see sizes"
        );

        // The weakest are dropped.
        let (_, truth) = sealed(400);
        let selected: BTreeSet<usize> = truth.source.iter().copied().flatten().collect();
        assert_eq!(selected, (0..256).collect(), "{scheme}");

        // Decoys: as long as real descriptors, and included in the global descriptor. The leak would be a global
        // descriptor of the real rows alone: rows that it does not include are decoys.
        let (query, truth) = sealed(100);
        let decoys: Vec<usize> = (0..256).filter(|&row| truth.source[row].is_none()).collect();
        assert_eq!(decoys.len(), 156, "{scheme}");
        let norm = |row: &usize| -> f64 {
            query
                .descriptors()
                .expect("rows")
                .row(*row)
                .iter()
                .map(|v| f64::from(*v).powi(2))
                .sum::<f64>()
                .sqrt()
        };
        assert!((0..256).all(|row| (norm(&row) - 512.0).abs() < 8.0), "{scheme}: a length stands out");
        let profile = profile();
        let vocabulary = profile.vocabulary().expect("VLAD");
        let of = |rows: Vec<usize>| {
            vocabulary.aggregate(query.descriptors().expect("rows").to_owned().select(rows).view())
        };
        let real_only = of((0..256).filter(|&row| truth.source[row].is_some()).collect());
        assert_eq!(
            of((0..256).collect()).as_codes(),
            query.global().expect("of rows").as_codes(),
            "{scheme}"
        );
        assert_ne!(
            real_only.as_codes(),
            query.global().expect("of rows").as_codes(),
            "the measure does not see the leak"
        );
    }
}

/// L6: devices of one model differ slightly in every calibration value.
#[test]
fn l6_camera_identifies_no_device() {
    let mut rng = rng(6);
    let pixels = uniform_pixels(256, 6);
    let mut sent_values = BTreeSet::new();
    let mut leak = BTreeSet::new();
    for i in 0..300 {
        let params = [
            rng.random_range(515.0..535.0),
            rng.random_range(314.0..326.0),
            rng.random_range(234.0..246.0),
            rng.random_range(-0.02..0.0),
        ];
        let device = Intrinsics::new("SIMPLE_RADIAL", 640, 480, &params).expect("valid");
        leak.insert(params.map(f64::to_bits));
        sent_values.insert(CanonicalCamera::for_intrinsics(&device).expect("ordinary").codes());
        if i % 50 == 0 {
            // No information is lost: the canonical pixel is the same ray.
            let features = features_at(&pixels, 6);
            let (query, truth) =
                seal_with_truth(features, &device, &profile(), &options("dcl"), &mut rng).expect("sealed");
            for (source, pixel) in truth.source.iter().zip(&truth.pixels) {
                let Some(source) = source else { continue };
                let ray = device.unproject(pixels[*source]).expect("inside").bearing();
                assert!((query.camera().unproject(*pixel).bearing() - ray).norm() < 1e-12);
            }
        }
    }
    assert_eq!(leak.len(), 300, "the measure does not see the leak");
    // The devices lie on both sides of one border of the list.
    assert!(sent_values.len() <= 2, "{} cameras for 300 devices of one model", sent_values.len());
}

/// L6: every accelerometer has its own error of some tenths of a degree; rounding hides it. Gravity is sent only if the
/// caller gives it, alone or with an orientation (`session.rs`), and changes nothing else in the query.
#[test]
fn l6_gravity_is_rounded() {
    let features = || features_at(&uniform_pixels(256, 6), 6);
    let sealer = Sealer::new(&profile(), options("dcl")).expect("its profile");
    let extracted = |gravity| Extracted::new(features(), camera()).with_gravity(gravity);
    let sealed = |gravity| sealer.seal(extracted(gravity), &mut rng(6)).expect("sealed");
    let plain = sealed(None);
    assert_eq!((plain.gravity(), plain.focal_known()), (None, FocalKnowledge::Calibrated));
    let (mut sent_values, mut leak) = (BTreeSet::new(), BTreeSet::new());
    let mut rng_of_devices = rng(7);
    for _ in 0..300 {
        let mut error = || rng_of_devices.random_range(-0.003..0.003); // radians: a sixth of a degree
        let felt = [0.021 + error(), 0.981, 0.174 + error()];
        leak.insert(felt.map(f64::to_bits));
        let gravity = CoarseGravity::new(felt, 1.0).expect("a direction");
        let query = sealed(Some(gravity));
        assert_eq!(query.gravity(), Some(gravity));
        sent_values.insert(query.encode());
        assert_eq!(query.encode().len(), plain.encode().len(), "L5");
        assert_eq!(query.observations(), plain.observations(), "the rows do not depend on it");
    }
    assert_eq!(leak.len(), 300, "the measure does not see the leak");
    assert!(sent_values.len() <= 6, "{} directions for 300 devices of one model", sent_values.len());
    let gravity = CoarseGravity::new([0.1, 0.9, 0.2], 1.0).ok();
    let printed = format!("{:?}", extracted(gravity));
    assert!(!printed.contains("0."), "L8: {printed}");
}

/// L7: two different lines for one keypoint cross in it. Within an image, features at one position share a line; a
/// retry with the same features does not compile, because `Sealer::seal` takes them by value (`compile_fail` example in its
/// documentation).
#[test]
fn l7_one_keypoint_has_one_line() {
    let positions = uniform_pixels(300, 7);
    // Two orientations at every position, as SIFT returns them.
    let twice: Vec<Pixel> = positions.iter().flat_map(|p| [*p, *p]).collect();
    for scheme in LINE_SCHEMES {
        let (query, truth) =
            seal_with_truth(features_at(&twice, 7), &camera(), &profile(), &options(scheme), &mut rng(7))
                .expect("sealed");
        let row_of = |source: usize| truth.source.iter().position(|s| *s == Some(source)).expect("kept");
        let observations = query.observations();
        for index in 0..256 {
            let rows = [row_of(2 * index), row_of(2 * index + 1)];
            match &observations {
                Observations::Lines(lines) => assert_eq!(lines[rows[0]], lines[rows[1]]),
                Observations::EitherLine(lines) => assert_eq!(lines[rows[0]], lines[rows[1]]),
                Observations::Anchored { lines, .. } => assert_eq!(lines[rows[0]], lines[rows[1]]),
                Observations::Points(_) => panic!("a line scheme"),
            }
        }
    }
    // The leak: a second line for each keypoint. Half a pixel of dither on either line does not help.
    let lines = |seed| {
        let scheme = Scheme::RandomLines;
        match obfuscate_points(&positions, 640, 480, &scheme, AngleBits::default(), &mut rng(seed)) {
            Ok(Observations::Lines(lines)) => lines,
            other => panic!("{other:?}"),
        }
    };
    let (first, second) = (lines(1), lines(2));
    let named = positions
        .iter()
        .zip(first.iter().zip(&second))
        .filter(|(pixel, (a, b))| a.intersection(b).is_some_and(|crossing| crossing.distance(pixel) < 3.0));
    assert!(named.count() > 200, "the measure does not see the leak");
    // A retry sends the same bytes.
    let query = seal(features_at(&positions, 7), &camera(), &profile(), &options("dcl"), &mut rng(7))
        .expect("sealed");
    assert_eq!(query.encode(), query.clone().encode());
}

/// L8: debug output is equal for any two queries of one size class.
#[test]
fn l8_debug_output_has_counts_only() {
    for scheme in ["points", "random-lines", "coordinate-permutation", "dcl"] {
        let sealed = |seed| {
            let features = features_at(&uniform_pixels(256, seed), seed);
            seal_with_truth(features, &camera(), &profile(), &options(scheme), &mut rng(seed))
                .expect("sealed")
        };
        let ((a, truth_a), (b, truth_b)) = (sealed(1), sealed(2));
        assert_eq!(format!("{a:?} {a:#?}"), format!("{b:?} {b:#?}"));
        assert_eq!(format!("{:?}", a.observations()), format!("{:?}", b.observations()));
        assert_eq!(format!("{truth_a:?}"), format!("{truth_b:?}"));
        assert_eq!(format!("{:?}", a.descriptors()), format!("{:?}", b.descriptors()));
        assert_eq!(format!("{:?}", a.global()), format!("{:?}", b.global()));
        let features = |seed| format!("{:?}", features_at(&uniform_pixels(256, seed), seed));
        assert_eq!(features(1), features(2));
        // The leak: the output of a derived implementation.
        let content =
            |q: &veiloc_protocol::SealedQuery| format!("{:?}", q.descriptors().expect("rows").as_bytes());
        assert_ne!(content(&a), content(&b), "the measure does not see the leak");
    }
    let mut features = features_at(&uniform_pixels(10, 1), 1);
    features.keypoints[3].pixel.u = f64::NAN;
    let error = seal(features, &camera(), &profile(), &options("dcl"), &mut rng(1)).expect_err("not finite");
    assert!(matches!(error, SealError::NotFinite { index: 3 }));
}

/// L9: a random direction that depends on the keypoint reveals information about it. Drawn before, it cannot.
#[test]
fn l9_random_directions_are_independent_of_keypoints() {
    let bits = AngleBits::default();
    let lines = |points: &[Pixel], seed| match obfuscate_points(
        points,
        640,
        480,
        &Scheme::RandomLines,
        bits,
        &mut rng(seed),
    ) {
        Ok(Observations::Lines(lines)) => lines,
        other => panic!("{other:?}"),
    };
    let angle = |line: &PixelLine| line.direction().y.atan2(line.direction().x).rem_euclid(PI);
    let (here, there) = (uniform_pixels(5000, 8), uniform_pixels(5000, 9));
    let sent_values = lines(&here, 1);
    // Exactly: with equal generators, two images get the same directions.
    let codes = |lines: &[PixelLine]| -> Vec<u16> { lines.iter().map(|l| bits.code_of(angle(l))).collect() };
    let same = codes(&sent_values).iter().zip(codes(&lines(&there, 1))).filter(|(a, b)| **a == *b).count();
    assert!(same >= 4990, "{same} of 5000 directions the same"); // code_of may round across a border
    // The leak: a direction chosen such that the line crosses the middle of the image, within about 60 degrees.
    let toward = |p: &Pixel| (240.0 - p.v).atan2(320.0 - p.u);
    let alignment = |pairs: &mut dyn Iterator<Item = (f64, f64)>| -> f64 {
        pairs.map(|(a, b)| (2.0 * (a - b)).cos()).sum::<f64>() / 5000.0
    };
    let real = alignment(&mut here.iter().zip(&sent_values).map(|(p, l)| (angle(l), toward(p))));
    let mut draw = rng(10);
    let leak = alignment(&mut here.iter().map(|p| (toward(p) + draw.random_range(-1.0..1.0), toward(p))));
    assert!(leak > 0.4, "the measure does not see the leak");
    assert!(real.abs() < 0.04, "{real}");
    // Uniform over the half circle: chi² with 15 degrees of freedom stays under its 99.9 % point.
    let mut bins = [0.0_f64; 16];
    for line in &sent_values {
        bins[(angle(line) / PI * 16.0) as usize % 16] += 1.0;
    }
    let chi2: f64 = bins.iter().map(|n| (n - 312.5).powi(2) / 312.5).sum();
    assert!(chi2 < 37.7, "{chi2}");
    // Offsets are multiples of a quarter pixel from the centre, and each line passes within dither of its keypoint.
    for (line, point) in sent_values.iter().zip(&here) {
        let quarters = 4.0 * line.signed_distance(Pixel::new(320.0, 240.0));
        assert!((quarters - quarters.round()).abs() < 1e-6);
        assert!(line.signed_distance(*point).abs() < 0.7072 + 0.1251);
    }
    // The same for permuted positions: one of the two lines passes by the keypoint.
    let scheme = Scheme::CoordinatePermutation;
    match obfuscate_points(&here, 640, 480, &scheme, bits, &mut rng(1)) {
        Ok(Observations::EitherLine(pairs)) => {
            for ([horizontal, vertical], point) in pairs.iter().zip(&here) {
                assert!((angle(horizontal).min(PI - angle(horizontal))) < 1e-9);
                assert!((angle(vertical) - FRAC_PI_2).abs() < 1e-9);
                let distance = [horizontal, vertical].map(|l| l.signed_distance(*point).abs());
                assert!(distance[0].min(distance[1]) <= 0.626, "{distance:?}");
            }
        }
        other => panic!("{other:?}"),
    }
}

fn limits(max_keypoints: u32) -> veiloc_protocol::ExtractionLimits {
    veiloc_protocol::ExtractionLimits { max_keypoints, max_image_side: 1600 }
}
