//! Contact sheets: originals in rows, reconstructions in columns, boxes around detected objects.

use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder as _};
use veiloc_features::ColourImage;
use veiloc_features::detector::Detection;

use crate::EvalError;

/// Pixels between tiles.
const GAP: usize = 4;
/// Pixels per grid cell, which keeps the boxes thin.
const TIMES: usize = 2;
const WHITE: [u8; 3] = [255; 3];
/// Distinct in print and for colour-blind readers (Okabe and Ito).
const BOX: [u8; 3] = [230, 159, 0];

/// An image with its detected objects.
#[derive(Debug, Clone)]
pub struct Tile {
    /// The image.
    pub image: ColourImage,
    /// Boxes, in its pixels.
    pub boxes: Vec<Detection>,
}

/// Tiles in rows and columns.
#[derive(Debug, Clone, Default)]
pub struct ContactSheet {
    /// Titles of the columns.
    pub columns: Vec<String>,
    /// `[rows][columns]`.
    pub rows: Vec<Vec<Tile>>,
}

impl ContactSheet {
    /// The sheet as one image; `None` without tiles.
    pub fn image(&self) -> Option<ColourImage> {
        let side = |of: fn(&ColourImage) -> u32| {
            let sides = self.rows.iter().flatten().map(|tile| of(&tile.image) as usize);
            sides.max().map(|side| TIMES * side + GAP)
        };
        let (wide, high) = (side(ColourImage::width)?, side(ColourImage::height)?);
        let most = self.rows.iter().map(Vec::len).max()?;
        let (width, height) = (most * wide + GAP, self.rows.len() * high + GAP);
        let mut data: Vec<u8> = WHITE.iter().copied().cycle().take(3 * width * height).collect();
        for (y, row) in self.rows.iter().enumerate() {
            for (x, tile) in row.iter().enumerate() {
                let first = [x * wide + GAP, y * high + GAP];
                let mut draw = |x: usize, y: usize, colour: &[u8]| {
                    let at = 3 * ((first[1] + y) * width + first[0] + x);
                    data[at..at + 3].copy_from_slice(colour);
                };
                tile.draw(&mut draw);
            }
        }
        ColourImage::new(width as u32, height as u32, data).ok()
    }
}

impl ContactSheet {
    /// The sheet as a PNG file; `None` without tiles.
    ///
    /// # Errors
    /// [`EvalError::Sheet`] for a sheet that exceeds the format's limits.
    pub fn png(&self) -> Result<Option<Vec<u8>>, EvalError> {
        let Some(image) = self.image() else { return Ok(None) };
        let mut bytes = Vec::new();
        let (width, height) = (image.width(), image.height());
        PngEncoder::new(&mut bytes)
            .write_image(image.data(), width, height, ExtendedColorType::Rgb8)
            .map_err(|error| EvalError::Sheet(error.to_string()))?;
        Ok(Some(bytes))
    }
}

impl Tile {
    /// The image with its boxes, two by two pixels per grid cell.
    pub fn drawn(&self) -> ColourImage {
        let [width, height] = [self.image.width(), self.image.height()].map(|side| TIMES * side as usize);
        let mut data = vec![0; 3 * width * height];
        self.draw(&mut |x, y, colour| data[3 * (y * width + x)..][..3].copy_from_slice(colour));
        ColourImage::new(width as u32, height as u32, data)
            .expect("three bytes a pixel of an image that has some")
    }

    fn draw(&self, draw: &mut dyn FnMut(usize, usize, &[u8])) {
        let (width, height) = (self.image.width() as usize, self.image.height() as usize);
        for y in 0..TIMES * height {
            for x in 0..TIMES * width {
                let at = 3 * (y / TIMES * width + x / TIMES);
                draw(x, y, &self.image.data()[at..at + 3]);
            }
        }
        for found in &self.boxes {
            let inside = |at: f32, side: usize| (at.max(0.0) as usize * TIMES).min(TIMES * side - 1);
            let [left, upper, right, lower] = found.corners;
            let (x, y) =
                ([inside(left, width), inside(right, width)], [inside(upper, height), inside(lower, height)]);
            (x[0]..=x[1]).for_each(|at| y.iter().for_each(|y| draw(at, *y, &BOX)));
            (y[0]..=y[1]).for_each(|at| x.iter().for_each(|x| draw(*x, at, &BOX)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_are_drawn_side_by_side_with_boxes() {
        let tile = |value: u8, boxes: Vec<Detection>| Tile {
            image: ColourImage::new(8, 6, vec![value; 8 * 6 * 3]).expect("three bytes a pixel"),
            boxes,
        };
        let found = Detection { class: 0, score: 1.0, corners: [2.0, 1.0, 90.0, 4.0] };
        let columns = vec!["a".to_owned(), "b".to_owned()];
        let rows = vec![vec![tile(10, vec![]), tile(20, vec![found])], vec![tile(30, vec![])]];
        let sheet = ContactSheet { columns, rows }.image().expect("three tiles");
        assert_eq!((sheet.width(), sheet.height()), (2 * 20 + 4, 2 * 16 + 4));
        let at = |x: usize, y: usize| &sheet.data()[3 * (y * 44 + x)..][..3];
        assert_eq!([at(0, 0), at(4, 4), at(19, 15), at(20, 4)], [&[255; 3], &[10; 3], &[10; 3], &[255; 3]]);
        assert_eq!([at(24, 4), at(4, 20), at(24, 20)], [&[20; 3], &[30; 3], &[255; 3]]);
        assert_eq!(
            [at(28, 6), at(39, 9), at(30, 12), at(29, 7)],
            [&BOX, &BOX, &BOX, &[20; 3]],
            "cut off at the edge"
        );
        let alone =
            tile(20, vec![Detection { class: 0, score: 1.0, corners: [2.0, 1.0, 90.0, 4.0] }]).drawn();
        assert_eq!((alone.width(), alone.height()), (16, 12));
        let at = |x: usize, y: usize| &alone.data()[3 * (y * 16 + x)..][..3];
        assert_eq!([at(0, 0), at(4, 2), at(15, 5), at(5, 3)], [&[20; 3], &BOX, &BOX, &[20; 3]]);
        assert!(ContactSheet::default().image().is_none());
        assert!(ContactSheet::default().png().expect("nothing to write").is_none());
    }
}
