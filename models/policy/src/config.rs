//! What configurations of both algorithms have in common: networks, and limits.

use std::error::Error;
use std::fmt;

use crate::checkpoint::Writer;
use crate::environment::{Environment, Interface};
use crate::network::{Activation, Shape};

/// A value of a configuration, or something of an environment, is outside of what can be learned with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ConfigError {
    /// What is wrong.
    pub field: &'static str,
    /// What it may be.
    pub allowed: &'static str,
}

impl fmt::Display for ConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.field, self.allowed)
    }
}

impl Error for ConfigError {}

/// Says what is wrong unless `right`.
pub(crate) fn check(
    right: bool,
    field: &'static str,
    allowed: &'static str,
) -> Result<(), ConfigError> {
    if right {
        Ok(())
    } else {
        Err(ConfigError { field, allowed })
    }
}

/// The hidden part of a network.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Hidden {
    /// Units of each layer, from the inputs on: 1 to 4 layers of 1 to 1,024 units.
    pub units: Vec<usize>,
    /// After each of them.
    pub activation: Activation,
}

impl Default for Hidden {
    /// Two layers of 64 units with the hyperbolic tangent.
    fn default() -> Self {
        Self {
            units: vec![64, 64],
            activation: Activation::Tanh,
        }
    }
}

impl Hidden {
    pub(crate) fn validate(&self) -> Result<(), ConfigError> {
        let layers = (1..=4).contains(&self.units.len());
        check(layers, "hidden.units", "1 to 4 layers")?;
        let units = self.units.iter().all(|units| (1..=1_024).contains(units));
        check(units, "hidden.units", "1 to 1,024 units in a layer")
    }

    pub(crate) fn shape(&self, inputs: usize, outputs: usize) -> Shape {
        Shape {
            inputs,
            hidden: self.units.clone(),
            outputs,
            activation: self.activation,
        }
    }

    pub(crate) fn write(&self, writer: &mut Writer) {
        writer.u64(self.units.len() as u64);
        self.units
            .iter()
            .for_each(|units| writer.u64(*units as u64));
        writer.u8(self.activation as u8);
    }
}

/// The interface that all of these have.
pub(crate) fn interface<E: Environment>(environments: &[E]) -> Result<Interface, ConfigError> {
    let count = (1..=4_096).contains(&environments.len());
    check(count, "environments", "1 to 4,096 of them")?;
    let interface = environments[0].interface();
    let alike = environments.iter().all(|e| e.interface() == interface);
    check(alike, "environments", "all with one interface")?;
    check(
        (1..=10_000).contains(&interface.agents),
        "agents",
        "1 to 10,000",
    )?;
    let observation = (1..=4_096).contains(&interface.observation);
    check(observation, "observation", "1 to 4,096 numbers")?;
    check(interface.state <= 65_536, "state", "at most 65,536 numbers")?;
    check(
        (2..=256).contains(&interface.actions),
        "actions",
        "2 to 256",
    )?;
    Ok(interface)
}

/// A learning rate that falls from `first` in a straight line, to a part of it after all rounds.
pub(crate) fn falling(first: f64, last: f64, round: u64, rounds: u64) -> f64 {
    let left = 1.0 - (round as f64 / rounds as f64).min(1.0);
    first * (last + (1.0 - last) * left)
}

/// Most samples in a round.
const SAMPLES: usize = 1 << 24;

/// What configurations of both algorithms have.
pub(crate) struct Shared<'a> {
    pub(crate) hidden: &'a Hidden,
    pub(crate) rounds: u64,
    pub(crate) steps: usize,
    pub(crate) minibatch: usize,
    pub(crate) rate: f64,
    pub(crate) final_rate: f64,
    pub(crate) gamma: f32,
    pub(crate) gradient: f32,
}

impl Shared<'_> {
    /// Checks it against `interface` and the number of environments.
    pub(crate) fn validate(
        &self,
        interface: &Interface,
        environments: usize,
    ) -> Result<(), ConfigError> {
        self.hidden.validate()?;
        check(self.rounds > 0, "rounds", "at least 1")?;
        let samples = self
            .steps
            .checked_mul(environments * interface.agents)
            .is_some_and(|samples| (2..=SAMPLES).contains(&samples));
        check(samples, "steps", "2 to 2²⁴ samples in a round")?;
        let minibatch = (1..=65_536).contains(&self.minibatch);
        check(minibatch, "minibatch", "1 to 65,536")?;
        let rate = self.rate > 0.0 && self.rate <= 1.0;
        check(rate, "rate", "above 0, at most 1")?;
        let final_rate = (0.0..=1.0).contains(&self.final_rate);
        check(final_rate, "final_rate", "0 to 1")?;
        check((0.0..=1.0).contains(&self.gamma), "gamma", "0 to 1")?;
        let gradient = self.gradient > 0.0 && self.gradient.is_finite();
        check(gradient, "gradient", "above 0")
    }
}

impl Interface {
    pub(crate) fn write(&self, writer: &mut Writer) {
        for size in [self.agents, self.observation, self.state, self.actions] {
            writer.u64(size as u64);
        }
    }
}

/// The loss is no number any more: learning has to begin anew, with a lower rate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Diverged;

impl fmt::Display for Diverged {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the gradient is not finite: learn with a lower rate")
    }
}

impl Error for Diverged {}
