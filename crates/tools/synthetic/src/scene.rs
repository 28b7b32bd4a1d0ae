//! The scene: surfaces, materials and light.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::builder::{Builder, Obstacle};
use crate::bvh::{Bvh, Quad, Vec3};
use crate::light::{LightGrid, bake};
use crate::material::Material;
use crate::room::{HALF, HEIGHT, furnish};

/// A furnished room of 6.8 x 5.8 x 2.75 m that renders itself.
///
/// World axes: `x` and `y` on the floor, `z` up, origin in the middle of the floor; map units are metres.
pub struct RenderedRoom {
    pub(crate) seed: u64,
    pub(crate) quads: Vec<Quad>,
    pub(crate) materials: Vec<Material>,
    pub(crate) light: Vec<LightGrid>,
    pub(crate) bvh: Bvh,
    pub(crate) obstacles: Vec<Obstacle>,
}

impl RenderedRoom {
    /// Builds, paints and lights the room of this seed: about a second on two cores.
    pub fn generate(seed: u64) -> Self {
        let mut builder = Builder::new(ChaCha8Rng::seed_from_u64(seed));
        let lamps = furnish(&mut builder);
        let bvh = Bvh::new(&builder.quads);
        let casting: Vec<Quad> =
            builder.quads.iter().zip(&builder.casts).filter(|(_, c)| **c).map(|(q, _)| *q).collect();
        let light = bake(&builder.quads, &casting, &lamps);
        Self {
            seed,
            light,
            bvh,
            quads: builder.quads,
            materials: builder.materials,
            obstacles: builder.obstacles,
        }
    }

    /// Returns a room with the shape, the furniture and the prints of the room of `seed`; the share `differing` of its
    /// other surfaces has its own stains, grain and wear: like two rooms of one hotel.
    pub fn similar_to(seed: u64, own: u64, differing: f64) -> Self {
        let mut scene = Self::generate(seed);
        let mut rng = ChaCha8Rng::seed_from_u64(own ^ 0xa11c_e5ee_d000_0000);
        for material in &mut scene.materials {
            let (differs, seed) = (rng.random_bool(differing.clamp(0.0, 1.0)), rng.random());
            material.seed = if differs { seed } else { material.seed };
        }
        // Camera positions differ too.
        scene.seed = own;
        scene
    }

    /// Lower and upper corner of the room, metres.
    pub fn bounds(&self) -> [[f64; 3]; 2] {
        let [x, y] = HALF.map(f64::from);
        [[-x, -y, 0.0], [x, y, f64::from(HEIGHT)]]
    }

    /// Returns whether a position is in the room and at least `clearance` metres from walls and furniture.
    pub fn is_free(&self, position: [f64; 3], clearance: f64) -> bool {
        let p = Vec3::new(position[0] as f32, position[1] as f32, position[2] as f32);
        let c = clearance as f32;
        let room = p.x.abs() < HALF[0] - c && p.y.abs() < HALF[1] - c && p.z > c && p.z < HEIGHT - c;
        let outside = |o: &Obstacle| {
            let nearest = p.sup(&o.low).inf(&o.high);
            (nearest - p).norm() > c
        };
        room && self.obstacles.iter().all(outside)
    }
}

impl std::fmt::Debug for RenderedRoom {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Place(seed {}, {} surfaces)", self.seed, self.quads.len())
    }
}
