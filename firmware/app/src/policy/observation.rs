//! What a network sees.
//!
//! | numbers | version 1 |
//! |---|---|
//! | 0–3 | how near the ranger sees something, at this decision and the three before it: 127 is at the ranger, 0 is 2 m or more |
//! | 4, 5 | duty of both wheels together, and the duty that turns, counter-clockwise |
//! | 6–17 | how near the nearest thing that is remembered is in each of twelve sectors, from ahead counter-clockwise: 127 is at the rim, 0 is 1.5 m or more |
//! | 18–29 | how well it is known what is in each sector: 127 was looked at just now, 0 is not known |
//! | 30, 31 | how near something is in the way, ahead and behind: 127 is at the rim, 0 is 0.5 m or more |
//! | 32–43 | the three nearest robots: how near (127 is here, 0 is 3 m or more), cosine and sine of their bearing, and how fast they come nearer, in 1/127 m/s; zeros where there is none |
//! | 44 | how many are nearer than 1.2 m, times 32 |
//! | 45 | time since the behaviour began: 127 from 60 s on |
//! | 46 | 127 where the shield has taken something from the last decision |
//! | 47 | where the last decision turned: 127 left, −127 right |

use super::memory::{Other, Place, Survey};
use super::sector::SECTORS;
use super::shield::Around;
use crate::motion::angle::turned;

/// Numbers of an observation.
pub const WIDTH: usize = ROWS * 16;
const ROWS: usize = 3;
/// Robots that are seen one by one.
const SEEN: usize = 3;

/// What a network sees.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Observation([[i8; 16]; ROWS]);

impl Observation {
    /// Nothing but zeros.
    pub const NOTHING: Self = Self([[0; 16]; ROWS]);

    /// These numbers.
    pub fn new(numbers: [i8; WIDTH]) -> Self {
        let mut it = Self::default();
        it.0.as_flattened_mut().copy_from_slice(&numbers);
        it
    }

    /// Its numbers.
    pub const fn numbers(&self) -> &[i8] {
        self.0.as_flattened()
    }
}

/// What an observation is made of.
pub(super) struct Seen<'a> {
    /// How near the ranger sees something: see [`range`].
    pub(super) ranges: [i8; 4],
    pub(super) duties: [f32; 2],
    pub(super) survey: &'a Survey,
    pub(super) place: &'a Place,
    pub(super) others: &'a [Other],
    /// Decisions since the behaviour began.
    pub(super) decisions: u16,
    pub(super) less: bool,
    /// Where the last decision turned.
    pub(super) turned: i32,
}

/// How near the ranger sees something.
pub(super) fn range(mm: u16) -> i8 {
    scaled(i32::from(mm), 2_000)
}

/// 127 at 0, 0 from `far` on.
fn scaled(value: i32, far: i32) -> i8 {
    (127 - value.clamp(0, far) * 127 / far) as i8
}

fn within(value: i32) -> i8 {
    value.clamp(-127, 127) as i8
}

/// The nearest ones, nearest first; of those at the same distance the first.
fn nearest(others: &[Other]) -> [Option<&Other>; SEEN] {
    let mut found: [Option<&Other>; SEEN] = [None; SEEN];
    for other in others {
        let mut next = Some(other);
        for place in &mut found {
            let is_nearer =
                |other: &Other| place.is_none_or(|known| other.distance < known.distance);
            if next.is_some_and(is_nearer) {
                core::mem::swap(place, &mut next);
            }
        }
    }
    found
}

impl Seen<'_> {
    pub(super) fn observation(&self) -> Observation {
        let [left, right] = self.duties;
        let duty = |value: f32| within((value * 63.5) as i32);
        let Around { ahead, behind } = self.survey.around;
        let mut out = Observation::default();
        let numbers = out.0.as_flattened_mut();
        let mut put = numbers.iter_mut();
        let mut add = |values: &[i8]| {
            for value in values {
                if let Some(number) = put.next() {
                    *number = *value;
                }
            }
        };
        add(&self.ranges);
        add(&[duty(left + right), duty(right - left)]);
        add(&self.survey.things);
        add(&self.survey.looks);
        add(&[ahead, behind].map(|free| scaled(i32::from(free), 500)));
        let towards = self.place.heading.direction();
        for other in nearest(self.others) {
            add(&other.map_or([0; 4], |other| {
                let [x, y] = other.at.map(i32::from);
                let there = turned([x, y], towards);
                let distance = i32::from(other.distance);
                let far = distance.max(1);
                let [vx, vy] = other.velocity.map(i32::from);
                let nearer = -(vx * x + vy * y) / far;
                [
                    scaled(distance, 3_000),
                    within(there[0] * 127 / far),
                    within(there[1] * 127 / far),
                    within(nearer * 127 / 1_000),
                ]
            }));
        }
        let near = self.others.iter().filter(|other| other.distance < 1_200);
        let time = i32::from(self.decisions.min(600)) * 127 / 600;
        add(&[
            within(near.count() as i32 * 32),
            time as i8,
            if self.less { 127 } else { 0 },
            within(self.turned),
        ]);
        out
    }
}

const _: () = assert!(4 + 2 + 2 * SECTORS + 2 + 4 * SEEN + 4 == WIDTH);
