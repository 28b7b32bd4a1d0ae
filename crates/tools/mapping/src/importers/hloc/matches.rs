//! Match files: for each image pair the partner of every keypoint of the first image.

use std::path::Path;

use hdf5_pure::Group;

use crate::MappingError;
use crate::importers::hloc::archive::Archive;
use crate::importers::hloc::write::{GroupTree, NewDataset, Values};

const MATCHES: &str = "matches0";
const SCORES: &str = "matching_scores0";
/// Maximum number of keypoints per image.
const MAX_KEYPOINTS: usize = 1 << 17;

/// Two matched keypoints.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KeypointMatch {
    /// Index of the keypoint in the first image.
    pub first: u32,
    /// Index of the keypoint in the second image.
    pub second: u32,
    /// Confidence of the matcher, 0 to 1; 1 if the file has none.
    pub score: f32,
}

/// A match file.
#[derive(Debug)]
pub struct MatchesFile(Archive);

impl MatchesFile {
    /// Opens a file; each pair is read on demand.
    ///
    /// # Errors
    /// [`MappingError::Io`], [`MappingError::NotHdf5`].
    pub fn open(path: &Path) -> Result<Self, MappingError> {
        Archive::open(path).map(Self)
    }

    /// Reads the matches of two images in either order of the pair, under hloc's pair names (`a/b`) or its older ones
    /// (`a_b`), in which `-` separates the folders of names; `None` if the pair does not exist.
    ///
    /// # Errors
    /// [`MappingError::BadInFile`] for datasets that cannot be read or are not indices.
    pub fn read(&self, first: &str, second: &str) -> Result<Option<Vec<KeypointMatch>>, MappingError> {
        for separator in ['/', '_'] {
            for (a, b, turned) in [(first, second, false), (second, first, true)] {
                let name = name_of_pair(a, b, separator);
                if let Some(group) = self.0.group(&name) {
                    return self.read_group(&name, &group, turned);
                }
            }
        }
        Ok(None)
    }

    fn read_group(
        &self,
        name: &str,
        group: &Group,
        turned: bool,
    ) -> Result<Option<Vec<KeypointMatch>>, MappingError> {
        let bad = |what: &str, reason: String| Err(self.0.bad(&format!("{name}/{what}"), reason));
        let Some(partners) = self.0.numbers(name, group, MATCHES)? else { return Ok(None) };
        let scores = self.0.numbers(name, group, SCORES)?;
        let partners = &partners.values;
        if partners.len() > MAX_KEYPOINTS {
            return bad(MATCHES, format!("has {} keypoints, more than {MAX_KEYPOINTS}", partners.len()));
        }
        if let Some(scores) = scores.as_ref().filter(|scores| scores.values.len() != partners.len()) {
            return bad(SCORES, format!("has {} numbers instead of {}", scores.values.len(), partners.len()));
        }
        let mut matches = Vec::new();
        for (index, partner) in partners.iter().enumerate().filter(|(_, partner)| **partner != -1.0) {
            let known = (0.0..MAX_KEYPOINTS as f32).contains(partner) && partner.fract() == 0.0;
            let score = scores.as_ref().map_or(1.0, |scores| scores.values[index]);
            if !known || !score.is_finite() {
                return bad(
                    MATCHES,
                    format!("keypoint {index} has an invalid match index; match the pair again"),
                );
            }
            let (own, other) = (index as u32, *partner as u32);
            let (first, second) = if turned { (other, own) } else { (own, other) };
            matches.push(KeypointMatch { first, second, score });
        }
        Ok(Some(matches))
    }
}

/// hloc's name of a pair.
fn name_of_pair(first: &str, second: &str, separator: char) -> String {
    format!("{}{separator}{}", first.replace('/', "-"), second.replace('/', "-"))
}

/// Writes the matches of pairs by the names of their images; each pair has the number of keypoints of the first image.
/// A keypoint of the first image has one partner: of several the last one is written.
///
/// # Errors
/// [`MappingError::Unwritable`] for a duplicate pair, or a keypoint that the first image does not have;
/// [`MappingError::Io`].
pub fn write_matches<'a>(
    path: &Path,
    pairs: impl IntoIterator<Item = (&'a str, &'a str, usize, Vec<KeypointMatch>)>,
) -> Result<(), MappingError> {
    let mut tree = GroupTree::default();
    for (first, second, keypoints, matches) in pairs {
        let name = name_of_pair(first, second, '/');
        let mut partners = vec![-1_i32; keypoints];
        let mut scores = vec![0.0_f32; keypoints];
        for found in matches {
            let index = found.first as usize;
            if index >= keypoints || found.second > i32::MAX as u32 {
                let reason = format!("keypoint {index} is beyond the {keypoints} of the first image");
                return Err(MappingError::Unwritable { name, reason });
            }
            partners[index] = found.second as i32;
            scores[index] = found.score;
        }
        let dataset = |name, values| NewDataset { name, shape: vec![keypoints], values, attribute: None };
        let datasets = vec![dataset(MATCHES, Values::Small(partners)), dataset(SCORES, Values::Half(scores))];
        tree.put(&name, datasets)?;
    }
    tree.save(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pair_names_follow_hloc() {
        assert_eq!(name_of_pair("db/a.jpg", "query/day/b.jpg", '/'), "db-a.jpg/query-day-b.jpg");
        assert_eq!(name_of_pair("db/a.jpg", "query/day/b.jpg", '_'), "db-a.jpg_query-day-b.jpg");
    }
}
