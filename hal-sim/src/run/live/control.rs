//! What can be told to a live world: stand still, step, go at another pace, begin again, robots
//! more and fewer, faults.

use std::fmt;
use std::time::Instant as Real;

use crawler_hal::{Duration, Instant};
use crawler_protocol::{RobotId, SimulatorCommand};
use tokio::sync::oneshot;

use super::driver::Driver;
use crate::run::Step;
use crate::run::control::Factor;
use crate::world::Pose;

/// Orders that may wait; one more is refused.
pub(super) const MAX_ORDERS: usize = 64;

/// How a live world is, as far as it can be told what to do.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct LiveState {
    /// Whether it stands still.
    pub paused: bool,
    /// How many times as fast as real time it is to run.
    pub factor: f64,
    /// Time since its beginning.
    pub time: Instant,
    /// Its seed.
    pub seed: u64,
    /// Robots in it.
    pub robots: u32,
    /// Fingerprint of its history at the end of the last whole second; 0 before there is one.
    /// Live worlds do not repeat it: their robots' messages take as long as they take.
    pub hash: u64,
}

/// What came of an order.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct LiveDone {
    /// How the world is now.
    pub state: LiveState,
    /// The robot that was added.
    pub robot: Option<RobotId>,
}

/// Why a live world does not do what it is told.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum ControlError {
    /// Too many orders are waiting.
    Busy,
    /// The world has ended.
    Ended,
    /// There is no such robot.
    NoRobot,
    /// It cannot be done, and why.
    Refused(String),
}

impl fmt::Display for ControlError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Busy => f.write_str("too many orders are waiting"),
            Self::Ended => f.write_str("the world has ended"),
            Self::NoRobot => f.write_str("there is no such robot in the world"),
            Self::Refused(text) => f.write_str(text),
        }
    }
}

impl std::error::Error for ControlError {}

type Answer = oneshot::Sender<Result<LiveDone, ControlError>>;

/// Something a live world is to do.
#[derive(Debug)]
pub(super) struct Order {
    pub(super) command: SimulatorCommand,
    pub(super) answer: Answer,
}

/// Real time as the world is to follow it: at a factor, and with pauses left out.
#[derive(Debug)]
pub(super) struct Watch {
    base: Instant,
    since: Real,
    factor: Factor,
    paused: bool,
}

impl Watch {
    pub(super) fn start(now: Real) -> Self {
        Self {
            base: Instant::BOOT,
            since: now,
            factor: Factor::REAL_TIME,
            paused: false,
        }
    }

    pub(super) fn is_paused(&self) -> bool {
        self.paused
    }

    pub(super) fn factor(&self) -> f64 {
        self.factor.get()
    }

    pub(super) fn read(&self, now: Real) -> Instant {
        if self.paused {
            return self.base;
        }
        self.base + self.factor.of(now.saturating_duration_since(self.since))
    }

    /// When the watch will show `due`; `None` while it stands, or far too late to matter.
    pub(super) fn when(&self, due: Instant) -> Option<Real> {
        if self.paused || due == Instant::FAR_FUTURE {
            return None;
        }
        let span = due.saturating_since(self.base).as_micros() as f64 / self.factor.get();
        let span = std::time::Duration::try_from_secs_f64(span * 1e-6).ok()?;
        self.since.checked_add(span)
    }

    fn settle(&mut self, now: Real) {
        self.base = self.read(now);
        self.since = now;
    }

    fn set_factor(&mut self, factor: Factor, now: Real) {
        self.settle(now);
        self.factor = factor;
    }

    fn set_paused(&mut self, paused: bool, now: Real) {
        self.settle(now);
        self.paused = paused;
    }

    /// Shows `base` from now on: the world went there by itself.
    fn put(&mut self, base: Instant, now: Real) {
        self.base = base;
        self.since = now;
    }
}

/// Steps under way.
#[derive(Debug)]
pub(super) struct Stepping {
    pub(super) end: Instant,
    answer: Answer,
}

impl Driver<'_> {
    /// Does what it was told since the last turn.
    pub(super) fn obey(&mut self) {
        while let Ok(Order { command, answer }) = self.orders.try_recv() {
            let now = Real::now();
            let ends_steps = matches!(
                command,
                SimulatorCommand::Pause
                    | SimulatorCommand::Resume
                    | SimulatorCommand::Step { .. }
                    | SimulatorCommand::Reset { .. }
            );
            if ends_steps && let Some(stepping) = self.stepping.take() {
                self.watch.put(self.pacer.real(self.simulation.now()), now);
                self.answer(stepping.answer, Ok(None));
            }
            if let SimulatorCommand::Step { steps } = command {
                self.watch.set_paused(true, now);
                let span = Step::Physics.span().as_micros();
                let begun = self.simulation.now().as_micros() / span;
                let end = Instant::from_micros((begun + u64::from(steps)).saturating_mul(span));
                self.stepping = Some(Stepping { end, answer });
                continue;
            }
            let done = self.carry_out(&command, now);
            self.answer(answer, done);
        }
    }

    /// Goes on, at the pace of real time.
    pub(super) fn wake_up(&mut self) {
        let now = Real::now();
        if let Some(stepping) = self.stepping.take() {
            self.watch.put(self.pacer.real(self.simulation.now()), now);
            self.answer(stepping.answer, Ok(None));
        }
        self.watch.set_factor(Factor::REAL_TIME, now);
        self.watch.set_paused(false, now);
    }

    /// Goes on with the steps under way, for at most `most`.
    pub(super) fn step_on(&mut self, most: Duration) {
        let Some(stepping) = &self.stepping else {
            return;
        };
        let end = stepping.end;
        let target = end.min(self.simulation.now() + most);
        self.simulation.run_until(target);
        if target < end {
            return;
        }
        self.watch.put(self.pacer.real(end), Real::now());
        if let Some(stepping) = self.stepping.take() {
            self.answer(stepping.answer, Ok(None));
        }
    }

    fn answer(&mut self, answer: Answer, done: Result<Option<RobotId>, ControlError>) {
        let state = self.tell_state();
        // Whoever asked may not want to know any more.
        let _ = answer.send(done.map(|robot| LiveDone { state, robot }));
    }

    /// Puts the state where everybody can see it.
    pub(super) fn tell_state(&mut self) -> LiveState {
        let state = LiveState {
            paused: self.watch.is_paused(),
            factor: self.watch.factor(),
            time: self.simulation.now(),
            seed: self.simulation.seed(),
            robots: self.simulation.present(),
            hash: self.simulation.second_hashes().last().copied().unwrap_or(0),
        };
        self.board.set_state(state);
        state
    }

    fn carry_out(
        &mut self,
        command: &SimulatorCommand,
        now: Real,
    ) -> Result<Option<RobotId>, ControlError> {
        let refused = |error: &dyn fmt::Display| ControlError::Refused(error.to_string());
        match command {
            SimulatorCommand::Pause => self.watch.set_paused(true, now),
            SimulatorCommand::Resume => self.watch.set_paused(false, now),
            SimulatorCommand::Speed { factor } => {
                let factor = Factor::new(f64::from(*factor)).map_err(|error| refused(&error))?;
                self.watch.set_factor(factor, now);
            }
            SimulatorCommand::Reset { seed } => self.begin_again(*seed, now)?,
            SimulatorCommand::Add { pose } => {
                self.make_room()?;
                let added = match pose {
                    Some(place) => {
                        let pose = Pose::new(place.x, place.y, place.theta);
                        self.simulation.spawn_at(pose)
                    }
                    None => self.simulation.spawn(),
                };
                let robot = added.map_err(|error| refused(&error))?;
                return Ok(self.simulation.id(robot).cloned());
            }
            SimulatorCommand::Remove { robot } => {
                let robot = self.number(robot)?;
                // Its connection closes without a goodbye, and the broker publishes its last
                // will at once. Not every broker does that after a goodbye that asks for it.
                self.take_out(robot);
            }
            SimulatorCommand::Snapshot { .. } | SimulatorCommand::Restore { .. } => {
                return Err(refused(&crate::run::snapshot::SnapshotError::Live));
            }
            SimulatorCommand::Inject {
                robot,
                fault,
                lasting_ms,
            } => {
                let robot = self.number(robot)?;
                let lasting = lasting_ms.map(|ms| Duration::from_millis(ms.into()));
                let broken = self.simulation.inject(robot, *fault, lasting);
                broken.map_err(|error| refused(&error))?;
            }
            SimulatorCommand::Heal { robot } => {
                let robot = self.number(robot)?;
                self.simulation.heal(robot);
            }
            SimulatorCommand::Step { .. } => {}
        }
        Ok(None)
    }

    fn number(&self, id: &RobotId) -> Result<usize, ControlError> {
        (0..self.simulation.robots())
            .find(|&robot| self.simulation.id(robot) == Some(id))
            .filter(|&robot| {
                self.simulation
                    .observe(robot)
                    .is_some_and(|seen| seen.present)
            })
            .ok_or(ControlError::NoRobot)
    }

    /// Sockets for one more robot.
    fn make_room(&self) -> Result<(), ControlError> {
        let need = u64::from(self.simulation.present()) + 1 + super::SPARE_DESCRIPTORS;
        let have = rlimit::increase_nofile_limit(2 * need);
        let have = have.map_err(|error| ControlError::Refused(error.to_string()))?;
        if have < need {
            let text = format!("{need} open files are needed and {have} allowed");
            return Err(ControlError::Refused(text));
        }
        Ok(())
    }

    /// The same scenario from its beginning. Connections of its robots close, as when they are
    /// removed, and the new ones connect.
    fn begin_again(&mut self, seed: Option<u64>, now: Real) -> Result<(), ControlError> {
        let seed = seed.unwrap_or(self.simulation.seed());
        let (gateway, simulation) = (self.make)(seed, self.given.clone())
            .map_err(|error| ControlError::Refused(error.to_string()))?;
        self.log.close(&self.simulation, self.board);
        self.empty_world();
        self.gateway = gateway;
        self.simulation = simulation;
        self.next_place = Instant::BOOT;
        self.pacer = super::Pacer::new();
        let factor = self.watch.factor;
        let paused = self.watch.paused;
        self.watch = Watch::start(now);
        self.watch.factor = factor;
        self.watch.paused = paused;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration as StdDuration;

    #[test]
    fn a_watch_leaves_pauses_out_and_runs_at_its_factor() {
        let begun = Real::now();
        let after = |ms| begun + StdDuration::from_millis(ms);
        let mut watch = Watch::start(begun);
        assert_eq!(watch.read(after(250)), Instant::from_millis(250));
        watch.set_factor(Factor::new(4.0).expect("usable"), after(1_000));
        assert_eq!(watch.read(after(1_500)), Instant::from_millis(3_000));
        assert_eq!(watch.when(Instant::from_millis(5_000)), Some(after(2_000)));
        watch.set_paused(true, after(2_000));
        assert_eq!(watch.read(after(60_000)), Instant::from_millis(5_000));
        assert_eq!(watch.when(Instant::from_millis(6_000)), None);
        watch.put(Instant::from_millis(5_010), after(61_000));
        watch.set_paused(false, after(62_000));
        assert_eq!(watch.read(after(62_500)), Instant::from_millis(7_010));
        assert_eq!(watch.when(Instant::FAR_FUTURE), None);
    }
}
