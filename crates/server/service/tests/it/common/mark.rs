//! A query with a recognizable content, to detect leaks.
#![allow(dead_code, unreachable_pub)] // each user takes its own part

use rand::SeedableRng;
use rand_chacha::ChaCha20Rng;
use veiloc_descriptor::{DescriptorKind, Descriptors};

use super::{Files, seal_features, truth};

/// Sixteen bytes that occur nowhere else.
pub const MARK: &[u8; 16] = b"XqZvKwJyQxVzWkYj";

/// A part of the mark in all forms in which a program might print bytes.
fn forms() -> Vec<String> {
    let list = |f: fn(&u8) -> String, by: &str| MARK[3..8].iter().map(f).collect::<Vec<_>>().join(by);
    let base64 = |skip: usize| {
        let alphabet = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
        MARK[skip..skip + 6].chunks(3).fold(String::new(), |text, c| {
            let bits = u32::from(c[0]) << 16 | u32::from(c[1]) << 8 | u32::from(c[2]);
            [18, 12, 6, 0]
                .iter()
                .fold(text, |t, s| t + &(alphabet[(bits >> s & 63) as usize] as char).to_string())
        })
    };
    vec![
        String::from_utf8(MARK[3..8].to_vec()).expect("ASCII"),
        list(|b| format!("{b:02x}"), ""),
        list(|b| format!("{b:02X}"), ""),
        list(|b| format!("{b:02x}"), " "),
        list(ToString::to_string, ", "),
        list(ToString::to_string, ","),
        list(ToString::to_string, " "),
        base64(0),
        base64(1),
        base64(2),
    ]
}

pub fn find_mark(text: &str) -> Option<String> {
    forms().into_iter().find(|form| text.contains(form))
}

/// A query whose descriptors all consist of the mark, eight times.
pub fn marked(files: &Files) -> Vec<u8> {
    let mut features = files.scene.features(&truth());
    let count = features.keypoints.len();
    features.descriptors =
        Descriptors::new(DescriptorKind::ROOT_SIFT, MARK.repeat(8 * count)).expect("whole rows");
    let mut rng = ChaCha20Rng::seed_from_u64(3);
    seal_features(features, &files.scene.camera, &files.scene.profile, &mut rng).encode()
}
