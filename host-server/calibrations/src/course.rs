//! A drive under the eyes of the server: which word the robot gets next, and what ends it. It knows neither clock nor
//! network: time and what was seen are handed in.

use std::sync::Arc;

use crawler_protocol::{RobotId, RobotState};
use crawler_twin::body::Pose;
use crawler_twin::course::{Course, Limits, Part};
use crawler_twin::evidence::Fix;
use crawler_twin::identify::jumps_between;
use crawler_twin::rehearsal::Sweep;

use crate::ground::BESIDE_M;
use crate::record::{BrokenOff, State};
use crate::robots::RobotView;

/// How far beyond what was rehearsed a robot may be seen, metres: fixes have noise, and bodies are odd.
pub(crate) const BEYOND_M: f64 = 0.15;
/// Nothing was heard of the robot, or seen of it, for so long, seconds.
const SILENT_S: f64 = 1.5;
/// Between two words to a robot that drives: well within the half second after which it stands.
const WORD_S: f64 = 0.15;
/// So long is waited until telemetry comes quickly, seconds.
const PATIENCE_S: f64 = 15.0;
/// What must have come within [`LOOK_BACK_S`] before it begins: samples, fixes.
const ENOUGH: (usize, usize) = (20, 3);
pub(crate) const LOOK_BACK_S: f64 = 2.0;

/// What is seen at a moment.
#[derive(Debug, Clone)]
pub(crate) struct Seen {
    /// Seconds, by the clock of twins.
    pub(crate) now_s: f64,
    /// The newest fix.
    pub(crate) fix: Option<Fix>,
    /// When the robot last told its duties.
    pub(crate) told_s: Option<f64>,
    /// Samples and fixes of the last [`LOOK_BACK_S`].
    pub(crate) recent: (usize, usize),
    /// The robot; `None` when nobody knows it any more.
    pub(crate) robot: Option<RobotView>,
    /// The others.
    pub(crate) others: Vec<(RobotId, [f64; 2])>,
}

/// What to do.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Next {
    /// Nothing.
    Wait,
    /// A word to the robot.
    Drive { v: f64, w: f64 },
    /// Stop, and go on.
    Stand,
    /// It has driven all of it; what was held out begins at this moment, seconds.
    Driven { held_s: f64 },
    /// It is over.
    Broken(BrokenOff),
}

/// See the [module](self).
#[derive(Debug)]
pub(crate) struct Driving {
    home: Pose,
    sweep: Arc<Sweep>,
    course: Course,
    boot: u32,
    begun_s: f64,
    /// Until when the leg lasts; `None` before the first.
    until_s: Option<f64>,
    word: (f64, f64),
    worded_s: f64,
    held_s: Option<f64>,
    fix: Option<Fix>,
    pub(crate) state: State,
}

impl Driving {
    pub(crate) fn new(
        home: Pose,
        sweep: Arc<Sweep>,
        limits: Limits,
        (seed, boot): (u64, u32),
        now_s: f64,
    ) -> Self {
        Self {
            home,
            sweep,
            course: Course::new(limits, seed),
            boot,
            begun_s: now_s,
            until_s: None,
            word: (0.0, 0.0),
            worded_s: f64::NEG_INFINITY,
            held_s: None,
            fix: None,
            state: State::Preparing,
        }
    }

    /// Where it began, metres.
    pub(crate) const fn home(&self) -> [f64; 2] {
        [self.home.x, self.home.y]
    }

    /// Legs that were begun, and all of them.
    pub(crate) fn legs(&self) -> [usize; 2] {
        [self.course.begun(), self.course.len()]
    }

    /// What to do now.
    pub(crate) fn step(&mut self, seen: &Seen) -> Next {
        if let Some(broken) = self.watch(seen) {
            return Next::Broken(broken);
        }
        let now_s = seen.now_s;
        let Some(until_s) = self.until_s else {
            let (samples, fixes) = seen.recent;
            if samples >= ENOUGH.0 && fixes >= ENOUGH.1 {
                self.until_s = Some(now_s);
                return self.step(seen);
            }
            if now_s - self.begun_s > PATIENCE_S {
                return Next::Broken(BrokenOff::TooLittle);
            }
            return Next::Wait;
        };
        if now_s >= until_s {
            let Some(fix) = self.fix else {
                return Next::Broken(BrokenOff::TrackerLost);
            };
            let at = self.home.sees(Pose {
                x: fix.x,
                y: fix.y,
                theta: fix.theta,
            });
            let ago_s = now_s - fix.arrived_s.unwrap_or(now_s);
            let Some((part, leg)) = self.course.next(at, ago_s) else {
                let held_s = self.held_s.unwrap_or(now_s);
                self.state = State::Identifying;
                return Next::Driven { held_s };
            };
            self.state = match part {
                Part::Baseline => State::Baseline,
                Part::HeldOut => State::HeldOut,
            };
            if part == Part::HeldOut {
                // Stamps of fixes are held against it.
                self.held_s.get_or_insert(fix.at_s);
            }
            // Each leg begins when the one before was to end, unless that was long ago.
            let begins_s = if now_s - until_s < 0.2 {
                until_s
            } else {
                now_s
            };
            self.until_s = Some(begins_s + leg.seconds);
            self.word = (leg.v, leg.w);
            self.worded_s = now_s;
            return self.say();
        }
        if self.word != (0.0, 0.0) && now_s - self.worded_s >= WORD_S {
            self.worded_s = now_s;
            return self.say();
        }
        Next::Wait
    }

    const fn say(&self) -> Next {
        let (v, w) = self.word;
        if v == 0.0 && w == 0.0 {
            Next::Stand
        } else {
            Next::Drive { v, w }
        }
    }

    /// Whatever should not be.
    fn watch(&mut self, seen: &Seen) -> Option<BrokenOff> {
        let now_s = seen.now_s;
        let Some(robot) = seen.robot.as_ref().filter(|robot| robot.is_online) else {
            return Some(BrokenOff::LinkLost);
        };
        if robot.state == Some(RobotState::Error) {
            return Some(BrokenOff::Halted);
        }
        if robot.boot != self.boot || robot.state == Some(RobotState::Initializing) {
            return Some(BrokenOff::Restarted);
        }
        if robot.state == Some(RobotState::Updating) {
            return Some(BrokenOff::OtherCommand("an update".to_owned()));
        }
        if let Some(behaviour) = &robot.behaviour {
            return Some(BrokenOff::OtherCommand(format!("who began {behaviour}")));
        }
        // Before the first of them came, it began at the beginning.
        let silent = |at_s: Option<f64>| now_s - at_s.unwrap_or(self.begun_s) > SILENT_S;
        if silent(seen.told_s) {
            return Some(BrokenOff::LinkLost);
        }
        if silent(seen.fix.and_then(|fix| fix.arrived_s)) {
            return Some(BrokenOff::TrackerLost);
        }
        if let Some(fix) = seen.fix {
            let jumped = self
                .fix
                .is_some_and(|last| last.at_s < fix.at_s && jumps_between(&last, &fix));
            self.fix = Some(fix);
            if jumped {
                return Some(BrokenOff::Jumped);
            }
            if !self.sweep.holds(self.home, [fix.x, fix.y], BEYOND_M) {
                return Some(BrokenOff::LeftArea);
            }
        }
        let near = seen
            .others
            .iter()
            .find(|(_, at)| self.sweep.holds(self.home, *at, BESIDE_M - BEYOND_M));
        near.map(|(robot, _)| BrokenOff::RobotNear(robot.to_string()))
    }
}
