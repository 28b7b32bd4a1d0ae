//! Images that cannot be used, and their messages.

use std::fmt;
use std::path::PathBuf;

use veiloc_features::FeatureError;

/// An image that cannot be used.
#[derive(Debug)]
pub struct BadImage {
    /// Its name in the input.
    pub name: String,
    /// Why it cannot be used.
    pub reason: BadReason,
}

impl fmt::Display for BadImage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let reason = self.reason.to_string();
        // File errors contain the path already.
        if reason.contains(&self.name) { f.write_str(&reason) } else { write!(f, "{}: {reason}", self.name) }
    }
}

/// Why an image cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum BadReason {
    /// Its name occurs twice.
    #[error("is in the list twice; list every image once")]
    Twice,
    /// It has no pose.
    #[error("there is no pose for it; remove it from the list or add its pose")]
    NoPose,
    /// It is to be added to a map that already has it.
    #[error(
        "is already in the map; remove it first to replace it, or add another image of this name with a prefix (`map add \
         --prefix`)"
    )]
    AlreadyInMap,
    /// Its file does not exist.
    #[error("there is no file {}; check the path", path.display())]
    NoFile {
        /// The expected path.
        path: PathBuf,
    },
    /// Its file cannot be read, or its size differs from its camera's.
    #[error(transparent)]
    Image(#[from] FeatureError),
}

/// All images that cannot be used. The message names the first ten and counts the rest.
#[derive(Debug)]
pub struct BadImages {
    /// The images, in the order of the list.
    pub images: Vec<BadImage>,
    /// Total number of images.
    pub of: usize,
}

impl fmt::Display for BadImages {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} of {} images cannot be used", self.images.len(), self.of)?;
        write_list(f, &self.images)
    }
}

/// Images that were left out; the message has their number, the first ten names, and the number of the others.
#[derive(Debug)]
pub struct SkippedImages(pub Vec<BadImage>);

impl fmt::Display for SkippedImages {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let images = if self.0.len() == 1 { "image was" } else { "images were" };
        write!(f, "{} {images} left out", self.0.len())?;
        write_list(f, &self.0)
    }
}

/// Writes what follows "3 of 20 images": one image per line, the first ten, and the number of the others.
fn write_list(f: &mut fmt::Formatter<'_>, images: &[BadImage]) -> fmt::Result {
    images.iter().take(NAMED).try_for_each(|image| write!(f, "\n  {image}"))?;
    match images.len().saturating_sub(NAMED) {
        0 => Ok(()),
        more => write!(f, "\n  and {more} more"),
    }
}

/// Maximum number of images in a message.
const NAMED: usize = 10;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn message_names_ten_images_and_counts_the_rest() {
        let bad = |n: usize| BadImages {
            images: (0..n)
                .map(|i| BadImage { name: format!("{i}.jpg"), reason: BadReason::NoPose })
                .collect(),
            of: 20,
        };
        let text = bad(10).to_string();
        assert!(text.starts_with("10 of 20 images cannot be used\n  0.jpg: there is no pose"), "{text}");
        assert_eq!(text.lines().count(), 11);
        assert!(!text.contains("more"));
        let text = bad(13).to_string();
        assert!(text.contains("9.jpg") && !text.contains("10.jpg") && text.ends_with("and 3 more"), "{text}");
    }
}
