//! Agreement with pycolmap and OpenCV on a synthetic image; `research/oracles/features.py --fixture` made the files.

use std::path::Path;

use veiloc_features::{Features, SiftOptions, extract_sift, load_gray};

/// Keypoints and RootSIFT bytes of another program.
struct Reference {
    /// `[N]` of u, v, scale, orientation
    keypoints: Vec<[f64; 4]>,
    /// `[N, 128]`
    descriptors: Vec<u8>,
}

/// Reads the format of `examples/extract.rs`.
fn read(path: &Path) -> Reference {
    let bytes = std::fs::read(path).expect("a file of the repository");
    let count = u32::from_le_bytes(bytes[..4].try_into().expect("four bytes")) as usize;
    let (numbers, descriptors) = bytes[4..].split_at(count * 20);
    let number = |four: &[u8]| f64::from(f32::from_le_bytes(four.try_into().expect("four bytes")));
    let keypoints = numbers
        .chunks_exact(20)
        .map(|row| [number(&row[..4]), number(&row[4..8]), number(&row[8..12]), number(&row[12..16])])
        .collect();
    assert_eq!(descriptors.len(), count * 128);
    Reference { keypoints, descriptors: descriptors.to_vec() }
}

fn cosine(a: &[u8], b: &[u8]) -> f64 {
    let dot = |a: &[u8], b: &[u8]| a.iter().zip(b).map(|(&a, &b)| f64::from(a) * f64::from(b)).sum::<f64>();
    dot(a, b) / (dot(a, a) * dot(b, b)).sqrt()
}

/// Agreement of our features with another program's keypoints.
#[derive(Debug)]
struct Agreement {
    /// Share with one of ours within 1.5 px and a quarter of the scale.
    repeated: f64,
    /// Share of those whose best has the orientation too, within 15 degrees.
    oriented: f64,
    /// Share of those whose best match has the orientation too, within 15 degrees.
    bias: [f64; 2],
    /// Median cosine of the descriptors of the oriented ones.
    cosine: f64,
}

fn agreement(ours: &Features, theirs: &Reference) -> Agreement {
    let (mut repeated, mut bias, mut cosines) = (0.0, [0.0; 2], Vec::new());
    for (i, &[u, v, scale, orientation]) in theirs.keypoints.iter().enumerate() {
        let near: Vec<usize> = (0..ours.keypoints.len())
            .filter(|&k| {
                let k = &ours.keypoints[k];
                (k.pixel.u - u).hypot(k.pixel.v - v) < 1.5 && (f64::from(k.scale) / scale).ln().abs() < 0.22
            })
            .collect();
        let turn = |k: usize| {
            let turn =
                (f64::from(ours.keypoints[k].orientation) - orientation).rem_euclid(std::f64::consts::TAU);
            turn.min(std::f64::consts::TAU - turn)
        };
        let Some(&best) = near.iter().min_by(|&&a, &&b| turn(a).total_cmp(&turn(b))) else { continue };
        repeated += 1.0;
        bias[0] += ours.keypoints[best].pixel.u - u;
        bias[1] += ours.keypoints[best].pixel.v - v;
        if turn(best).to_degrees() < 15.0 {
            cosines.push(cosine(ours.descriptors.row(best), &theirs.descriptors[i * 128..][..128]));
        }
    }
    cosines.sort_by(f64::total_cmp);
    Agreement {
        repeated: repeated / theirs.keypoints.len() as f64,
        oriented: cosines.len() as f64 / repeated,
        bias: bias.map(|sum| sum / repeated),
        cosine: cosines[cosines.len() / 2],
    }
}

#[test]
fn keypoints_and_bytes_agree_with_colmap_and_opencv() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data");
    let image = load_gray(&folder.join("drawn.png")).expect("a file of the repository");
    let ours = extract_sift(&image, &SiftOptions::default());
    for (name, repeated, oriented, cosine) in
        [("drawn_pycolmap.bin", 0.75, 0.9, 0.995), ("drawn_opencv.bin", 0.75, 0.85, 0.98)]
    {
        let found = agreement(&ours, &read(&folder.join(name)));
        assert!(found.repeated > repeated, "{name}: {found:?}");
        assert!(found.oriented > oriented, "{name}: {found:?}");
        assert!(found.cosine > cosine, "{name}: {found:?}");
        assert!(found.bias.iter().all(|b| b.abs() < 0.03), "{name}: {found:?}");
        eprintln!("{name}: {found:?}");
    }
}
