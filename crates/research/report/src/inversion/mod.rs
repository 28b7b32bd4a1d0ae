//! The page of `veiloc eval inversion`: the paper's Table 1, and the contact sheets, image by image.
//!
//! The page holds the images themselves and what was made of them, and says so at its head.

mod page;
mod table;
#[cfg(test)]
mod tests;

pub use page::inversion_page;

/// What the page shows; plain data, filled by whoever evaluated.
#[derive(Debug, Clone, Default)]
pub struct InversionReport {
    /// How many images were evaluated.
    pub images: usize,
    /// The networks, a sentence each.
    pub networks: Vec<String>,
    /// Means over images, in the order of the table.
    pub rows: Vec<InversionRow>,
    /// Contact sheets, none where no image is shown.
    pub sheets: Vec<InversionSheet>,
    /// What whoever repeats it must know: names and values.
    pub details: Vec<(String, String)>,
}

/// What was made of one scheme and attack, means over images.
#[derive(Debug, Clone, Default)]
pub struct InversionRow {
    /// Scheme the images were sent under; `bag` for descriptors alone, `nothing` for no descriptor at all.
    pub scheme: String,
    /// As the document has it: `none`, `guess`, `closed-form`, `graph`, `realistic` or `lines`.
    pub attack: String,
    /// Which realistic attack was the best.
    pub by: Option<String>,
    /// Mean error of the positions, pixels; `None` where none are given.
    pub mean_px: Option<f64>,
    /// Peak signal-to-noise ratio, decibels.
    pub psnr: f64,
    /// Structural similarity, to 1.
    pub ssim: f64,
    /// LPIPS, from 0, where its weights were at hand.
    pub lpips: Option<f64>,
    /// Distance of features, from 0 to 1, where its weights were at hand.
    pub feature_distance: Option<f64>,
    /// Objects found again, and objects in the originals, where a detector was at hand.
    pub objects: Option<[usize; 2]>,
    /// How often right places are believed more than wrong ones, where the network judges places.
    pub told_apart: Option<f64>,
}

/// A contact sheet.
#[derive(Debug, Clone, Default)]
pub struct InversionSheet {
    /// What it shows, a heading.
    pub title: String,
    /// How to read it, a sentence.
    pub note: String,
    /// Image by image.
    pub images: Vec<SheetImage>,
}

/// An image of a contact sheet.
#[derive(Debug, Clone, Default)]
pub struct SheetImage {
    /// Its name.
    pub name: String,
    /// The original first, then what was made of it.
    pub tiles: Vec<SheetTile>,
}

/// One image of a contact sheet.
#[derive(Debug, Clone, Default)]
pub struct SheetTile {
    /// Scheme and attack as in [`InversionRow`]; `None` for the original.
    pub of: Option<[String; 2]>,
    /// Its own scores, a few words; may be empty.
    pub scores: String,
    /// Width and height of the image, pixels.
    pub size: [u32; 2],
    /// Its pixels row by row, `[height, width, 3]`.
    pub pixels: Vec<u8>,
}
