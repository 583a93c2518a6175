//! Whether a robot may be calibrated now, where it stands. Pure: nothing here asks anybody.

use std::fmt;

use crawler_protocol::{RobotId, RobotState};
use crawler_twin::body::Pose;
use crawler_twin::course::{LEAST_MPS, LEAST_RAD, Limits};
use crawler_twin::rehearsal::Sweep;
use crawler_twins::NoTwin;

use crate::ground::{BESIDE_M, Ground, are_apart};
use crate::robots::RobotView;

/// A place that is less sure than this is none to begin at, metres.
pub const MOST_SIGMA_M: f64 = 0.05;
/// Nor is a heading, radians.
pub const MOST_SIGMA_RAD: f64 = 0.15;
/// A robot that moves is not to be calibrated, metres per second.
const STANDING_MPS: f64 = 0.02;
/// Places are looked at so far apart, metres.
const GRID_M: f64 = 0.05;
/// Most robots that are calibrated at a time.
pub const MOST_AT_A_TIME: usize = 8;

/// Why a robot may not be calibrated.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Refusal {
    /// It is not there.
    Offline,
    /// Two robots have its name.
    Doubled,
    /// It has no wheels.
    CannotDrive,
    /// It stands until somebody sees to it.
    Halted,
    /// It does something else.
    NotIdle(String),
    /// Its own parameters do not let it drive fast enough.
    TooSlow(Limits),
    /// No twin follows it.
    NoTwin(NoTwin),
    /// Nobody knows well enough where it is.
    Unsure,
    /// Nothing says where it is to stay.
    NoArea,
    /// It may come too near to something.
    Leaves {
        /// To what, for people.
        what: String,
        /// Where, metres.
        at: [f64; 2],
    },
    /// Another robot is too near.
    NearRobot {
        /// Which.
        robot: RobotId,
        /// Where, metres.
        at: [f64; 2],
    },
    /// It is being calibrated.
    Busy,
    /// Another one is being calibrated too near.
    NearCalibration(RobotId),
    /// So many others are.
    TooMany,
}

impl Refusal {
    /// Its name, for programs.
    #[must_use]
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Offline => "offline",
            Self::Doubled => "doubled",
            Self::CannotDrive => "cannot_drive",
            Self::Halted => "halted",
            Self::NotIdle(_) => "not_idle",
            Self::TooSlow(_) => "too_slow",
            Self::NoTwin(_) => "no_twin",
            Self::Unsure => "unsure",
            Self::NoArea => "no_area",
            Self::Leaves { .. } => "leaves",
            Self::NearRobot { .. } => "near_robot",
            Self::Busy => "busy",
            Self::NearCalibration(_) => "near_calibration",
            Self::TooMany => "too_many",
        }
    }

    /// Whether it may be over when others are done.
    #[must_use]
    pub const fn is_for_now(&self) -> bool {
        matches!(self, Self::Busy | Self::NearCalibration(_) | Self::TooMany)
    }

    /// Where, of what is about a place.
    #[must_use]
    pub const fn at(&self) -> Option<[f64; 2]> {
        match self {
            Self::Leaves { at, .. } | Self::NearRobot { at, .. } => Some(*at),
            _ => None,
        }
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Offline => f.write_str("the robot is not online"),
            Self::Doubled => f.write_str("two robots have this name"),
            Self::CannotDrive => f.write_str("the robot does not drive"),
            Self::Halted => {
                f.write_str("the robot stands until somebody sees to it: reset it first")
            }
            Self::NotIdle(what) => write!(f, "the robot does something else: {what}"),
            Self::TooSlow(limits) => write!(
                f,
                "the robot may drive at {:.2} m/s and turn at {:.1} rad/s by its own parameters, and needs \
                 {LEAST_MPS} m/s and {LEAST_RAD} rad/s",
                limits.v, limits.w
            ),
            Self::NoTwin(why) => write!(f, "{why}"),
            Self::Unsure => write!(
                f,
                "where the robot is, is not known to {:.0} cm and {:.0}°, or it moves",
                MOST_SIGMA_M * 100.0,
                MOST_SIGMA_RAD.to_degrees()
            ),
            Self::NoArea => f.write_str(
                "nothing says where the robot is to stay: put up a fence to keep it in, or state a free area",
            ),
            Self::Leaves { what, at } => write!(
                f,
                "the robot may come too near to {what}, at {:.2}, {:.2}",
                at[0], at[1]
            ),
            Self::NearRobot { robot, at } => write!(
                f,
                "robot {robot} is too near, at {:.2}, {:.2}",
                at[0], at[1]
            ),
            Self::Busy => f.write_str("the robot is being calibrated"),
            Self::NearCalibration(robot) => {
                write!(f, "robot {robot} is being calibrated too near")
            }
            Self::TooMany => write!(f, "{MOST_AT_A_TIME} robots are being calibrated"),
        }
    }
}

/// How fast a robot may drive, by what it told of its parameters; else those of a robot as it comes.
#[must_use]
pub fn limits(robot: &RobotView) -> Limits {
    Limits {
        v: robot.max_speed.map_or(0.5, f64::from),
        w: robot.max_turn.map_or(3.0, f64::from),
    }
}

/// What is against the robot itself.
#[must_use]
pub fn of_robot(robot: &RobotView) -> Option<Refusal> {
    if !robot.is_online {
        return Some(Refusal::Offline);
    }
    if robot.is_doubled {
        return Some(Refusal::Doubled);
    }
    if !robot.drives {
        return Some(Refusal::CannotDrive);
    }
    if robot.state == Some(RobotState::Error) {
        return Some(Refusal::Halted);
    }
    if let Some(behaviour) = &robot.behaviour {
        return Some(Refusal::NotIdle(behaviour.clone()));
    }
    if robot.state != Some(RobotState::Idle) {
        let what = robot
            .state
            .map_or("what, it does not tell", RobotState::name);
        return Some(Refusal::NotIdle(what.to_owned()));
    }
    let limits = limits(robot);
    (!limits.suffice()).then_some(Refusal::TooSlow(limits))
}

/// What is against the place where the robot is.
#[must_use]
pub fn of_place(sigma_m: f64, sigma_rad: f64, speed: f64) -> Option<Refusal> {
    let is_sure =
        sigma_m <= MOST_SIGMA_M && sigma_rad <= MOST_SIGMA_RAD && speed.abs() <= STANDING_MPS;
    (!is_sure).then_some(Refusal::Unsure)
}

/// What is against the drive: everything that a body swept in rehearsal is held against the ground and others.
#[must_use]
pub fn of_drive(
    sweep: &Sweep,
    start: Pose,
    ground: &Ground,
    others: &[(RobotId, [f64; 2])],
) -> Option<Refusal> {
    if !ground.is_bounded() {
        return Some(Refusal::NoArea);
    }
    let mut places = places(sweep, start);
    let far = |at: &[f64; 2]| (at[0] - start.x).hypot(at[1] - start.y);
    places.sort_by(|one, other| far(one).total_cmp(&far(other)));
    for at in places {
        if let Some(what) = ground.against(at) {
            return Some(Refusal::Leaves { what, at });
        }
    }
    let near = others
        .iter()
        .find(|(_, at)| sweep.holds(start, *at, BESIDE_M));
    near.map(|(robot, at)| Refusal::NearRobot {
        robot: robot.clone(),
        at: *at,
    })
}

/// What is against it beside others that are being calibrated.
#[must_use]
pub fn beside<'a>(
    corners: &[[f64; 2]],
    others: impl Iterator<Item = (&'a RobotId, &'a [[f64; 2]])>,
) -> Option<Refusal> {
    let mut count = 0;
    for (robot, theirs) in others {
        count += 1;
        if !are_apart(corners, theirs, BESIDE_M) {
            return Some(Refusal::NearCalibration(robot.clone()));
        }
    }
    (count >= MOST_AT_A_TIME).then_some(Refusal::TooMany)
}

/// Places of what was swept, no farther apart than [`GRID_M`], and its corners.
fn places(sweep: &Sweep, start: Pose) -> Vec<[f64; 2]> {
    let corners = sweep.corners(start, 0.0);
    let bound = |axis: usize, pick: fn(f64, f64) -> f64, first: f64| {
        corners.iter().map(|at| at[axis]).fold(first, pick)
    };
    let low = [0, 1].map(|axis| bound(axis, f64::min, f64::INFINITY));
    let high = [0, 1].map(|axis| bound(axis, f64::max, f64::NEG_INFINITY));
    let steps = |axis: usize| ((high[axis] - low[axis]) / GRID_M).ceil().clamp(0.0, 400.0) as usize;
    let mut places = corners;
    for i in 0..=steps(0) {
        for j in 0..=steps(1) {
            let at = [low[0] + i as f64 * GRID_M, low[1] + j as f64 * GRID_M];
            if sweep.holds(start, at, 0.0) {
                places.push(at);
            }
        }
    }
    places
}
