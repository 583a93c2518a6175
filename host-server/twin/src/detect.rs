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
const MOST: f64 = 10.0;
/// Nor can all fixes within this time: what the wheels did between two samples is known to no more than that. Seconds.
const SAMPLE_S: f64 = 0.2;
/// Fixes that a name is found from.
const LOOK_BACK: usize = 40;
/// Fixes after it was named by which a name may still become another one.
const UNSETTLED: u32 = 20;
/// And no more than this is missing.
const MOST_AMOUNT: f64 = 1.3;
/// A name gives way to another one that explains what was seen so much better, as a logarithm of the likelihood.
const CLEARLY: f64 = 3.0;
/// What is less than this is how bodies are, not a fault.
const LEAST_AMOUNT: f64 = 0.04;
/// So many times the driving that gave a fault its name outweighs that.
const OUTWEIGHS: f64 = 5.0;
/// A wheel that is slower than this may as well stand: when it starts nobody knows to the volt. Metres per second.
const SLOWEST_MPS: f64 = 0.08;
/// A tracker pauses when it takes so many times as long as usual.
const PAUSE: f64 = 2.5;
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
#[derive(Debug, Clone, Copy)]
pub(crate) struct Innovation {
    /// Beside what the filter expected.
    pub(crate) left: [f64; 3],
    /// Inverse of its covariance.
    pub(crate) inverse: Square<3>,
    /// What of an error the filter is left with once it has taken in the fix.
    pub(crate) rest: Square<3>,
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

/// What a fault of one makes of an innovation, by what a fix said, and by itself.
#[derive(Debug, Clone, Copy, Default)]
struct Terms {
    innovation: f64,
    own: f64,
}

impl Terms {
    /// The size that is most likely.
    fn size(self) -> f64 {
        (self.innovation / self.own.max(1e-9)).clamp(-MOST_AMOUNT, 0.0)
    }

    /// Logarithm of the likelihood ratio of a size.
    fn ratio(self, size: f64) -> f64 {
        size * self.innovation - 0.5 * size * size * self.own
    }

    /// That of the most likely one.
    fn gain(self) -> f64 {
        self.ratio(self.size())
    }

    fn and(self, other: Self) -> Self {
        Self {
            innovation: self.innovation + other.innovation,
            own: self.own + other.own,
        }
    }
}

/// One look, by kind.
type Look = [Terms; 4];

/// What faults of each kind make of a fix, and how much it may say.
#[derive(Debug, Clone, Copy)]
struct Said {
    look: Look,
    most: f64,
}

impl Said {
    /// The logarithm of the likelihood ratio of a size, as far as the fix is believed.
    fn ratio(&self, kind: Kind, size: f64) -> f64 {
        let ratio = self.look[kind as usize].ratio(size);
        ratio.clamp(-self.most, self.most)
    }
}

/// What came with a fix.
#[derive(Debug, Clone, Copy)]
struct Step {
    /// Where a fault of one of each kind would push the robot since the fix before.
    directions: [[f64; 3]; 4],
    /// How far it went along both axes: what is wrong with its heading turns that.
    went: [f64; 2],
    /// What the fix said, and whether it counts.
    told: Innovation,
    counts: bool,
}

/// The signature of a fault of one: what it makes of where the filter has the robot (Willsky and Jones, 1976).
#[derive(Debug, Clone, Copy, Default)]
struct Signature([f64; 3]);

impl Signature {
    /// Goes on to the next fix, and returns what the fault makes of that. A filter that is sure of a place follows fixes slowly,
    /// and little by little a small fault makes it wrong by much.
    fn next(&mut self, step: &Step, kind: Kind) -> Terms {
        let times = |matrix: &Square<3>, other: [f64; 3]| {
            matrix.map(|row| row.iter().zip(other).map(|(a, b)| a * b).sum::<f64>())
        };
        let with = |one: [f64; 3], other: [f64; 3]| -> f64 {
            one.iter().zip(other).map(|(a, b)| a * b).sum()
        };
        let [x, y, theta] = self.0;
        let [dx, dy, turn] = step.directions[kind as usize];
        let [along, across] = step.went;
        let pushed = [
            x - across * theta + dx,
            y + along * theta + dy,
            theta + turn,
        ];
        self.0 = times(&step.told.rest, pushed);
        if !step.counts {
            return Terms::default();
        }
        let weighed = times(&step.told.inverse, pushed);
        Terms {
            innovation: with(weighed, step.told.left),
            own: with(weighed, pushed),
        }
    }
}

/// See the [module](self).
#[derive(Debug, Clone, Default)]
pub(crate) struct Detector {
    /// Whether the body is not known: then only what shows on any body is named.
    coarse: bool,
    /// Of each kind, of a fault that is there all the while, or since what is named began.
    signatures: [Signature; 4],
    /// Of each kind and size.
    sums: [[f64; 3]; 4],
    steps: VecDeque<Step>,
    /// What passes between two fixes as a rule, seconds.
    usual_s: Option<f64>,
    /// Whether something may hold it up that is none of its own.
    touched: bool,
    named: Option<(Fault, Kind)>,
    /// All that was looked at since it began.
    since_then: Look,
    /// Fixes since it was named.
    since: u32,
    /// How large it was when it got its name, and from how much driving.
    first: f64,
    first_own: f64,
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

    /// The filter begins anew: what was summed up is of what it believed before.
    pub(crate) fn begin(&mut self) {
        self.signatures = Default::default();
        self.sums = Default::default();
        self.steps.clear();
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

    /// Takes in an innovation with the inverse of its covariance; `touches` says whether something may have held the robot up.
    pub(crate) fn look(
        &mut self,
        sight: &Sight,
        told: &Innovation,
        at_s: f64,
        track_m: f64,
        touches: bool,
    ) {
        let (sin, cos) = sight.heading.sin_cos();
        let way = (sight.ways[0] + sight.ways[1]) * 0.5;
        let slowest = sight.ways[0].abs().min(sight.ways[1].abs());
        // After a pause of the tracker what the robot did meanwhile is known less well than a fix is.
        let usual_s = self.usual_s.unwrap_or(sight.seconds);
        let paused = sight.seconds > PAUSE * usual_s;
        // One pause is no new rule, and two fixes of one moment are none either.
        let most_s = PAUSE * usual_s + 0.1;
        self.usual_s = Some(usual_s + (sight.seconds.min(most_s) - usual_s) / 16.0);
        let step = Step {
            directions: Kind::ALL.map(|kind| kind.direction(sight, track_m)),
            went: [cos * way, sin * way],
            told: *told,
            counts: !paused && slowest >= SLOWEST_MPS * sight.seconds,
        };
        let look = Kind::ALL.map(|kind| self.signatures[kind as usize].next(&step, kind));
        if touches != self.touched {
            // What was summed up is of another state of affairs.
            self.touched = touches;
            self.sums = Default::default();
            self.steps.clear();
            // What held it is left behind.
            let is_stuck = |(fault, _): &(Fault, Kind)| fault.fault == FaultName::Stuck;
            self.named = self.named.filter(|named| touches || !is_stuck(named));
        }
        if self.steps.len() == LOOK_BACK {
            self.steps.pop_front();
        }
        self.steps.push_back(step);
        if !step.counts {
            return;
        }
        let said = Said {
            look,
            most: MOST * (sight.seconds / SAMPLE_S).min(1.0),
        };
        let coarse = self.coarse || touches;
        match self.named {
            // What touches says nothing of what was wrong before.
            Some((fault, _)) if touches && fault.fault != FaultName::Stuck => {}
            Some(_) => self.goes_on(&said, coarse),
            None => self.sum_up(&said, coarse, at_s),
        }
    }

    /// What was named may be something else, more or less, or over.
    fn goes_on(&mut self, said: &Said, coarse: bool) {
        if let Some((fault, kind)) = &mut self.named {
            for (sum, terms) in self.since_then.iter_mut().zip(said.look) {
                *sum = sum.and(terms);
            }
            self.since += 1;
            if self.since <= UNSETTLED {
                // A few fixes blur whose it is; more of them tell.
                let best = best_of(&self.since_then);
                let all = self.since_then[best as usize];
                let named = name_of(best, -all.size());
                let is_clear = all.gain() > self.since_then[*kind as usize].gain() + CLEARLY;
                let is_one = -all.size() >= LEAST_AMOUNT && (!coarse || named == FaultName::Stuck);
                if is_one && named != fault.fault && (best == *kind || is_clear) {
                    (*kind, fault.fault) = (best, named);
                    self.first = -all.size();
                    self.first_own = all.own;
                }
            }
            let all = self.since_then[*kind as usize];
            fault.amount = -all.size();
            // What is over is less and less on the whole, and must not become too little to be told from nothing.
            let size = fault.amount.max(0.5 * self.first).max(LEAST_AMOUNT);
            self.over = (self.over - said.ratio(*kind, -size)).max(0.0);
            // Who hardly turns says next to nothing about a slip. What comes to so little of all it did since would not be
            // named.
            let driven = all.own > OUTWEIGHS * self.first_own;
            let is_nothing = driven && fault.amount < 0.5 * LEAST_AMOUNT;
            if self.over > THRESHOLD || is_nothing {
                self.named = None;
                self.over = 0.0;
                self.sums = Default::default();
                self.steps.clear();
            }
        }
    }

    /// Sums up what faults make of a fix, and names one when a sum rises over the threshold.
    fn sum_up(&mut self, said: &Said, coarse: bool, at_s: f64) {
        let mut alarmed = false;
        for kind in Kind::ALL {
            let sums = &mut self.sums[kind as usize];
            let sizes = if coarse {
                kind.coarse_sizes()
            } else {
                kind.sizes()
            };
            for (sum, size) in sums.iter_mut().zip(sizes) {
                *sum = (*sum + said.ratio(kind, *size)).max(0.0);
                alarmed |= *sum > THRESHOLD;
            }
        }
        if alarmed {
            self.named = self.name(at_s, coarse);
            self.over = 0.0;
            if self.named.is_some() {
                self.sums = Default::default();
            } else {
                self.sums = self.sums.map(|sums| sums.map(|sum| sum * 0.5));
            }
        }
    }

    /// The fault that explains the last fixes best, from when on whatever.
    fn name(&mut self, at_s: f64, coarse: bool) -> Option<(Fault, Kind)> {
        let mut best: Option<(f64, Kind, usize)> = None;
        for begun in 0..self.steps.len() {
            for kind in Kind::ALL {
                let gain = self.since(begun, kind).0.gain();
                if best.is_none_or(|(most, ..)| gain > most) {
                    best = Some((gain, kind, begun));
                }
            }
        }
        let (_, kind, begun) = best?;
        let all = Kind::ALL.map(|kind| self.since(begun, kind));
        let since_then = all.map(|(terms, _)| terms);
        let own = since_then[kind as usize];
        let amount = -own.size();
        let fault = name_of(kind, amount);
        if amount < LEAST_AMOUNT || (coarse && fault != FaultName::Stuck) {
            return None;
        }
        self.signatures = all.map(|(_, signature)| signature);
        (self.since_then, self.since) = (since_then, 0);
        (self.first, self.first_own) = (amount, own.own);
        Some((
            Fault {
                fault,
                since_s: at_s,
                amount,
            },
            kind,
        ))
    }

    /// What a fault that began at one of the last steps makes of all fixes since.
    fn since(&self, begun: usize, kind: Kind) -> (Terms, Signature) {
        let mut signature = Signature::default();
        let all = self
            .steps
            .range(begun..)
            .fold(Terms::default(), |all, step| {
                all.and(signature.next(step, kind))
            });
        (all, signature)
    }
}

/// The kind that explains fixes best.
fn best_of(looks: &Look) -> Kind {
    let gain = |kind: Kind| looks[kind as usize].gain();
    let more = |best: Kind, kind: Kind| if gain(kind) > gain(best) { kind } else { best };
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

#[cfg(test)]
mod tests {
    use super::*;

    const SIGMAS: [f64; 3] = [0.01, 0.01, 0.02];
    /// Of a filter that takes half of every innovation.
    const REST: Square<3> = [[0.5, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 0.5]];

    /// Fixes of a robot that drives straight on and turns now and then, whose turns come short by a share.
    fn drive(detector: &mut Detector, from: u32, fixes: u32, short: f64) {
        let mut behind = 0.0;
        for fix in from..from + fixes {
            let turn = if fix % 20 < 2 { 0.03 } else { 0.001 };
            let sight = Sight {
                ways: [0.03 - 0.07 * turn, 0.03 + 0.07 * turn],
                seconds: 0.1,
                heading: 0.0,
            };
            behind -= short * turn;
            let mut inverse = [[0.0; 3]; 3];
            for (i, sigma) in SIGMAS.into_iter().enumerate() {
                inverse[i][i] = 1.0 / (sigma * sigma);
            }
            let told = Innovation {
                left: [0.0, 0.0, behind],
                inverse,
                rest: REST,
            };
            behind *= REST[2][2];
            let touches = false;
            detector.look(&sight, &told, f64::from(fix) * 0.1, 0.14, touches);
        }
    }

    #[test]
    fn whatever_passes_between_fixes_it_learns_what_is_usual() {
        for (first, then) in [(0.0, 0.1), (0.01, 2.5), (2.5, 0.1), (30.0, 0.5)] {
            let mut detector = Detector::default();
            let mut counted = Vec::new();
            for fix in 0..120 {
                let pauses = fix > 80 && fix % 10 == 0;
                let seconds = match fix {
                    0 => first,
                    _ if pauses => 5.0 * then,
                    _ => then,
                };
                let sight = Sight {
                    ways: [0.3 * seconds; 2],
                    seconds,
                    heading: 0.0,
                };
                let told = Innovation {
                    left: [0.0; 3],
                    inverse: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
                    rest: REST,
                };
                detector.look(&sight, &told, f64::from(fix), 0.14, false);
                let step = detector.steps.back().expect("a step");
                counted.push((fix, pauses, step.counts));
            }
            for (fix, pauses, counts) in counted.into_iter().skip(70) {
                assert_eq!(counts, !pauses, "{first} {then}: {fix}");
            }
        }
    }

    #[test]
    fn fixes_within_one_sample_say_no_more_than_one() {
        // A robot that stands although its wheels turn, as sure as can be.
        let named_after_s = |seconds: f64| {
            let mut detector = Detector::default();
            let mut fixes = 0;
            while detector.is_quiet() {
                fixes += 1;
                assert!(fixes < 1_000, "it is never named");
                let way = 0.3 * seconds;
                let sight = Sight {
                    ways: [way; 2],
                    seconds,
                    heading: 0.0,
                };
                let told = Innovation {
                    left: [-way, 0.0, 0.0],
                    inverse: [[1e9, 0.0, 0.0], [0.0, 1e9, 0.0], [0.0, 0.0, 1e9]],
                    rest: [[0.0; 3]; 3],
                };
                detector.look(&sight, &told, f64::from(fixes) * seconds, 0.14, false);
            }
            assert_eq!(detector.faults()[0].fault, FaultName::Stuck);
            f64::from(fixes) * seconds
        };
        for (seconds, least_s) in [(0.5, 1.5), (0.2, 0.6), (0.1, 0.4), (0.05, 0.4), (0.02, 0.4)] {
            let named_s = named_after_s(seconds);
            assert!(named_s >= least_s - 1e-9, "{seconds}: {named_s}");
        }
    }

    #[test]
    fn a_slip_that_was_none_is_over_though_the_robot_hardly_turns() {
        // By four seconds of driving it turns 8 % less than its wheels do.
        let named = || {
            let own = 40.0 * 0.03 * 0.03 * 0.1 / (SIGMAS[2] * SIGMAS[2]);
            let fault = Fault {
                fault: FaultName::Slipping,
                since_s: 0.0,
                amount: 0.08,
            };
            let mut detector = Detector {
                named: Some((fault, Kind::Turn)),
                since: UNSETTLED + 1,
                first: fault.amount,
                first_own: own,
                ..Detector::default()
            };
            detector.since_then[Kind::Turn as usize] = Terms {
                innovation: -fault.amount * own,
                own,
            };
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
