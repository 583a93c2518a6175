//! Driving by a policy without the network: memory, observations in turn, and what was decided.

use crawler_hal::Instant;
use crawler_protocol::Pose;
use heapless::Vec;

use super::action::Action;
use super::angle::turns;
use super::memory::{Memory, Other, Place, distance};
use super::observation::{Observation, Seen, range};
use super::shield::{Around, shield};
use super::{DECIDED_WITHIN, STEPS};
use crate::motion::Twist;
use crate::perception::{Reading, Sight};

/// Farther than this nobody is reckoned with, in millimetres, so that no product overflows.
const FARTHEST_MM: i32 = 8_000;
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
    /// Goes with the decision.
    pub number: u16,
}

/// Another robot, in the coordinates of position references.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Near {
    /// Millimetres along both axes.
    pub at: [i32; 2],
    /// Millimetres per second along both axes.
    pub velocity: [i32; 2],
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
    /// Who is near; nobody while the robot is not sure of its own place.
    pub near: &'a [Near],
    /// The time.
    pub now: Instant,
}

/// Most others that are reckoned with.
const MOST: usize = 16;

/// Driving by a policy, as far as it takes no network.
#[derive(Debug, Clone)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Pilot {
    memory: Memory,
    place: Place,
    /// By how much it turned from one decision to the next, the last one first.
    turned: [i16; TURNS],
    ranges: [i8; 4],
    /// Control steps until the next observation.
    wait: u8,
    /// Observations of this behaviour so far.
    decisions: u16,
    /// Observations so far.
    number: u16,
    /// The one that was made in this step.
    observation: Observation,
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
                heading: 0,
            },
            turned: [0; TURNS],
            ranges: [0; 4],
            wait: 0,
            decisions: 0,
            number: 0,
            observation: Observation::NOTHING,
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

    /// What a decision is wanted for since this control step.
    pub fn asked(&self) -> Option<Asked> {
        self.asks.then_some(Asked {
            observation: self.observation,
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
        self.asks = self.wait == 0;
        if self.asks {
            self.wait = STEPS;
            self.observe(known);
        }
        self.wait -= 1;
        self.twist = match self.decided {
            Some((action, at)) if known.now - at <= DECIDED_WITHIN => {
                let seen = known.reading.fresh(known.now);
                let seen = seen.map_or(0, Sight::distance_mm);
                let around = Around {
                    ahead: self
                        .around
                        .ahead
                        .min(seen.saturating_sub(known.critical_mm)),
                    ..self.around
                };
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

    fn observe(&mut self, known: &Known<'_>) {
        let before = self.place;
        let place = place(&known.pose);
        self.place = place;
        let off = |axis: usize| {
            let way = place.at[axis].saturating_sub(before.at[axis]);
            way.clamp(-FARTHEST_MM, FARTHEST_MM)
        };
        let way = distance([off(0), off(1)]).min(LONGEST_MM);
        self.turned.rotate_right(1);
        self.turned[0] = place.heading.wrapping_sub(before.heading).cast_signed();
        self.memory.pass(&place, way as u16);
        let others = others(&place, known.near);
        let seen = known.reading.fresh(known.now);
        if let Some((sight, at)) = known.reading.sight
            && seen.is_some()
        {
            let age = (known.now - at).as_micros() as u32 / 1_000;
            let heading = self.headed(age as i32 + ECHO_AGE_MS);
            self.memory.see(&Place { heading, ..place }, sight, &others);
        }
        self.ranges.rotate_right(1);
        self.ranges[0] = range(seen.map_or(0, Sight::distance_mm));
        if self.decisions == 0 {
            self.ranges = [self.ranges[0]; 4];
        }
        let survey = self.memory.survey(&place, &others);
        self.around = survey.around;
        let turned = self.decided.map_or(0, |(action, _)| action.twist()[1]);
        self.observation = Seen {
            ranges: self.ranges,
            duties: known.duties,
            survey: &survey,
            place: &place,
            others: &others,
            decisions: self.decisions,
            less: self.less,
            turned,
        }
        .observation();
        self.decisions = self.decisions.saturating_add(1);
        self.number = self.number.wrapping_add(1);
    }

    /// Where the robot headed so many milliseconds ago.
    fn headed(&self, ms: i32) -> u16 {
        let mut heading = self.place.heading;
        let mut left = ms;
        for turned in self.turned {
            let part = left.clamp(0, DECISION_MS);
            let turned = i32::from(turned) * part / DECISION_MS;
            heading = heading.wrapping_sub(turned as u16);
            left -= part;
        }
        heading
    }
}

fn place(pose: &Pose) -> Place {
    Place {
        at: [pose.x, pose.y].map(thousandths),
        heading: turns(pose.theta),
    }
}

/// In thousandths; casts saturate, and no number is 0.
fn thousandths(value: f32) -> i32 {
    (value * 1_000.0) as i32
}

/// Who is near, nearest first.
fn others(place: &Place, near: &[Near]) -> Vec<Other, MOST> {
    let mut others: Vec<Other, MOST> = Vec::new();
    for neighbour in near {
        let at = [
            neighbour.at[0].saturating_sub(place.at[0]),
            neighbour.at[1].saturating_sub(place.at[1]),
        ];
        if at.iter().any(|along| along.saturating_abs() > FARTHEST_MM) {
            continue;
        }
        let other = Other {
            at,
            distance: ((at[0] * at[0] + at[1] * at[1]).cast_unsigned().isqrt()) as i32,
            velocity: neighbour.velocity.map(|along| along.clamp(-5_000, 5_000)),
        };
        let rank = others
            .iter()
            .filter(|known| known.distance <= other.distance)
            .count();
        let _ = others.insert(rank, other);
    }
    others
}
