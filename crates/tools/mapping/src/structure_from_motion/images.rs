//! The images of a folder, their cameras, and whether they are frames of a video.

use std::collections::BTreeSet;
use std::path::Path;

use crate::error::MappingError;
use crate::importers::poses::image_names;

/// All JPEG and PNG files in a folder and its folders, sorted.
pub(super) fn all_of(folder: &Path) -> Result<Vec<String>, MappingError> {
    folder.read_dir().map_err(MappingError::io(folder))?;
    Ok(image_names(folder))
}

/// How images share cameras: one camera if all have one size, or else COLMAP's choice (by size, and focal length in EXIF).
pub(super) fn camera_mode(folder: &Path, names: &[String]) -> &'static str {
    let sizes: BTreeSet<Option<(u32, u32)>> =
        names.iter().map(|name| image::image_dimensions(folder.join(name)).ok()).collect();
    if sizes.len() == 1 { "SINGLE" } else { "AUTO" }
}

/// Whether the names are numbered as frames are: one stem and a number with few gaps.
pub(super) fn are_frames(names: &[String]) -> bool {
    let numbered = |name: &String| {
        let stem = name.rsplit_once('.').map_or(name.as_str(), |(stem, _)| stem);
        let end = stem.trim_end_matches(|c: char| !c.is_ascii_digit());
        let digits = end.len() - end.trim_end_matches(|c: char| c.is_ascii_digit()).len();
        let (prefix, number) = end.split_at(end.len() - digits);
        Some((prefix.to_owned(), number.parse::<u64>().ok()?))
    };
    let Some(numbers) = names.iter().map(numbered).collect::<Option<BTreeSet<(String, u64)>>>() else {
        return false;
    };
    let prefixes: BTreeSet<&String> = numbers.iter().map(|(prefix, _)| prefix).collect();
    // A camera roll is numbered, too, but not from one folder of frames at regular steps.
    let steps: Vec<u64> = numbers
        .iter()
        .zip(numbers.iter().skip(1))
        .filter(|(a, b)| a.0 == b.0)
        .map(|(a, b)| b.1 - a.1)
        .collect();
    let mut sorted = steps.clone();
    sorted.sort_unstable();
    let usual = sorted.get(sorted.len() / 2).copied().unwrap_or(0);
    let regular = steps.iter().filter(|step| **step == usual).count();
    numbers.len() == names.len() && prefixes.len() * 50 <= names.len() && 10 * regular >= 9 * steps.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_numbered_at_regular_steps() {
        let frames = |name: fn(u32) -> String| are_frames(&(0..400).map(name).collect::<Vec<_>>());
        assert!(frames(|n| format!("frame-{n:06}.color.jpg")));
        assert!(frames(|n| format!("seq-01/{}.png", 5 * n)));
        assert!(!frames(|n| format!("IMG_{}.jpg", 1000 + n * (n % 7))), "a camera roll");
        assert!(!frames(|n| format!("{}.jpg", char::from(b'a' + (n % 26) as u8))));
        assert!(!frames(|n| format!("room{n}/0.jpg")), "a folder each");
    }
}
