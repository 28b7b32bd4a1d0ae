//! Writes the masks of what `--hide` hides in images, for `study privacy hidden-people`.
//!
//! ```text
//! people DETECTOR CLASS IMAGES LIST OUT
//! ```
//!
//! LIST: names of images in the folder IMAGES, one per line. OUT gets `door/3.jpg.png` for `door/3.jpg`, in which black hides;
//! all is white where nothing was found.

use std::error::Error;
use std::path::Path;

use image::{GrayImage, Luma};
use veiloc_features::detector::{HideOptions, ObjectMasker};
use veiloc_features::image_size;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [detector, class, images, list, out] = &arguments[..] else {
        return Err("people DETECTOR CLASS IMAGES LIST OUT".into());
    };
    let masker =
        ObjectMasker::open(Path::new(detector), std::slice::from_ref(class), HideOptions::default())?;
    for name in std::fs::read_to_string(list)?.lines() {
        let path = Path::new(images).join(name);
        let mask = masker.hide(&path)?.mask;
        let (width, height) = image_size(&path)?;
        let hides = |x, y| mask.as_ref().is_some_and(|mask| mask.hides(x, y));
        let pixels = GrayImage::from_fn(width, height, |x, y| Luma([u8::from(!hides(x, y)) * 255]));
        let file = Path::new(out).join(format!("{name}.png"));
        std::fs::create_dir_all(file.parent().ok_or("a name is needed")?)?;
        pixels.save(file)?;
    }
    Ok(())
}
