//! One simulated arena and the bodies in it: geometry, physics, and the numbers of both.
//!
//! A `Space` is a value: the same arena, parameters and calls give the same bytes of state. It
//! knows neither devices nor programs; what [`crate::devices::World`] adds to it are those.
//!
//! Reading order: `arena` and [`Parameters`] say what there is, `bodies` what changes, `body` what of one is known; `space`
//! holds both and the grids that find neighbours; `physics` moves it on, `hearing` asks it.

mod arena;
mod battery;
mod bodies;
mod body;
mod dropped;
mod error;
mod exchange;
mod fingerprint;
mod geometry;
mod grid;
mod hash;
mod hearing;
mod inhabit;
mod members;
mod movers;
mod neighbours;
mod parameters;
mod patches;
mod physics;
mod rng;
mod space;
mod stored;
#[cfg(test)]
mod tests;

use crawler_hal::Millivolts;

pub use arena::{
    ARENA_SIDE_M, Arena, ArenaError, Colour, MAX_MOVERS, MAX_OBSTACLES, MAX_PATCHES, Mover, Object,
    ObjectShape, Obstacle, Patch,
};
pub use battery::charge_at_rest;
pub use body::Body;
pub use dropped::{DropError, Dropped, DroppedItem, MAX_DROPPED};
pub use error::{PlacementError, WorldError};
pub use fingerprint::{Fingerprint, Fnv};
pub use geometry::Pose;
pub use members::Members;
pub use parameters::Camera;
pub use parameters::{
    Bound, Chassis, Gauge, Look, Pack, ParameterError, Parameters, Profile, RadioFigures, Ranger,
    Row, Spread, Surroundings, TABLE, Vary, Wiring, page as parameters_page,
};
pub use physics::PHYSICS_STEP;

pub(crate) use arena::Solid;
#[cfg(feature = "live")]
pub(crate) use bodies::Bodies;
pub(crate) use bodies::{Bridge, Build, Inputs, Presence};
#[cfg(feature = "live")]
pub(crate) use dropped::Items;
pub(crate) use dropped::validate_dropped;
pub(crate) use exchange::Published;
pub(crate) use fingerprint::StateFingerprint;
pub(crate) use geometry::{Beam, Cone, Vec2, wrap_any};
pub(crate) use hash::{body as hash_body, movers as hash_movers};
pub(crate) use physics::Power;
pub(crate) use rng::{Purpose, mix, normal, stream, uniform};
pub(crate) use space::{Space, Thing};
pub(crate) use stored::SpaceState;

/// Most robots of one world; the live feed counts them in 16 bits.
pub const MAX_ROBOTS: usize = 65_535;

/// A robot of a world. Given out in order from 0 and never used again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RobotIndex(u32);

impl RobotIndex {
    /// The robot added as number `index`, counting from 0.
    pub const fn new(index: u32) -> Self {
        Self(index)
    }

    /// The number, counting from 0.
    pub const fn get(self) -> u32 {
        self.0
    }
}

/// The truth about a robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// Where it is and where it looks.
    pub pose: Pose,
    /// Forward speed over the floor, metres per second.
    pub speed: f32,
    /// Rate of turn, radians per second, anticlockwise.
    pub turn: f32,
    /// By how much the rims of the left and the right wheel are faster than the floor under them,
    /// metres per second.
    pub slip: [f32; 2],
    /// How often it began to touch something.
    pub contacts: u32,
    /// Terminal voltage of the pack.
    pub battery: Millivolts,
    /// Share of the charge left, 0 to 1.
    pub charge: f32,
    /// Energy drawn from the pack since the start, joules.
    pub energy_j: f64,
    /// Duty of the left and right enable input, −255 to 255, negative while the direction pins
    /// say backward, 0 while they say brake.
    pub duty: [i16; 2],
    /// Level of the lamp pin.
    pub lamp: bool,
    /// Whether its supply is above the brown-out voltage.
    pub powered: bool,
    /// Whether it is still in the world.
    pub present: bool,
    /// How often the watchdog bit.
    pub starvations: u32,
    /// Rules of flash memory broken by the program.
    pub flash_violations: u32,
}
