//! Images as a device with the pack of their place sends them.

use std::collections::BTreeMap;

use veiloc_datasets::problem_files::KeypointImage;
use veiloc_descriptor::Descriptors;
use veiloc_obfuscation::{ExplainedRow, KnownPlace, PackUse};
use veiloc_protocol::Candidate;

use super::neighbours::stored_descriptors;
use crate::EvalError;

/// What is sent of an image, without decoys: the keypoints that the place explains, or those that match a point of it. The
/// latter have the descriptors of their points in the pack, in the image that shows most of them: an attacker who has the
/// pack knows no others. Nothing is left of an image that does not show the place.
pub(super) fn sent_with_pack(
    place: &KnownPlace,
    usage: PackUse,
    image: &KeypointImage,
) -> Result<KeypointImage, EvalError> {
    let descriptors = stored_descriptors(image)?;
    let seal = |source| EvalError::Seal { name: image.name.clone(), source };
    let found = place.look_up(descriptors).map_err(seal)?;
    let explained = |row: &usize| found[*row].is_explained();
    let mut sent: Vec<usize> = (0..found.len()).filter(explained).collect();
    if !ExplainedRow::show_place(&found) {
        sent.clear();
    }
    let descriptors = match usage {
        PackUse::Explained => descriptors.select(sent.iter().copied()),
        PackUse::Matches => {
            // Of the rows at one position the most probable match is sent.
            let mut best: BTreeMap<[u64; 2], (usize, Candidate)> = BTreeMap::new();
            for row in sent {
                let (Some(candidate), at) = (found[row].candidate, image.keypoints[row]) else { continue };
                let known = best.entry([at.u.to_bits(), at.v.to_bits()]).or_insert((row, candidate));
                if candidate.weight > known.1.weight {
                    *known = (row, candidate);
                }
            }
            let mut matched: Vec<(usize, Candidate)> = best.into_values().collect();
            matched.sort_unstable_by_key(|(row, _)| *row);
            sent = matched.iter().map(|(row, _)| *row).collect();
            of_points(place, &matched)
        }
    };
    Ok(KeypointImage {
        keypoints: sent.iter().map(|row| image.keypoints[*row]).collect(),
        descriptors: Some(descriptors),
        ..image.clone()
    })
}

/// A row of the pack for each of these points, from the image that shows most of them.
fn of_points(place: &KnownPlace, matched: &[(usize, Candidate)]) -> Descriptors {
    let pack = place.pack();
    let mut row_of: BTreeMap<u32, Option<usize>> = matched.iter().map(|(_, m)| (m.point, None)).collect();
    let shown = |image: &usize| pack.image(*image).points().iter().filter(|p| row_of.contains_key(p)).count();
    let mut images: Vec<usize> = (0..pack.image_count()).collect();
    images.sort_by_cached_key(|image| std::cmp::Reverse(shown(image)));
    for row in images.into_iter().flat_map(|image| pack.rows_of(image)) {
        if let Some(known) = row_of.get_mut(&pack.points()[row]) {
            known.get_or_insert(row);
        }
    }
    let mut rows = Descriptors::empty(pack.descriptors().kind());
    for row in matched.iter().filter_map(|(_, m)| row_of[&m.point]) {
        rows.push(pack.descriptors().row(row)).expect("of one kind");
    }
    rows
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use veiloc_descriptor::{DescriptorKind, Vocabulary};
    use veiloc_geometry::Pixel;
    use veiloc_protocol::{Pack, Profile};

    use super::*;

    /// `count` random rows of the length of RootSIFT.
    fn rows(count: usize, seed: u64) -> Descriptors {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut rows = Descriptors::empty(DescriptorKind::ROOT_SIFT);
        for _ in 0..count {
            let values: Vec<f64> = (0..128).map(|_| rng.random::<f64>().powi(3)).collect();
            let length = values.iter().map(|v| v * v).sum::<f64>().sqrt();
            let bytes: Vec<u8> = values.iter().map(|v| (500.0 * v / length) as u8).collect();
            rows.push(&bytes).expect("128 numbers");
        }
        rows
    }

    #[test]
    fn a_match_has_the_descriptor_of_its_point_and_nothing_else_is_sent() {
        let (place, person) = (rows(100, 1), rows(50, 2));
        let seen_again = |rows: &Descriptors, by: u8| {
            let bytes = rows.as_bytes().iter().map(|byte| byte + by);
            Descriptors::new(rows.kind(), bytes.collect()).expect("whole rows")
        };
        let profile = Profile::vlad(Vocabulary::new(place.select(0..8)).expect("eight words"));
        let pack = Pack::new(profile, 100, [((0..100).collect(), place.clone())]).expect("parts fit");
        let known = KnownPlace::new(pack).expect("sift");
        let mut shown = seen_again(&place, 1);
        (0..50).for_each(|row| shown.push(person.row(row)).expect("of one kind"));
        let keypoints = (0..150).map(|i| Pixel::new(f64::from(i), 9.0)).collect();
        let image = KeypointImage {
            name: "image".to_owned(),
            width: 640,
            height: 480,
            keypoints,
            descriptors: Some(shown.clone()),
        };
        let explained = sent_with_pack(&known, PackUse::Explained, &image).expect("sift");
        assert_eq!(explained.keypoints, image.keypoints[..100]);
        assert_eq!(explained.descriptors, Some(shown.select(0..100)));
        let matched = sent_with_pack(&known, PackUse::Matches, &image).expect("sift");
        assert_eq!((matched.keypoints, matched.descriptors), (image.keypoints[..100].to_vec(), Some(place)));
        let person =
            KeypointImage { keypoints: image.keypoints[..50].to_vec(), descriptors: Some(person), ..image };
        let nothing = sent_with_pack(&known, PackUse::Matches, &person).expect("sift");
        assert!(nothing.keypoints.is_empty());
    }
}
