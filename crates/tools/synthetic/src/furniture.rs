//! Furniture of the room. Each piece is built in a local frame ([`LocalFrame`]): front left corner, `x` along the
//! front, `y` back.

use std::sync::Arc;

use rand::Rng;

use crate::builder::{Builder, LocalFrame};
use crate::colour::{Colour, colour};
use crate::material::Pattern;
use crate::print::{PrintKind, any_colour, print};

impl Builder {
    pub(crate) fn colour(&mut self, light: std::ops::Range<f32>) -> Colour {
        any_colour(&mut self.rng, light)
    }

    pub(crate) fn printed(&mut self, kind: PrintKind, size: [f32; 2]) -> Pattern {
        let seed = self.rng.random();
        Pattern::Print(Arc::new(print(kind, size, seed)))
    }

    fn wood(&mut self) -> Pattern {
        let tone = self.rng.random_range(0.25..0.6);
        Pattern::Planks(colour(tone, tone * 0.68, tone * 0.4), self.rng.random_range(0.07..0.14))
    }

    /// A bookcase with books on every board.
    pub(crate) fn bookcase(&mut self, frame: &LocalFrame, width: f32, height: f32) {
        let (depth, board) = (0.3, 0.025);
        let wood = self.wood();
        for x in [0.0, width - board] {
            self.block(&frame.moved(x, 0.0, 0.0, 0.0), [board, depth, height], &wood);
        }
        self.block(&frame.moved(0.0, depth - 0.01, 0.0, 0.0), [width, 0.01, height], &wood);
        let boards = (height / 0.34) as usize;
        for k in 0..=boards {
            let z = (height - board) * k as f32 / boards as f32;
            self.block(&frame.moved(0.0, 0.0, z, 0.0), [width, depth, board], &wood);
            if k < boards {
                let free = (height - board) / boards as f32 - board;
                self.books(&frame.moved(board, 0.03, z + board, 0.0), width - 2.0 * board, free);
            }
        }
    }

    /// A row of books, with occasional boxes and gaps.
    pub(crate) fn books(&mut self, frame: &LocalFrame, width: f32, free: f32) {
        let mut x = 0.01;
        loop {
            let thick = self.rng.random_range(0.022..0.065);
            if x + thick > width {
                return;
            }
            let roll: f32 = self.rng.random();
            if roll < 0.06 {
                x += self.rng.random_range(0.03..0.12);
                continue;
            }
            if roll < 0.12 && x + 0.17 < width {
                let size = [self.rng.random_range(0.08..0.16), 0.12, free * self.rng.random_range(0.3..0.7)];
                self.labelled_box(&frame.moved(x, 0.02, 0.0, 0.0), size);
                x += size[0] + 0.01;
                continue;
            }
            let tall = free * self.rng.random_range(0.6..0.96);
            let deep = self.rng.random_range(0.15..0.22);
            let spine = Pattern::Spine(self.colour(0.12..0.85), self.colour(0.05..1.0));
            let cover = Pattern::Cardboard(self.colour(0.1..0.7));
            let paper = Pattern::Shell(colour(0.75, 0.72, 0.62));
            let set_back = self.rng.random_range(0.0..0.05);
            let at = frame.moved(x, set_back, 0.0, 0.0);
            self.faces(&at, [thick, deep, tall], [&spine, &paper, &cover, &cover, &paper, &paper]);
            x += thick + 0.002;
        }
    }

    /// A box with a print on every side.
    pub(crate) fn labelled_box(&mut self, frame: &LocalFrame, size: [f32; 3]) {
        let [w, d, h] = size;
        let kind = if self.rng.random_bool(0.5) { PrintKind::Label } else { PrintKind::Poster };
        let sides = [[w, h], [w, h], [d, h], [d, h], [w, d], [w, d]].map(|s| self.printed(kind, s));
        self.faces(frame, size, sides.each_ref());
    }

    /// A cardboard box with labels.
    pub(crate) fn carton(&mut self, frame: &LocalFrame, size: [f32; 3]) {
        let tone = self.rng.random_range(0.35..0.6);
        let card = Pattern::Cardboard(colour(tone, tone * 0.75, tone * 0.5));
        self.block(frame, size, &card);
        let [w, d, h] = size;
        for side in 0..3 {
            let (lw, lh) = (w.min(d) * self.rng.random_range(0.35..0.6), h * self.rng.random_range(0.3..0.5));
            let label = self.printed(PrintKind::Label, [lw, lh]);
            let up = crate::bvh::Vec3::new(0.0, 0.0, lh);
            let (corner, along) = match side {
                0 => (frame.at(w * 0.2, -0.003, h * 0.3), frame.across()),
                1 => (frame.at(-0.003, d * 0.8, h * 0.3), -frame.back()),
                _ => (frame.at(w + 0.003, d * 0.2, h * 0.3), frame.back()),
            };
            self.flat(|b| b.quad(corner, along * lw, up, &label));
        }
    }

    /// A table top on four legs.
    pub(crate) fn table(&mut self, frame: &LocalFrame, [w, d, h]: [f32; 3]) {
        let wood = self.wood();
        for (x, y) in [(0.02, 0.02), (w - 0.07, 0.02), (0.02, d - 0.07), (w - 0.07, d - 0.07)] {
            self.block(&frame.moved(x, y, 0.0, 0.0), [0.05, 0.05, h - 0.035], &wood);
        }
        self.block(&frame.moved(0.0, 0.0, h - 0.035, 0.0), [w, d, 0.035], &wood);
    }

    /// Papers, boxes, mugs and piles of books on a surface of this size.
    pub(crate) fn clutter(&mut self, frame: &LocalFrame, [w, d]: [f32; 2], things: usize) {
        for k in 0..things {
            let x = self.rng.random_range(0.06..(w - 0.26).max(0.07));
            let y = self.rng.random_range(0.05..(d - 0.26).max(0.06));
            let turn = self.rng.random_range(-0.6..0.6);
            let at = frame.moved(x, y, 0.0, turn);
            match k % 4 {
                0 => {
                    let sheet = self.printed(PrintKind::Paper, [0.21, 0.29]);
                    let lift = 0.002 + 0.0006 * k as f32;
                    self.flat(|b| {
                        b.quad(at.at(0.0, 0.0, lift), at.across() * 0.21, at.back() * 0.29, &sheet);
                    });
                }
                1 => {
                    let size = [
                        self.rng.random_range(0.08..0.2),
                        self.rng.random_range(0.08..0.2),
                        self.rng.random_range(0.06..0.24),
                    ];
                    self.labelled_box(&at, size);
                }
                2 => {
                    let mug = Pattern::Wallpaper(self.colour(0.3..0.9), self.colour(0.05..0.9));
                    let inside = Pattern::Shell(colour(0.12, 0.08, 0.05));
                    self.column(&at.moved(0.08, 0.08, 0.0, 0.0), 0.042, 0.1, &mug, &inside);
                }
                _ => {
                    let mut z = 0.0;
                    for _ in 0..self.rng.random_range(2..5) {
                        let tall = self.rng.random_range(0.02..0.05);
                        let cover = Pattern::Cardboard(self.colour(0.1..0.8));
                        let top = self.printed(PrintKind::Poster, [0.15, 0.21]);
                        let slip = self.rng.random_range(-0.25..0.25);
                        let book = at.moved(0.0, 0.0, z, slip);
                        self.faces(&book, [0.15, 0.21, tall], [&cover, &cover, &cover, &cover, &top, &cover]);
                        z += tall;
                    }
                }
            }
        }
    }

    /// A desk against a wall, with two screens.
    pub(crate) fn desk(&mut self, frame: &LocalFrame, width: f32) {
        self.table(frame, [width, 0.7, 0.74]);
        let on = frame.moved(0.0, 0.0, 0.74, 0.0);
        let black = Pattern::Shell(colour(0.06, 0.06, 0.07));
        for (x, turn) in [(0.25, 0.16), (0.82, -0.12)] {
            let foot = on.moved(x + 0.2, 0.46, 0.0, turn);
            self.block(&foot, [0.12, 0.12, 0.015], &black);
            let screen = self.printed(PrintKind::Screen, [0.52, 0.32]);
            let at = on.moved(x, 0.5, 0.1, turn);
            self.faces(&at, [0.52, 0.03, 0.32], [&screen, &black, &black, &black, &black, &black]);
        }
        let keys = self.printed(PrintKind::Label, [0.42, 0.14]);
        let at = on.moved(0.5, 0.12, 0.0, 0.05);
        self.faces(&at, [0.42, 0.14, 0.02], [&black, &black, &black, &black, &keys, &black]);
        self.clutter(&on, [width, 0.4], 7);
    }

    /// A chair.
    pub(crate) fn chair(&mut self, frame: &LocalFrame) {
        let wood = self.wood();
        let cloth = Pattern::Cloth(self.colour(0.2..0.7));
        for (x, y) in [(0.0, 0.0), (0.38, 0.0), (0.0, 0.38), (0.38, 0.38)] {
            self.block(&frame.moved(x, y, 0.0, 0.0), [0.04, 0.04, 0.43], &wood);
        }
        self.block(&frame.moved(0.0, 0.0, 0.43, 0.0), [0.42, 0.42, 0.05], &cloth);
        self.block(&frame.moved(0.0, 0.38, 0.48, 0.0), [0.42, 0.04, 0.46], &cloth);
    }

    /// A sofa with cushions.
    pub(crate) fn sofa(&mut self, frame: &LocalFrame, width: f32) {
        let cloth = Pattern::Cloth(self.colour(0.2..0.6));
        self.block(frame, [width, 0.75, 0.38], &cloth);
        self.block(&frame.moved(0.0, 0.58, 0.38, 0.0), [width, 0.17, 0.4], &cloth);
        for x in [0.0, width - 0.16] {
            self.block(&frame.moved(x, 0.0, 0.38, 0.0), [0.16, 0.58, 0.2], &cloth);
        }
        let mut x = 0.22;
        while x + 0.4 < width - 0.16 {
            let cushion = self.printed(PrintKind::Poster, [0.38, 0.34]);
            let side = Pattern::Cloth(self.colour(0.2..0.8));
            let turn = self.rng.random_range(-0.2..0.2);
            let at = frame.moved(x, 0.42, 0.38, turn);
            self.faces(&at, [0.38, 0.13, 0.34], [&cushion, &side, &side, &side, &side, &side]);
            x += self.rng.random_range(0.42..0.6);
        }
    }

    /// A chest of drawers.
    pub(crate) fn chest(&mut self, frame: &LocalFrame, [w, d, h]: [f32; 3]) {
        let wood = self.wood();
        self.block(frame, [w, d, h], &wood);
        let front = self.wood();
        let knob = Pattern::Shell(colour(0.7, 0.6, 0.3));
        for k in 0..3 {
            let z = 0.03 + (h - 0.04) * k as f32 / 3.0;
            self.block(&frame.moved(0.03, -0.02, z, 0.0), [w - 0.06, 0.02, h / 3.0 - 0.04], &front);
            for x in [0.25, 0.72] {
                self.block(&frame.moved(w * x, -0.045, z + h / 6.0 - 0.02, 0.0), [0.03, 0.025, 0.03], &knob);
            }
        }
    }

    /// A floor lamp.
    pub(crate) fn floor_lamp(&mut self, frame: &LocalFrame) {
        let metal = Pattern::Shell(colour(0.3, 0.3, 0.32));
        let shade = Pattern::Wallpaper(colour(0.85, 0.75, 0.5), self.colour(0.1..0.8));
        self.column(frame, 0.15, 0.03, &metal, &metal);
        self.column(frame, 0.018, 1.4, &metal, &metal);
        self.column(&frame.moved(0.0, 0.0, 1.4, 0.0), 0.19, 0.3, &shade, &shade);
    }
}
