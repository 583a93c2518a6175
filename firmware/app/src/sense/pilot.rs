//! Map and plan, as long as they are needed.

use crawler_drivers::us100::RangeError;
use crawler_hal::Millimeters;
use crawler_protocol::Pose;

use crate::behaviour::Course;
use crate::context::Snapshot;
use crate::hold::{Blank, Room};
use crate::motion::angle::{PoseMm, millimetres};
use crate::motion::sin_cos;
use crate::navigation::{Destination, Look, Navigator, Other, Place, Planned};

/// Looks without a place to go to after which all is forgotten: half a minute.
const FORGET_AFTER: u16 = 375;
/// Looks on the way after which everything known is a step less sure: two minutes.
const FADE_EVERY: u16 = 1_500;
/// So much less sure of its place than before, in metres, the robot has to be for the same.
const FADE_BY: f32 = 0.3;

impl Blank for Navigator {
    const BLANK: Self = Self::BLANK;
}

/// Keeps a [`Navigator`] true.
pub(super) struct Pilot<R> {
    navigator: R,
    /// Looks since the robot was last on its way, or since what is known faded.
    rested: u16,
    looked: u16,
    /// How sure the robot was of its place when what is known faded.
    sigma: f32,
}

impl<R: Room<Navigator>> Pilot<R> {
    pub(super) const fn new() -> Self {
        Self {
            navigator: R::EMPTY,
            rested: FORGET_AFTER,
            looked: 0,
            sigma: 0.0,
        }
    }

    /// The robot is not on its way.
    pub(super) fn rest(&mut self) {
        if self.rested < FORGET_AFTER {
            self.rested += 1;
            if self.rested == FORGET_AFTER {
                self.navigator.enter().forget();
                self.navigator.leave();
            }
        }
    }

    /// Map and plan, while they are kept.
    pub(super) fn navigator(&self) -> Option<&Navigator> {
        self.navigator.get().filter(|_| self.rested < FORGET_AFTER)
    }

    /// Takes in a look from `pose`.
    pub(super) fn look(
        &mut self,
        pose: &Pose,
        going: Destination,
        look: Option<Look>,
        others: &[Other],
    ) {
        let navigator = self.navigator.enter();
        self.rested = 0;
        self.looked += 1;
        self.sigma = self.sigma.min(pose.sigma);
        if self.looked >= FADE_EVERY || pose.sigma > self.sigma + FADE_BY {
            self.looked = 0;
            self.sigma = pose.sigma;
            navigator.fade();
        }
        navigator.set_out(place_of(pose), going);
        navigator.meet(others.iter().copied());
        if let Some(look) = look {
            navigator.look(look);
        }
    }

    /// Plans on by one slice.
    pub(super) fn plan(&mut self) -> Planned {
        self.navigator.enter().plan()
    }
}

/// What a measurement shows; nothing when it has failed.
pub(super) fn look_of(measured: Result<Millimeters, RangeError>) -> Option<Look> {
    match measured {
        Ok(range) => Some(Look::Echo(i32::from(range.0))),
        Err(RangeError::TooNear(_)) => Some(Look::Echo(0)),
        Err(RangeError::NoEcho(_)) => Some(Look::Nothing),
        Err(_) => None,
    }
}

/// How a robot on its way drives on: along its nose, unless its wheels turn back.
pub(super) fn course_of(at: &Snapshot, going: Destination) -> Course {
    let [left, right] = at.wheels;
    let wanted = if left + right < 0.0 {
        -going.speed
    } else {
        going.speed
    };
    let here = PoseMm::new(&at.pose);
    Course::new(&here, millimetres(at.pose.sigma), wanted).narrow()
}

fn place_of(pose: &Pose) -> Place {
    let [sin, cos] = sin_cos(pose.theta);
    Place {
        at: [pose.x, pose.y].map(|along| (along * 1_000.0) as i32),
        heading: [cos, sin].map(|part| (part * 4_096.0) as i32),
    }
}
