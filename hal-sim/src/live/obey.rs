//! A live world does what it is told: stand still, step, go at another pace, begin again or
//! elsewhere, robots and things more and fewer, faults.

use std::fmt;
use std::time::Instant as Real;

use crawler_hal::{Duration, Instant};
use crawler_protocol::{FaultCommand, RobotId};
use crawler_sim_protocol::{ScenarioName, SimulatorCommand};

use super::control::{Answer, ControlError, LiveDone, LiveState, Order};
use super::driver::{Beginning, Driver};
use crate::run::control::Factor;
use crate::scenario::Scenario;
use crate::tools::debugger::Step;
use crate::world::{DropError, Dropped, Pose};

/// What an order has brought into the world.
#[derive(Default)]
struct Made {
    robot: Option<RobotId>,
    item: Option<u32>,
}

fn refused(why: impl fmt::Display) -> ControlError {
    ControlError::Refused(why.to_string())
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
                    | SimulatorCommand::Load { .. }
                    | SimulatorCommand::Restore { .. }
            );
            if ends_steps && let Some(stepping) = self.stepping.take() {
                self.watch.put(self.pacer.real(self.simulation.now()), now);
                self.answer(stepping.answer, Ok(Made::default()));
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
            self.answer(stepping.answer, Ok(Made::default()));
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
            self.answer(stepping.answer, Ok(Made::default()));
        }
    }

    fn answer(&mut self, answer: Answer, done: Result<Made, ControlError>) {
        let state = self.tell_state();
        // Whoever asked may not want to know any more.
        let _ = answer.send(done.map(|Made { robot, item }| LiveDone { state, robot, item }));
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

    fn carry_out(&mut self, command: &SimulatorCommand, now: Real) -> Result<Made, ControlError> {
        match command {
            SimulatorCommand::Pause => self.watch.set_paused(true, now),
            SimulatorCommand::Resume => self.watch.set_paused(false, now),
            SimulatorCommand::Speed { factor } => {
                let factor = Factor::new(f64::from(*factor)).map_err(refused)?;
                self.watch.set_factor(factor, now);
            }
            SimulatorCommand::Reset { seed } => {
                let scenario = self.simulation.scenario().clone();
                let seed = seed.unwrap_or(self.simulation.seed());
                self.begin(&Beginning::New(Box::new(scenario), seed), now)?;
            }
            SimulatorCommand::Load {
                scenario,
                robots,
                seed,
            } => self.load(scenario, *robots, *seed, now)?,
            SimulatorCommand::Add { pose } => {
                self.make_room(self.simulation.present() + 1)?;
                let added = match pose {
                    Some(place) => {
                        let pose = Pose::new(place.x, place.y, place.theta);
                        self.simulation.spawn_at(pose)
                    }
                    None => self.simulation.spawn(),
                };
                let robot = added.map_err(refused)?;
                return Ok(Made {
                    robot: self.simulation.id(robot).cloned(),
                    item: None,
                });
            }
            SimulatorCommand::Remove { robot } => {
                let robot = self.number(robot)?;
                // Its connection closes without a goodbye, and the broker publishes its last
                // will at once. Not every broker does that after a goodbye that asks for it.
                self.take_out(robot);
            }
            SimulatorCommand::Snapshot { name } => {
                let kept = self.simulation.keep();
                self.bookmarks.add(name, kept).map_err(refused)?;
                self.tell_bookmarks();
            }
            SimulatorCommand::Restore { name } => {
                let kept = self.bookmarks.get(name).map_err(refused)?;
                self.make_room(kept.present())?;
                self.begin(&Beginning::Again(&kept), now)?;
            }
            SimulatorCommand::Forget { name } => {
                self.bookmarks.remove(name).map_err(refused)?;
                self.tell_bookmarks();
            }
            SimulatorCommand::Fault(FaultCommand::Inject {
                robot,
                fault,
                lasting_ms,
            }) => {
                let robot = self.number(robot)?;
                let lasting = lasting_ms.map(|ms| Duration::from_millis(ms.into()));
                let broken = self.simulation.inject(robot, *fault, lasting);
                broken.map_err(refused)?;
            }
            SimulatorCommand::Fault(FaultCommand::Heal { robot }) => {
                let robot = self.number(robot)?;
                self.simulation.heal(robot);
            }
            SimulatorCommand::Drop { what } => {
                let item = self.drop_in(*what)?;
                self.tell_arena();
                return Ok(Made {
                    robot: None,
                    item: Some(item),
                });
            }
            SimulatorCommand::Take { item } => {
                if !self.simulation.take_away(*item) {
                    return Err(refused(format!(
                        "nothing that was dropped has number {item}"
                    )));
                }
                self.tell_arena();
            }
            SimulatorCommand::Step { .. } => {}
        }
        Ok(Made::default())
    }

    fn drop_in(&mut self, what: Dropped) -> Result<u32, ControlError> {
        self.simulation.drop_in(what).map_err(|error| match error {
            DropError::OnRobot(index) => match self.simulation.id(index.get() as usize) {
                Some(id) => refused(format!("{id} stands there")),
                None => refused(error),
            },
            other => refused(other),
        })
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

    /// Sockets for so many robots.
    fn make_room(&self, robots: u32) -> Result<(), ControlError> {
        super::make_room(self.files_each, robots).map_err(refused)
    }

    /// Begins a scenario that comes with the crate, in place of the one that runs.
    fn load(
        &mut self,
        name: &ScenarioName,
        robots: Option<u32>,
        seed: Option<u64>,
        now: Real,
    ) -> Result<(), ControlError> {
        let mut scenario = Scenario::built_in(name.as_str()).map_err(refused)?;
        let running = self.simulation.scenario();
        if scenario.radio != running.radio || scenario.link != running.link {
            // It stands between robots and broker since the world began, and boards may be in it.
            let text = "its radio is another one, which a world gets only when it is started";
            return Err(refused(text));
        }
        scenario.detector = running.detector;
        scenario.policy.clone_from(&running.policy);
        if let Some(robots) = robots {
            scenario.robots = robots;
        }
        let seed = seed.unwrap_or(self.simulation.seed());
        self.make_room(scenario.robots)?;
        self.begin(&Beginning::New(Box::new(scenario), seed), now)
    }

    /// Begins another world. Connections of the robots of the one that runs close, as when they
    /// are removed, and the new ones connect.
    fn begin(&mut self, beginning: &Beginning<'_>, now: Real) -> Result<(), ControlError> {
        let made = (self.make)(beginning, self.given.clone());
        let (gateway, simulation) = made.map_err(refused)?;
        self.log.close(&self.simulation, self.board);
        self.empty_world();
        self.gateway = gateway;
        self.simulation = simulation;
        if let Beginning::Again(kept) = beginning {
            // Links that were lost are lost again; the old robots' have just been mended.
            self.simulation.go_on(kept);
        }
        self.next_place = Instant::BOOT;
        self.pacer = super::Pacer::new();
        self.watch.put(self.simulation.now(), now);
        self.tell_arena();
        Ok(())
    }
}
