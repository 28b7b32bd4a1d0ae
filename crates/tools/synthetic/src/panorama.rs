//! Renders equirectangular panoramas, from the pinhole images of six directions.

use image::{Rgb, RgbImage};
use nalgebra::{Rotation3, Vector3};
use rayon::prelude::*;
use veiloc_geometry::frames::{Camera, Rig};
use veiloc_geometry::{Intrinsics, Panorama, Pixel, RigFromWorld, Rigid3};

use crate::render::RenderOptions;
use crate::scene::RenderedRoom;

impl RenderedRoom {
    /// Renders a panorama, as a 360° camera stitches it from several images. `rig_from_world`: the pose of its frame, with `y`
    /// down. Equal input gives equal bytes.
    pub fn render_panorama(
        &self,
        rig_from_world: &RigFromWorld,
        panorama: Panorama,
        options: &RenderOptions,
    ) -> RgbImage {
        // Wider than a side of the cube by what interpolation needs at its edges.
        let side = panorama.width() / 2;
        let focal = 0.48 * f64::from(side);
        let middle = 0.5 * f64::from(side);
        let camera = Intrinsics::new("SIMPLE_PINHOLE", side, side, &[focal, middle, middle])
            .expect("a square with about half of it as focal length");
        let about = |axis: Vector3<f64>, quarters: f64| {
            Rotation3::new(-axis * quarters * std::f64::consts::FRAC_PI_2)
        };
        let (y, x) = (Vector3::y(), Vector3::x());
        let sides = (0..4).map(|quarters| about(y, f64::from(quarters)));
        let rotations: Vec<Rotation3<f64>> = sides.chain([about(x, 1.0), about(x, -1.0)]).collect();
        let images: Vec<RgbImage> = (0..)
            .zip(&rotations)
            .map(|(number, rotation)| {
                let cam_from_rig = Rigid3::<Camera, Rig>::new(*rotation, Vector3::zeros());
                let own =
                    RenderOptions { seed: 8 * options.seed + number, vignetting: 0.0, ..options.clone() };
                self.render(&cam_from_rig.compose(rig_from_world), &camera, &own).rgb().clone()
            })
            .collect();
        let (width, height) = (panorama.width(), panorama.height());
        let rows = (0..height).into_par_iter().flat_map_iter(|row| {
            let (images, rotations) = (&images, &rotations);
            (0..width).flat_map(move |column| {
                let direction = panorama.direction(&Pixel::from_center_at_zero(column.into(), row.into()));
                let in_cameras = rotations.iter().map(|rotation| rotation * direction);
                let (image, v) = images
                    .iter()
                    .zip(in_cameras)
                    .max_by(|(_, a), (_, b)| a.z.total_cmp(&b.z))
                    .expect("six images");
                let pixel = Pixel::new(middle + focal * v.x / v.z, middle + focal * v.y / v.z);
                interpolated(image, &pixel)
            })
        });
        RgbImage::from_raw(width, height, rows.collect()).unwrap_or_else(|| RgbImage::new(width, height))
    }
}

fn interpolated(image: &RgbImage, pixel: &Pixel) -> [u8; 3] {
    let [x, y] = pixel.center_at_zero();
    let Rgb(sample) = image::imageops::interpolate_bilinear(image, x as f32, y as f32).unwrap_or(Rgb([0; 3]));
    sample
}
