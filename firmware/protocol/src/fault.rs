//! What can be broken about a robot, and how a robot is told.

mod command;
#[cfg(feature = "schema")]
mod schema;

use core::fmt;

use serde::de::{Deserialize, Deserializer, Error, Unexpected};
use serde::ser::{Serialize, SerializeMap, Serializer};

pub use command::{FaultCommand, MAX_LASTING_MS};

use crate::fields::{given, must, only};
use crate::words::words;

/// Most that a noisy ranger is off by, as one standard deviation in millimetres.
pub const MAX_NOISE_MM: u16 = 1_000;
/// Most that a battery can be made to sag by, in ohms.
pub const MAX_SAG_OHM: f32 = 1_000.0;
/// Farthest that a clock is stepped either way, in milliseconds: ten years.
pub const MAX_CLOCK_STEP_MS: i64 = 315_360_000_000;
/// Most hostile packets a second.
pub const MAX_PACKETS_PER_S: u16 = 200;

words! {
    /// A wheel.
    Wheel {
        /// The left one.
        Left = "left",
        /// The right one.
        Right = "right",
    }
}

words! {
    /// How a link is lost.
    LinkCut {
        /// No signal: nothing is sent and nothing arrives.
        Radio = "radio",
        /// The access point refuses the password.
        Password = "password",
        /// The network gives no address.
        NoAddress = "no-address",
        /// The broker says nothing any more.
        Silent = "silent",
    }
}

words! {
    /// The name of a fault.
    FaultName {
        /// See [`FaultSpec::RangerDead`].
        RangerDead = "ranger-dead",
        /// See [`FaultSpec::RangerStuck`].
        RangerStuck = "ranger-stuck",
        /// See [`FaultSpec::RangerNoisy`].
        RangerNoisy = "ranger-noisy",
        /// See [`FaultSpec::LineNoise`].
        LineNoise = "line-noise",
        /// See [`FaultSpec::LineStuck`].
        LineStuck = "line-stuck",
        /// See [`FaultSpec::MotorWeak`].
        MotorWeak = "motor-weak",
        /// See [`FaultSpec::MotorDead`].
        MotorDead = "motor-dead",
        /// See [`FaultSpec::MotorStuckOn`].
        MotorStuckOn = "motor-stuck-on",
        /// See [`FaultSpec::LinkLoss`].
        LinkLoss = "link-loss",
        /// See [`FaultSpec::HostilePackets`].
        HostilePackets = "hostile-packets",
        /// See [`FaultSpec::ClockStep`].
        ClockStep = "clock-step",
        /// See [`FaultSpec::BrownOut`].
        BrownOut = "brown-out",
        /// See [`FaultSpec::BatterySag`].
        BatterySag = "battery-sag",
        /// See [`FaultSpec::BatteryAt`].
        BatteryAt = "battery-at",
        /// See [`FaultSpec::FlashPowerCut`].
        FlashPowerCut = "flash-power-cut",
        /// See [`FaultSpec::FlashNoise`].
        FlashNoise = "flash-noise",
        /// See [`FaultSpec::CameraAbsent`].
        CameraAbsent = "camera-absent",
        /// See [`FaultSpec::CameraStalled`].
        CameraStalled = "camera-stalled",
        /// See [`FaultSpec::CameraGarbage`].
        CameraGarbage = "camera-garbage",
    }
}

/// Something broken. Several may hold at once.
///
/// On the wire, and in scenario files, the fields stand beside `fault`:
/// `{"fault":"motor-weak","wheel":"left","strength":0.5}`.
#[derive(Debug, Clone, Copy, PartialEq)]
// Whoever carries faults out decides about every one of them.
#[allow(clippy::exhaustive_enums)]
pub enum FaultSpec {
    /// The ranger answers nothing.
    RangerDead,
    /// The ranger tells this distance whatever is in front of it.
    RangerStuck {
        /// The distance in millimetres.
        mm: u16,
    },
    /// The ranger's distances are off, each by something else.
    RangerNoisy {
        /// One standard deviation in millimetres, up to [`MAX_NOISE_MM`].
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
    /// A motor gives nothing.
    MotorDead {
        /// Which one.
        wheel: Wheel,
    },
    /// The bridge of a motor is shorted: it drives forward with all that the battery has,
    /// whatever the program asks for.
    MotorStuckOn {
        /// Which one.
        wheel: Wheel,
    },
    /// The link is lost.
    LinkLoss {
        /// How; [`LinkCut::Radio`] where it is not said.
        how: LinkCut,
    },
    /// Somebody sends packets to the robot that nobody should: garbage, too large, replayed,
    /// of wrong types, stale.
    HostilePackets {
        /// Packets a second, 1 to [`MAX_PACKETS_PER_S`].
        per_s: u16,
    },
    /// The clock of the robot jumps. It is set right again by what the server tells, when that
    /// has said the same for a while.
    ClockStep {
        /// Milliseconds, within ±[`MAX_CLOCK_STEP_MS`].
        ms: i64,
    },
    /// The supply of the controller dips below what it needs; it resets when the supply is back.
    BrownOut,
    /// The battery sags more: worn cells or a bad contact. With enough of it the robot browns
    /// out whenever it draws current.
    BatterySag {
        /// Ohms added to the pack's own, up to [`MAX_SAG_OHM`].
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

/// What the numbers of a fault are.
const EXPECTED: &str = "a share of 0 to 1, 0 to 1000 ohms, noise of at most 1000 mm, a step of the \
                        clock of at most ten years, 1 to 200 packets a second";

/// A number of a fault is not finite, or out of its range.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FaultRange;

impl fmt::Display for FaultRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "a number of a fault must be {EXPECTED}")
    }
}

impl core::error::Error for FaultRange {}

impl FaultSpec {
    /// Which fault this is.
    #[must_use]
    pub const fn name(&self) -> FaultName {
        match self {
            Self::RangerDead => FaultName::RangerDead,
            Self::RangerStuck { .. } => FaultName::RangerStuck,
            Self::RangerNoisy { .. } => FaultName::RangerNoisy,
            Self::LineNoise { .. } => FaultName::LineNoise,
            Self::LineStuck => FaultName::LineStuck,
            Self::MotorWeak { .. } => FaultName::MotorWeak,
            Self::MotorDead { .. } => FaultName::MotorDead,
            Self::MotorStuckOn { .. } => FaultName::MotorStuckOn,
            Self::LinkLoss { .. } => FaultName::LinkLoss,
            Self::HostilePackets { .. } => FaultName::HostilePackets,
            Self::ClockStep { .. } => FaultName::ClockStep,
            Self::BrownOut => FaultName::BrownOut,
            Self::BatterySag { .. } => FaultName::BatterySag,
            Self::BatteryAt { .. } => FaultName::BatteryAt,
            Self::FlashPowerCut { .. } => FaultName::FlashPowerCut,
            Self::FlashNoise { .. } => FaultName::FlashNoise,
            Self::CameraAbsent => FaultName::CameraAbsent,
            Self::CameraStalled => FaultName::CameraStalled,
            Self::CameraGarbage => FaultName::CameraGarbage,
        }
    }

    /// Checks the numbers of a fault. Whatever was read has passed.
    ///
    /// # Errors
    /// [`FaultRange`] when one is out of its range.
    pub fn validate(&self) -> Result<(), FaultRange> {
        let sound = match *self {
            Self::RangerDead
            | Self::RangerStuck { .. }
            | Self::LineStuck
            | Self::MotorDead { .. }
            | Self::MotorStuckOn { .. }
            | Self::LinkLoss { .. }
            | Self::BrownOut
            | Self::FlashPowerCut { .. }
            | Self::FlashNoise { .. }
            | Self::CameraAbsent
            | Self::CameraStalled
            | Self::CameraGarbage => true,
            Self::RangerNoisy { mm } => mm <= MAX_NOISE_MM,
            Self::LineNoise { flips: share }
            | Self::MotorWeak {
                strength: share, ..
            }
            | Self::BatteryAt { charge: share } => (0.0..=1.0).contains(&share),
            Self::BatterySag { ohm } => (0.0..=MAX_SAG_OHM).contains(&ohm),
            Self::HostilePackets { per_s } => (1..=MAX_PACKETS_PER_S).contains(&per_s),
            Self::ClockStep { ms } => (-MAX_CLOCK_STEP_MS..=MAX_CLOCK_STEP_MS).contains(&ms),
        };
        if sound { Ok(()) } else { Err(FaultRange) }
    }
}

impl FaultName {
    /// The fields of this fault beside `fault`.
    const fn fields(self) -> &'static [&'static str] {
        match self {
            Self::RangerDead
            | Self::LineStuck
            | Self::BrownOut
            | Self::CameraAbsent
            | Self::CameraStalled
            | Self::CameraGarbage => &[],
            Self::RangerStuck | Self::RangerNoisy => &["mm"],
            Self::LineNoise => &["flips"],
            Self::MotorWeak => &["wheel", "strength"],
            Self::MotorDead | Self::MotorStuckOn => &["wheel"],
            Self::LinkLoss => &["how"],
            Self::HostilePackets => &["per_s"],
            Self::ClockStep => &["ms"],
            Self::BatterySag => &["ohm"],
            Self::BatteryAt => &["charge"],
            Self::FlashPowerCut => &["after_bytes"],
            Self::FlashNoise => &["seed"],
        }
    }
}

/// Every field that a fault can have.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct Fields {
    fault: FaultName,
    #[serde(default, deserialize_with = "given")]
    mm: Option<u16>,
    #[serde(default, deserialize_with = "given")]
    flips: Option<f32>,
    #[serde(default, deserialize_with = "given")]
    wheel: Option<Wheel>,
    #[serde(default, deserialize_with = "given")]
    strength: Option<f32>,
    #[serde(default, deserialize_with = "given")]
    how: Option<LinkCut>,
    #[serde(default, deserialize_with = "given")]
    per_s: Option<u16>,
    #[serde(default, deserialize_with = "given")]
    ms: Option<i64>,
    #[serde(default, deserialize_with = "given")]
    ohm: Option<f32>,
    #[serde(default, deserialize_with = "given")]
    charge: Option<f32>,
    #[serde(default, deserialize_with = "given")]
    after_bytes: Option<u32>,
    #[serde(default, deserialize_with = "given")]
    seed: Option<u32>,
}

impl Fields {
    fn meaning<E: Error>(self) -> Result<FaultSpec, E> {
        let there = [
            ("mm", self.mm.is_some()),
            ("flips", self.flips.is_some()),
            ("wheel", self.wheel.is_some()),
            ("strength", self.strength.is_some()),
            ("how", self.how.is_some()),
            ("per_s", self.per_s.is_some()),
            ("ms", self.ms.is_some()),
            ("ohm", self.ohm.is_some()),
            ("charge", self.charge.is_some()),
            ("after_bytes", self.after_bytes.is_some()),
            ("seed", self.seed.is_some()),
        ];
        only(there, self.fault.fields())?;
        let fault = match self.fault {
            FaultName::RangerDead => FaultSpec::RangerDead,
            FaultName::RangerStuck => FaultSpec::RangerStuck {
                mm: must(self.mm, "mm")?,
            },
            FaultName::RangerNoisy => FaultSpec::RangerNoisy {
                mm: must(self.mm, "mm")?,
            },
            FaultName::LineNoise => FaultSpec::LineNoise {
                flips: must(self.flips, "flips")?,
            },
            FaultName::LineStuck => FaultSpec::LineStuck,
            FaultName::MotorWeak => FaultSpec::MotorWeak {
                wheel: must(self.wheel, "wheel")?,
                strength: must(self.strength, "strength")?,
            },
            FaultName::MotorDead => FaultSpec::MotorDead {
                wheel: must(self.wheel, "wheel")?,
            },
            FaultName::MotorStuckOn => FaultSpec::MotorStuckOn {
                wheel: must(self.wheel, "wheel")?,
            },
            FaultName::LinkLoss => FaultSpec::LinkLoss {
                how: self.how.unwrap_or(LinkCut::Radio),
            },
            FaultName::HostilePackets => FaultSpec::HostilePackets {
                per_s: must(self.per_s, "per_s")?,
            },
            FaultName::ClockStep => FaultSpec::ClockStep {
                ms: must(self.ms, "ms")?,
            },
            FaultName::BrownOut => FaultSpec::BrownOut,
            FaultName::BatterySag => FaultSpec::BatterySag {
                ohm: must(self.ohm, "ohm")?,
            },
            FaultName::BatteryAt => FaultSpec::BatteryAt {
                charge: must(self.charge, "charge")?,
            },
            FaultName::FlashPowerCut => FaultSpec::FlashPowerCut {
                after_bytes: must(self.after_bytes, "after_bytes")?,
            },
            FaultName::FlashNoise => FaultSpec::FlashNoise {
                seed: must(self.seed, "seed")?,
            },
            FaultName::CameraAbsent => FaultSpec::CameraAbsent,
            FaultName::CameraStalled => FaultSpec::CameraStalled,
            FaultName::CameraGarbage => FaultSpec::CameraGarbage,
        };
        if fault.validate().is_ok() {
            Ok(fault)
        } else {
            let number = Unexpected::Other("a number out of range");
            Err(E::invalid_value(number, &EXPECTED))
        }
    }
}

impl<'de> Deserialize<'de> for FaultSpec {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Fields::deserialize(deserializer)?.meaning()
    }
}

impl Serialize for FaultSpec {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("fault", self.name().name())?;
        match self {
            Self::RangerDead
            | Self::LineStuck
            | Self::BrownOut
            | Self::CameraAbsent
            | Self::CameraStalled
            | Self::CameraGarbage => {}
            Self::RangerStuck { mm } | Self::RangerNoisy { mm } => {
                map.serialize_entry("mm", mm)?;
            }
            Self::LineNoise { flips } => map.serialize_entry("flips", flips)?,
            Self::MotorWeak { wheel, strength } => {
                map.serialize_entry("wheel", wheel)?;
                map.serialize_entry("strength", strength)?;
            }
            Self::MotorDead { wheel } | Self::MotorStuckOn { wheel } => {
                map.serialize_entry("wheel", wheel)?;
            }
            Self::LinkLoss { how } => map.serialize_entry("how", how)?,
            Self::HostilePackets { per_s } => map.serialize_entry("per_s", per_s)?,
            Self::ClockStep { ms } => map.serialize_entry("ms", ms)?,
            Self::BatterySag { ohm } => map.serialize_entry("ohm", ohm)?,
            Self::BatteryAt { charge } => map.serialize_entry("charge", charge)?,
            Self::FlashPowerCut { after_bytes } => {
                map.serialize_entry("after_bytes", after_bytes)?;
            }
            Self::FlashNoise { seed } => map.serialize_entry("seed", seed)?,
        }
        map.end()
    }
}
