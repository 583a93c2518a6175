//! Parameters in the form the control step wants them.

use crawler_drivers::l298n::Trim;
use crawler_hal::{Duration, Millivolts};

use crate::config::Geometry;
use crate::motion::{Twist, duty_for, wheel_speeds};
use crate::parameters::{Parameter, Parameters};

/// Everything adjustable about the control step, in SI units, computed once per change.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tuning {
    /// Shape of the drive at nominal voltage.
    nominal: Geometry,
    /// The same at the voltage there is.
    pub(super) geometry: Geometry,
    voltage: Option<Millivolts>,
    /// Metres per second of a wheel.
    pub(super) max_speed: f32,
    /// Radians per second.
    pub(super) max_turn: f32,
    /// Change of duty per period, 0 to 1.
    pub(super) ramp_step: f32,
    pub(super) safe_mm: u16,
    pub(super) critical_mm: u16,
    pub(super) avoidance: bool,
    /// Share of `max_speed`.
    pub(super) goto_speed: f32,
    /// Metres.
    pub(super) arrive_tolerance: f32,
    pub(super) link_grace: Duration,
    pub(super) resume_within: Duration,
    /// Whether to look through the camera whatever the robot does.
    pub(super) vision_always: bool,
    trims: [Trim; 2],
}

impl Default for Tuning {
    /// That of a robot whose parameters and shape are the usual ones.
    fn default() -> Self {
        Self::new(&Parameters::default(), &Geometry::default())
    }
}

impl Tuning {
    /// The tuning that `parameters` ask for, on a drive of shape `geometry`.
    pub fn new(parameters: &Parameters, geometry: &Geometry) -> Self {
        let number = |parameter| parameters.number(parameter);
        Self {
            nominal: *geometry,
            geometry: *geometry,
            voltage: None,
            max_speed: number(Parameter::MaxSpeed).min(geometry.top_speed_mps),
            max_turn: number(Parameter::MaxTurn),
            ramp_step: number(Parameter::RampStep) * 0.01,
            // The table keeps both within u16.
            safe_mm: number(Parameter::SafeDistance) as u16,
            critical_mm: number(Parameter::CriticalDistance) as u16,
            avoidance: parameters.switch(Parameter::Avoidance),
            goto_speed: number(Parameter::GotoSpeed) * 0.01,
            arrive_tolerance: number(Parameter::ArriveTolerance),
            link_grace: Duration::from_millis(number(Parameter::LinkGrace) as u64),
            resume_within: Duration::from_millis(number(Parameter::ResumeWithin) as u64),
            vision_always: parameters.switch(Parameter::VisionAlways),
            trims: [Parameter::TrimLeft, Parameter::TrimRight]
                .map(|trim| Trim::new(number(trim)).unwrap_or(Trim::NONE)),
        }
    }

    /// Reckons with this voltage from now on; with the nominal one while it is not known.
    pub(super) fn set_voltage(&mut self, voltage: Option<Millivolts>) {
        if voltage != self.voltage {
            self.voltage = voltage;
            self.geometry = voltage.map_or(self.nominal, |at| self.nominal.at(at));
        }
    }

    /// The same at this voltage; at the nominal one while it is not known.
    #[must_use]
    pub fn at(&self, voltage: Option<Millivolts>) -> Self {
        let mut tuning = *self;
        tuning.set_voltage(voltage);
        tuning
    }

    /// Duties at which the wheels settle at `twist`, within the permitted speed.
    pub fn duties(&self, twist: Twist) -> [f32; 2] {
        wheel_speeds(twist, &self.geometry, self.max_speed)
            .map(|speed| duty_for(speed, &self.geometry))
    }

    /// Trims of the left and right wheel, for the motor driver.
    pub const fn trims(&self) -> [Trim; 2] {
        self.trims
    }

    /// Shape of the drive.
    pub const fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    /// Largest change of duty within one period.
    pub const fn ramp_step(&self) -> f32 {
        self.ramp_step
    }
}
