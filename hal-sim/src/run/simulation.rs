//! A simulation: see [`Simulation`].

mod command;
mod observe;
mod robots;
mod step;

use std::fmt;
use std::rc::Rc;

use crawler_app::{Config, Credentials};
use crawler_hal::{Duration, Instant};
use crawler_protocol::{Action, Fleet, Topic};

use super::error::SimulationError;
use super::fingerprint::Fingerprint;
use super::machine::{Program, SimRobot};
use super::tracker::Camera;
use crate::net::lockstep::Air;
use crate::scenario::{Scenario, Spawner};
use crate::sched::{Scheduler, SimClock};
use crate::world::{PHYSICS_STEP, RobotIndex, World};

/// Unix time at the beginning of every simulated world: 2026-01-01, in milliseconds.
pub const EPOCH_MS: u64 = 1_767_225_600_000;
/// How often the state of the world goes into the history.
const HISTORY_PERIOD: Duration = Duration::from_millis(500);
/// How often robots are looked at that have not been given the initial command yet.
const START_PERIOD: Duration = Duration::from_millis(100);
/// How often robots are told the time: by the server of a lockstep world, or without a network
/// by the simulation.
const TIME_PERIOD: Duration = Duration::from_secs(5);

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
    broker: BrokerAddress,
}

/// Name and password for a broker, as robots hold them.
///
/// # Errors
/// [`SimulationError::Credentials`] when the name is longer than 32 bytes or the password longer
/// than 64.
pub fn credentials(name: &str, password: &str) -> Result<Credentials, SimulationError> {
    Ok(Credentials {
        username: name.try_into().map_err(|_| SimulationError::Credentials)?,
        password: password
            .try_into()
            .map_err(|_| SimulationError::Credentials)?,
    })
}

/// Where a broker is, and what it wants to know of its clients.
#[derive(Debug, Default)]
pub(crate) struct BrokerAddress {
    pub(crate) host: heapless::String<64>,
    pub(crate) port: u16,
    pub(crate) credentials: Option<Credentials>,
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
            BrokerAddress::default(),
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
        let nowhere = BrokerAddress::default();
        let clock = SimClock::new();
        Self::with(scenario, seed, &clock, Fleet::default(), Way::None, nowhere)
    }

    pub(crate) fn with(
        scenario: Scenario,
        seed: u64,
        clock: &SimClock,
        fleet: Fleet,
        way: Way,
        broker: BrokerAddress,
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
            let credentials = self.broker.credentials.clone();
            let client =
                crate::net::tracker::run(fleet, credentials, outlet, network, clock.world());
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
