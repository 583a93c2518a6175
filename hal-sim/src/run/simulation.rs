//! A simulation: see [`Simulation`].
//!
//! Reading order: this file makes one, `inputs` is what can be done to it and `observe` what can be asked of it; these
//! three are a thin surface, whose one duty is that whatever comes from outside is in the journal. Below it `runtime`
//! lets time pass over the parts, each of which has its own state and its own promise:
//!
//! | module | what it has |
//! |---|---|
//! | `population` | bodies, programs and links of the robots, under one number each |
//! | `programs`, with `updates` and `versions` | what programs are started with |
//! | `uplink` | the way to the broker, and what is published there |
//! | `initial`, `command` | the command that every robot gets first; how commands are numbered |
//! | `troubles`, with `hostile` | what is broken, and until when |
//! | `tracking`, `cells` | what robots are told of where they and others are |
//! | `history` | the fingerprints of all that happens |
//!
//! `direct` and `troubles` say what the runtime does when the scenario or a fault is due, and `checkpoint` keeps a live
//! one to go on from.

mod cells;
#[cfg(feature = "live")]
mod checkpoint;
mod command;
mod direct;
mod history;
mod hostile;
mod initial;
mod inputs;
mod observe;
mod population;
mod programs;
mod runtime;
mod tracking;
mod troubles;
mod updates;
mod uplink;
mod versions;

use std::fmt;

use crawler_hal::Duration;
use crawler_protocol::{Fleet, Topic};
use crawler_release::PublicKeys;

use super::error::SimulationError;
use super::journal::Journal;
use super::parallel::ShardHandle;
use crate::net::lockstep::VirtualNetwork;
use crate::scenario::Scenario;
use crate::sched::SimClock;
use runtime::Runtime;

#[cfg(feature = "live")]
pub(crate) use checkpoint::Checkpoint;
pub(crate) use programs::BrokerAddress;
pub use programs::credentials;
pub use uplink::Link;
pub(crate) use uplink::Way;

/// Unix time at the beginning of every simulated world: 2026-01-01, in milliseconds.
pub const EPOCH_MS: u64 = 1_767_225_600_000;
/// How often robots are told the time: by the server of a lockstep world, or without a network
/// by the simulation.
const TIME_PERIOD: Duration = Duration::from_secs(5);

/// A world whose bodies run the real robot program.
///
/// A value on one thread. In lockstep and without a network it is deterministic: the same
/// scenario, seed and calls give the same [`Simulation::history_hash`], on one thread or, with
/// [`parallel::run`](super::parallel::run), on several.
pub struct Simulation {
    runtime: Runtime,
    /// What was done to it from outside.
    journal: Journal,
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
        let way = (fleet, way);
        Self::with(scenario, seed, &clock, way, nowhere, shard_handle)
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
        let way = (Fleet::default(), Way::None);
        let clock = SimClock::new();
        Self::with(scenario, seed, &clock, way, nowhere, shard_handle)
    }

    pub(crate) fn with(
        scenario: Scenario,
        seed: u64,
        clock: &SimClock,
        way: (Fleet, Way),
        broker: BrokerAddress,
        shard_handle: Option<ShardHandle>,
    ) -> Result<Self, SimulationError> {
        let mut runtime = Runtime::deserted(scenario, seed, clock, way, broker, shard_handle)?;
        runtime.populate(clock)?;
        Ok(Self::of(runtime))
    }

    fn of(runtime: Runtime) -> Self {
        Self {
            runtime,
            journal: Journal::default(),
        }
    }

    /// A simulation whose robots reach their broker by `link`.
    ///
    /// # Errors
    /// See [`SimulationError`].
    pub fn linked(link: Link, scenario: Scenario, seed: u64) -> Result<Self, SimulationError> {
        match link {
            Link::Lockstep => Self::lockstep(scenario, seed),
            Link::None => Self::without_network(scenario, seed),
        }
    }

    /// The same scenario from the beginning, with `seed` or with the seed of this one.
    ///
    /// # Errors
    /// [`SimulationError::Live`] for a live one, and what the first time may have failed with.
    pub fn anew(&self, seed: Option<u64>) -> Result<Self, SimulationError> {
        let link = self.link().ok_or(SimulationError::Live)?;
        let seed = seed.unwrap_or(self.seed());
        Self::linked(link, self.scenario().clone(), seed)
    }

    /// Keeps the world as it is, but for its programs.
    #[cfg(feature = "live")]
    pub(crate) fn keep(&self) -> Checkpoint {
        self.runtime.keep()
    }

    /// A simulation in which the robots of a kept one stand again, each where it was and under its
    /// name. [`Simulation::go_on`] does the rest before time passes.
    ///
    /// # Errors
    /// See [`SimulationError`].
    #[cfg(feature = "live")]
    pub(crate) fn again(
        kept: &Checkpoint,
        way: (Fleet, Way),
        broker: BrokerAddress,
    ) -> Result<Self, SimulationError> {
        Runtime::again(kept, way, broker).map(Self::of)
    }

    /// Breaks what was broken, and goes on from the kept state of bodies and flash.
    #[cfg(feature = "live")]
    pub(crate) fn go_on(&mut self, kept: &Checkpoint) {
        self.runtime.go_on(kept);
    }

    /// Takes the camera down, connection and all.
    #[cfg(feature = "live")]
    pub(crate) fn end_tracking(&mut self) {
        let runtime = &mut self.runtime;
        runtime.tracking.end(&mut runtime.population);
    }
}

impl fmt::Debug for Simulation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Simulation")
            .field("scenario", &self.scenario().name)
            .field("seed", &self.seed())
            .field("robots", &self.robots())
            .field("now", &self.now())
            .finish_non_exhaustive()
    }
}
