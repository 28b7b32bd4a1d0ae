//! Equal images give equal bytes, with any number of threads; ranking, order and limits.

use veiloc_features::{Features, GrayImage, SiftOptions, extract_sift};

fn texture(width: u32, height: u32) -> GrayImage {
    let value = |x: u32, y: u32| {
        let (x, y) = (f64::from(x), f64::from(y));
        let wave = (0.31 * x + 0.07 * y).sin() * (0.11 * x - 0.23 * y).cos() + (0.0021 * x * y).sin();
        (0.5 + 0.2 * wave) as f32
    };
    let data = (0..height).flat_map(|y| (0..width).map(move |x| value(x, y))).collect();
    GrayImage::new(width, height, data).expect("finite")
}

fn with_threads(count: usize, image: &GrayImage, options: &SiftOptions) -> Features {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(count).build().expect("threads");
    pool.install(|| extract_sift(image, options))
}

#[test]
fn result_is_independent_of_the_thread_count() {
    for upsample in [false, true] {
        let mut options = SiftOptions::default();
        options.upsample = upsample;
        for (width, height) in [(203, 157), (64, 300)] {
            let image = texture(width, height);
            let one = with_threads(1, &image, &options);
            assert!(one.keypoints.len() > 100, "{}", one.keypoints.len());
            for count in [1, 2, 3, 7] {
                assert!(with_threads(count, &image, &options) == one, "{count} threads, {width}x{height}");
            }
        }
    }
}

#[test]
fn fewer_keypoints_are_a_prefix_of_more() {
    let image = texture(160, 120);
    let mut options = SiftOptions::default();
    let all = extract_sift(&image, &options);
    assert!(all.keypoints.is_sorted_by(|a, b| a.response >= b.response));
    assert_eq!(all.descriptors.len(), all.keypoints.len());
    for max in [0, 1, 17, 64] {
        options.max_keypoints = max;
        let few = extract_sift(&image, &options);
        assert_eq!(few.keypoints[..], all.keypoints[..max]);
        assert_eq!(few.descriptors.as_bytes(), &all.descriptors.as_bytes()[..max * 128]);
    }
    for keypoint in &all.keypoints {
        assert!(keypoint.pixel.u > 0.0 && keypoint.pixel.u < 160.0, "inside");
        assert!(keypoint.pixel.v > 0.0 && keypoint.pixel.v < 120.0, "inside");
        assert!(keypoint.orientation.abs() <= std::f32::consts::PI && keypoint.scale > 0.0);
    }
}

#[test]
fn scaled_features_are_in_scaled_pixels() {
    let features = extract_sift(&texture(160, 120), &SiftOptions::default());
    let larger = features.clone().scaled(2.0, 2.0);
    assert_eq!(larger.keypoints[3].pixel.u, 2.0 * features.keypoints[3].pixel.u);
    assert_eq!(larger.keypoints[3].scale, 2.0 * features.keypoints[3].scale);
    assert!(larger.descriptors == features.descriptors);
}
