//! The images of a folder, their cameras, and whether they are frames of a video.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::path::Path;

use exif::{In, Tag};
use rayon::prelude::*;
use veiloc_features::{Image, image_size};

use crate::error::MappingError;
use crate::importers::poses::image_names;
use crate::input::bad_image::{BadImage, BadReason};
use crate::input::exif::exif_of;
use crate::input::image_names::image_file;

/// The photographs in a folder and its folders, sorted, and what was left out with the reason: files that programs put beside
/// photographs, and that would become images of the map.
pub(super) fn all_of(folder: &Path) -> Result<(Vec<String>, BTreeMap<LeftOut, usize>), MappingError> {
    folder.read_dir().map_err(MappingError::io(folder))?;
    let all = image_names(folder);
    let folders: BTreeSet<&Path> = all.iter().filter_map(|name| Path::new(name).parent()).collect();
    let (mut kept, mut left_out) = (Vec::new(), BTreeMap::new());
    for name in &all {
        let reason = Path::new(name).ancestors().skip(1).find_map(|of| LeftOut::of_folder(of, &folders));
        match reason {
            Some(reason) => *left_out.entry(reason).or_default() += 1,
            None => kept.push(name.clone()),
        }
    }
    // Previews, of which no folder says so. What cannot be read is not judged here.
    let longer = |name: &String| image_size(&folder.join(name)).ok().map(|(w, h)| w.max(h));
    let sides: Vec<Option<u32>> = kept.iter().map(longer).collect();
    let mut known: Vec<u32> = sides.iter().copied().flatten().collect();
    known.sort_unstable();
    if let Some(middle) = known.get(known.len() / 2) {
        let is_preview = |side: &Option<u32>| side.is_some_and(|side| PREVIEW * side < *middle);
        let previews = sides.iter().filter(|side| is_preview(side)).count();
        if previews > 0 {
            left_out.insert(LeftOut::Preview, previews);
        }
        let mut sides = sides.iter();
        kept.retain(|_| !sides.next().is_some_and(is_preview));
    }
    Ok((kept, left_out))
}

/// The longer side of a preview is shorter than this part of the usual one.
const PREVIEW: u32 = 4;

/// Why an image of a folder is left out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum LeftOut {
    /// It is in a folder of masks.
    Mask,
    /// It is in a folder of previews, as of network storage.
    PreviewFolder,
    /// It is much smaller than the others.
    Preview,
    /// It is in a folder of smaller copies, such as `images_2` beside `images`.
    SmallerCopy,
}

impl LeftOut {
    fn of_folder(folder: &Path, all: &BTreeSet<&Path>) -> Option<Self> {
        let name = folder.file_name()?.to_str()?;
        let plain = name.to_ascii_lowercase();
        if ["mask", "masks", "segmentation"].contains(&plain.as_str()) {
            return Some(Self::Mask);
        }
        if ["@eadir", "thumbnails", "thumbs", "previews", "__macosx"].contains(&plain.as_str()) {
            return Some(Self::PreviewFolder);
        }
        let (original, number) = name.rsplit_once('_')?;
        let is_copy = number.parse::<u8>().is_ok_and(u8::is_power_of_two);
        (is_copy && all.contains(&*folder.with_file_name(original))).then_some(Self::SmallerCopy)
    }
}

impl fmt::Display for LeftOut {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Mask => "in a folder of masks",
            Self::PreviewFolder => "in a folder of previews",
            Self::Preview => "much smaller than the others",
            Self::SmallerCopy => "in a folder of smaller copies",
        })
    }
}

/// The images that share a camera, for each camera: those of one size, focal length and lens, as their EXIF has it. Zooms and
/// lenses of one phone have one size.
pub(super) fn by_camera(folder: &Path, names: &[String]) -> Vec<Vec<String>> {
    let mut cameras: BTreeMap<_, Vec<String>> = BTreeMap::new();
    for name in names {
        let path = folder.join(name);
        let size = image_size(&path).ok();
        cameras.entry((size, lens_of(&path))).or_default().push(name.clone());
    }
    let mut groups: Vec<Vec<String>> = cameras.into_values().collect();
    groups.sort();
    groups
}

/// What EXIF says about the lens of an image.
fn lens_of(path: &Path) -> Vec<String> {
    let Some(exif) = exif_of(path) else { return Vec::new() };
    [
        Tag::Make,
        Tag::Model,
        Tag::LensModel,
        Tag::FocalLength,
        Tag::FocalLengthIn35mmFilm,
        Tag::DigitalZoomRatio,
    ]
    .into_iter()
    .map(|tag| {
        exif.get_field(tag, In::PRIMARY).map_or_else(String::new, |field| field.display_value().to_string())
    })
    .collect()
}

/// The images that cannot be decoded, before long work begins on the others.
pub(super) fn undecodable(folder: &Path, names: &[String]) -> Vec<BadImage> {
    let bad = |name: &String| {
        let path = image_file(folder, name);
        let reason = if path.is_file() {
            BadReason::Image(Image::open(&path).err()?)
        } else {
            BadReason::NoFile { path }
        };
        Some(BadImage { name: name.clone(), reason })
    };
    names.par_iter().filter_map(bad).collect()
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

    fn image(path: &Path, size: u32) {
        std::fs::create_dir_all(path.parent().expect("a folder")).expect("a folder");
        image::GrayImage::from_pixel(size, size / 2, image::Luma([90])).save(path).expect("saved");
    }

    #[test]
    fn files_beside_photographs_are_left_out_and_counted() {
        let root = tempfile::tempdir().expect("temporary folder");
        for (name, size) in [
            ("images/a.png", 640),
            ("images/b.png", 640),
            ("images/c.png", 600),
            ("images/tiny.png", 100),
            ("images_2/a.png", 320),
            ("images/@eaDir/a.png", 640),
            ("masks/a.png", 640),
            ("room_2/a.png", 640),
        ] {
            image(&root.path().join(name), size);
        }
        let (kept, left_out) = all_of(root.path()).expect("a folder");
        assert_eq!(kept, ["images/a.png", "images/b.png", "images/c.png", "room_2/a.png"]);
        let expected = [
            (LeftOut::Mask, 1),
            (LeftOut::PreviewFolder, 1),
            (LeftOut::Preview, 1),
            (LeftOut::SmallerCopy, 1),
        ];
        assert_eq!(left_out, expected.into());
    }

    #[test]
    fn images_of_one_size_and_lens_share_a_camera() {
        let root = tempfile::tempdir().expect("temporary folder");
        let names = ["a.png", "b.png", "stray.png"].map(str::to_owned);
        for (name, size) in names.iter().zip([640, 640, 320]) {
            image(&root.path().join(name), size);
        }
        assert_eq!(by_camera(root.path(), &names), [names[..2].to_vec(), names[2..].to_vec()]);
    }

    #[test]
    fn undecodable_files_are_found_first() {
        let root = tempfile::tempdir().expect("temporary folder");
        image(&root.path().join("whole.png"), 640);
        let whole = std::fs::read(root.path().join("whole.png")).expect("read");
        std::fs::write(root.path().join("cut.png"), &whole[..whole.len() / 2]).expect("written");
        std::fs::write(root.path().join("empty.jpg"), []).expect("written");
        let names = ["whole.png", "cut.png", "empty.jpg", "none.jpg"].map(str::to_owned);
        let bad: Vec<String> = undecodable(root.path(), &names).into_iter().map(|bad| bad.name).collect();
        assert_eq!(bad, names[1..]);
    }

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
