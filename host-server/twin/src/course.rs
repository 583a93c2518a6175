//! The drive that a robot is calibrated on where it stands: chosen leg by leg, so that it stays around where it began.
//!
//! A baseline to identify on (standing, straights and turns at several speeds both ways, arcs), then legs in no
//! order to validate on. Which way a leg goes is decided when it begins, by where the robot is: of what it may be,
//! that which stays nearest to the beginning.

use crate::body::Pose;
use crate::script::Leg;

/// Time between two legs of the baseline, in which the robot comes to rest.
const REST_S: f64 = 0.5;
/// The robot stands before it drives, and before what is held out.
const STAND_S: f64 = 1.5;
/// Slowest straight, metres per second.
const SLOWEST_MPS: f64 = 0.12;
/// Fastest, where the robot permits it.
const FASTEST_MPS: f64 = 0.5;
/// Slowest turn, radians per second.
const SLOWEST_RAD: f64 = 1.0;
/// Fastest, where the robot permits it.
const FASTEST_RAD: f64 = 3.0;
/// What a robot goes on by when a leg is over: until it hears of it, and its wheels follow.
const LATE_S: f64 = 0.2;
/// Legs that are held out.
const HELD_OUT: usize = 25;
/// A robot that may not drive so fast cannot be calibrated: it would tell its friction and little else.
pub const LEAST_MPS: f64 = 0.3;
/// Nor one that may not turn so fast.
pub const LEAST_RAD: f64 = 1.5;

/// How fast a robot may drive, by its own parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Of a wheel, metres per second.
    pub v: f64,
    /// Of the whole robot, radians per second.
    pub w: f64,
}

impl Limits {
    /// What a drive makes use of: faster robots are not driven faster.
    #[must_use]
    pub const fn used(self) -> Self {
        Self {
            v: self.v.clamp(LEAST_MPS, FASTEST_MPS),
            w: self.w.clamp(LEAST_RAD, FASTEST_RAD),
        }
    }

    /// Whether a robot can be calibrated within them.
    #[must_use]
    pub fn suffice(self) -> bool {
        self.v >= LEAST_MPS && self.w >= LEAST_RAD
    }
}

/// What a leg is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// To identify on.
    Baseline,
    /// To validate on.
    HeldOut,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Step {
    Stand(f64),
    /// This, or the same backward.
    Either(Leg),
    /// What undoes the leg before the last standing.
    Back,
    /// One of these. They take the same time.
    Any([Leg; 5]),
}

/// See the [module](self).
#[derive(Debug, Clone, PartialEq)]
pub struct Course {
    steps: Vec<Step>,
    next: usize,
    last: Leg,
    stands: bool,
    held_out: usize,
}

const STANDING: Leg = Leg {
    seconds: 0.0,
    v: 0.0,
    w: 0.0,
};

fn reverse(leg: Leg) -> Leg {
    Leg {
        v: -leg.v,
        w: -leg.w,
        ..leg
    }
}

impl Course {
    /// A drive within `limits`. What is held out is another one for each `seed`.
    #[must_use]
    pub fn new(limits: Limits, seed: u64) -> Self {
        let Limits { v: top, w: spin } = limits.used();
        let mut steps = vec![Step::Stand(STAND_S)];
        // Straights go to and fro over the beginning, so they begin beside it.
        let aside = Leg {
            seconds: 0.8,
            v: 0.5 * top,
            w: 0.0,
        };
        steps.extend([Step::Either(aside), Step::Stand(REST_S)]);
        let mut both = |leg: Leg| {
            let rest = Step::Stand(REST_S);
            steps.extend([Step::Either(leg), rest, Step::Back, rest]);
        };
        let between = |low: f64, high: f64, share: f64| low + (high - low) * share;
        for (seconds, share) in [(2.0, 0.0), (1.6, 0.27), (1.2, 0.53), (1.0, 0.8), (0.9, 1.0)] {
            let v = between(SLOWEST_MPS, top, share);
            both(Leg { seconds, v, w: 0.0 });
        }
        for (seconds, share) in [(1.6, 0.0), (1.4, 0.4), (1.2, 0.7), (1.2, 1.0)] {
            let w = between(SLOWEST_RAD, spin, share);
            both(Leg { seconds, v: 0.0, w });
        }
        for (v, w) in [(0.5, 0.3), (0.5, -0.3), (0.75, 0.4), (0.75, -0.4)] {
            both(Leg {
                seconds: 1.1,
                v: v * top,
                w: w * spin,
            });
        }
        let held_out = steps.len();
        steps.push(Step::Stand(STAND_S));
        let mut random = Random::new(seed);
        for _ in 0..HELD_OUT {
            let seconds = 0.8 + 0.6 * random.share();
            // To and fro would hide what is wrong with a body: these mostly lead on, by curves either way.
            let leg = |random: &mut Random, ahead: f64, side: f64| Leg {
                seconds,
                v: ahead * top * (0.4 + 0.4 * random.share()),
                w: side * spin * (0.1 + 0.6 * random.share()),
            };
            let ways = [
                (1.0, 1.0),
                (1.0, -1.0),
                (1.0, 1.0),
                (1.0, -1.0),
                (-1.0, 1.0),
            ];
            steps.push(Step::Any(
                ways.map(|(ahead, side)| leg(&mut random, ahead, side)),
            ));
        }
        steps.push(Step::Stand(1.0));
        Self {
            steps,
            next: 0,
            last: STANDING,
            stands: true,
            held_out,
        }
    }

    /// The next leg of a robot that was at `at`, seen from where it began, so many seconds ago; `None` at the end.
    pub fn next(&mut self, at: Pose, ago_s: f64) -> Option<(Part, Leg)> {
        let step = *self.steps.get(self.next)?;
        let part = if self.next < self.held_out {
            Part::Baseline
        } else {
            Part::HeldOut
        };
        self.next += 1;
        // It has gone on since, and will until it hears of the next.
        let (way, turn) = if self.stands {
            (0.0, 0.0)
        } else {
            let seconds = (ago_s + LATE_S).min(self.last.seconds);
            (self.last.v * seconds, self.last.w * seconds)
        };
        let (sin, cos) = (0.5 * turn).sin_cos();
        let at = at.then(Pose {
            x: way * cos,
            y: way * sin,
            theta: turn,
        });
        self.stands = matches!(step, Step::Stand(_));
        let leg = match step {
            Step::Stand(seconds) => {
                return Some((
                    part,
                    Leg {
                        seconds,
                        ..STANDING
                    },
                ));
            }
            Step::Either(leg) => nearest(at, &[leg, reverse(leg)]),
            Step::Back => reverse(self.last),
            Step::Any(legs) => nearest(at, &legs),
        };
        self.last = leg;
        Some((part, leg))
    }

    /// How long all of it takes, seconds.
    #[must_use]
    pub fn seconds(&self) -> f64 {
        let mut last = 0.0;
        let seconds = self.steps.iter().map(|step| {
            match step {
                Step::Stand(seconds) => return *seconds,
                Step::Either(leg) | Step::Any([leg, ..]) => last = leg.seconds,
                Step::Back => {}
            }
            last
        });
        seconds.sum()
    }

    /// Legs, standing included.
    #[must_use]
    pub fn len(&self) -> usize {
        self.steps.len()
    }

    /// Whether there is nothing to drive; never so.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.steps.is_empty()
    }

    /// Legs that were begun.
    #[must_use]
    pub const fn begun(&self) -> usize {
        self.next
    }
}

/// The leg that stays nearest to the beginning, by its middle and its end.
fn nearest(at: Pose, legs: &[Leg]) -> Leg {
    let farthest = |leg: &Leg| {
        let there = |seconds: f64| {
            let half = 0.5 * leg.w * seconds;
            let way = leg.v * seconds;
            let (sin, cos) = (at.theta + half).sin_cos();
            (at.x + way * cos).hypot(at.y + way * sin)
        };
        there(0.5 * leg.seconds).max(there(leg.seconds))
    };
    let least = legs
        .iter()
        .copied()
        .min_by(|a, b| farthest(a).total_cmp(&farthest(b)));
    least.unwrap_or(STANDING)
}

/// Numbers from a seed: `SplitMix64`.
#[derive(Debug, Clone)]
pub(crate) struct Random(u64);

impl Random {
    pub(crate) const fn new(seed: u64) -> Self {
        Self(seed)
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Evenly from 0 to 1.
    pub(crate) fn share(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Evenly within so much of 1.
    pub(crate) fn about(&mut self, spread: f64) -> f64 {
        1.0 + spread * (2.0 * self.share() - 1.0)
    }

    /// Evenly within so much of 0.
    pub(crate) fn within(&mut self, most: f64) -> f64 {
        most * (2.0 * self.share() - 1.0)
    }

    /// Bell-shaped, with deviation 1.
    pub(crate) fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.share()).sum::<f64>() - 6.0
    }
}
