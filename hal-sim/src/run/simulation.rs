//! A simulation: see [`Simulation`].

use std::fmt;
use std::rc::Rc;

use crawler_app::{Config, Geometry};
use crawler_hal::{Clock, Duration, Instant};
use crawler_protocol::{Action, Command, Fleet, Kind, MAX_MESSAGE, RobotId, Source, Topic};

use super::error::SimulationError;
use super::fingerprint::Fingerprint;
use super::machine::{self, Program, SimRobot};
use super::tracker::{self, Camera};
use crate::net::NoNetwork;
use crate::net::lockstep::{Air, Cut};
use crate::scenario::{Scenario, Spawner};
use crate::sched::{Scheduler, SimClock};
use crate::world::{BodyEvent, Observation, PHYSICS_STEP, Pose, RobotIndex, World};

/// Unix time at the beginning of every simulated world: 2026-01-01, in milliseconds.
pub const EPOCH_MS: u64 = 1_767_225_600_000;
/// How often the state of the world goes into the history.
const HISTORY_PERIOD: Duration = Duration::from_millis(500);
/// How often robots are looked at that have not been given the initial command yet.
const START_PERIOD: Duration = Duration::from_millis(100);
/// How often robots are told the time: by the server of a lockstep world, or without a network
/// by the simulation.
const TIME_PERIOD: Duration = Duration::from_secs(5);
/// Who gives the commands of a simulation.
const SOURCE: &str = "simulator";
/// Voltage for which odometry is calibrated: a 2S pack in the middle of its charge.
const NOMINAL_V: f32 = 7.4;

/// How robots reach their broker.
pub(crate) enum Way {
    /// Not at all.
    None,
    /// In the process, in virtual time.
    Lockstep(Air),
    /// Over real sockets.
    #[cfg(feature = "live")]
    Live(crate::net::live::Gateway),
}

struct Machine {
    config: Config,
    index: RobotIndex,
    robot: Rc<SimRobot>,
    /// `None` without power, and after removal.
    program: Option<Program>,
    /// Number of its link, where links have numbers.
    link: usize,
    boots: u32,
}

/// A world whose bodies run the real robot program.
///
/// A value on one thread. In lockstep and without a network it is deterministic: the same
/// scenario, seed and calls give the same [`Simulation::history_hash`].
pub struct Simulation {
    scenario: Scenario,
    seed: u64,
    fleet: Fleet,
    sched: Scheduler,
    world: World,
    way: Way,
    machines: Vec<Machine>,
    spawner: Spawner,
    /// The camera above the arena.
    camera: Option<Camera>,
    /// Its client in a live world.
    #[cfg(feature = "live")]
    messenger: Option<crate::sched::TaskId>,
    /// Robots that wait for the initial command.
    waiting: Vec<u32>,
    action: Option<Action>,
    next_start: Instant,
    /// When the robots of a simulation without a network are told the time.
    next_time: Instant,
    /// When the next physics step ends.
    next_step: Instant,
    next_history: Instant,
    history: Fingerprint,
    seq: u64,
    /// Whom robots are to connect to.
    broker: (heapless::String<64>, u16),
}

impl Simulation {
    /// A simulation with a broker in the process and links in virtual time.
    ///
    /// # Errors
    /// See [`SimulationError`].
    pub fn lockstep(scenario: Scenario, seed: u64) -> Result<Self, SimulationError> {
        let clock = SimClock::new();
        let air = Air::new(scenario.link, seed, &clock);
        let fleet = Fleet::default();
        air.serve_time(&Topic::Time.render(&fleet), EPOCH_MS, TIME_PERIOD);
        let mut simulation = Self::with(
            scenario,
            seed,
            &clock,
            fleet,
            Way::Lockstep(air.clone()),
            (heapless::String::new(), 1883),
        )?;
        simulation.sched.spawn(air.run());
        Ok(simulation)
    }

    /// A simulation whose robots never find a network. Commands come through
    /// [`Simulation::submit`] and the simulation sets the robots' clocks, as the server does
    /// where there is one. Answers find no way out: a robot that keeps
    /// [`ADMIT_LIMIT`](crawler_app::outbox::ADMIT_LIMIT) of them refuses all but halts with
    /// `busy`, as a robot does that has lost its link.
    ///
    /// # Errors
    /// See [`SimulationError`].
    pub fn without_network(scenario: Scenario, seed: u64) -> Result<Self, SimulationError> {
        let nowhere = (heapless::String::new(), 1883);
        let clock = SimClock::new();
        Self::with(scenario, seed, &clock, Fleet::default(), Way::None, nowhere)
    }

    pub(crate) fn with(
        scenario: Scenario,
        seed: u64,
        clock: &SimClock,
        fleet: Fleet,
        way: Way,
        broker: (heapless::String<64>, u16),
    ) -> Result<Self, SimulationError> {
        scenario.validate()?;
        let action = scenario.action()?;
        let next_time = if matches!(way, Way::None) {
            Instant::BOOT
        } else {
            Instant::FAR_FUTURE
        };
        let arena = scenario.arena(seed)?;
        let spawner = scenario.spawner(&arena, seed);
        let world = World::with_parameters(arena, scenario.parameters, seed, clock)?;
        let robots = scenario.robots;
        let camera = Camera::new(scenario.tracker, seed).filter(|_| !matches!(way, Way::None));
        let mut simulation = Self {
            scenario,
            seed,
            fleet,
            sched: Scheduler::new(clock),
            world,
            way,
            machines: Vec::new(),
            spawner,
            camera,
            #[cfg(feature = "live")]
            messenger: None,
            waiting: Vec::new(),
            action,
            next_start: Instant::FAR_FUTURE,
            next_time,
            next_step: Instant::BOOT + PHYSICS_STEP,
            next_history: Instant::BOOT + HISTORY_PERIOD,
            history: Fingerprint::new(),
            seq: 0,
            broker,
        };
        for number in 1..=robots {
            match simulation.spawn() {
                Err(SimulationError::NoRoom(..)) => {
                    return Err(SimulationError::NoRoom(number, robots));
                }
                other => other?,
            };
        }
        #[cfg(feature = "live")]
        simulation.send_messenger(clock);
        Ok(simulation)
    }

    /// Connects the camera of a live world to the broker.
    #[cfg(feature = "live")]
    fn send_messenger(&mut self, clock: &SimClock) {
        if let (Way::Live(gateway), Some(_)) = (&self.way, &self.camera) {
            let outlet = Rc::clone(gateway.outlet());
            let network = gateway.service();
            let fleet = self.fleet.clone();
            let client = crate::net::tracker::run(fleet, outlet, network, clock.world());
            self.messenger = Some(self.sched.spawn(client));
        }
    }

    /// Takes the camera down, connection and all.
    #[cfg(feature = "live")]
    pub(crate) fn end_tracking(&mut self) {
        self.camera = None;
        if let Some(messenger) = self.messenger.take() {
            self.sched.remove(messenger);
        }
    }

    /// Adds a robot at a free place drawn from the seed, and boots it. Returns its number.
    ///
    /// # Errors
    /// [`SimulationError::NoRoom`] when no free place is found.
    pub fn spawn(&mut self) -> Result<usize, SimulationError> {
        let margin = self.scenario.parameters.chassis.radius_m + self.scenario.spawn.clearance;
        let world = &self.world;
        let all = self.machines.len() as u32 + 1;
        let pose = self
            .spawner
            .find(|pose| world.clearance(pose.x, pose.y, margin) >= margin)
            .ok_or(SimulationError::NoRoom(all, all))?;
        self.spawn_at(pose)
    }

    /// Adds a robot at `pose` and boots it. Returns its number.
    ///
    /// # Errors
    /// [`SimulationError::Placement`] when the place is not free.
    pub fn spawn_at(&mut self, pose: Pose) -> Result<usize, SimulationError> {
        let number = self.machines.len();
        let wiring = self.scenario.wiring(number);
        let (index, parts) = self.world.add_wired(pose, wiring)?;
        let config = self.config(number);
        let robot = machine::context(&config);
        let (program, link) = match &self.way {
            Way::None => (
                machine::start(&mut self.sched, &robot, parts, NoNetwork),
                number,
            ),
            Way::Lockstep(air) => {
                let network = air.add_link();
                let link = network.link();
                (
                    machine::start(&mut self.sched, &robot, parts, network),
                    link,
                )
            }
            #[cfg(feature = "live")]
            Way::Live(gateway) => (
                machine::start(&mut self.sched, &robot, parts, gateway.network()),
                number,
            ),
        };
        self.machines.push(Machine {
            config,
            index,
            robot,
            program: Some(program),
            link,
            boots: 1,
        });
        if self.action.is_some() {
            self.waiting.push(number as u32);
            self.next_start = self.next_start.min(self.sched.now() + START_PERIOD);
        }
        Ok(number)
    }

    /// Takes a robot out of the world, program and all. Its number is not used again.
    pub fn remove(&mut self, robot: usize) {
        if let Some(machine) = self.machines.get_mut(robot) {
            if let Some(program) = machine.program.take() {
                program.stop(&mut self.sched);
            }
            self.world.remove_robot(machine.index);
            self.waiting.retain(|&waiting| waiting as usize != robot);
        }
    }

    fn config(&self, number: usize) -> Config {
        let chassis = &self.scenario.parameters.chassis;
        let name = format!("sim-{:04}", number + 1);
        Config {
            // Letters, digits and a hyphen: always a valid id.
            id: RobotId::new(&name).unwrap_or_else(|_| unreachable!("{name} is a valid id")),
            fleet: self.fleet.clone(),
            broker_host: self.broker.0.clone(),
            broker_port: self.broker.1,
            kind: Kind::Simulated,
            board: "sim",
            firmware: env!("CARGO_PKG_VERSION"),
            geometry: Geometry {
                wheel_base_m: chassis.track_m,
                top_speed_mps: chassis.speed_at(NOMINAL_V),
                time_constant_s: chassis.driven_tau_s,
                // What a turning wheel settles by. A standing one starts a little later; that is
                // over within a step or two of the ramp.
                stiction_duty: chassis.dead_band(NOMINAL_V),
                nominal_v: NOMINAL_V,
                bridge_drop_v: chassis.bridge_drop_v,
            },
        }
    }

    /// The scenario.
    #[must_use]
    pub fn scenario(&self) -> &Scenario {
        &self.scenario
    }

    /// The seed.
    #[must_use]
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// The fleet all robots belong to.
    #[must_use]
    pub fn fleet(&self) -> &Fleet {
        &self.fleet
    }

    /// Time since the beginning of the world.
    #[must_use]
    pub fn now(&self) -> Instant {
        self.sched.now()
    }

    /// Unix time in milliseconds, as a lockstep world's server tells it.
    #[must_use]
    pub fn unix_ms(&self) -> u64 {
        EPOCH_MS + self.now().as_millis()
    }

    /// Number of robots ever added.
    #[must_use]
    pub fn robots(&self) -> usize {
        self.machines.len()
    }

    /// A robot's program as it is now; a new one after each boot.
    #[must_use]
    pub fn robot(&self, robot: usize) -> Option<&Rc<SimRobot>> {
        self.machines.get(robot).map(|machine| &machine.robot)
    }

    /// Name of a robot on the wire.
    #[must_use]
    pub fn id(&self, robot: usize) -> Option<&RobotId> {
        self.machines.get(robot).map(|machine| &machine.config.id)
    }

    /// How often a robot's program was started.
    #[must_use]
    pub fn boots(&self, robot: usize) -> u32 {
        self.machines.get(robot).map_or(0, |machine| machine.boots)
    }

    /// The truth about a robot.
    #[must_use]
    pub fn observe(&self, robot: usize) -> Option<Observation> {
        self.world.observe(self.machines.get(robot)?.index)
    }

    /// The world.
    #[must_use]
    pub fn world(&self) -> &World {
        &self.world
    }

    /// The world, to break things in it. Its robots and its time are the simulation's to change.
    pub fn world_mut(&mut self) -> &mut World {
        &mut self.world
    }

    /// Number of a robot in the world.
    #[must_use]
    pub fn index(&self, robot: usize) -> Option<RobotIndex> {
        self.machines.get(robot).map(|machine| machine.index)
    }

    /// The network of a lockstep simulation.
    #[must_use]
    pub fn air(&self) -> Option<&Air> {
        if let Way::Lockstep(air) = &self.way {
            Some(air)
        } else {
            None
        }
    }

    /// Number of robots that were added and not removed.
    #[must_use]
    pub fn present(&self) -> u32 {
        let observed = self
            .machines
            .iter()
            .filter_map(|m| self.world.observe(m.index));
        observed.filter(|seen| seen.present).count() as u32
    }

    /// The next moment at which anything but physics happens.
    #[must_use]
    pub fn next_due(&mut self) -> Instant {
        let due = self.sched.next_due().unwrap_or(Instant::FAR_FUTURE);
        due.min(self.next_start).min(self.next_time)
    }

    /// See [`Scheduler::wake_outer_when_ready`].
    #[cfg(feature = "live")]
    pub(crate) fn wake_when_ready(&self, waker: &std::task::Waker) -> bool {
        self.sched.wake_outer_when_ready(waker)
    }

    /// Polls of tasks so far.
    #[must_use]
    pub fn polls(&self) -> u64 {
        self.sched.polls()
    }

    /// Cuts or heals the link of a robot in lockstep; does nothing otherwise.
    pub fn cut(&mut self, robot: usize, cut: Cut) {
        if let (Way::Lockstep(air), Some(machine)) = (&self.way, self.machines.get(robot)) {
            air.cut(machine.link, cut);
        }
    }

    /// A fingerprint of all that happened so far: the full physical state twice a second, every
    /// boot, and in lockstep every message that robots published.
    #[must_use]
    pub fn history_hash(&self) -> u64 {
        let mut history = self.history;
        history.word(self.now().as_micros());
        history.word(self.world.hash());
        if let Way::Lockstep(air) = &self.way {
            history.word(air.fingerprint());
        }
        history.value()
    }

    /// Gives a robot a command and returns its sequence number. In lockstep it travels through
    /// the broker; otherwise it is handed to the program at once.
    pub fn submit(&mut self, robot: usize, action: Action) -> u64 {
        let (seq, payload) = self.compose(action);
        self.submit_raw(robot, &payload);
        seq
    }

    /// Gives a robot the bytes of a command, whatever they are. The way is that of
    /// [`Simulation::submit`].
    pub fn submit_raw(&mut self, robot: usize, payload: &[u8]) {
        let Some(machine) = self.machines.get(robot) else {
            return;
        };
        match (&self.way, &machine.program) {
            (Way::Lockstep(air), _) => {
                let topic = Topic::CommandRobot(machine.config.id.clone());
                air.publish(&topic.render(&self.fleet), payload, true, false);
            }
            (_, Some(program)) => {
                machine.robot.submit(payload, program.clock.now());
            }
            (_, None) => {}
        }
    }

    /// Gives every robot a command, by one message to the swarm where there is a broker. Returns
    /// its sequence number.
    pub fn submit_all(&mut self, action: Action) -> u64 {
        let (seq, payload) = self.compose(action);
        if let Way::Lockstep(air) = &self.way {
            let topic = Topic::CommandSwarm.render(&self.fleet);
            air.publish(&topic, &payload, true, false);
        } else {
            for robot in 0..self.machines.len() {
                self.submit_raw(robot, &payload);
            }
        }
        seq
    }

    fn compose(&mut self, action: Action) -> (u64, Vec<u8>) {
        self.seq += 1;
        let command = Command {
            action,
            timestamp: self.command_time(),
            seq: self.seq,
            source: Source::new(SOURCE).unwrap_or_else(|_| unreachable!("{SOURCE} is valid")),
        };
        let mut buffer = [0; MAX_MESSAGE];
        // Only a command with numbers that are not finite cannot be written. Robots refuse an
        // empty message, as they would refuse such a command.
        let len = command.to_json(&mut buffer).unwrap_or(0);
        (self.seq, buffer[..len].to_vec())
    }

    /// Unix time for commands: what robots take for the present.
    fn command_time(&self) -> u64 {
        if matches!(self.way, Way::Lockstep(_)) {
            return self.unix_ms();
        }
        self.machines
            .iter()
            .find_map(|machine| {
                let program = machine.program.as_ref()?;
                machine.robot.unix_ms(program.clock.now())
            })
            .unwrap_or_else(|| self.unix_ms())
    }

    /// Lets `span` pass.
    pub fn run_for(&mut self, span: Duration) {
        self.run_until(self.now() + span);
    }

    /// Lets time pass until `end`.
    pub fn run_until(&mut self, end: Instant) {
        loop {
            self.sched.run();
            if self.handle_events() {
                continue;
            }
            if self.sched.now() >= self.next_time {
                self.next_time += TIME_PERIOD;
                self.tell_time();
                continue;
            }
            if self.sched.now() >= self.next_start {
                self.start_waiting();
                continue;
            }
            let due = self.next_due();
            if !self.step_physics(due.min(end)) {
                continue;
            }
            if due > end {
                self.sched.advance_to(end);
                return;
            }
            self.sched.advance_to(due);
        }
    }

    /// Steps physics up to `target`. False when something happened that programs must see first;
    /// time then stands at the step in which it did.
    fn step_physics(&mut self, target: Instant) -> bool {
        while self.next_step <= target {
            self.sched.advance_to(self.next_step);
            self.world.step();
            self.next_step += PHYSICS_STEP;
            if self.sched.now() >= self.next_history {
                self.next_history += HISTORY_PERIOD;
                let hash = self.world.hash();
                self.history.word(hash);
            }
            // Both have something for programs to do.
            if self.track() | self.handle_events() {
                return false;
            }
        }
        true
    }

    /// Tells the robots whose turn it is where they are. Returns whether there were any.
    fn track(&mut self) -> bool {
        let Some(camera) = &mut self.camera else {
            return false;
        };
        let robots = self.machines.len();
        let most = match &self.way {
            Way::None | Way::Lockstep(_) => u64::MAX,
            #[cfg(feature = "live")]
            Way::Live(_) => tracker::LIVE_MOST_PER_S,
        };
        let due = camera.pass(PHYSICS_STEP, robots, most);
        for _ in 0..due {
            let number = camera.turn(robots);
            let machine = &self.machines[number];
            let Some(truth) = self.world.observe(machine.index).filter(|o| o.present) else {
                continue;
            };
            let pose = camera.see(truth.pose);
            let id = &machine.config.id;
            match &self.way {
                Way::None => {}
                Way::Lockstep(air) => {
                    let unix = EPOCH_MS + self.sched.now().as_millis();
                    if let Some(payload) = tracker::compose(id, unix, pose) {
                        let topic = Topic::Pose(id.clone()).render(&self.fleet);
                        air.publish(&topic, &payload, false, false);
                    }
                }
                #[cfg(feature = "live")]
                Way::Live(gateway) => gateway.outlet().push(id, pose, self.sched.now()),
            }
        }
        due > 0
    }

    /// Gives the initial command to robots that can take it by now.
    fn start_waiting(&mut self) {
        let Some(action) = self.action.clone() else {
            self.next_start = Instant::FAR_FUTURE;
            return;
        };
        let waiting = std::mem::take(&mut self.waiting);
        for number in waiting {
            let machine = &self.machines[number as usize];
            let ready = machine.program.as_ref().is_some_and(|program| {
                let booted = machine.boot_is_over();
                booted && machine.robot.unix_ms(program.clock.now()).is_some()
            });
            if ready {
                self.submit(number as usize, action.clone());
            } else {
                self.waiting.push(number);
            }
        }
        self.next_start = if self.waiting.is_empty() {
            Instant::FAR_FUTURE
        } else {
            self.now() + START_PERIOD
        };
    }

    /// Sets the clocks of robots that no server tells the time.
    fn tell_time(&self) {
        for machine in &self.machines {
            if let Some(program) = &machine.program {
                let now = program.clock.now();
                machine.robot.observe_time(self.unix_ms(), now);
            }
        }
    }

    /// Resets and power cuts. Returns whether there were any.
    fn handle_events(&mut self) -> bool {
        let events = self.world.take_events();
        for event in &events {
            let (BodyEvent::PowerLost(index) | BodyEvent::Reset(index, _)) = *event;
            // Robots are added to both in the same order.
            let number = index.get() as usize;
            let Some(machine) = self.machines.get_mut(number) else {
                continue;
            };
            if let Some(program) = machine.program.take() {
                program.stop(&mut self.sched);
            }
            let BodyEvent::Reset(_, cause) = *event else {
                continue;
            };
            let Some(parts) = self.world.boot(index, cause) else {
                continue;
            };
            machine.robot = machine::context(&machine.config);
            machine.boots += 1;
            let sched = &mut self.sched;
            machine.program = Some(match &self.way {
                Way::None => machine::start(sched, &machine.robot, parts, NoNetwork),
                Way::Lockstep(air) => {
                    machine::start(sched, &machine.robot, parts, air.rejoin(machine.link))
                }
                #[cfg(feature = "live")]
                Way::Live(gateway) => {
                    machine::start(sched, &machine.robot, parts, gateway.network())
                }
            });
            self.history.word(u64::from(index.get()));
            self.history.word(self.sched.now().as_micros());
        }
        !events.is_empty()
    }
}

impl Machine {
    fn boot_is_over(&self) -> bool {
        self.robot.snapshot().state != crawler_protocol::RobotState::Initializing
    }
}

impl fmt::Debug for Simulation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Simulation")
            .field("scenario", &self.scenario.name)
            .field("seed", &self.seed)
            .field("robots", &self.machines.len())
            .field("now", &self.now())
            .finish_non_exhaustive()
    }
}
