//! Faults by name, from what fixes say beside what was expected.
//!
//! Each fault has a direction in which it pushes the innovations of the filter, given what the wheels
//! did since the fix before. A cumulative sum of likelihood ratios runs for each of some sizes of each fault; under
//! no fault the time to an alarm of one is at least `exp(THRESHOLD)` fixes on average (Wald). When one rises
//! over the threshold, the fault that explains the last fixes best, of any size, is named.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

use crate::linear::Square;

/// Sum at which a fault is named: 10 sums, and one false alarm in a thousand robot-hours at ten fixes a second,
/// would have `ln(10 · 3.6e7)` = 19.7.
const THRESHOLD: f64 = 20.0;
/// One fix cannot say more than this: a tracker errs, too.
const MOST: f64 = 7.0;
/// Fixes that a name is found from.
const LOOK_BACK: usize = 40;
/// Fixes after it was named by which a name may still become another one.
const UNSETTLED: u32 = 20;
/// What is less than this is how bodies are, not a fault.
const LEAST_AMOUNT: f64 = 0.04;
/// So many times the driving that gave a fault its name outweighs that.
const OUTWEIGHS: f64 = 5.0;
/// A wheel that is slower than this may as well stand: when it starts nobody knows to the volt. Metres per second.
const SLOWEST_MPS: f64 = 0.08;
/// So many jumps within [`JUMPS_S`] are the tracker's.
const JUMPS: usize = 3;
/// Seconds.
const JUMPS_S: f64 = 30.0;

/// What can be wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum FaultName {
    /// The left motor makes less of its duty than it should.
    LeftWeak,
    /// The right one does.
    RightWeak,
    /// Both do: the battery, or what it drives through.
    BothWeak,
    /// It turns less than its wheels do.
    Slipping,
    /// It does not move although its wheels are told to.
    Stuck,
    /// The tracker jumps to and fro: it takes another robot for this one, or errs.
    TrackerWrong,
    /// What the robot says comes late.
    Late,
}

impl FaultName {
    /// All of them.
    pub const ALL: [Self; 7] = [
        Self::LeftWeak,
        Self::RightWeak,
        Self::BothWeak,
        Self::Slipping,
        Self::Stuck,
        Self::TrackerWrong,
        Self::Late,
    ];

    /// Its name, for programs.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::LeftWeak => "left_weak",
            Self::RightWeak => "right_weak",
            Self::BothWeak => "both_weak",
            Self::Slipping => "slipping",
            Self::Stuck => "stuck",
            Self::TrackerWrong => "tracker_wrong",
            Self::Late => "late",
        }
    }

    /// What it means, for people.
    #[must_use]
    pub const fn meaning(self) -> &'static str {
        match self {
            Self::LeftWeak => "the left motor makes less of its duty than it did",
            Self::RightWeak => "the right motor makes less of its duty than it did",
            Self::BothWeak => {
                "both motors make less of their duty: the battery, or a brake on the floor"
            }
            Self::Slipping => "it turns less than its wheels do",
            Self::Stuck => "it stands although its wheels are told to turn",
            Self::TrackerWrong => "the tracker sees it now here, now there",
            Self::Late => "what it says comes late",
        }
    }
}

/// A fault that was found.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Fault {
    /// Which.
    pub fault: FaultName,
    /// The tracker's time at which it was named, seconds.
    pub since_s: f64,
    /// How much: the share that is missing; of `late`, seconds.
    pub amount: f64,
}

impl std::fmt::Display for Fault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let name = self.fault.name();
        match self.fault {
            FaultName::Late => write!(f, "{name}: by {:.1} s", self.amount),
            FaultName::TrackerWrong => {
                write!(f, "{name}: {:.0} jumps in half a minute", self.amount)
            }
            _ => write!(
                f,
                "{name}: {:.0} % is missing",
                self.amount.min(1.0) * 100.0
            ),
        }
    }
}

/// What the wheels did between two fixes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Sight {
    /// Ways, left and right, metres.
    pub(crate) ways: [f64; 2],
    /// Time.
    pub(crate) seconds: f64,
    /// Heading at the end.
    pub(crate) heading: f64,
}

/// What a fix says.
pub(crate) struct Innovation {
    /// Beside what the filter expected.
    pub(crate) left: [f64; 3],
    /// Inverse of its covariance.
    pub(crate) inverse: Square<3>,
    /// Beside where the fix before and the wheels have it.
    pub(crate) moved: Option<[f64; 3]>,
}

/// A direction in which innovations are pushed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Left,
    Right,
    Both,
    Turn,
}

impl Kind {
    const ALL: [Self; 4] = [Self::Left, Self::Right, Self::Both, Self::Turn];

    /// Sizes that a sum runs for.
    const fn sizes(self) -> &'static [f64] {
        match self {
            Self::Left | Self::Right => &[-0.04, -0.1, -0.25],
            Self::Both => &[-0.07, -0.2, -0.9],
            Self::Turn => &[-0.3],
        }
    }

    /// The same where the body is not known.
    const fn coarse_sizes(self) -> &'static [f64] {
        match self {
            Self::Both => &[-0.9],
            Self::Left | Self::Right | Self::Turn => &[],
        }
    }

    /// Change of what is expected at a fix for a change of one.
    fn direction(self, sight: &Sight, track_m: f64) -> [f64; 3] {
        let (sin, cos) = sight.heading.sin_cos();
        let [left, right] = sight.ways;
        let (way, turn) = match self {
            Self::Left => (left * 0.5, -left / track_m),
            Self::Right => (right * 0.5, right / track_m),
            Self::Both => ((left + right) * 0.5, (right - left) / track_m),
            Self::Turn => (0.0, (right - left) / track_m),
        };
        [cos * way, sin * way, turn]
    }
}

/// A direction by what a fix said, and by itself.
#[derive(Debug, Clone, Copy)]
struct Terms {
    innovation: f64,
    own: f64,
    moved: f64,
    way: f64,
}

/// One look, by kind.
type Look = [Terms; 4];

/// See the [module](self).
#[derive(Debug, Clone, Default)]
pub(crate) struct Detector {
    /// Whether the body is not known: then only what shows on any body is named.
    coarse: bool,
    /// Of each kind and size.
    sums: [[f64; 3]; 4],
    looks: VecDeque<Look>,
    named: Option<(Fault, Kind)>,
    /// How large each would be, from ways between fixes since then.
    sizes: [(f64, f64); 4],
    /// Fixes since it was named.
    since: u32,
    /// How large it was when it got its name, and from how much driving.
    first: f64,
    first_way: f64,
    /// Evidence that what was named is over.
    over: f64,
    jumps: VecDeque<f64>,
    tracker: Option<Fault>,
    late: Option<Fault>,
}

impl Detector {
    /// One for a robot whose body is not known.
    pub(crate) fn coarse() -> Self {
        Self {
            coarse: true,
            ..Self::default()
        }
    }

    /// Whether the body does what it should.
    pub(crate) const fn is_quiet(&self) -> bool {
        self.named.is_none()
    }

    pub(crate) fn faults(&self) -> Vec<Fault> {
        let named = self.named.map(|(fault, _)| fault);
        [named, self.tracker, self.late]
            .into_iter()
            .flatten()
            .collect()
    }

    /// Takes in whether messages come late.
    pub(crate) fn late(&mut self, late: bool, at_s: f64, amount: f64) {
        if !late {
            self.late = None;
        } else if self.late.is_none() {
            let fault = FaultName::Late;
            self.late = Some(Fault {
                fault,
                since_s: at_s,
                amount,
            });
        }
    }

    /// Takes in whether a fix is one that no robot gets to.
    pub(crate) fn jumped(&mut self, jumped: bool, at_s: f64) {
        while self
            .jumps
            .front()
            .is_some_and(|first| at_s - first > JUMPS_S)
        {
            self.jumps.pop_front();
        }
        if jumped {
            self.jumps.push_back(at_s);
            // What was summed up is of another place.
            self.sums = Default::default();
            self.looks.clear();
        }
        if self.jumps.len() < JUMPS {
            self.tracker = None;
        } else if self.tracker.is_none() {
            let fault = FaultName::TrackerWrong;
            let amount = self.jumps.len() as f64;
            self.tracker = Some(Fault {
                fault,
                since_s: at_s,
                amount,
            });
        }
        self.jumps.truncate(1_000);
    }

    /// Takes in an innovation with the inverse of its covariance.
    pub(crate) fn look(&mut self, sight: &Sight, told: &Innovation, at_s: f64, track_m: f64) {
        if sight.ways[0].abs().min(sight.ways[1].abs()) < SLOWEST_MPS * sight.seconds {
            return;
        }
        let look: Look = Kind::ALL.map(|kind| {
            let direction = kind.direction(sight, track_m);
            let weighed = told
                .inverse
                .map(|row| row.iter().zip(direction).map(|(a, b)| a * b).sum::<f64>());
            let with = |other: [f64; 3]| weighed.iter().zip(other).map(|(a, b)| a * b).sum::<f64>();
            // A heading is off by 0.02 rad where a place is by 1 cm.
            let weights = [1.0, 1.0, 0.25];
            let plain = |other: [f64; 3]| -> f64 {
                (0..3).map(|i| weights[i] * direction[i] * other[i]).sum()
            };
            Terms {
                innovation: with(told.left),
                own: with(direction),
                moved: told.moved.map_or(0.0, plain),
                way: told.moved.map_or(0.0, |_| plain(direction)),
            }
        });
        if self.looks.len() == LOOK_BACK {
            self.looks.pop_front();
        }
        self.looks.push_back(look);
        // Of a size d the logarithm of the likelihood ratio is d · a − d² · b / 2.
        let ratio = |terms: Terms, size: f64| {
            (size * terms.innovation - 0.5 * size * size * terms.own).clamp(-MOST, MOST)
        };
        if let Some((fault, kind)) = &mut self.named {
            for (size, terms) in self.sizes.iter_mut().zip(look) {
                size.0 += terms.moved;
                size.1 += terms.way;
            }
            self.since += 1;
            if self.since <= UNSETTLED {
                // A few fixes blur whose it is; more of them tell.
                let best = best_of(&self.sizes);
                let named = name_of(best, amount(self.sizes[best as usize]));
                let renames = named != fault.fault && (!self.coarse || named == FaultName::Stuck);
                if renames {
                    (*kind, fault.fault) = (best, named);
                    self.first = amount(self.sizes[best as usize]);
                    self.first_way = self.sizes[best as usize].1;
                }
            }
            let there = look[*kind as usize];
            fault.amount = amount(self.sizes[*kind as usize]);
            // What is over is less and less on the whole, and must not become too little to be told from nothing.
            let size = fault.amount.max(0.5 * self.first).max(LEAST_AMOUNT);
            self.over = (self.over - ratio(there, -size)).max(0.0);
            // Who hardly turns says next to nothing about a slip. What comes to so little of all it did since would not be
            // named.
            let driven = self.sizes[*kind as usize].1 > OUTWEIGHS * self.first_way;
            let is_nothing = driven && fault.amount < 0.5 * LEAST_AMOUNT;
            if self.over > THRESHOLD || is_nothing {
                self.named = None;
                self.over = 0.0;
                self.sums = Default::default();
                self.looks.clear();
            }
            return;
        }
        let mut alarmed = false;
        for kind in Kind::ALL {
            let sums = &mut self.sums[kind as usize];
            let sizes = if self.coarse {
                kind.coarse_sizes()
            } else {
                kind.sizes()
            };
            for (sum, size) in sums.iter_mut().zip(sizes) {
                *sum = (*sum + ratio(look[kind as usize], *size)).max(0.0);
                alarmed |= *sum > THRESHOLD;
            }
        }
        if alarmed {
            self.named = self.name(at_s);
            self.over = 0.0;
            if self.named.is_some() {
                self.sums = Default::default();
            } else {
                self.sums = self.sums.map(|sums| sums.map(|sum| sum * 0.5));
            }
        }
    }

    /// The fault that explains the last fixes best.
    fn name(&mut self, at_s: f64) -> Option<(Fault, Kind)> {
        let mut best: Option<(f64, usize, Kind)> = None;
        for kind in Kind::ALL {
            // The latest fixes are of the fault for sure; how far back it goes is tried.
            let (mut a, mut b) = (0.0, 0.0);
            for (i, look) in self.looks.iter().rev().enumerate() {
                let terms = look[kind as usize];
                (a, b) = (a + terms.innovation, b + terms.own);
                let size = (a / b.max(1e-9)).clamp(-1.3, 0.0);
                let gain = size * a - 0.5 * size * size * b;
                if best.is_none_or(|(most, _, _)| gain > most) {
                    best = Some((gain, i + 1, kind));
                }
            }
        }
        let (_, count, _) = best?;
        // The filter follows a fault a little, which blurs whose it is: ways between fixes tell.
        let size = |kind: Kind| {
            let of = self
                .looks
                .iter()
                .rev()
                .take(count)
                .map(|look| look[kind as usize]);
            of.fold((0.0, 0.0), |(a, b), terms| (a + terms.moved, b + terms.way))
        };
        let sizes = Kind::ALL.map(size);
        let kind = best_of(&sizes);
        let amount = amount(sizes[kind as usize]);
        if amount < LEAST_AMOUNT {
            return None;
        }
        let fault = name_of(kind, amount);
        if self.coarse && fault != FaultName::Stuck {
            return None;
        }
        (self.sizes, self.since, self.first) = (sizes, 0, amount);
        self.first_way = sizes[kind as usize].1;
        Some((
            Fault {
                fault,
                since_s: at_s,
                amount,
            },
            kind,
        ))
    }
}

/// The kind that explains ways between fixes best.
fn best_of(sizes: &[(f64, f64); 4]) -> Kind {
    let explained = |kind: Kind| {
        let (moved, way) = sizes[kind as usize];
        moved.min(0.0).powi(2) / way.max(1e-9)
    };
    let more = |best: Kind, kind: Kind| {
        if explained(kind) > explained(best) {
            kind
        } else {
            best
        }
    };
    Kind::ALL.into_iter().fold(Kind::Left, more)
}

const fn name_of(kind: Kind, amount: f64) -> FaultName {
    match kind {
        Kind::Left => FaultName::LeftWeak,
        Kind::Right => FaultName::RightWeak,
        Kind::Both if amount > 0.7 => FaultName::Stuck,
        Kind::Both => FaultName::BothWeak,
        Kind::Turn => FaultName::Slipping,
    }
}

/// The share that is missing.
fn amount((moved, way): (f64, f64)) -> f64 {
    (-moved / way.max(1e-9)).clamp(0.0, 1.3)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fixes of a robot that drives straight on and turns now and then, whose turns come short by a share.
    fn drive(detector: &mut Detector, from: u32, fixes: u32, short: f64) {
        for fix in from..from + fixes {
            let turn = if fix % 20 < 2 { 0.03 } else { 0.001 };
            let sight = Sight {
                ways: [0.03 - 0.07 * turn, 0.03 + 0.07 * turn],
                seconds: 0.1,
                heading: 0.0,
            };
            let moved = [0.0, 0.0, -short * turn];
            let mut inverse = [[0.0; 3]; 3];
            for (i, sigma) in [0.01_f64, 0.01, 0.02].into_iter().enumerate() {
                inverse[i][i] = 1.0 / (sigma * sigma);
            }
            let told = Innovation {
                left: moved,
                inverse,
                moved: Some(moved),
            };
            detector.look(&sight, &told, f64::from(fix) * 0.1, 0.14);
        }
    }

    #[test]
    fn a_slip_that_was_none_is_over_though_the_robot_hardly_turns() {
        // By four seconds of driving it turns 8 % less than its wheels do.
        let named = || {
            let way = 40.0 * 0.25 * 0.03 * 0.03 * 0.1;
            let fault = Fault {
                fault: FaultName::Slipping,
                since_s: 0.0,
                amount: 0.08,
            };
            let mut detector = Detector {
                named: Some((fault, Kind::Turn)),
                since: UNSETTLED + 1,
                first: fault.amount,
                first_way: way,
                ..Detector::default()
            };
            detector.sizes[Kind::Turn as usize] = (-fault.amount * way, way);
            detector
        };
        let mut none = named();
        drive(&mut none, 0, 600, 0.0);
        assert!(none.is_quiet(), "{:?}", none.faults());
        // While it lasts it stays.
        let mut slips = named();
        drive(&mut slips, 0, 6_000, 0.08);
        let there = slips.faults()[0].amount;
        assert!((there - 0.08).abs() < 0.01, "{there}");
    }
}
