//! A world at work: time passes, and what is due happens, each in its turn.
//!
//! Nothing here is written into a journal, whoever asks for it: what comes from outside is noted one level up, in
//! `inputs`, and what the scenario does is no input.

use std::rc::Rc;

use crawler_hal::{Duration, Instant};
use crawler_protocol::{Action, Fleet};

use super::cells::Cells;
use super::command::CommandNumbers;
use super::history::History;
use super::initial::Initial;
use super::population::Population;
use super::programs::{BrokerAddress, Programs};
use super::tracking::Tracking;
use super::troubles::Troubles;
use super::uplink::{Link, Uplink, Way};
use super::{EPOCH_MS, TIME_PERIOD};
use crate::devices::World;
use crate::run::director::Director;
use crate::run::error::SimulationError;
use crate::run::parallel::ShardHandle;
use crate::scenario::Scenario;
use crate::sched::{Scheduler, SimClock};
use crate::world::{Members, PHYSICS_STEP, Pose};

/// See the [module](self).
pub(super) struct Runtime {
    pub(super) scenario: Rc<Scenario>,
    pub(super) seed: u64,
    pub(super) population: Population,
    pub(super) uplink: Uplink,
    /// Whoever runs the scenario.
    pub(super) director: Director,
    /// What every robot is told first.
    pub(super) initial: Initial,
    pub(super) commands: CommandNumbers,
    /// What is broken about the robots, and until when.
    pub(super) troubles: Troubles,
    pub(super) tracking: Tracking,
    pub(super) cells: Cells,
    pub(super) history: History,
    /// When the robots of a simulation without a network are told the time.
    next_time: Instant,
    /// When the next physics step ends.
    next_step: Instant,
    /// Where the other shards of the world are met.
    shard_handle: Option<ShardHandle>,
}

impl Runtime {
    /// The world of a scenario without a robot.
    pub(super) fn deserted(
        scenario: Scenario,
        seed: u64,
        clock: &SimClock,
        (fleet, way): (Fleet, Way),
        broker: BrokerAddress,
        shard_handle: Option<ShardHandle>,
    ) -> Result<Self, SimulationError> {
        scenario.validate()?;
        let initial = Initial::new(scenario.action()?);
        let uplink = Uplink::new(fleet, way);
        let next_time = if uplink.link() == Some(Link::None) {
            Instant::BOOT
        } else {
            Instant::FAR_FUTURE
        };
        let arena = scenario.arena(seed)?;
        let spawner = scenario.spawner(&arena, seed);
        let director = Director::new(&scenario, &arena, seed);
        let members = shard_handle
            .as_ref()
            .map_or(Members::ALL, ShardHandle::members);
        let parameters = scenario.drawn_parameters(seed);
        let world = World::replica(arena, parameters, seed, clock, members)?;
        let scenario = Rc::new(scenario);
        let programs = Programs::new(&scenario, broker)?;
        Ok(Self {
            tracking: Tracking::new(scenario.tracker, seed, &uplink),
            scenario,
            seed,
            population: Population::new(Scheduler::new(clock), world, programs, spawner),
            uplink,
            director,
            initial,
            commands: CommandNumbers::new(),
            troubles: Troubles::default(),
            cells: Cells::new(),
            history: History::new(),
            next_time,
            next_step: Instant::BOOT + PHYSICS_STEP,
            shard_handle,
        })
    }

    /// Has its robots, each at a free place, and its camera.
    pub(super) fn populate(&mut self, clock: &SimClock) -> Result<(), SimulationError> {
        let robots = self.scenario.robots;
        for number in 1..=robots {
            match self.place(None) {
                Err(SimulationError::NoRoom(..)) => {
                    return Err(SimulationError::NoRoom(number, robots));
                }
                other => other?,
            };
        }
        self.connect_camera(clock);
        Ok(())
    }

    /// Connects the camera of a live world to the broker.
    pub(super) fn connect_camera(&mut self, clock: &SimClock) {
        #[cfg(feature = "live")]
        self.tracking
            .connect(&mut self.population, &self.uplink, clock);
        #[cfg(not(feature = "live"))]
        let _ = clock;
    }

    /// Time goes on after `now`, when physics has taken so many `steps`.
    #[cfg(feature = "live")]
    pub(super) fn skip_to(&mut self, now: Instant, steps: u64) {
        self.population.sched.advance_to(now);
        let next = (steps + 1).saturating_mul(PHYSICS_STEP.as_micros());
        self.next_step = Instant::from_micros(next);
        self.cells = Cells::go_on(now);
        self.director.skip_to(now);
    }

    pub(super) fn now(&self) -> Instant {
        self.population.sched.now()
    }

    /// Unix time in milliseconds, as a lockstep world's server tells it.
    pub(super) fn unix_ms(&self) -> u64 {
        EPOCH_MS + self.now().as_millis()
    }

    /// Whether this is one of several shards of a world and another one has failed.
    pub(super) fn is_cut_off(&self) -> bool {
        self.shard_handle
            .as_ref()
            .is_some_and(ShardHandle::is_cut_off)
    }

    /// The next moment at which anything but physics happens.
    pub(super) fn next_due(&mut self) -> Instant {
        let due = self.population.sched.next_due();
        due.unwrap_or(Instant::FAR_FUTURE)
            .min(self.initial.due())
            .min(self.next_time)
            .min(self.troubles.next())
            .min(self.director.next_due())
            .min(self.uplink.next_due())
    }

    /// Lets time pass until `end`.
    pub(super) fn run_until(&mut self, end: Instant) {
        while !self.is_cut_off() {
            // What arrives in this moment comes before what programs make of it.
            if let Some(network) = self.uplink.network() {
                network.process();
            }
            self.population.sched.run();
            if self.population.handle_events(&self.uplink) {
                continue;
            }
            let now = self.now();
            if now >= self.next_time {
                self.next_time += TIME_PERIOD;
                self.tell_time();
                continue;
            }
            if now >= self.troubles.next() {
                self.pass_troubles();
                continue;
            }
            if now >= self.initial.due() {
                self.start_waiting();
                continue;
            }
            if now >= self.director.next_due() {
                self.direct();
                continue;
            }
            let due = self.next_due();
            if !self.step_physics(due.min(end)) {
                continue;
            }
            self.population.sched.advance_to(due.min(end));
            if due > end {
                return;
            }
        }
    }

    /// Steps physics up to `target`. False when something happened that programs must see first;
    /// time then stands at the step in which it did.
    fn step_physics(&mut self, target: Instant) -> bool {
        while self.next_step <= target {
            self.population.sched.advance_to(self.next_step);
            self.population.world.step();
            self.next_step += PHYSICS_STEP;
            if !self.exchange() {
                return false;
            }
            self.history.pass(&mut self.population, &self.uplink);
            let told = self.tracking.pass(&self.population, &self.uplink)
                | self.cells.tell(&self.population, &self.uplink);
            // All of them have something for programs to do.
            if told | self.population.handle_events(&self.uplink) {
                return false;
            }
        }
        true
    }

    /// What robots did to each other in this step: hands on their messages, shares airtime anew,
    /// and with several shards tells the others how the members fare and hears of theirs. False
    /// when the run is over because another shard has failed.
    fn exchange(&mut self) -> bool {
        self.cells.listen(&self.population);
        let network = self.uplink.network();
        match (&mut self.shard_handle, network) {
            (Some(shard_handle), network) => {
                let said = self.cells.said_mut();
                if !shard_handle.trade(&mut self.population.world, network, said) {
                    return false;
                }
            }
            (None, Some(network)) => network.settle(),
            (None, None) => {}
        }
        if let Some(network) = network {
            network.look(|link| {
                let pose = self.population.pose(link)?;
                Some((pose.x, pose.y))
            });
        }
        true
    }

    /// Sets the clocks of robots that no server tells the time.
    fn tell_time(&self) {
        for machine in self.population.iter() {
            if let Some((robot, program)) = machine.running() {
                program.tell_time(robot, self.unix_ms());
            }
        }
    }

    /// Adds a robot at `pose`, or at a free place drawn from the seed, and boots it. Returns its number.
    pub(super) fn place(&mut self, pose: Option<Pose>) -> Result<usize, SimulationError> {
        let pose = match pose {
            Some(pose) => pose,
            None => self.population.free_place()?,
        };
        let number = self.population.add(pose, &self.uplink)?;
        self.director.add(pose);
        let machine = self.population.get(number);
        if machine.is_some_and(|machine| machine.robot().is_some()) {
            self.initial.wait(number, self.now());
        }
        Ok(number)
    }

    /// Takes a robot out of the world, program and all. Its number is not used again.
    pub(super) fn remove(&mut self, robot: usize) {
        self.troubles.forget(robot);
        if self.population.remove(robot) {
            self.initial.forget(robot);
        }
    }

    /// Gives a robot a command, or what pretends to be one. Whoever attacks it hears that.
    pub(super) fn hand(&mut self, robot: usize, payload: &[u8]) {
        self.troubles.overhear(robot, payload);
        if let Some(machine) = self.population.get(robot) {
            self.uplink.command(machine, payload);
        }
    }

    /// Gives every robot a command, by one message to the swarm where there is a broker.
    pub(super) fn hand_all(&mut self, payload: &[u8]) {
        if !self.uplink.command_all(payload) {
            for robot in 0..self.population.len() {
                self.hand(robot, payload);
            }
        }
    }

    /// Numbers and writes a command from outside.
    pub(super) fn compose(&mut self, action: Action) -> (u64, Vec<u8>) {
        let timestamp = self.command_time();
        self.commands.write(action, timestamp)
    }

    /// Unix time for commands: what robots take for the present.
    pub(super) fn command_time(&self) -> u64 {
        #[cfg(feature = "live")]
        if self.uplink.link().is_none() {
            use crawler_hal::Clock as _;
            let told = self.population.iter().find_map(|machine| {
                let (robot, program) = machine.running()?;
                robot.unix_ms(program.clock.now())
            });
            return told.unwrap_or_else(|| self.unix_ms());
        }
        self.unix_ms()
    }

    /// When a fault that lasts so long is over.
    pub(super) fn until(&self, lasting: Option<Duration>) -> Instant {
        lasting.map_or(Instant::FAR_FUTURE, |lasting| self.now() + lasting)
    }
}
