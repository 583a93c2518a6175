//! What can be broken about a robot, by one call for every device.

use serde::{Deserialize, Serialize};

use crate::world::Ports;

/// Something broken. Given to [`crate::world::World::inject`]; several may hold at once.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "fault", rename_all = "kebab-case", deny_unknown_fields)]
#[non_exhaustive]
pub enum Fault {
    /// The ranger answers nothing.
    RangerDead,
    /// The ranger tells this distance whatever is in front of it.
    RangerStuck {
        /// The distance.
        mm: u16,
    },
    /// Bits flip on the ranger's serial line, in both directions.
    LineNoise {
        /// Share of bits that flip, 0 to 1.
        flips: f32,
    },
    /// The controller's end of the ranger's serial line hangs: it takes no more bytes than its
    /// FIFO holds, and gives none.
    LineStuck,
    /// A motor gives less speed than it should.
    MotorWeak {
        /// Which one.
        wheel: Wheel,
        /// What is left of it, 0 to 1.
        strength: f32,
    },
    /// The battery sags more: worn cells or a bad contact. With enough of it the robot browns
    /// out whenever it draws current.
    BatterySag {
        /// Ohms added to the pack's own.
        ohm: f32,
    },
    /// The battery is at this charge from now on; 0 is the end.
    BatteryAt {
        /// Share of the capacity, 0 to 1.
        charge: f32,
    },
    /// The power goes during a flash operation, and the controller resets.
    FlashPowerCut {
        /// Bytes written or erased until then.
        after_bytes: u32,
    },
    /// The flash is full of noise, as one that was never erased or has decayed.
    FlashNoise {
        /// Names the noise.
        seed: u32,
    },
    /// No camera answers: its cable is off.
    CameraAbsent,
    /// The camera is there and never delivers a picture, nor an error.
    CameraStalled,
    /// The camera delivers noise.
    CameraGarbage,
}

/// A wheel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Wheel {
    /// The left one.
    Left,
    /// The right one.
    Right,
}

/// A number of a fault is not finite or out of its range.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FaultError;

impl core::fmt::Display for FaultError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("a fault's share must be 0 to 1, its resistance 0 to 1000 ohms")
    }
}

impl core::error::Error for FaultError {}

impl Fault {
    /// Checks the numbers of a fault.
    ///
    /// # Errors
    /// [`FaultError`] when one is out of its range.
    pub fn validate(&self) -> Result<(), FaultError> {
        let sound = match *self {
            Self::RangerDead
            | Self::RangerStuck { .. }
            | Self::FlashPowerCut { .. }
            | Self::FlashNoise { .. }
            | Self::LineStuck
            | Self::CameraAbsent
            | Self::CameraStalled
            | Self::CameraGarbage => true,
            Self::LineNoise { flips: share }
            | Self::MotorWeak {
                strength: share, ..
            }
            | Self::BatteryAt { charge: share } => (0.0..=1.0).contains(&share),
            Self::BatterySag { ohm } => (0.0..=1_000.0).contains(&ohm),
        };
        if sound { Ok(()) } else { Err(FaultError) }
    }
}

/// How the ranger is broken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum RangerFault {
    Dead,
    Stuck(u16),
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

pub(crate) fn inject(ports: &Ports, fault: Fault) -> Result<(), FaultError> {
    fault.validate()?;
    let mut faults = ports.faults.get();
    let space = &mut *ports.shared.space.borrow_mut();
    let i = ports.index();
    match fault {
        Fault::RangerDead => faults.ranger = Some(RangerFault::Dead),
        Fault::RangerStuck { mm } => faults.ranger = Some(RangerFault::Stuck(mm)),
        Fault::LineNoise { flips } => faults.bit_flips = flips,
        Fault::LineStuck => faults.line_stuck = true,
        Fault::FlashNoise { seed } => ports.chip.borrow_mut().fill_with_noise(u64::from(seed)),
        Fault::MotorWeak { wheel, strength } => match wheel {
            Wheel::Left => space.bodies.build[i].left = ports.sound.left * strength,
            Wheel::Right => space.bodies.build[i].right = ports.sound.right * strength,
        },
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
    }
    ports.faults.set(faults);
    Ok(())
}

/// Mends everything but the charge that is gone.
pub(crate) fn heal(ports: &Ports) {
    ports.faults.set(Faults::NONE);
    ports.sonar.borrow_mut().hanging = 0;
    ports.shared.space.borrow_mut().bodies.build[ports.index()] = ports.sound;
    ports.chip.borrow_mut().keep_power();
}
