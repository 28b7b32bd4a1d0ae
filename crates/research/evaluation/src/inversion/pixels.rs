//! Colours as the network has them, and images as files have them.

use veiloc_attacks::training::Matrix;
use veiloc_features::ColourImage;

use crate::inversion::network::Grid;

/// The image on a grid, each cell the mean of the pixels it covers, parts of pixels by their area: `[3, cells]` from 0 to 1.
pub(crate) fn on_grid(image: &ColourImage, grid: Grid) -> Matrix {
    let (width, height) = (image.width() as usize, image.height() as usize);
    let columns = covered(width, grid.width);
    let rows = covered(height, grid.height);
    // Along rows first: [3, height, grid.width].
    let mut narrow = vec![0.0f32; 3 * height * grid.width];
    for (row, out) in image.data().chunks_exact(3 * width).zip(narrow.chunks_exact_mut(3 * grid.width)) {
        for (parts, out) in columns.iter().zip(out.chunks_exact_mut(3)) {
            for (x, share) in parts {
                out.iter_mut()
                    .zip(&row[3 * x..3 * x + 3])
                    .for_each(|(o, v)| *o += share * f32::from(*v) / 255.0);
            }
        }
    }
    let mut colours = Matrix::zeros(3, grid.cells());
    let wide = 3 * grid.width;
    for (parts, out) in rows.iter().zip(colours.as_mut_slice().chunks_exact_mut(wide)) {
        for (y, share) in parts {
            out.iter_mut().zip(&narrow[wide * y..wide * (y + 1)]).for_each(|(o, v)| *o += share * v);
        }
    }
    colours
}

/// Which pixels each cell covers, and by what share of the cell.
fn covered(pixels: usize, cells: usize) -> Vec<Vec<(usize, f32)>> {
    let size = pixels as f64 / cells as f64;
    let of = |cell: usize| {
        let (near, far) = (cell as f64 * size, (cell + 1) as f64 * size);
        let last = (far.ceil() as usize).min(pixels);
        (near as usize..last)
            .map(|pixel| {
                let share = (far.min(pixel as f64 + 1.0) - near.max(pixel as f64)) / size;
                (pixel, share.max(0.0) as f32)
            })
            .collect()
    };
    (0..cells).map(of).collect()
}

/// Colours `[3, cells]` as bytes, what is darker than black or brighter than white cut off.
pub(crate) fn to_bytes(colours: &Matrix) -> Vec<u8> {
    colours.as_slice().iter().map(|v| (255.0 * v.clamp(0.0, 1.0)).round() as u8).collect()
}

/// The same as an image.
pub(crate) fn to_image(colours: &Matrix, grid: Grid) -> ColourImage {
    let image = ColourImage::new(grid.width as u32, grid.height as u32, to_bytes(colours));
    image.expect("three bytes for each cell of a grid that has some")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_means_of_what_they_cover() {
        let bytes = (0..4 * 2).flat_map(|i| [i * 10, 100, 255 - i * 10]).collect();
        let image = ColourImage::new(4, 2, bytes).expect("as many as there are");
        let same = on_grid(&image, Grid { width: 4, height: 2 });
        assert_eq!(to_bytes(&same), image.data());
        let half = to_bytes(&on_grid(&image, Grid { width: 2, height: 1 }));
        assert_eq!(half, [25, 100, 230, 45, 100, 210]);
        // Three cells over four pixels: a whole one and a third of the next.
        let third = to_bytes(&on_grid(&image, Grid { width: 3, height: 2 }));
        assert_eq!(&third[..3], [3, 100, 253]);
        // Larger than the image: pixels are repeated.
        assert_eq!(to_bytes(&on_grid(&image, Grid { width: 8, height: 2 }))[..6], [0, 100, 255, 0, 100, 255]);
        let beyond = Matrix::from_column_slice(3, 1, &[-1.0, 0.5, 7.0]);
        assert_eq!(to_image(&beyond, Grid { width: 1, height: 1 }).data(), [0, 128, 255]);
    }
}
