//! What can be broken about a robot.
//!
//! The faults themselves are those of the protocol, so that the same words break a robot in a
//! scenario file, over the network and at a board. A fault belongs to a part of the robot; a new
//! fault of a part takes the place of the one before.

pub use crawler_protocol::{FaultName, FaultRange, FaultSpec as Fault, LinkCut, Wheel};

/// Why a fault was not injected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum FaultError {
    /// A number of it is not finite or out of its range.
    Range(FaultRange),
    /// There is no such robot, or no more.
    NoRobot,
    /// It is none of the body: [`crate::run::Simulation::inject`] takes it, a world does not.
    NotOfBody,
    /// It is one of the network, and the simulation has none that could be broken this way.
    NoNetwork,
}

impl core::fmt::Display for FaultError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Range(error) => error.fmt(f),
            Self::NoRobot => f.write_str("there is no such robot"),
            Self::NotOfBody => f.write_str("a world without programs has no links and no clocks"),
            Self::NoNetwork => f.write_str("there is no network that could be broken this way"),
        }
    }
}

impl core::error::Error for FaultError {}

impl From<FaultRange> for FaultError {
    fn from(error: FaultRange) -> Self {
        Self::Range(error)
    }
}

/// What a fault is a fault of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Part {
    Ranger,
    LineNoise,
    LineStuck,
    Left,
    Right,
    Link,
    Packets,
    Clock,
    Supply,
    Sag,
    Charge,
    FlashPower,
    FlashNoise,
    Camera,
}

impl Part {
    pub(crate) const fn of(fault: &Fault) -> Self {
        match fault {
            Fault::RangerDead | Fault::RangerStuck { .. } | Fault::RangerNoisy { .. } => {
                Self::Ranger
            }
            Fault::LineNoise { .. } => Self::LineNoise,
            Fault::LineStuck => Self::LineStuck,
            Fault::MotorWeak { wheel, .. }
            | Fault::MotorDead { wheel }
            | Fault::MotorStuckOn { wheel } => match wheel {
                Wheel::Left => Self::Left,
                Wheel::Right => Self::Right,
            },
            Fault::LinkLoss { .. } => Self::Link,
            Fault::HostilePackets { .. } => Self::Packets,
            Fault::ClockStep { .. } => Self::Clock,
            Fault::BrownOut => Self::Supply,
            Fault::BatterySag { .. } => Self::Sag,
            Fault::BatteryAt { .. } => Self::Charge,
            Fault::FlashPowerCut { .. } => Self::FlashPower,
            Fault::FlashNoise { .. } => Self::FlashNoise,
            Fault::CameraAbsent | Fault::CameraStalled | Fault::CameraGarbage => Self::Camera,
        }
    }
}

/// How the ranger is broken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum RangerFault {
    Dead,
    Stuck(u16),
    /// One standard deviation in millimetres beyond that of a sound one.
    Noisy(u16),
}

/// How the camera is broken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum CameraFault {
    Absent,
    Stalled,
    Garbage,
}

/// The faults that devices ask for themselves; the others act on the body or the chip.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Faults {
    pub(crate) ranger: Option<RangerFault>,
    pub(crate) bit_flips: f32,
    pub(crate) line_stuck: bool,
    pub(crate) camera: Option<CameraFault>,
}

impl Faults {
    pub(crate) const NONE: Self = Self {
        ranger: None,
        bit_flips: 0.0,
        line_stuck: false,
        camera: None,
    };
}
