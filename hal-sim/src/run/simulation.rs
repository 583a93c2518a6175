//! A simulation: see [`Simulation`].
//!
//! Reading order: this file makes one; `step` lets time pass; `robots` adds, boots and removes;
//! `initial`, `direct` and `command` tell robots what to do; `faults` and `hostile` trouble them;
//! `outside` is what else can be done to it, `observe` and `history` what can be asked;
//! `updates` is by what they take new programs, `versions` keeps their versions;
//! `checkpoint` keeps a live one to go on from.

#[cfg(feature = "live")]
mod checkpoint;
mod command;
mod direct;
mod faults;
mod history;
mod hostile;
mod initial;
mod observe;
mod outside;
mod robots;
mod step;
mod updates;
mod versions;

use std::collections::BTreeMap;
use std::fmt;
use std::rc::Rc;

use crawler_app::Credentials;
use crawler_hal::{Duration, Instant};
use crawler_protocol::{Fleet, RobotId, Says, Topic};
use crawler_release::PublicKeys;

use super::director::Director;
use super::error::SimulationError;
use super::eyes::DetectorInstance;
use super::hashes::Hashes;
use super::journal::Journal;
use super::machine::{Program, SimRobot};
use super::overhead::OverheadCamera;
use super::parallel::ShardHandle;
use crate::devices::World;
#[cfg(feature = "live")]
use crate::net::fix::publisher;
use crate::net::lockstep::VirtualNetwork;
use crate::scenario::{Scenario, Spawner};
use crate::sched::{Scheduler, SimClock};
use crate::world::Fingerprint;
use crate::world::{Members, PHYSICS_STEP, RobotIndex};
use initial::Initial;
use versions::Versions;

#[cfg(feature = "live")]
pub(crate) use checkpoint::Checkpoint;

/// Unix time at the beginning of every simulated world: 2026-01-01, in milliseconds.
pub const EPOCH_MS: u64 = 1_767_225_600_000;
/// How often the state of the world goes into the history.
const HISTORY_PERIOD: Duration = Duration::from_secs(1);
/// How often robots are told the time: by the server of a lockstep world, or without a network
/// by the simulation.
const TIME_PERIOD: Duration = Duration::from_secs(5);

/// How the robots of a world in virtual time reach their broker.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Link {
    /// In the process, in virtual time.
    Lockstep,
    /// Not at all.
    None,
}

/// How robots reach their broker.
pub(crate) enum Way {
    /// Not at all.
    None,
    /// In the process, in virtual time.
    Lockstep(VirtualNetwork),
    /// Over real sockets.
    #[cfg(feature = "live")]
    Live(crate::net::live::Gateway),
}

struct Machine {
    id: RobotId,
    index: RobotIndex,
    /// `None` when another shard runs it.
    robot: Option<Rc<SimRobot>>,
    /// `None` without power, and after removal.
    program: Option<Program>,
    /// Number of its link, where links have numbers.
    link: usize,
    boots: u32,
    /// Of its state so far and of its boots.
    history: Fingerprint,
}

/// A world whose bodies run the real robot program.
///
/// A value on one thread. In lockstep and without a network it is deterministic: the same
/// scenario, seed and calls give the same [`Simulation::history_hash`], on one thread or, with
/// [`parallel::run`](super::parallel::run), on several.
pub struct Simulation {
    scenario: Scenario,
    seed: u64,
    fleet: Fleet,
    sched: Scheduler,
    world: World,
    way: Way,
    machines: Vec<Machine>,
    spawner: Spawner,
    /// Whoever runs the scenario.
    director: Director,
    /// The camera above the arena.
    camera: Option<OverheadCamera>,
    /// Its client in a live world.
    #[cfg(feature = "live")]
    messenger: Option<crate::sched::TaskId>,
    /// What every robot is told first.
    initial: Initial,
    /// When the robots of a simulation without a network are told the time.
    next_time: Instant,
    /// When the next physics step ends.
    next_step: Instant,
    next_history: Instant,
    /// When robots that listen are told who is near.
    next_cells: Instant,
    /// What they say to those near them, by number, in the step in which that is told.
    said: BTreeMap<usize, Says>,
    hashes: Hashes,
    /// Number of the newest command.
    seq: u64,
    /// What was done to it from outside.
    pub(super) journal: Journal,
    /// Where the other shards of the world are met.
    shard_handle: Option<ShardHandle>,
    /// What is broken about the robots, and until when.
    troubles: faults::Troubles,
    /// Whom robots are to connect to.
    broker: BrokerAddress,
    /// What their cameras are seen through with.
    detector: Option<Rc<DetectorInstance>>,
    /// Versions of programs from bundles.
    versions: Versions,
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

/// What robots are told of the world outside: where their broker is and what it wants to know of its clients, and
/// whose releases they believe.
#[derive(Debug, Clone, Default)]
pub(crate) struct BrokerAddress {
    pub(crate) host: heapless::String<64>,
    pub(crate) port: u16,
    pub(crate) credentials: Option<Credentials>,
    /// By which keys robots believe releases; without one they take no updates.
    pub(crate) release_keys: Option<PublicKeys>,
    /// Where their devices are recorded.
    #[cfg(feature = "recording")]
    pub(crate) event_logs: Option<super::event_log::EventLogs>,
}

impl Simulation {
    /// A simulation like [`Simulation::lockstep`] whose robots take releases that are signed with one of these
    /// keys.
    ///
    /// # Errors
    /// See [`SimulationError`].
    pub fn updating(
        scenario: Scenario,
        seed: u64,
        keys: PublicKeys,
    ) -> Result<Self, SimulationError> {
        let given = BrokerAddress {
            release_keys: Some(keys),
            ..BrokerAddress::default()
        };
        let mut simulation = Self::lockstep_given(scenario, seed, given, None)?;
        // The keys are no part of what it could be repeated from.
        simulation.journal.withhold();
        Ok(simulation)
    }

    /// A simulation with a broker in the process and links in virtual time.
    ///
    /// # Errors
    /// See [`SimulationError`].
    pub fn lockstep(scenario: Scenario, seed: u64) -> Result<Self, SimulationError> {
        Self::lockstep_shard(scenario, seed, None)
    }

    /// A simulation like [`Simulation::linked`] whose robots boot with a tap on every device.
    /// Its history is that of one without.
    ///
    /// # Errors
    /// See [`SimulationError`].
    #[cfg(feature = "recording")]
    pub fn recorded(
        link: Link,
        scenario: Scenario,
        seed: u64,
        event_logs: super::event_log::EventLogs,
    ) -> Result<Self, SimulationError> {
        let given = BrokerAddress {
            event_logs: Some(event_logs),
            ..BrokerAddress::default()
        };
        match link {
            Link::Lockstep => Self::lockstep_given(scenario, seed, given, None),
            Link::None => Self::without_network_with(scenario, seed, given, None),
        }
    }

    /// One shard of such a simulation, or all of it.
    pub(crate) fn lockstep_shard(
        scenario: Scenario,
        seed: u64,
        shard_handle: Option<ShardHandle>,
    ) -> Result<Self, SimulationError> {
        Self::lockstep_given(scenario, seed, BrokerAddress::default(), shard_handle)
    }

    fn lockstep_given(
        scenario: Scenario,
        seed: u64,
        nowhere: BrokerAddress,
        shard_handle: Option<ShardHandle>,
    ) -> Result<Self, SimulationError> {
        let clock = SimClock::new();
        let network = VirtualNetwork::with_radio(&scenario.radio_setup(seed), &clock);
        let fleet = Fleet::default();
        network.serve_time(&Topic::Time.render(&fleet), EPOCH_MS, TIME_PERIOD);
        if shard_handle.is_some() {
            network.share();
        }
        let way = Way::Lockstep(network);
        Self::with(scenario, seed, &clock, fleet, way, nowhere, shard_handle)
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
        Self::shard_without_network(scenario, seed, None)
    }

    /// One shard of such a simulation, or all of it.
    pub(crate) fn shard_without_network(
        scenario: Scenario,
        seed: u64,
        shard_handle: Option<ShardHandle>,
    ) -> Result<Self, SimulationError> {
        Self::without_network_with(scenario, seed, BrokerAddress::default(), shard_handle)
    }

    fn without_network_with(
        scenario: Scenario,
        seed: u64,
        nowhere: BrokerAddress,
        shard_handle: Option<ShardHandle>,
    ) -> Result<Self, SimulationError> {
        let fleet = Fleet::default();
        let clock = SimClock::new();
        Self::with(
            scenario,
            seed,
            &clock,
            fleet,
            Way::None,
            nowhere,
            shard_handle,
        )
    }

    pub(crate) fn with(
        scenario: Scenario,
        seed: u64,
        clock: &SimClock,
        fleet: Fleet,
        way: Way,
        broker: BrokerAddress,
        shard_handle: Option<ShardHandle>,
    ) -> Result<Self, SimulationError> {
        let robots = scenario.robots;
        let mut simulation =
            Self::deserted(scenario, seed, clock, fleet, way, broker, shard_handle)?;
        for number in 1..=robots {
            match simulation.place(None) {
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

    /// The same without a robot.
    fn deserted(
        scenario: Scenario,
        seed: u64,
        clock: &SimClock,
        fleet: Fleet,
        way: Way,
        broker: BrokerAddress,
        shard_handle: Option<ShardHandle>,
    ) -> Result<Self, SimulationError> {
        scenario.validate()?;
        let initial = Initial::new(scenario.action()?);
        let next_time = if matches!(way, Way::None) {
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
        let detector = scenario.detector.map(DetectorInstance::new).transpose()?;
        let camera =
            OverheadCamera::new(scenario.tracker, seed).filter(|_| !matches!(way, Way::None));
        Ok(Self {
            scenario,
            seed,
            fleet,
            sched: Scheduler::new(clock),
            world,
            way,
            machines: Vec::new(),
            spawner,
            director,
            camera,
            #[cfg(feature = "live")]
            messenger: None,
            initial,
            next_time,
            next_step: Instant::BOOT + PHYSICS_STEP,
            next_history: Instant::BOOT + HISTORY_PERIOD,
            next_cells: Instant::BOOT + crawler_cells::PERIOD,
            said: BTreeMap::new(),
            hashes: Hashes::default(),
            seq: command::FIRST_SEQ,
            journal: Journal::default(),
            shard_handle,
            troubles: faults::Troubles::default(),
            broker,
            detector,
            versions: Versions::default(),
        })
    }

    /// Connects the camera of a live world to the broker.
    #[cfg(feature = "live")]
    fn send_messenger(&mut self, clock: &SimClock) {
        if let (Way::Live(gateway), Some(_)) = (&self.way, &self.camera) {
            let outlet = Rc::clone(gateway.outlet());
            let network = gateway.service();
            let fleet = self.fleet.clone();
            let credentials = self.broker.credentials.clone();
            let (host, clock) = (self.broker.host.clone(), clock.world());
            let network = gateway.secure(network, Box::new(|| None));
            let client = publisher::run(fleet, credentials, outlet, network, host, clock);
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
    /// Its program and the context that it runs on, while it runs in this shard.
    fn running(&self) -> Option<(&Rc<SimRobot>, &Program)> {
        self.robot.as_ref().zip(self.program.as_ref())
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
