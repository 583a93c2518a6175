//! What became of the commands of a run.

use std::collections::BTreeMap;

use crawler_hal::{Duration, Instant};
use crawler_protocol::{CommandName, Response, ResponseStatus, RobotId, Topic};

use crate::net::lockstep::Published;
use crate::run::{Issued, Simulation};

/// A command whose end is not known this long after it was given has failed.
const OVERDUE: Duration = Duration::from_secs(10);

#[derive(Debug)]
struct Given {
    issued: Issued,
    /// Its first answer, and when that came.
    first: Option<(ResponseStatus, Instant)>,
    last: Option<(ResponseStatus, Instant)>,
    /// How long it has waited for its first answer while the robot could hear, microseconds.
    waited_us: u64,
}

/// See the [module](self).
#[derive(Debug, Default)]
pub(super) struct Commands {
    /// By robot and number.
    given: BTreeMap<(usize, u64), Given>,
    /// Those without a first answer.
    open: Vec<(usize, u64)>,
    longest: Option<(u64, Issued)>,
    /// Robots that were told since the last look what to do from now on.
    pub(super) told: Vec<usize>,
    /// Robots that said since the last look that they came to the end of what they were last told to do.
    pub(super) over: Vec<usize>,
    /// For each robot: since when it has to stand.
    standing: Vec<Option<Instant>>,
}

impl Commands {
    /// Takes in what was published since the last call, `step` ago; `hears` tells whether a robot
    /// is connected.
    pub(super) fn follow(
        &mut self,
        simulation: &mut Simulation,
        published: &[Published],
        step: Duration,
        hears: impl Fn(usize) -> bool,
    ) {
        self.standing.resize(simulation.robots(), None);
        for issued in simulation.take_issued() {
            let key = (issued.robot, issued.seq);
            if let Some(standing) = self.standing.get_mut(issued.robot)
                && !is_halt(issued.command)
            {
                *standing = None;
            }
            if decides_motion(issued.command) {
                self.told.push(issued.robot);
            }
            self.open.push(key);
            let given = Given {
                issued,
                first: None,
                last: None,
                waited_us: 0,
            };
            self.given.insert(key, given);
        }
        for published in published {
            let Ok(Topic::Response(robot)) = Topic::parse(simulation.fleet(), &published.topic)
            else {
                continue;
            };
            let Ok(response) = Response::from_json(&published.payload) else {
                continue;
            };
            let Some(number) = number(&robot) else {
                continue;
            };
            self.answer(number, response.seq, response.status, published.at);
        }
        let given = &mut self.given;
        let longest = &mut self.longest;
        self.open.retain(|key| {
            let Some(given) = given.get_mut(key).filter(|given| given.first.is_none()) else {
                return false;
            };
            if hears(given.issued.robot) {
                given.waited_us += step.as_micros();
            }
            if longest.is_none_or(|(so_far, _)| given.waited_us > so_far) {
                *longest = Some((given.waited_us, given.issued));
            }
            true
        });
    }

    fn answer(&mut self, robot: usize, seq: u64, status: ResponseStatus, at: Instant) {
        let Some(given) = self.given.get_mut(&(robot, seq)) else {
            return;
        };
        let (first, _) = *given.first.get_or_insert((status, at));
        if !status.is_final() || given.last.is_some() {
            return;
        }
        given.last = Some((status, at));
        let command = given.issued.command;
        if status != ResponseStatus::Completed {
            return;
        }
        if is_halt(command) {
            let newest = self.given.range((robot, 0)..=(robot, u64::MAX)).next_back();
            let is_newest = newest.is_some_and(|(&(_, newest), _)| newest == seq);
            if is_newest && let Some(standing) = self.standing.get_mut(robot) {
                standing.get_or_insert(at);
            }
        }
        // What is completed at once has no end: it has begun.
        let had_end = decides_motion(command) && first == ResponseStatus::Accepted;
        let mut later = self.given.range((robot, seq + 1)..=(robot, u64::MAX));
        if had_end && !later.any(|(_, given)| decides_motion(given.issued.command)) {
            self.over.push(robot);
        }
    }

    /// Whether the robot has answered everything it was told.
    pub(super) fn is_settled(&self, robot: usize) -> bool {
        self.open.iter().all(|&(other, _)| other != robot)
    }

    /// Since when a robot has to stand, because it was told to and said so.
    pub(super) fn stands_since(&self, robot: usize) -> Option<Instant> {
        self.standing.get(robot).copied().flatten()
    }

    /// The longest wait for a first answer of a robot that could hear, microseconds.
    pub(super) const fn longest_wait(&self) -> Option<(u64, Issued)> {
        self.longest
    }

    /// How many commands ended as completed, and how many ended or should have.
    pub(super) fn success(&self, now: Instant) -> (usize, usize) {
        let ended = self.given.values().filter(|given| {
            given.last.is_some() || given.first.is_none() && now - given.issued.at >= OVERDUE
        });
        let completed = self.given.values().filter(|given| {
            let status = given.last.map(|(status, _)| status);
            status == Some(ResponseStatus::Completed)
        });
        (completed.count(), ended.count())
    }
}

/// The number of the robot of this name: they are called after their numbers, counted from 1.
pub(super) fn number(robot: &RobotId) -> Option<usize> {
    let number = robot.as_str().strip_prefix("sim-")?;
    number.parse::<usize>().ok()?.checked_sub(1)
}

/// Whether the command says what a robot is to do from now on: to move, or to stand.
const fn decides_motion(command: CommandName) -> bool {
    use CommandName as Name;
    matches!(
        command,
        Name::Move
            | Name::Drive
            | Name::Stop
            | Name::Estop
            | Name::Scan
            | Name::Behave
            | Name::Goto
    )
}

const fn is_halt(command: CommandName) -> bool {
    matches!(command, CommandName::Stop | CommandName::Estop)
}
