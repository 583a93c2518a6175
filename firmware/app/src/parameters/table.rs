//! The table of parameters.

use crawler_protocol::MAX_BATCH;

/// Index of a parameter in [`TABLE`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Parameter {
    /// What people call the robot.
    Name,
    /// Highest speed of a wheel.
    MaxSpeed,
    /// Highest rate of turning in place.
    MaxTurn,
    /// Largest change of duty within one control period.
    RampStep,
    /// Below this distance the robot slows down.
    SafeDistance,
    /// Below this distance the robot does not go forward.
    CriticalDistance,
    /// Whether manual driving heeds the ranger. Behaviours always do.
    Avoidance,
    /// Speed of `goto`.
    GotoSpeed,
    /// How near `goto` has to come.
    ArriveTolerance,
    /// How long a behaviour goes on after the link is known to be lost.
    LinkGrace,
    /// Samples of telemetry per second.
    TelemetryRate,
    /// Factor on the duty of the left wheel.
    TrimLeft,
    /// Factor on the duty of the right wheel.
    TrimRight,
    /// Below this voltage the robot drives slowly.
    LowBattery,
    /// Below this voltage it stops.
    CriticalBattery,
    /// Time between two looks through the camera.
    VisionPeriod,
    /// Whether to look although nothing that the robot does needs it.
    VisionAlways,
    /// How telemetry is written: 0 is JSON, 1 is CBOR.
    TelemetryFormat,
    /// Samples of telemetry that travel in one message, if as many fit.
    TelemetryBatch,
    /// A behaviour that was interrupted for less than this goes on; 0 is never.
    ResumeWithin,
}

/// Number of parameters.
pub const PARAMETER_COUNT: usize = TABLE.len();

/// Type, range and default of a parameter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Domain {
    /// A finite number.
    Number {
        /// Smallest value.
        min: f32,
        /// Largest value.
        max: f32,
        /// Value until someone sets another.
        default: f32,
        /// Whether only whole numbers are meant.
        whole: bool,
    },
    /// On or off.
    Switch {
        /// Value until someone sets another.
        default: bool,
    },
    /// Printable ASCII without quotes and backslash; empty until someone sets it.
    Text {
        /// Most bytes.
        max_len: usize,
    },
}

impl Domain {
    /// Whether `number` is a legal value; never true of NaN, or where no number is wanted.
    pub fn admits(&self, number: f32) -> bool {
        match *self {
            Self::Number {
                min, max, whole, ..
            } => min <= number && number <= max && (!whole || libm::truncf(number) == number),
            Self::Switch { .. } | Self::Text { .. } => false,
        }
    }

    pub(super) fn default_number(&self) -> f32 {
        match *self {
            Self::Number { default, .. } => default,
            Self::Switch { default } => f32::from(u8::from(default)),
            Self::Text { .. } => 0.0,
        }
    }
}

/// Everything fixed about one parameter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Definition {
    /// Which one.
    pub parameter: Parameter,
    /// Name on the wire.
    pub name: &'static str,
    /// Unit, where the name does not say it.
    pub unit: Option<&'static str>,
    /// Type, range and default.
    pub domain: Domain,
    /// Whether it outlives a reboot.
    pub persistent: bool,
    /// Its key in flash. Never reused for anything else.
    pub key: u8,
}

impl Definition {
    /// Finds a parameter by its name on the wire.
    pub fn by_name(name: &str) -> Option<&'static Self> {
        TABLE.iter().find(|definition| definition.name == name)
    }
}

const fn number(
    parameter: Parameter,
    key: u8,
    name: &'static str,
    unit: Option<&'static str>,
    [min, default, max]: [f32; 3],
    whole: bool,
) -> Definition {
    Definition {
        parameter,
        name,
        unit,
        domain: Domain::Number {
            min,
            max,
            default,
            whole,
        },
        persistent: true,
        key,
    }
}

/// All parameters, in the order of [`Parameter`]. Ranges are written minimum, default, maximum.
#[rustfmt::skip]
pub const TABLE: [Definition; 20] = [
    Definition {
        parameter: Parameter::Name,
        name: "name",
        unit: None,
        domain: Domain::Text { max_len: super::MAX_TEXT },
        persistent: true,
        key: 1,
    },
    number(Parameter::MaxSpeed, 2, "max_speed", Some("m/s"), [0.05, 0.5, 2.0], false),
    number(Parameter::MaxTurn, 3, "max_turn", Some("rad/s"), [0.3, 3.0, 10.0], false),
    // At most 20 % in 20 ms: from standstill to full duty in no less than a tenth of a second,
    // which is what the gears of the nominal chassis bear.
    number(Parameter::RampStep, 4, "ramp_step", Some("%/20ms"), [1.0, 5.0, 20.0], false),
    number(Parameter::SafeDistance, 5, "safe_distance_mm", None, [100.0, 600.0, 3000.0], true),
    number(Parameter::CriticalDistance, 6, "critical_distance_mm", None, [50.0, 250.0, 1500.0], true),
    Definition {
        parameter: Parameter::Avoidance,
        name: "avoidance",
        unit: None,
        domain: Domain::Switch { default: true },
        // Switched off for a moment by hand; a robot must not wake up blind.
        persistent: false,
        key: 7,
    },
    number(Parameter::GotoSpeed, 8, "goto_speed", Some("%"), [5.0, 60.0, 100.0], true),
    number(Parameter::ArriveTolerance, 9, "arrive_tolerance", Some("m"), [0.03, 0.10, 1.0], false),
    number(Parameter::LinkGrace, 11, "link_grace_ms", None, [0.0, 0.0, 60_000.0], true),
    number(Parameter::TelemetryRate, 12, "telemetry_hz", None, [0.1, 5.0, 20.0], false),
    number(Parameter::TrimLeft, 13, "trim_left", None, [0.7, 1.0, 1.0], false),
    number(Parameter::TrimRight, 14, "trim_right", None, [0.7, 1.0, 1.0], false),
    // Two lithium-ion cells in series: 3.5 V a cell, sagging, is about a fifth of the charge;
    // at 3.3 V the L298N leaves small motors too little to start.
    number(Parameter::LowBattery, 15, "low_battery_mv", None, [6000.0, 7000.0, 8200.0], true),
    number(Parameter::CriticalBattery, 16, "critical_battery_mv", None, [5500.0, 6600.0, 8000.0], true),
    number(Parameter::VisionPeriod, 17, "vision_period_ms", None, [100.0, 500.0, 10_000.0], true),
    Definition {
        parameter: Parameter::VisionAlways,
        name: "vision_always",
        unit: None,
        domain: Domain::Switch { default: false },
        persistent: true,
        key: 18,
    },
    number(Parameter::TelemetryFormat, 19, "telemetry_format", None, [0.0, 0.0, 1.0], true),
    number(Parameter::TelemetryBatch, 20, "telemetry_batch", None, [1.0, 1.0, MAX_BATCH as f32], true),
    // A ranger that is silent or a network that is gone for longer has been noticed by somebody, who
    // may hold the robot in their hands when it is well again. Nor does a `stop` wait any longer for a
    // robot that is away.
    number(Parameter::ResumeWithin, 21, "resume_within_ms", None, [0.0, 60_000.0, 60_000.0], true),
];
