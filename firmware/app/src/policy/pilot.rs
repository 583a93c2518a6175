//! Driving by a policy without the network: memory, observations in turn, and what was decided.
//!
//! A control step has no time for a whole observation, so each does a part of it:
//!
//! | step | |
//! |---:|---|
//! | 1 | who is near, and how far the robot has come since it did this last |
//! | 2 | what the ranger sees is taken into memory |
//! | 3 | what is remembered of things around the robot |
//! | 4 | what is known of the ways ahead and behind, for the shield as well |
//! | 5 | the observation, for which a decision is wanted |

use crawler_hal::Instant;
use crawler_protocol::Pose;
use heapless::Vec;

use super::action::Action;
use super::memory::{Memory, Other, Place, Survey, distance};
use super::observation::{Observation, Seen, range};
use super::shield::{Around, shield};
use super::{DECIDED_WITHIN, STEPS};
use crate::motion::Twist;
use crate::motion::angle::{Angle, length, millimetres};
use crate::neighbours::{MOST, Neighbour};
use crate::perception::{Reading, Sight};

/// Farther than this nobody is reckoned with, in millimetres, so that no product overflows.
const FARTHEST_MM: i32 = 8_000;
/// Nor faster, in millimetres per second.
const FASTEST_MMPS: i32 = 5_000;
/// What the median of three measurements and the sound make of an echo: it is older than it says, in milliseconds.
const ECHO_AGE_MS: i32 = 95;
/// Milliseconds from one decision to the next.
const DECISION_MS: i32 = 100;
/// Decisions back to which it is known where the robot headed.
const TURNS: usize = 4;
/// Most that a robot drives from one decision to the next, in millimetres: more is an estimate that jumped.
const LONGEST_MM: i32 = 100;

/// What was decided.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Decision {
    /// Number of the action.
    pub action: u8,
    /// Number of the observation that it was decided for.
    pub number: u16,
}

/// What a decision is wanted for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Asked {
    /// What is seen.
    pub observation: Observation,
    /// What is in the way then: what the shield goes by in the control step that has made the observation.
    pub around: Around,
    /// Goes with the decision.
    pub number: u16,
}

/// What a control step knows.
#[derive(Debug, Clone, Copy)]
pub struct Known<'a> {
    /// Where the robot should be.
    pub pose: Pose,
    /// Duty of the left and right wheel, −1 to 1.
    pub duties: [f32; 2],
    /// Newest word of the ranger.
    pub reading: &'a Reading,
    /// Nothing drives ahead where the ranger sees something nearer than this.
    pub critical_mm: u16,
    /// Who is near, in steps that [`Pilot::looks_around`]; nobody while the robot is not sure of its own place.
    pub near: &'a [Neighbour],
    /// The time.
    pub now: Instant,
}

/// What a control step does of an observation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
enum Part {
    Others,
    Sight,
    Things,
    Ways,
    Whole,
}

impl Part {
    /// All of them, in their order.
    const ALL: [Self; 5] = [
        Self::Others,
        Self::Sight,
        Self::Things,
        Self::Ways,
        Self::Whole,
    ];

    const fn next(self) -> Self {
        match self {
            Self::Others => Self::Sight,
            Self::Sight => Self::Things,
            Self::Things => Self::Ways,
            Self::Ways => Self::Whole,
            Self::Whole => Self::Others,
        }
    }
}

const _: () = assert!(Part::ALL.len() == STEPS as usize);

/// Driving by a policy, as far as it takes no network.
#[derive(Debug, Clone)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Pilot {
    memory: Memory,
    /// Where it was at the first part of the last observation.
    place: Place,
    /// By how much it turned from one decision to the next, the last one first.
    turned: [i16; TURNS],
    others: Vec<Other, MOST>,
    survey: Survey,
    ranges: [i8; 4],
    /// Of the next control step.
    part: Part,
    /// Observations of this behaviour so far.
    decisions: u16,
    /// Observations so far.
    number: u16,
    /// The one that was made in this step.
    observation: Observation,
    /// What the shield goes by in this step.
    free: Around,
    asks: bool,
    decided: Option<(Action, Instant)>,
    around: Around,
    /// Whether the shield has taken something since the last observation.
    less: bool,
    twist: [i32; 2],
}

impl Default for Pilot {
    fn default() -> Self {
        Self::new()
    }
}

impl Pilot {
    /// Nothing was seen, and nothing is to be done.
    pub const fn new() -> Self {
        Self {
            memory: Memory::new(),
            place: Place {
                at: [0; 2],
                heading: Angle::from_units(0),
            },
            turned: [0; TURNS],
            others: Vec::new(),
            survey: Survey::EMPTY,
            ranges: [0; 4],
            part: Part::Others,
            decisions: 0,
            number: 0,
            observation: Observation::NOTHING,
            free: Around::CLEAR,
            asks: false,
            decided: None,
            around: Around::CLEAR,
            less: false,
            twist: [0; 2],
        }
    }

    /// Begins anew, at the next control step.
    pub fn begin(&mut self, pose: &Pose) {
        let number = self.number;
        *self = Self::new();
        self.number = number;
        self.place = place(pose);
    }

    /// Another behaviour, or none, has this control step.
    pub(crate) const fn rest(&mut self) {
        self.asks = false;
    }

    /// Whether the next control step takes in who is near.
    pub const fn looks_around(&self) -> bool {
        matches!(self.part, Part::Others)
    }

    /// Whether the next control step has time for a position reference.
    pub(crate) const fn has_time(&self) -> bool {
        matches!(self.part, Part::Ways | Part::Whole)
    }

    /// What a decision is wanted for since this control step.
    pub fn asked(&self) -> Option<Asked> {
        self.asks.then_some(Asked {
            observation: self.observation,
            around: self.free,
            number: self.number,
        })
    }

    /// Takes a control step.
    pub fn step(&mut self, known: &Known<'_>, decision: Option<Decision>) {
        // One that was under way when the behaviour began anew is of another time.
        if let Some(Decision { action, number }) = decision
            && self.number.wrapping_sub(number) < 2
            && self.decisions > 0
            && let Some(action) = Action::of(action)
        {
            self.decided = Some((action, known.now));
            self.less = false;
        }
        let place = place(&known.pose);
        match self.part {
            Part::Others => self.go_on(place, known.near),
            Part::Sight => self.see(&place, known),
            Part::Things => self.survey = self.memory.things(&place),
            Part::Ways => {
                self.memory.complete(&mut self.survey, &place, &self.others);
                self.around = self.survey.around;
            }
            Part::Whole => self.observe(&place, known),
        }
        self.asks = self.part == Part::Whole;
        self.part = self.part.next();
        self.twist = match self.decided {
            Some((action, at)) if known.now - at <= DECIDED_WITHIN => {
                let seen = known.reading.fresh(known.now);
                let around = self.free(seen.map_or(0, Sight::distance_mm), known);
                let (twist, less) = shield(action, around);
                self.less |= less;
                twist
            }
            Some(_) | None => [0; 2],
        };
    }

    /// What is wanted of the wheels.
    pub fn twist(&self) -> Twist {
        let [v, w] = self.twist.map(|thousandths| thousandths as f32 * 0.001);
        Twist { v, w }
    }

    fn go_on(&mut self, place: Place, near: &[Neighbour]) {
        let before = self.place;
        self.place = place;
        let off = |axis: usize| {
            let way = place.at[axis].saturating_sub(before.at[axis]);
            way.clamp(-FARTHEST_MM, FARTHEST_MM)
        };
        let way = distance([off(0), off(1)]).min(LONGEST_MM);
        self.turned.rotate_right(1);
        self.turned[0] = place.heading.minus(before.heading).units();
        self.memory.pass(&place, way as u16);
        self.others.clear();
        self.others.extend(
            near.iter()
                .filter_map(|other| relative(&place, other))
                .take(MOST),
        );
    }

    fn see(&mut self, place: &Place, known: &Known<'_>) {
        if let Some((sight, at)) = known.reading.sight
            && known.reading.fresh(known.now).is_some()
        {
            let age = (known.now - at).as_micros() as u32 / 1_000;
            let heading = self.headed(place.heading, age as i32 + ECHO_AGE_MS);
            let then = Place { heading, ..*place };
            self.memory.see(&then, sight, &self.others);
        }
    }

    fn observe(&mut self, place: &Place, known: &Known<'_>) {
        let seen = known.reading.fresh(known.now);
        let seen = seen.map_or(0, Sight::distance_mm);
        self.free = self.free(seen, known);
        self.ranges.rotate_right(1);
        self.ranges[0] = range(seen);
        if self.decisions == 0 {
            self.ranges = [self.ranges[0]; 4];
        }
        let turned = self.decided.map_or(0, |(action, _)| action.twist()[1]);
        self.observation = Seen {
            ranges: self.ranges,
            duties: known.duties,
            survey: &self.survey,
            place,
            others: &self.others,
            decisions: self.decisions,
            less: self.less,
            turned,
        }
        .observation();
        self.decisions = self.decisions.saturating_add(1);
        self.number = self.number.wrapping_add(1);
    }

    /// What is in the way when the ranger sees so far.
    fn free(&self, seen_mm: u16, known: &Known<'_>) -> Around {
        let ahead = seen_mm.saturating_sub(known.critical_mm);
        Around {
            ahead: self.around.ahead.min(ahead),
            ..self.around
        }
    }

    /// Where the robot headed so many milliseconds ago.
    fn headed(&self, now: Angle, ms: i32) -> Angle {
        let mut heading = now;
        let mut left = ms;
        for turned in self.turned {
            let part = left.clamp(0, DECISION_MS);
            let turned = i32::from(turned) * part / DECISION_MS;
            heading = heading.minus(Angle::from_units(turned as i16));
            left -= part;
        }
        heading
    }
}

fn place(pose: &Pose) -> Place {
    Place {
        at: [pose.x, pose.y].map(millimetres),
        heading: Angle::from_radians(pose.theta),
    }
}

/// Where a neighbour is, unless that is too far away.
fn relative(place: &Place, neighbour: &Neighbour) -> Option<Other> {
    let off = |axis: usize| {
        let off = neighbour.at[axis].saturating_sub(place.at[axis]);
        (off.saturating_abs() <= FARTHEST_MM).then_some(off)
    };
    let at = [off(0)?, off(1)?];
    let bounded = |rate: i32| rate.clamp(-FASTEST_MMPS, FASTEST_MMPS) as i16;
    Some(Other {
        at: at.map(|off| off as i16),
        distance: length(at) as i16,
        velocity: neighbour.velocity().map(bounded),
    })
}
