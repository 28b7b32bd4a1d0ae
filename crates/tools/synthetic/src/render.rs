//! Renders an image with the depth of every pixel, from a pose and a camera.
//!
//! One ray goes through every pixel corner. If all four corners of a pixel hit the same surface, four samples of its
//! texture are averaged; otherwise nine rays are, so that edges are smooth. Texture detail finer than a sample is left
//! out, so that it cannot alias.

use image::{GrayImage, Luma, Rgb, RgbImage};
use nalgebra::Vector3;
use rayon::prelude::*;
use veiloc_geometry::{CameraFromWorld, Intrinsics, Pixel, PlanePoint, Point3, frames::World};

use crate::bvh::{Hit, Vec3};
use crate::colour::Colour;
use crate::noise::{hash, unit};
use crate::scene::RenderedRoom;

/// Options of the simulated sensor.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct RenderOptions {
    /// Factor on the light; 1 by default.
    pub exposure: f32,
    /// Loss of light in the corners of the image, 0 to 1; 0.18 by default.
    pub vignetting: f32,
    /// Standard deviation of the sensor's noise, grey levels of 255; 1 by default.
    pub noise: f32,
    /// Seed of the noise: every image needs its own.
    pub seed: u64,
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self { exposure: 1.0, vignetting: 0.18, noise: 1.0, seed: 0 }
    }
}

impl RenderOptions {
    /// The defaults with this seed of the noise.
    pub fn with_seed(seed: u64) -> Self {
        Self { seed, ..Self::default() }
    }
}

/// A rendered image with its ground truth.
#[derive(Clone, PartialEq)]
pub struct Rendering {
    rgb: RgbImage,
    /// `[height · width]`, metres; NaN if a pixel has no ray.
    depth: Vec<f32>,
    camera: Intrinsics,
    cam_from_world: CameraFromWorld,
}

impl Rendering {
    /// The image, 8 bits a channel.
    pub const fn rgb(&self) -> &RgbImage {
        &self.rgb
    }

    /// The image in grey, Rec. 601 weights.
    pub fn gray(&self) -> GrayImage {
        let (w, h) = self.rgb.dimensions();
        GrayImage::from_fn(w, h, |x, y| {
            let [r, g, b] = self.rgb.get_pixel(x, y).0.map(f32::from);
            Luma([(0.299 * r + 0.587 * g + 0.114 * b).round() as u8])
        })
    }

    /// Depth (camera `z`, metres) at the centre of a pixel; `None` outside the image, or if the distortion leaves the
    /// pixel without a ray.
    pub fn depth(&self, x: u32, y: u32) -> Option<f32> {
        let (w, h) = self.rgb.dimensions();
        let z = *self.depth.get(y as usize * w as usize + x as usize)?;
        (x < w && y < h && z.is_finite()).then_some(z)
    }

    /// The 3D point at the centre of a pixel.
    pub fn point(&self, x: u32, y: u32) -> Option<Point3<World>> {
        let z = f64::from(self.depth(x, y)?);
        let p = self.camera.unproject(Pixel::new(f64::from(x) + 0.5, f64::from(y) + 0.5))?;
        Some(self.cam_from_world.inverse().transform(&Point3::new(p.x * z, p.y * z, z)))
    }

    /// The camera.
    pub const fn camera(&self) -> &Intrinsics {
        &self.camera
    }

    /// The pose.
    pub const fn cam_from_world(&self) -> &CameraFromWorld {
        &self.cam_from_world
    }
}

impl std::fmt::Debug for Rendering {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Rendering({} x {})", self.rgb.width(), self.rgb.height())
    }
}

/// Farther than any wall.
const FAR: f32 = 100.0;

impl RenderedRoom {
    /// Renders the image of a camera (with its distortion) at a pose. Equal input gives equal bytes.
    pub fn render(
        &self,
        cam_from_world: &CameraFromWorld,
        camera: &Intrinsics,
        options: &RenderOptions,
    ) -> Rendering {
        let view = View::new(self, cam_from_world, camera);
        let (w, h) = (camera.width as usize, camera.height as usize);
        // Corner rays, row by row: [h + 1][w + 1].
        let corners: Vec<Vec<Option<Corner>>> = (0..=h)
            .into_par_iter()
            .map(|y| {
                let mut last = u32::MAX;
                let row = (0..=w).map(|x| {
                    let corner = view.corner(x as f64, y as f64, last);
                    last = corner.map_or(u32::MAX, |c| c.quad);
                    corner
                });
                row.collect()
            })
            .collect();
        let rows: Vec<(Vec<u8>, Vec<f32>)> = (0..h)
            .into_par_iter()
            .map(|y| {
                let mut bytes = Vec::with_capacity(3 * w);
                let mut depths = Vec::with_capacity(w);
                for x in 0..w {
                    let four = [corners[y][x], corners[y][x + 1], corners[y + 1][x], corners[y + 1][x + 1]];
                    let (colour, depth) = view.pixel(four);
                    bytes.extend(develop(colour, x, y, camera, options));
                    depths.push(depth);
                }
                (bytes, depths)
            })
            .collect();
        let (bytes, depths): (Vec<Vec<u8>>, Vec<Vec<f32>>) = rows.into_iter().unzip();
        let rgb = RgbImage::from_raw(camera.width, camera.height, bytes.concat())
            .unwrap_or_else(|| RgbImage::from_pixel(camera.width, camera.height, Rgb([0; 3])));
        Rendering { rgb, depth: depths.concat(), camera: *camera, cam_from_world: *cam_from_world }
    }
}

/// The ray through a pixel corner, and the surface that it hits.
#[derive(Clone, Copy)]
struct Corner {
    /// Position on the plane `z = 1` of the camera.
    plane: [f32; 2],
    quad: u32,
}

struct View<'a> {
    scene: &'a RenderedRoom,
    camera: &'a Intrinsics,
    center: Vec3,
    /// Columns: the camera's axes in the world.
    axes: [Vec3; 3],
    /// Width of a pixel at depth 1.
    pixel: f32,
}

impl<'a> View<'a> {
    fn new(scene: &'a RenderedRoom, cam_from_world: &CameraFromWorld, camera: &'a Intrinsics) -> Self {
        let single = |v: Vector3<f64>| v.map(|c| c as f32);
        let r = cam_from_world.rotation().matrix();
        Self {
            scene,
            camera,
            center: single(cam_from_world.center().coords),
            axes: [0, 1, 2].map(|k| single(r.row(k).transpose())),
            pixel: 1.0 / camera.pinhole().mean_focal() as f32,
        }
    }

    /// World direction of a ray with camera `z` of 1, so that its length parameter is the depth.
    fn ray(&self, plane: [f32; 2]) -> Vec3 {
        self.axes[0] * plane[0] + self.axes[1] * plane[1] + self.axes[2]
    }

    fn hit(&self, plane: [f32; 2], hint: u32) -> Option<Hit> {
        self.scene.bvh.first_hit(&self.scene.quads, self.center, self.ray(plane), FAR, hint)
    }

    fn corner(&self, u: f64, v: f64, hint: u32) -> Option<Corner> {
        let PlanePoint { x, y } = self.camera.unproject(Pixel::new(u, v))?;
        let plane = [x as f32, y as f32];
        Some(Corner { plane, quad: self.hit(plane, hint).map_or(u32::MAX, |h| h.quad) })
    }

    /// Mean colour and centre depth of the pixel between four corners.
    fn pixel(&self, corners: [Option<Corner>; 4]) -> (Colour, f32) {
        let [Some(a), Some(b), Some(c), Some(d)] = corners else {
            return (Colour::zeros(), f32::NAN);
        };
        let inside = |s: f32, t: f32| {
            [0, 1].map(|k| {
                let top = a.plane[k] * (1.0 - s) + b.plane[k] * s;
                let bottom = c.plane[k] * (1.0 - s) + d.plane[k] * s;
                top * (1.0 - t) + bottom * t
            })
        };
        let one = a.quad != u32::MAX && a.quad == b.quad && a.quad == c.quad && a.quad == d.quad;
        let n = if one { 2 } else { 3 };
        let mut hint = a.quad;
        let mut sum = Colour::zeros();
        for k in 0..n * n {
            let at = |i: usize| (i as f32 + 0.5) / n as f32;
            let plane = inside(at(k % n), at(k / n));
            let hit = if one { Some(self.intersect(a.quad, plane)) } else { self.hit(plane, hint) };
            hint = hit.map_or(hint, |h| h.quad);
            sum += hit.map_or_else(Colour::zeros, |h| self.shade(&h, plane));
        }
        let middle = inside(0.5, 0.5);
        let depth = if one {
            self.intersect(a.quad, middle).t
        } else {
            self.hit(middle, hint).map_or(f32::NAN, |h| h.t)
        };
        (sum / (n * n) as f32, depth)
    }

    fn intersect(&self, quad: u32, plane: [f32; 2]) -> Hit {
        let (t, a, b) = self.scene.quads[quad as usize].intersect(self.center, self.ray(plane));
        Hit { quad, t, a, b }
    }

    fn shade(&self, hit: &Hit, plane: [f32; 2]) -> Colour {
        let quad = &self.scene.quads[hit.quad as usize];
        let ray = self.ray(plane);
        let facing = (quad.normal.dot(&ray) / ray.norm()).abs().max(0.05);
        // Half a pixel wide, longer on slanted surfaces.
        let footprint = 0.6 * self.pixel * hit.t / facing.sqrt();
        let (u, v) = (hit.a * quad.size[0], hit.b * quad.size[1]);
        let material = &self.scene.materials[hit.quad as usize];
        let reflectance = material.reflectance(u, v, quad.size, footprint);
        if matches!(material.pattern, crate::material::Pattern::Lamp(_)) {
            return reflectance;
        }
        reflectance * self.scene.light[hit.quad as usize].at(hit.a, hit.b)
    }
}

/// Exposure, vignetting, tone curve and noise.
fn develop(colour: Colour, x: usize, y: usize, camera: &Intrinsics, options: &RenderOptions) -> [u8; 3] {
    let (w, h) = (camera.width as f32, camera.height as f32);
    let (dx, dy) = ((x as f32 + 0.5 - w / 2.0) / w, (y as f32 + 0.5 - h / 2.0) / h);
    let lens = 1.0 - options.vignetting * 2.0 * (dx * dx + dy * dy);
    let seed = (options.seed ^ (options.seed >> 32)) as u32 ^ 0x51ed_270b;
    let bits = hash(seed, x as i32, y as i32);
    let channel = |k: u32| {
        let light = (colour[k as usize] * options.exposure * lens).max(0.0);
        // Linear in the shadows, saturating to white.
        let curve = 1.0 - (-1.25 * light).exp();
        let value = 255.0 * curve.clamp(0.0, 1.0).powf(1.0 / 2.2);
        // The sum of four uniform numbers is approximately normal.
        let bell: f32 = (0..4).map(|i| unit(bits, 4 * k + i)).sum::<f32>() - 2.0;
        (value + options.noise * bell * 1.732).round().clamp(0.0, 255.0) as u8
    };
    [channel(0), channel(1), channel(2)]
}
