//! Who steers a robot, and by what.

use crawler_app::controller::{Controller, Inputs, Outputs, Tuning};
use crawler_app::motion::{Odometry, Ramp, Twist};
use crawler_app::order::{Halt, Order, UpdateWish};
use crawler_app::perception::{Battery, LinkHealth, Reading};
use crawler_app::policy::Policies;
use crawler_hal::{Duration, Instant};
use crawler_protocol::{Pose, ResponseStatus};
use heapless::Deque;
use rand_pcg::Pcg32;
use serde::{Deserialize, Serialize};

/// Orders that may wait, as many as under the firmware.
const ORDERS: usize = 4;

/// Who steers a robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Steering {
    /// The controller of the firmware, which takes orders.
    Shipped,
    /// The function handed to [`super::BareWorld::step_with`].
    Caller,
}

/// What a robot knows when it decides.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Senses {
    /// Time since it was switched on.
    pub now: Instant,
    /// The filtered range and what is thought of the sensor, as the firmware sees them.
    pub reading: Reading,
    /// Where odometry puts it, from where it was switched on.
    pub pose: Pose,
    /// Duty of the left and right wheel, −1 to 1.
    pub duties: [f32; 2],
    /// Voltage, charge, and what follows for driving.
    pub battery: Battery,
    /// How often it began to touch something. No robot of this build feels that: it is for
    /// rewards, and for bumpers to come.
    pub contacts: u32,
}

/// What a robot is to do.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Drive {
    /// Stand at once.
    #[default]
    Stop,
    /// Move like this, with wheel speeds and ramps as the firmware makes them.
    Twist(Twist),
    /// Bring the left and right wheel to these duties, −1 to 1, down the firmware's ramps.
    Duties([f32; 2]),
}

/// What steers, and all it remembers.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[allow(clippy::large_enum_variant)] // Worlds hold robots of one kind.
pub(super) enum SteeringState {
    Shipped {
        controller: Controller,
        orders: Deque<Order, ORDERS>,
        /// Of the last order.
        answer: Option<ResponseStatus>,
    },
    Caller {
        odometry: Odometry,
        ramps: [Ramp; 2],
        drive: StoredDrive,
    },
}

/// A [`Drive`] in a form that can be stored.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(super) enum StoredDrive {
    Stop,
    Twist(f32, f32),
    Duties([f32; 2]),
}

impl From<Drive> for StoredDrive {
    fn from(drive: Drive) -> Self {
        match drive {
            Drive::Stop => Self::Stop,
            Drive::Twist(Twist { v, w }) => Self::Twist(v, w),
            Drive::Duties(duties) => Self::Duties(duties),
        }
    }
}

/// What the rest of the robot knows at a control step.
#[derive(Debug, Clone, Copy)]
pub(super) struct Known {
    pub(super) reading: Reading,
    pub(super) battery: Battery,
}

impl SteeringState {
    pub(super) fn new(steering: Steering, tuning: Tuning) -> Self {
        match steering {
            Steering::Shipped => Self::Shipped {
                controller: Controller::new(tuning),
                orders: Deque::new(),
                answer: None,
            },
            Steering::Caller => Self::Caller {
                odometry: Odometry::default(),
                ramps: [Ramp::default(); 2],
                drive: StoredDrive::Stop,
            },
        }
    }

    pub(super) const fn steering(&self) -> Steering {
        match self {
            Self::Shipped { .. } => Steering::Shipped,
            Self::Caller { .. } => Steering::Caller,
        }
    }

    /// Takes other settings, after a state without them was read.
    pub(super) fn set_tuning(&mut self, tuning: Tuning) {
        if let Self::Shipped { controller, .. } = self {
            controller.set_tuning(tuning);
        }
    }

    pub(super) fn pose(&self) -> Pose {
        match self {
            Self::Shipped { controller, .. } => controller.pose(),
            Self::Caller { odometry, .. } => odometry.pose(),
        }
    }

    pub(super) fn duties(&self) -> [f32; 2] {
        match self {
            Self::Shipped { controller, .. } => controller.duties(),
            Self::Caller { ramps, .. } => ramps.map(|ramp| ramp.duty()),
        }
    }

    /// One step of the firmware's controller. `halt` is one that did not wait for the period.
    pub(super) fn steer_itself(
        &mut self,
        known: &Known,
        halt: Option<&Halt>,
        rng: &mut Pcg32,
        now: Instant,
    ) -> Option<[f32; 2]> {
        let Self::Shipped {
            controller,
            orders,
            answer,
        } = self
        else {
            return None;
        };
        let order = if halt.is_some() {
            None
        } else {
            orders.pop_front()
        };
        let inputs = Inputs {
            reading: known.reading,
            charge: known.battery.charge,
            voltage: known.battery.voltage,
            fix: None,
            view: None,
            near: &[],
            own: 0,
            guide: None,
            leeway: crawler_app::behaviour::Leeway::ALL,
            link: LinkHealth::Absent,
            loaded: true,
            motor_fault: false,
            halt,
            order: order.as_ref(),
            update: UpdateWish::None,
            policies: Policies::NONE,
            decision: None,
        };
        let Outputs {
            duties, answers, ..
        } = controller.step(&inputs, rng, now);
        for given in &answers {
            *answer = match given.status {
                ResponseStatus::Accepted => None,
                status => Some(status),
            };
        }
        Some(duties)
    }

    /// One step of a robot that the caller steers, `elapsed` after the one before it.
    pub(super) fn steer_by(
        &mut self,
        told: Option<Drive>,
        tuning: &Tuning,
        elapsed: Duration,
        now: Instant,
    ) {
        let Self::Caller { ramps, drive, .. } = self else {
            return;
        };
        if let Some(told) = told {
            *drive = told.into();
        }
        let targets = match *drive {
            StoredDrive::Stop => {
                for ramp in ramps {
                    ramp.cut(now);
                }
                return;
            }
            StoredDrive::Twist(v, w) => tuning.duties(Twist { v, w }),
            StoredDrive::Duties(duties) => duties,
        };
        let step =
            tuning.ramp_step() * (elapsed.as_secs_f32() / super::PERIOD.as_secs_f32()).min(1.0);
        for (ramp, target) in ramps.iter_mut().zip(targets) {
            ramp.towards(target, step, now);
        }
    }

    /// Lets the caller's robot reckon with the duties of the last step.
    pub(super) fn reckon(&mut self, tuning: &Tuning, elapsed: Duration) {
        if let Self::Caller {
            odometry, ramps, ..
        } = self
        {
            let duties = ramps.map(|ramp| ramp.duty());
            odometry.advance(duties, elapsed, tuning.geometry());
        }
    }
}
