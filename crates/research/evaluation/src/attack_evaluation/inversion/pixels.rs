//! Originals on the grid of a network.

use veiloc_attacks::learned::inversion::Grid;
use veiloc_features::ColourImage;

/// The image on a grid: each cell is the mean of the pixels it covers, weighted by area.
pub(super) fn on_grid(image: &ColourImage, grid: Grid) -> ColourImage {
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
    let mut colours = vec![0.0f32; 3 * grid.cells()];
    let wide = 3 * grid.width;
    for (parts, out) in rows.iter().zip(colours.chunks_exact_mut(wide)) {
        for (y, share) in parts {
            out.iter_mut().zip(&narrow[wide * y..wide * (y + 1)]).for_each(|(o, v)| *o += share * v);
        }
    }
    let bytes = colours.iter().map(|v| (255.0 * v).round() as u8).collect();
    ColourImage::new(grid.width as u32, grid.height as u32, bytes)
        .expect("three bytes for each cell of a grid that has some")
}

/// The pixels that each cell covers, with their shares of the cell.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_area_weighted_means() {
        let bytes = (0..4 * 2).flat_map(|i| [i * 10, 100, 255 - i * 10]).collect();
        let image = ColourImage::new(4, 2, bytes).expect("as many as there are");
        let same = on_grid(&image, Grid { width: 4, height: 2 });
        assert_eq!(same.data(), image.data());
        let half = on_grid(&image, Grid { width: 2, height: 1 });
        assert_eq!(half.data(), [25, 100, 230, 45, 100, 210]);
        // Three cells over four pixels: a whole one and a third of the next.
        let third = on_grid(&image, Grid { width: 3, height: 2 });
        assert_eq!(&third.data()[..3], [3, 100, 253]);
        // Larger than the image: pixels are repeated.
        let larger = on_grid(&image, Grid { width: 8, height: 2 });
        assert_eq!(larger.data()[..6], [0, 100, 255, 0, 100, 255]);
    }
}
