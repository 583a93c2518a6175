//! What stands in a world, and what can be dropped into a running one.
//!
//! One definition for scenarios, journals, commands, what the server says, and the simulator itself.

use serde::de::{Error, Unexpected};
use serde::{Deserialize, Serialize};

use crate::place::Place;
use crawler_protocol::fields::{given, must, only};
use crawler_protocol::{MAX_COORDINATE, words};

/// Least and greatest length of what is dropped, in metres. The greatest is that of an arena.
pub const EXTENT_RANGE: (f32, f32) = (0.01, 500.0);

/// Largest turn of a box either way, in radians.
const MAX_THETA: f32 = Place::MAX_THETA;

/// What the numbers of a dropped thing are.
const EXPECTED: &str = "a place within 10 km, a turn within 7 rad, lengths of 0.01 to 500 m";

/// Something put into a running world. As a field of `drop` it is called what it is.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
// Whoever runs a world decides about both.
#[allow(clippy::exhaustive_enums)]
pub enum Dropped {
    /// `obstacle`.
    Obstacle(Obstacle),
    /// `object`.
    Object(Object),
}

impl Dropped {
    /// The ground it covers.
    #[must_use]
    pub const fn body(&self) -> Obstacle {
        match self {
            Self::Obstacle(obstacle) => *obstacle,
            Self::Object(object) => object.body(),
        }
    }
}

/// Something solid that does not move; lengths in metres, angles in radians.
///
/// Read by itself, as scenarios and journals have it, its numbers may be any: whoever makes a world of them checks
/// them. A `drop` is refused whose numbers are out of range.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "shape", rename_all = "lowercase", deny_unknown_fields)]
#[allow(clippy::exhaustive_enums)]
pub enum Obstacle {
    /// A round post.
    Circle {
        /// Centre.
        x: f32,
        /// Centre.
        y: f32,
        /// Radius.
        r: f32,
    },
    /// A box.
    Box {
        /// Centre.
        x: f32,
        /// Centre.
        y: f32,
        /// Full length along its own x axis.
        w: f32,
        /// Full length along its own y axis.
        h: f32,
        /// Anticlockwise turn about its centre; 0 where it is not said.
        #[serde(default)]
        theta: f32,
    },
}

/// A coloured thing that stands on the floor, as solid as an obstacle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Object {
    /// What it looks like.
    pub shape: ObjectShape,
    /// Centre, metres.
    pub x: f32,
    /// Centre, metres.
    pub y: f32,
    /// Width and height, metres.
    pub size: f32,
    /// Its colour.
    pub colour: Colour,
}

impl Object {
    /// The ground it stands on. A ball or a cone is as solid as a cylinder of its width: worlds
    /// are flat.
    #[must_use]
    pub const fn body(&self) -> Obstacle {
        let (x, y, size) = (self.x, self.y, self.size);
        match self.shape {
            ObjectShape::Box => Obstacle::Box {
                x,
                y,
                w: size,
                h: size,
                theta: 0.0,
            },
            ObjectShape::Cylinder | ObjectShape::Ball | ObjectShape::Cone => Obstacle::Circle {
                x,
                y,
                r: size * 0.5,
            },
        }
    }
}

/// The shape of a thing. Each is as high as it is wide.
// In schemas it has the name of old.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(rename = "ThingShape"))]
#[serde(rename_all = "lowercase")]
#[allow(clippy::exhaustive_enums)]
pub enum ObjectShape {
    /// Upright.
    Cylinder,
    /// A cube with its sides along the walls.
    Box,
    /// On the floor.
    Ball,
    /// Upright, on its base.
    Cone,
}

impl ObjectShape {
    /// Every value, in order.
    pub const ALL: &'static [Self] = &[Self::Cylinder, Self::Box, Self::Ball, Self::Cone];

    /// The name on the wire.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Cylinder => "cylinder",
            Self::Box => "box",
            Self::Ball => "ball",
            Self::Cone => "cone",
        }
    }
}

words! {
    /// The colour of a thing.
    Colour {
        /// Red.
        Red = "red",
        /// Green.
        Green = "green",
        /// Blue.
        Blue = "blue",
        /// Yellow.
        Yellow = "yellow",
        /// Orange.
        Orange = "orange",
        /// Purple.
        Purple = "purple",
        /// White.
        White = "white",
        /// Black.
        Black = "black",
    }
}

impl Colour {
    /// Red, green and blue, 0 to 255, in full light.
    #[must_use]
    pub const fn rgb(self) -> [u8; 3] {
        match self {
            Self::Red => [200, 30, 30],
            Self::Green => [30, 150, 50],
            Self::Blue => [30, 70, 190],
            Self::Yellow => [230, 200, 30],
            Self::Orange => [235, 120, 25],
            Self::Purple => [120, 50, 150],
            Self::White => [240, 240, 240],
            Self::Black => [20, 20, 20],
        }
    }
}

/// Every shape there is.
#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Shape {
    Circle,
    Box,
    Cylinder,
    Ball,
    Cone,
}

/// Every field that an obstacle or an object of a `drop` can have.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Solid {
    shape: Shape,
    x: f32,
    y: f32,
    #[serde(default, deserialize_with = "given")]
    r: Option<f32>,
    #[serde(default, deserialize_with = "given")]
    w: Option<f32>,
    #[serde(default, deserialize_with = "given")]
    h: Option<f32>,
    #[serde(default, deserialize_with = "given")]
    theta: Option<f32>,
    #[serde(default, deserialize_with = "given")]
    size: Option<f32>,
    #[serde(default, deserialize_with = "given")]
    colour: Option<Colour>,
}

impl Solid {
    fn only<E: Error>(&self, allowed: &'static [&'static str]) -> Result<(), E> {
        let there = [
            ("r", self.r.is_some()),
            ("w", self.w.is_some()),
            ("h", self.h.is_some()),
            ("theta", self.theta.is_some()),
            ("size", self.size.is_some()),
            ("colour", self.colour.is_some()),
        ];
        only(there, allowed)
    }

    /// Checks the place, and that each length is one.
    fn check<E: Error>(&self, lengths: &[f32]) -> Result<(), E> {
        let (least, most) = EXTENT_RANGE;
        let sound = self.x.abs() <= MAX_COORDINATE
            && self.y.abs() <= MAX_COORDINATE
            && self.theta.unwrap_or(0.0).abs() <= MAX_THETA
            && lengths.iter().all(|length| (least..=most).contains(length));
        if sound {
            Ok(())
        } else {
            let number = Unexpected::Other("a number out of range");
            Err(E::invalid_value(number, &EXPECTED))
        }
    }

    pub(super) fn obstacle<E: Error>(self) -> Result<Obstacle, E> {
        let (x, y) = (self.x, self.y);
        match self.shape {
            Shape::Circle => {
                self.only(&["r"])?;
                let r = must(self.r, "r")?;
                self.check(&[r])?;
                Ok(Obstacle::Circle { x, y, r })
            }
            Shape::Box => {
                self.only(&["w", "h", "theta"])?;
                let (w, h) = (must(self.w, "w")?, must(self.h, "h")?);
                self.check(&[w, h])?;
                let theta = self.theta.unwrap_or(0.0);
                Ok(Obstacle::Box { x, y, w, h, theta })
            }
            Shape::Cylinder | Shape::Ball | Shape::Cone => {
                let shape = Unexpected::Other("the shape of an object");
                Err(E::invalid_value(shape, &"circle or box"))
            }
        }
    }

    pub(super) fn object<E: Error>(self) -> Result<Object, E> {
        let shape = match self.shape {
            Shape::Cylinder => ObjectShape::Cylinder,
            Shape::Box => ObjectShape::Box,
            Shape::Ball => ObjectShape::Ball,
            Shape::Cone => ObjectShape::Cone,
            Shape::Circle => {
                let shape = Unexpected::Other("the shape of an obstacle");
                return Err(E::invalid_value(shape, &"cylinder, box, ball or cone"));
            }
        };
        self.only(&["size", "colour"])?;
        let size = must(self.size, "size")?;
        let colour = must(self.colour, "colour")?;
        self.check(&[size])?;
        Ok(Object {
            shape,
            x: self.x,
            y: self.y,
            size,
            colour,
        })
    }
}
