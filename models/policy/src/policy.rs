//! What was learned: a network that chooses actions.

use crate::batch::Runner;
use crate::categorical;
use crate::checkpoint::{CheckpointError, Kind, Reader, Writer};
use crate::compute::Compute;
use crate::config::Hidden;
use crate::environment::{Environment, Episode, Seed, Status};
use crate::network::{Activation, Network};
use crate::random::{self, Purpose};

/// How an action is chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Choice {
    /// The one with the largest output. Whoever learned by sampling may stand still for ever so, where two
    /// robots wait for each other.
    Best,
    /// With the probability that the outputs give it.
    Sampled,
}

/// A network that chooses actions.
#[derive(Debug, Clone)]
pub struct Policy {
    network: Network,
}

/// What a file of a policy is told apart by: nothing but its kind.
const FINGERPRINT: [u8; 32] = [0; 32];

impl Policy {
    pub(crate) const fn new(network: Network) -> Self {
        Self { network }
    }

    /// Its network.
    pub const fn network(&self) -> &Network {
        &self.network
    }

    /// The policy as bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        let shape = self.network.shape();
        let mut writer = Writer::new(Kind::Policy, FINGERPRINT);
        writer.u64(shape.inputs as u64);
        writer.u64(shape.outputs as u64);
        writer.u8(shape.hidden.len() as u8);
        for units in &shape.hidden {
            writer.u64(*units as u64);
        }
        writer.u8(shape.activation as u8);
        writer.f32s(self.network.parameters());
        writer.finish()
    }

    /// Reads what [`to_bytes`](Self::to_bytes) wrote.
    ///
    /// # Errors
    /// When the bytes are something else, or the network is none that could have been learned.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, CheckpointError> {
        let mut reader = Reader::new(bytes, Kind::Policy)?;
        reader.expect(FINGERPRINT)?;
        let mut size = |most: u64| match reader.u64()? {
            size if (1..=most).contains(&size) => Ok(size as usize),
            _ => Err(CheckpointError::Invalid("shape")),
        };
        let (inputs, outputs) = (size(4_096)?, size(256)?);
        let layers = reader.u8()?;
        let mut units = Vec::new();
        for _ in 0..layers {
            units.push(usize::try_from(reader.u64()?).unwrap_or(usize::MAX));
        }
        let activation = match reader.u8()? {
            0 => Activation::Tanh,
            1 => Activation::Relu,
            _ => return Err(CheckpointError::Invalid("activation")),
        };
        let hidden = Hidden { units, activation };
        hidden
            .validate()
            .map_err(|_| CheckpointError::Invalid("shape"))?;
        let mut network = Network::zero(hidden.shape(inputs, outputs));
        network.change(|parameters| reader.f32s(parameters, "weights"))?;
        reader.finish()?;
        Ok(Self { network })
    }

    /// Plays the evaluation episodes with these numbers, each in an environment that `make` makes. What comes out
    /// is in their order, and does not depend on the threads.
    pub fn evaluate<E: Environment>(
        &self,
        choice: Choice,
        compute: &Compute,
        numbers: std::ops::Range<u32>,
        make: impl Fn() -> E + Sync,
    ) -> Vec<Episode> {
        let mut episodes: Vec<(u32, Option<Episode>)> =
            numbers.map(|number| (number, None)).collect();
        let mut scratch: Vec<Runner> = (0..compute.threads())
            .map(|_| Runner::new(&self.network))
            .collect();
        Compute::spread(&mut episodes, &mut scratch, |runner, part| {
            let mut environment = make();
            for (number, episode) in part {
                *episode = Some(self.episode(choice, compute, runner, &mut environment, *number));
            }
        });
        episodes
            .into_iter()
            .filter_map(|(_, episode)| episode)
            .collect()
    }

    fn episode<E: Environment>(
        &self,
        choice: Choice,
        compute: &Compute,
        runner: &mut Runner,
        environment: &mut E,
        number: u32,
    ) -> Episode {
        let interface = environment.interface();
        environment.reset(Seed::evaluation(number));
        let mut rng = random::stream(u64::from(number), Purpose::Decisions, (0, 0));
        let mut actions = vec![0; interface.agents];
        let mut rewards = vec![0.0; interface.agents];
        let mut probabilities = vec![0.0; interface.actions];
        runner.reserve(&self.network, interface.agents);
        let (mut reward, mut length) = (0.0, 0);
        loop {
            let rows = runner.inputs.chunks_exact_mut(interface.observation);
            for (agent, row) in rows.enumerate() {
                environment.observe(agent, row);
            }
            runner.run(&self.network, compute);
            let outputs = runner.outputs.chunks_exact_mut(interface.actions);
            for (action, outputs) in actions.iter_mut().zip(outputs) {
                *action = match choice {
                    Choice::Best => categorical::best(outputs) as u8,
                    Choice::Sampled => {
                        categorical::normalise(outputs, &mut probabilities);
                        categorical::sample(&probabilities, random::uniform(&mut rng)) as u8
                    }
                };
            }
            let status = environment.step(&actions, &mut rewards);
            reward += rewards.iter().sum::<f32>() / interface.agents as f32;
            length += 1;
            if status != Status::Running {
                return Episode {
                    reward,
                    length,
                    succeeded: environment.succeeded(),
                };
            }
        }
    }
}
