//! The paint of things.

use super::decor::{Paint, mixed, painted};
use super::noise::{Draws, of_cell, scramble, share, smooth, split};
use super::shape::{Form, Hit, Shape, Vec3};
use crate::world::Vec2;

/// Half of what a face is turned away from the front and still painted as the front: cos 30°.
const FRONT: f32 = 0.866;
/// Share of white in the paint of a front.
const FRONT_WHITE: f32 = 0.6;

const WHITE: Paint = [255.0; 3];
const RUBBER: Paint = [22.0, 22.0, 24.0];
const HUB: Paint = [150.0, 150.0, 140.0];
const DECK: Paint = [205.0, 205.0, 198.0];

/// What is painted on a thing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum Pattern {
    /// Nothing.
    #[default]
    Plain,
    /// Grain of wood, upright.
    Grain,
    /// Rings or lying stripes.
    Rings,
    /// Cubes of two colours.
    Checks,
    /// Speckles.
    Speckle,
    /// Plain and shining: one sees the light in it.
    Glossy,
    /// Wheels, deck, and a front with the two eyes of a ranger.
    Robot,
}

/// Everything about the paint of a thing but its colour.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Coat {
    pub(crate) pattern: Pattern,
    /// The second colour of the pattern.
    pub(crate) other: [u8; 3],
    pub(crate) seed: u32,
    /// Size of the pattern, metres.
    pub(crate) pitch: f32,
    /// Unit vector, in the frame of the lens, of the x axis that the pattern is fixed to.
    pub(crate) axis: Vec2,
}

impl Default for Coat {
    fn default() -> Self {
        Self {
            pattern: Pattern::Plain,
            other: [0; 3],
            seed: 0,
            pitch: 0.1,
            axis: Vec2::new(1.0, 0.0),
        }
    }
}

/// The paint of an obstacle, in a world of this look: any colours and any pattern.
pub(crate) fn obstacle(plain: [u8; 3], seed: u32, variety: f32, key: u32) -> ([u8; 3], Coat) {
    const PATTERNS: [Pattern; 4] = [
        Pattern::Grain,
        Pattern::Rings,
        Pattern::Checks,
        Pattern::Speckle,
    ];
    if variety == 0.0 {
        return (plain, Coat::default());
    }
    let mut draws = Draws::new(seed, key);
    let (hue, saturation) = (draws.between(0.0, 6.0), draws.between(0.0, 0.95));
    let brightness = draws.between(0.25, 0.95);
    let first = painted(hue, saturation, brightness);
    let nearby = draws.between(-0.5, 0.5) + 6.0 + hue;
    let darker = brightness * draws.between(0.35, 0.8);
    let second = painted(
        if nearby >= 6.0 { nearby - 6.0 } else { nearby },
        saturation * draws.between(0.3, 1.0),
        darker,
    );
    let varied = |drawn| mixed(plain.map(f32::from), drawn, (1.5 * variety).min(1.0));
    let coat = Coat {
        pattern: PATTERNS[draws.next() as usize % PATTERNS.len()],
        other: varied(second).map(|channel| channel as u8),
        seed: draws.next(),
        pitch: draws.between(0.03, 0.09),
        ..Coat::default()
    };
    (varied(first).map(|channel| channel as u8), coat)
}

/// The paint of an obstacle of this colour: its pattern is of the same, darker.
pub(crate) fn painted_obstacle(
    colour: [u8; 3],
    seed: u32,
    variety: f32,
    key: u32,
) -> ([u8; 3], Coat) {
    let colour = from_another_tin(colour, seed, variety, key);
    let (_, coat) = obstacle(colour, seed, variety, key);
    let other = colour.map(|channel| (f32::from(channel) * 0.65) as u8);
    (colour, Coat { other, ..coat })
}

/// The same colour from another tin: a little lighter, darker or paler.
pub(crate) fn from_another_tin(colour: [u8; 3], seed: u32, variety: f32, key: u32) -> [u8; 3] {
    let mut draws = Draws::new(seed, key);
    let light = 1.0 + variety * draws.between(-0.3, 0.15);
    [0, 1, 2].map(|channel: usize| {
        let stain = variety * draws.between(-15.0, 15.0);
        (f32::from(colour[channel]) * light + stain).clamp(0.0, 255.0) as u8
    })
}

/// The body of a robot.
pub(crate) fn robot(plain: [u8; 3], seed: u32, variety: f32, key: u32) -> [u8; 3] {
    if variety == 0.0 {
        return plain;
    }
    let mut draws = Draws::new(seed, key);
    let hue = draws.between(0.0, 6.0);
    let drawn = painted(hue, draws.between(0.0, 0.5), draws.between(0.15, 0.6));
    mixed(plain.map(f32::from), drawn, variety).map(|channel| channel as u8)
}

/// The paint where a ray meets a shape, in full light; `place` is where, from the middle of its
/// base and in the frame of the lens, `light` is towards the light, `gloss` the share of it in a
/// reflection.
pub(super) fn painted_at(shape: &Shape, hit: &Hit, place: Vec3, light: Vec3, gloss: f32) -> Paint {
    let colour = shape.colour.map(f32::from);
    let coat = &shape.coat;
    let other = coat.other.map(f32::from);
    // A millimetre below the surface, where no plane of a pattern coincides with a face.
    let inward = |at: f32, normal: f32| at - 1e-3 * normal;
    let flat = Vec2::new(inward(place.x, hit.normal.x), inward(place.y, hit.normal.y))
        .into_frame(coat.axis);
    let up = inward(place.z, hit.normal.z);
    let pitch = coat.pitch;
    match coat.pattern {
        Pattern::Plain => match shape.front {
            Some(front) if faces(front, hit.normal) => mixed(colour, WHITE, FRONT_WHITE),
            Some(_) | None => colour,
        },
        Pattern::Grain => {
            let grain = smooth(coat.seed, (flat.x + flat.y * 1.3) * 60.0, up * 6.0);
            mixed(colour, other, grain)
        }
        Pattern::Rings => {
            let (_, into) = split(up / pitch);
            mixed(colour, other, if into < 0.4 { 1.0 } else { 0.0 })
        }
        Pattern::Checks => {
            let cell = |at: f32| split(at / pitch).0;
            let odd = (cell(flat.x) ^ cell(flat.y) ^ cell(up)) & 1;
            mixed(colour, other, odd as f32)
        }
        Pattern::Speckle => {
            let cell = |at: f32| split(at * 90.0).0;
            let speck = of_cell(
                coat.seed ^ scramble(cell(up) as u32),
                cell(flat.x),
                cell(flat.y),
            );
            let speck = share(speck);
            mixed(colour, other, speck * speck)
        }
        Pattern::Glossy => {
            let shine = (hit.normal.dot(light) - 0.93) * 14.0;
            mixed(colour, WHITE, gloss * shine.clamp(0.0, 1.0))
        }
        Pattern::Robot => robot_at(shape, hit, flat, up, colour),
    }
}

fn faces(front: Vec2, normal: Vec3) -> bool {
    front.x * normal.x + front.y * normal.y >= FRONT
}

/// `flat` is from the middle, x ahead; heights are shares of the body's.
fn robot_at(shape: &Shape, hit: &Hit, flat: Vec2, up: f32, colour: Paint) -> Paint {
    let (_, height) = shape.form.extents();
    let radius = match shape.form {
        Form::Cylinder { radius, .. } | Form::Ball { radius } | Form::Cone { radius, .. } => radius,
        Form::Box { half, .. } => half.x.max(half.y),
    };
    let level = up / height;
    let (ahead, aside) = (flat.x / radius, flat.y.abs() / radius);
    if hit.normal.z > 0.5 {
        // Seen from above: a light wedge points ahead.
        return if ahead > 0.3 && aside < 0.5 * ahead {
            mixed(colour, WHITE, FRONT_WHITE)
        } else {
            colour
        };
    }
    if level < 0.55 && ahead.abs() < 0.6 {
        // Wheels to both sides, from the ground to half the height.
        let (across, high) = (ahead / 0.6, (level - 0.275) / 0.275);
        let off = across * across + high * high;
        if off < 1.0 {
            return if off < 0.12 { HUB } else { RUBBER };
        }
    }
    if level < 0.1 {
        return RUBBER;
    }
    if (0.6..0.74).contains(&level) {
        return DECK;
    }
    if shape.front.is_some_and(|front| faces(front, hit.normal)) {
        let (across, high) = ((aside - 0.2) / 0.12, (level - 0.4) / 0.085);
        if across * across + high * high < 1.0 {
            return RUBBER;
        }
        return mixed(colour, WHITE, FRONT_WHITE);
    }
    colour
}
