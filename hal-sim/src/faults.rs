//! What can be broken about a robot, by one call for every device.
//!
//! The faults themselves are those of the protocol, so that the same words break a robot in a
//! scenario file, over the network and at a board. A fault belongs to a part of the robot; a new
//! fault of a part takes the place of the one before.

use crate::world::{Ports, Space};

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

/// Breaks something of a body.
pub(crate) fn inject(ports: &Ports, fault: Fault) -> Result<(), FaultError> {
    fault.validate()?;
    mend(ports, Part::of(&fault));
    let mut faults = ports.faults.get();
    let space = &mut *ports.shared.space.borrow_mut();
    let i = ports.index();
    match fault {
        Fault::RangerDead => faults.ranger = Some(RangerFault::Dead),
        Fault::RangerStuck { mm } => faults.ranger = Some(RangerFault::Stuck(mm)),
        Fault::RangerNoisy { mm } => faults.ranger = Some(RangerFault::Noisy(mm)),
        Fault::LineNoise { flips } => faults.bit_flips = flips,
        Fault::LineStuck => faults.line_stuck = true,
        Fault::FlashNoise { seed } => ports.chip.borrow_mut().fill_with_noise(u64::from(seed)),
        Fault::MotorWeak { wheel, strength } => weaken(ports, space, wheel, strength),
        Fault::MotorDead { wheel } => weaken(ports, space, wheel, 0.0),
        Fault::MotorStuckOn { wheel } => {
            space.bodies.build[i].shorted[usize::from(wheel == Wheel::Right)] = true;
        }
        Fault::BrownOut => space.bodies.build[i].dips = true,
        Fault::BatterySag { ohm } => {
            space.bodies.build[i].internal_ohm = ports.sound.internal_ohm + ohm;
        }
        Fault::BatteryAt { charge } => {
            space.bodies.charge_as[i] = f64::from(charge) / space.per_capacity;
        }
        Fault::CameraAbsent => faults.camera = Some(CameraFault::Absent),
        Fault::CameraStalled => faults.camera = Some(CameraFault::Stalled),
        Fault::CameraGarbage => faults.camera = Some(CameraFault::Garbage),
        Fault::FlashPowerCut { after_bytes } => {
            ports
                .chip
                .borrow_mut()
                .cut_power_after(u64::from(after_bytes));
        }
        Fault::LinkLoss { .. } | Fault::HostilePackets { .. } | Fault::ClockStep { .. } => {
            return Err(FaultError::NotOfBody);
        }
    }
    ports.faults.set(faults);
    Ok(())
}

fn weaken(ports: &Ports, space: &mut Space, wheel: Wheel, strength: f32) {
    let build = &mut space.bodies.build[ports.index()];
    match wheel {
        Wheel::Left => build.left = ports.sound.left * strength,
        Wheel::Right => build.right = ports.sound.right * strength,
    }
}

/// Mends one part of a body. What a fault has destroyed stays destroyed: charge that is gone,
/// and what noise has overwritten.
pub(crate) fn mend(ports: &Ports, part: Part) {
    let mut faults = ports.faults.get();
    let space = &mut *ports.shared.space.borrow_mut();
    let build = &mut space.bodies.build[ports.index()];
    match part {
        Part::Ranger => faults.ranger = None,
        Part::LineNoise => faults.bit_flips = 0.0,
        Part::LineStuck => {
            faults.line_stuck = false;
            ports.sonar.borrow_mut().hanging = 0;
        }
        Part::Left => {
            build.left = ports.sound.left;
            build.shorted[0] = false;
        }
        Part::Right => {
            build.right = ports.sound.right;
            build.shorted[1] = false;
        }
        Part::Supply => build.dips = false,
        Part::Sag => build.internal_ohm = ports.sound.internal_ohm,
        Part::FlashPower => ports.chip.borrow_mut().keep_power(),
        Part::Camera => faults.camera = None,
        Part::Link | Part::Packets | Part::Clock | Part::Charge | Part::FlashNoise => {}
    }
    ports.faults.set(faults);
}

/// Mends everything but the charge that is gone.
pub(crate) fn heal(ports: &Ports) {
    ports.faults.set(Faults::NONE);
    ports.sonar.borrow_mut().hanging = 0;
    ports.shared.space.borrow_mut().bodies.build[ports.index()] = ports.sound;
    ports.chip.borrow_mut().keep_power();
}
