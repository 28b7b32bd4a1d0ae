//! Plan of the room: walls, wall decoration, and furniture.
//!
//! Axes: `x` and `y` on the floor, `z` up, origin in the middle of the floor, metres. A ring around the middle has
//! nothing taller than a table: the cameras move there.

use rand::Rng;

use crate::builder::{Builder, LocalFrame};
use crate::bvh::Vec3;
use crate::colour::colour;
use crate::material::Pattern;
use crate::print::PrintKind;

/// Half the room's length and width, and its height, metres.
pub(crate) const HALF: [f32; 2] = [3.4, 2.9];
pub(crate) const HEIGHT: f32 = 2.75;

/// Light from a rectangle, linear.
#[derive(Clone, Copy)]
pub(crate) struct Lamp {
    pub(crate) corner: Vec3,
    pub(crate) edge_u: Vec3,
    pub(crate) edge_v: Vec3,
    pub(crate) power: f32,
}

/// A wall: its lower left corner as seen from inside, and the direction to the right.
struct Wall {
    corner: Vec3,
    right: Vec3,
    width: f32,
}

impl Wall {
    fn all() -> [Self; 4] {
        let [x, y] = HALF;
        let wall = |cx, cy, rx, ry, width| Self {
            corner: Vec3::new(cx, cy, 0.0),
            right: Vec3::new(rx, ry, 0.0),
            width,
        };
        [
            wall(-x, y, 1.0, 0.0, 2.0 * x),  // north
            wall(x, y, 0.0, -1.0, 2.0 * y),  // east
            wall(x, -y, -1.0, 0.0, 2.0 * x), // south
            wall(-x, -y, 0.0, 1.0, 2.0 * y), // west
        ]
    }

    /// The local frame at distance `along` from the left end, `out` in front of the wall; its `y` axis points into the
    /// wall.
    fn frame(&self, along: f32, out: f32, z: f32) -> LocalFrame {
        let inward = Vec3::new(self.right.y, -self.right.x, 0.0);
        let p = self.corner + self.right * along + inward * out;
        LocalFrame::new(p.x, p.y, z, self.right.y.atan2(self.right.x))
    }
}

/// Builds everything; returns the lamps.
pub(crate) fn furnish(b: &mut Builder) -> Vec<Lamp> {
    let walls = Wall::all();
    let lamps = shell(b, &walls);
    hang(b, &walls);
    stand(b, &walls);
    lamps
}

fn shell(b: &mut Builder, walls: &[Wall; 4]) -> Vec<Lamp> {
    let [x, y] = HALF;
    let boards = Pattern::Planks(colour(0.5, 0.36, 0.22), 0.13);
    b.quad(Vec3::new(-x, -y, 0.0), Vec3::new(2.0 * x, 0.0, 0.0), Vec3::new(0.0, 2.0 * y, 0.0), &boards);
    let ceiling = Pattern::Plaster(colour(0.62, 0.6, 0.56));
    b.quad(Vec3::new(-x, y, HEIGHT), Vec3::new(2.0 * x, 0.0, 0.0), Vec3::new(0.0, -2.0 * y, 0.0), &ceiling);
    let looks = [
        Pattern::Plaster(colour(0.62, 0.58, 0.48)),
        Pattern::Brick(colour(0.55, 0.27, 0.19)),
        Pattern::Wallpaper(colour(0.45, 0.52, 0.5), colour(0.75, 0.62, 0.35)),
        Pattern::Plaster(colour(0.4, 0.5, 0.58)),
    ];
    let skirting = Pattern::Planks(colour(0.4, 0.3, 0.2), 0.05);
    for (wall, look) in walls.iter().zip(&looks) {
        b.quad(wall.corner, wall.right * wall.width, Vec3::new(0.0, 0.0, HEIGHT), look);
        b.block(&wall.frame(0.0, 0.02, 0.0), [wall.width, 0.019, 0.09], &skirting);
    }
    let beam = Pattern::Planks(colour(0.3, 0.2, 0.12), 0.07);
    for k in 0..3 {
        let at = -2.2 + 2.1 * k as f32;
        b.block(&LocalFrame::new(at, -y, HEIGHT - 0.16, 0.0), [0.14, 2.0 * y, 0.155], &beam);
    }
    let glow = Pattern::Lamp(colour(2.2, 2.1, 1.9));
    [(-1.2, -0.7), (1.2, 0.7), (-1.2, 1.5), (1.2, -1.5)]
        .into_iter()
        .map(|(cx, cy)| {
            let corner = Vec3::new(cx - 0.5, cy + 0.12, HEIGHT - 0.01);
            let (edge_u, edge_v) = (Vec3::new(1.0, 0.0, 0.0), Vec3::new(0.0, -0.24, 0.0));
            b.quad(corner, edge_u, edge_v, &glow);
            Lamp { corner, edge_u, edge_v, power: 2.6 }
        })
        .collect()
}

/// Posters and paintings without overlap.
fn hang(b: &mut Builder, walls: &[Wall; 4]) {
    for wall in walls {
        let mut hung: Vec<[f32; 4]> = Vec::new();
        for attempt in 0..120 {
            let scale: f32 = if attempt < 30 { 1.0 } else { 0.55 };
            let w = b.rng.random_range(0.3..1.0) * scale;
            let h = (w * b.rng.random_range(0.65..1.5)).min(1.1);
            let (u, v) = (b.rng.random_range(0.05..wall.width - w - 0.05), b.rng.random_range(0.55..2.5));
            let free = hung
                .iter()
                .all(|p| u > p[2] + 0.04 || u + w < p[0] - 0.04 || v > p[3] + 0.04 || v + h < p[1] - 0.04);
            if v + h > HEIGHT - 0.2 || !free || hung.len() > 15 {
                continue;
            }
            hung.push([u, v, u + w, v + h]);
            let kind = if w > h && b.rng.random_bool(0.6) { PrintKind::Landscape } else { PrintKind::Poster };
            let face = b.printed(kind, [w, h]);
            let rim = Pattern::Shell(b.colour(0.05..0.5));
            let thick = b.rng.random_range(0.006..0.03);
            let faces = [&face, &rim, &rim, &rim, &rim, &rim];
            b.flat(|b| b.faces(&wall.frame(u, thick, v), [w, thick - 0.001, h], faces));
        }
    }
}

fn stand(b: &mut Builder, [north, east, south, west]: &[Wall; 4]) {
    let mut jitter = |range: f32| b.rng.random_range(-range..range);
    let shifts: [f32; 8] = std::array::from_fn(|_| jitter(0.08));
    // North: two bookcases and a desk between them.
    b.bookcase(&north.frame(0.35 + shifts[0], 0.33, 0.0), 1.1, 2.05);
    b.desk(&north.frame(2.2 + shifts[1], 0.78, 0.0), 1.6);
    b.chair(&north.frame(2.7 + shifts[2], 1.2, 0.0).moved(0.42, 0.42, 0.0, 2.9));
    b.bookcase(&north.frame(4.5 + shifts[3], 0.33, 0.0), 1.3, 1.7);
    // East: a sofa and a floor lamp.
    b.sofa(&east.frame(1.2 + shifts[4], 0.8, 0.0), 2.1);
    b.floor_lamp(&east.frame(3.75, 0.4, 0.0));
    b.chest(&east.frame(4.3 + shifts[5], 0.5, 0.0), [1.0, 0.45, 0.85]);
    let on_chest = east.frame(4.3 + shifts[5], 0.5, 0.85);
    b.clutter(&on_chest, [1.0, 0.45], 8);
    // South: cartons in a pile, a bookcase, wall boards.
    for (along, z, size) in [
        (0.3, 0.0, [0.55, 0.45, 0.42]),
        (0.95, 0.0, [0.6, 0.5, 0.36]),
        (0.45, 0.42, [0.5, 0.4, 0.35]),
        (1.6, 0.0, [0.4, 0.4, 0.5]),
    ] {
        let turn = b.rng.random_range(-0.12..0.12);
        b.carton(&south.frame(along, 0.62, z).moved(0.0, 0.0, 0.0, turn), size);
    }
    b.bookcase(&south.frame(2.3 + shifts[6], 0.33, 0.0), 1.4, 1.35);
    b.clutter(&south.frame(2.3 + shifts[6], 0.32, 1.35), [1.4, 0.3], 7);
    b.table(&south.frame(4.1, 0.72, 0.0), [1.5, 0.65, 0.78]);
    b.clutter(&south.frame(4.1, 0.72, 0.78), [1.5, 0.65], 12);
    b.carton(&south.frame(4.4, 0.6, 0.0), [0.6, 0.4, 0.45]);
    // West: a chest, two boards with books, a bookcase.
    b.chest(&west.frame(0.7 + shifts[7], 0.5, 0.0), [1.2, 0.45, 0.95]);
    b.clutter(&west.frame(0.7 + shifts[7], 0.5, 0.95), [1.2, 0.45], 9);
    let board = Pattern::Planks(colour(0.45, 0.33, 0.2), 0.08);
    for z in [1.45, 1.9] {
        b.block(&west.frame(2.4, 0.26, z), [1.5, 0.25, 0.025], &board);
        b.books(&west.frame(2.42, 0.24, z + 0.025), 1.45, 0.34);
    }
    b.sofa(&west.frame(2.3, 0.78, 0.0), 1.7);
    b.bookcase(&west.frame(4.35, 0.33, 0.0), 1.0, 1.95);
    // A tiled pillar in one corner, two along the length of the room.
    let tiles = Pattern::Tiles(colour(0.6, 0.55, 0.5), 0.11);
    b.column(&LocalFrame::new(2.85, -2.35, 0.0, 0.2), 0.2, HEIGHT, &tiles, &tiles);
    b.column(&LocalFrame::new(-2.9, 2.4, 0.0, 0.1), 0.16, HEIGHT, &tiles, &tiles);
    middle(b);
}

/// Rugs, a low table, and small things on the floor.
fn middle(b: &mut Builder) {
    for (cx, cy, w, d, z) in
        [(0.0, 0.05, 2.9, 2.0, 0.006), (2.0, -1.9, 1.2, 0.8, 0.005), (-2.1, -1.6, 1.0, 1.3, 0.004)]
    {
        let palette = std::array::from_fn(|_| b.colour(0.12..0.85));
        let turn = b.rng.random_range(-0.2..0.2);
        let at = LocalFrame::new(cx, cy, z, turn);
        let corner = at.at(-w / 2.0, -d / 2.0, 0.0);
        b.flat(|b| b.quad(corner, at.across() * w, at.back() * d, &Pattern::Rug(palette)));
    }
    let turn = b.rng.random_range(-0.3..0.3);
    let table = LocalFrame::new(0.0, 0.0, 0.0, turn).moved(-0.55, -0.35, 0.0, 0.0);
    b.table(&table, [1.1, 0.7, 0.44]);
    b.clutter(&table.moved(0.0, 0.0, 0.44, 0.0), [1.1, 0.7], 10);
    for (x, y) in [(-1.1, 0.9), (1.0, -0.9), (1.25, 0.85)] {
        let turn = b.rng.random_range(-3.0..3.0);
        let size =
            [b.rng.random_range(0.2..0.4), b.rng.random_range(0.2..0.4), b.rng.random_range(0.15..0.4)];
        if b.rng.random_bool(0.5) {
            b.carton(&LocalFrame::new(x, y, 0.0, turn), size);
        } else {
            b.labelled_box(&LocalFrame::new(x, y, 0.0, turn), size);
        }
    }
}
