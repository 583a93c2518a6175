//! What can be dropped into a running world.

use serde::Serialize;
use serde::de::{Error, Unexpected};

use crawler_protocol::fields::{given, must, only};
use crawler_protocol::{MAX_COORDINATE, words};

/// Least and greatest length of what is dropped, in metres. The greatest is that of an arena.
pub const EXTENT_RANGE: (f32, f32) = (0.01, 500.0);

/// Largest turn of a box either way, in radians.
const MAX_THETA: f32 = crate::Place::MAX_THETA;

/// What the numbers of a dropped thing are.
const EXPECTED: &str = "a place within 10 km, a turn within 7 rad, lengths of 0.01 to 500 m";

/// Something put into a running world. As a field of `drop` it is called what it is.
#[derive(Debug, Clone, Copy, PartialEq)]
// Whoever runs a world decides about both.
#[allow(clippy::exhaustive_enums)]
pub enum Dropped {
    /// `obstacle`.
    Obstacle(Obstacle),
    /// `object`.
    Object(Thing),
}

/// Something solid that does not move. Lengths in metres, angles in radians.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(tag = "shape", rename_all = "lowercase")]
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
    /// A box, turned by `theta` about its centre.
    Box {
        /// Centre.
        x: f32,
        /// Centre.
        y: f32,
        /// Full length along its own x axis.
        w: f32,
        /// Full length along its own y axis.
        h: f32,
        /// Anticlockwise turn; 0 where it is not said.
        theta: f32,
    },
}

/// A coloured thing that stands on the floor, as solid as an obstacle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Thing {
    /// What it looks like.
    pub shape: ThingShape,
    /// Centre, metres.
    pub x: f32,
    /// Centre, metres.
    pub y: f32,
    /// Width and height, metres.
    pub size: f32,
    /// Its colour.
    pub colour: Colour,
}

words! {
    /// The shape of a [`Thing`]. Each is as high as it is wide.
    ThingShape {
        /// Upright.
        Cylinder = "cylinder",
        /// A cube with its sides along the walls.
        Box = "box",
        /// On the floor.
        Ball = "ball",
        /// Upright, on its base.
        Cone = "cone",
    }
}

words! {
    /// The colour of a [`Thing`].
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

/// Every shape there is.
#[derive(Clone, Copy, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
enum Shape {
    Circle,
    Box,
    Cylinder,
    Ball,
    Cone,
}

/// Every field that an obstacle or an object can have: one reader for both costs a board half.
#[derive(serde::Deserialize)]
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

    pub(super) fn object<E: Error>(self) -> Result<Thing, E> {
        let shape = match self.shape {
            Shape::Cylinder => ThingShape::Cylinder,
            Shape::Box => ThingShape::Box,
            Shape::Ball => ThingShape::Ball,
            Shape::Cone => ThingShape::Cone,
            Shape::Circle => {
                let shape = Unexpected::Other("the shape of an obstacle");
                return Err(E::invalid_value(shape, &"cylinder, box, ball or cone"));
            }
        };
        self.only(&["size", "colour"])?;
        let size = must(self.size, "size")?;
        let colour = must(self.colour, "colour")?;
        self.check(&[size])?;
        Ok(Thing {
            shape,
            x: self.x,
            y: self.y,
            size,
            colour,
        })
    }
}
