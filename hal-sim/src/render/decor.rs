//! What the world is painted with: floors, walls, light, and the paint of things.

use super::noise::{Draws, of_cell, scramble, share, smooth, split};
use super::shape::Vec3;
use crate::world::Look;

/// Red, green and blue, 0 to 255.
pub(super) type Paint = [f32; 3];

/// Walls are painted in panels of this length, metres, so that one sees oneself move along them.
const PANEL_M: f32 = 0.5;

const SKY: Paint = [196.0, 208.0, 222.0];
const FLOOR: Paint = [128.0, 122.0, 112.0];
const PANELS: [Paint; 2] = [[214.0, 210.0, 200.0], [184.0, 180.0, 172.0]];

/// Towards the light, of length 1: from the upper right of a plan of the arena, steep.
const LIGHT: Vec3 = Vec3::new(0.384, 0.288, 0.877);
/// Share of the light that comes from everywhere.
const AMBIENT: f32 = 0.45;

/// What a floor is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Floor {
    /// One colour.
    #[default]
    Plain,
    /// Square tiles with joints.
    Tiles,
    /// Boards with grain.
    Planks,
    /// Speckles.
    Carpet,
    /// Clouds of grey, large and small.
    Concrete,
    /// Chips of stone.
    Terrazzo,
    /// Squares of two colours.
    Checks,
    /// Round stones with joints, none in line with the next row.
    Cobbles,
    /// Veins.
    Marble,
}

impl Floor {
    /// Every kind.
    pub const ALL: [Self; 9] = [
        Self::Plain,
        Self::Tiles,
        Self::Planks,
        Self::Carpet,
        Self::Concrete,
        Self::Terrazzo,
        Self::Checks,
        Self::Cobbles,
        Self::Marble,
    ];
}

/// What walls are painted with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Wall {
    /// Panels of two colours.
    #[default]
    Panels,
    /// One colour over a skirting board.
    Skirting,
    /// Upright stripes.
    Stripes,
    /// Bricks with joints.
    Bricks,
    /// Plaster with stains.
    Stains,
    /// Posters of any height, some a pitch wide and some two.
    Posters,
    /// Large stones, each of its own tone.
    Blocks,
}

impl Wall {
    /// Every kind.
    pub const ALL: [Self; 7] = [
        Self::Panels,
        Self::Skirting,
        Self::Stripes,
        Self::Bricks,
        Self::Stains,
        Self::Posters,
        Self::Blocks,
    ];
}

/// Textures, colours and light of a world, out of its [`Look`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Decor {
    variety: f32,
    seed: u32,
    floor: Floor,
    wall: Wall,
    ground: [Paint; 2],
    walls: [Paint; 2],
    pub(super) sky: Paint,
    pub(super) light: Vec3,
    pub(super) ambient: f32,
    /// Size of the pattern of the floor and of the walls, metres.
    pitch: [f32; 2],
    /// The pattern of the floor is turned by this: cosine and sine.
    turn: [f32; 2],
}

impl Default for Decor {
    fn default() -> Self {
        Self::new(&Look::default())
    }
}

impl Decor {
    /// The decor of a world; the plain one where `look.variety` is 0.
    pub fn new(look: &Look) -> Self {
        let (seed, variety) = (look.seed, look.variety.clamp(0.0, 1.0));
        let mut draws = Draws::new(seed, 1);
        let floor = Floor::ALL[draws.next() as usize % Floor::ALL.len()];
        let wall = Wall::ALL[draws.next() as usize % Wall::ALL.len()];
        let mut paint = |plain: Paint, strong: f32, dark: f32| {
            let hue = draws.between(0.0, 6.0);
            let drawn = painted(hue, draws.between(0.0, strong), draws.between(dark, 0.95));
            mixed(plain, drawn, variety)
        };
        let ground = [paint(FLOOR, 0.45, 0.2), paint(FLOOR, 0.45, 0.2)];
        let walls = [paint(PANELS[0], 0.4, 0.35), paint(PANELS[1], 0.4, 0.35)];
        let sky = paint(SKY, 0.2, 0.4);
        let around = variety * draws.between(-core::f32::consts::PI, core::f32::consts::PI);
        let steep = LIGHT.z + variety * draws.between(-0.25, 0.08);
        let flat = (1.0 - steep * steep).max(0.0).sqrt();
        // The plain light comes from 36.87° north of east.
        let (north, east) = libm::sincosf(around + 0.643_501);
        let light = if variety > 0.0 {
            Vec3::new(flat * east, flat * north, steep)
        } else {
            LIGHT
        };
        let ambient = AMBIENT + variety * draws.between(-0.1, 0.25);
        let pitch = [draws.between(0.12, 0.4), draws.between(0.1, 0.5)];
        let (sine, cosine) = libm::sincosf(draws.between(0.0, 1.6));
        Self {
            variety,
            seed: scramble(seed),
            floor: if variety > 0.0 { floor } else { Floor::Plain },
            wall: if variety > 0.0 { wall } else { Wall::Panels },
            ground,
            walls,
            sky,
            light,
            ambient,
            pitch,
            turn: [cosine, sine],
        }
    }

    /// What the floor is made of.
    pub const fn floor(&self) -> Floor {
        self.floor
    }

    /// What the walls are painted with.
    pub const fn wall(&self) -> Wall {
        self.wall
    }

    /// How dark it is under things, 0 to 1.
    pub(super) fn contact(&self) -> f32 {
        0.6 * (1.5 * self.variety).min(1.0)
    }

    /// Share of white in a reflection of the light.
    pub(super) fn gloss(&self) -> f32 {
        0.5 * self.variety
    }

    /// The floor at a place, where a pixel covers `blot` metres of it: detail finer than that
    /// fades, as it does for a sensor that sums up light.
    pub(super) fn ground(&self, x: f32, y: f32, blot: f32) -> Paint {
        let [base, other] = self.ground;
        if self.floor == Floor::Plain {
            return base;
        }
        let (x, y) = (
            x * self.turn[0] + y * self.turn[1],
            y * self.turn[0] - x * self.turn[1],
        );
        let (pitch, seed) = (self.pitch[0], self.seed);
        let clear = |detail: f32| (detail / blot).min(1.0);
        let strength = |amount: f32| amount * (0.4 + 0.6 * self.variety);
        let share = match self.floor {
            Floor::Plain => 0.0,
            Floor::Tiles => {
                let ((column, u), (row, v)) = (split(x / pitch), split(y / pitch));
                let joint = 0.006 / pitch;
                let tile = share(of_cell(seed, column, row)) * strength(0.25);
                if u < joint || v < joint {
                    clear(0.012)
                } else {
                    tile
                }
            }
            Floor::Planks => {
                let (row, v) = split(y / (0.5 * pitch));
                let shifted = x + 3.0 * share(scramble(row as u32 ^ seed));
                let (column, u) = split(shifted / (4.0 * pitch));
                let tone = share(of_cell(seed, column, row)) * strength(0.5);
                let grain = smooth(seed ^ row as u32, shifted * 6.0, y * 150.0);
                let gap = v < 0.03 || u < 0.006;
                if gap {
                    clear(0.008)
                } else {
                    tone + grain * strength(0.35) * clear(0.008)
                }
            }
            Floor::Carpet => {
                let speck = of_cell(seed, split(x * 160.0).0, split(y * 160.0).0);
                let cloud = smooth(seed, x * 5.0, y * 5.0);
                (0.5 + (share(speck) - 0.5) * clear(0.007)) * strength(0.8) + cloud * 0.2
            }
            Floor::Concrete => {
                let large = smooth(seed, x * 2.5, y * 2.5);
                let middle = smooth(seed ^ 1, x * 11.0, y * 11.0) - 0.5;
                let small = smooth(seed ^ 2, x * 60.0, y * 60.0) - 0.5;
                (large + 0.5 * middle * clear(0.1) + 0.5 * small * clear(0.017)) * strength(0.6)
            }
            Floor::Terrazzo => {
                let ((column, u), (row, v)) = (split(x * 45.0), split(y * 45.0));
                let chip = of_cell(seed, column, row);
                let off = [share(chip) - u, share(scramble(chip)) - v];
                let inside = off[0] * off[0] + off[1] * off[1] < 0.12;
                if inside {
                    share(scramble(chip ^ 7)) * clear(0.02)
                } else {
                    0.1
                }
            }
            Floor::Checks => {
                let (column, row) = (split(x / pitch).0, split(y / pitch).0);
                let odd = ((column ^ row) & 1) as f32;
                (odd * 0.8 + 0.2 * share(of_cell(seed, column, row))) * clear(pitch)
            }
            Floor::Cobbles => {
                let (row, v) = split(y * 12.0);
                let (column, u) = split(x * 9.0 + 0.5 * (row & 1) as f32);
                let off = [2.0 * u - 1.0, 2.0 * v - 1.0].map(|way| way * way);
                if off[0] * off[0] + off[1] * off[1] < 0.7 {
                    share(of_cell(seed, column, row)) * strength(0.5)
                } else {
                    clear(0.03)
                }
            }
            Floor::Marble => {
                let bent = x + 0.5 * smooth(seed, x * 4.0, y * 4.0);
                let (_, into) = split(bent * 3.0 + smooth(seed ^ 1, x * 13.0, y * 13.0));
                let vein = (1.0 - 6.0 * (into - 0.5).abs()).max(0.0);
                (vein * clear(0.05) + 0.3 * smooth(seed ^ 2, x * 2.0, y * 2.0)) * strength(0.9)
            }
        };
        mixed(base, other, share.clamp(0.0, 1.0))
    }

    /// A wall, this far along it and this high.
    pub(super) fn wall_at(&self, along: f32, up: f32, blot: f32) -> Paint {
        let [one, two] = self.walls;
        let pitch = self.pitch[1];
        let clear = |detail: f32| (detail / blot).min(1.0);
        match self.wall {
            Wall::Panels => {
                let panel = split(along / PANEL_M).0;
                if panel & 1 == 0 { one } else { two }
            }
            Wall::Skirting => {
                let stain = smooth(self.seed, along * 3.0, up * 9.0) * 0.2;
                mixed(one, two, if up < 0.04 { 1.0 } else { stain })
            }
            Wall::Stripes => {
                let (_, into) = split(along / (0.6 * pitch));
                mixed(one, two, if into < 0.4 { clear(0.6 * pitch) } else { 0.0 })
            }
            Wall::Bricks => {
                let (row, v) = split(up / 0.06);
                let (column, u) = split(along / 0.2 + 0.5 * (row & 1) as f32);
                let tone = share(of_cell(self.seed, column, row)) * 0.3;
                let joint = v < 0.12 || u < 0.04;
                mixed(one, two, if joint { clear(0.015) } else { tone })
            }
            Wall::Stains => {
                let large = smooth(self.seed, along * 2.0, up * 3.0);
                let small = smooth(self.seed ^ 1, along * 14.0, up * 14.0) * clear(0.07);
                mixed(one, two, 0.7 * large + 0.3 * small)
            }
            Wall::Posters => {
                let (place, into) = split(along / pitch);
                let poster = of_cell(self.seed, place >> (self.seed & 1), 0);
                let [low, high, tone] = [1, 2, 3].map(|what| share(scramble(poster ^ what)));
                let from = 0.15 * low;
                let within = (0.1..0.9).contains(&into) && up > from && up < from + 0.2 * high;
                if within && poster & 3 != 0 {
                    painted(6.0 * share(poster), 0.6 * tone, 0.3 + 0.6 * high)
                } else {
                    one
                }
            }
            Wall::Blocks => {
                let (row, v) = split(up / 0.19);
                let (column, u) = split(along / pitch + 0.5 * (row & 1) as f32);
                let joint = v < 0.05 || u < 0.01 / pitch;
                let tone = share(of_cell(self.seed, column, row));
                mixed(one, two, if joint { 1.0 } else { 0.6 * tone })
            }
        }
    }
}

/// A colour of this hue (0 to 6), saturation and brightness.
pub(crate) fn painted(hue: f32, saturation: f32, brightness: f32) -> Paint {
    let (sector, into) = split(hue);
    let (low, falling, rising) = (
        1.0 - saturation,
        1.0 - saturation * into,
        1.0 - saturation * (1.0 - into),
    );
    let rgb = match sector {
        0 => [1.0, rising, low],
        1 => [falling, 1.0, low],
        2 => [low, 1.0, rising],
        3 => [low, falling, 1.0],
        4 => [rising, low, 1.0],
        _ => [1.0, low, falling],
    };
    rgb.map(|channel| channel * brightness * 255.0)
}

/// This share of the second in the first.
pub(crate) fn mixed(one: Paint, two: Paint, share: f32) -> Paint {
    [0, 1, 2].map(|channel: usize| one[channel] + (two[channel] - one[channel]) * share)
}
