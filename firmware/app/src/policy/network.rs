//! From an observation to an action.

use crawler_micromodel::vector::{Dense, MAX_WIDTH};

use super::action::Action;
use super::blob::{Mode, Policy};
use super::observation::{Observation, WIDTH};
use super::table::{chance, squeezed};

/// Steps of a logit, to one.
pub const LOGIT_STEPS: i32 = super::table::PRE_STEPS;
/// Logits beyond this are as good as certain, in [`LOGIT_STEPS`]; and no sum overflows.
const MOST: i32 = 1 << 20;

/// A network that is under way.
#[derive(Debug, Clone)]
pub struct Scratch {
    values: [i8; MAX_WIDTH],
    logits: [i32; Action::COUNT],
}

impl Scratch {
    /// Begins with what is observed.
    pub fn new(observation: &Observation) -> Self {
        let mut values = [0; MAX_WIDTH];
        values[..WIDTH].copy_from_slice(observation.numbers());
        Self {
            values,
            logits: [0; Action::COUNT],
        }
    }

    /// Runs the next layer.
    #[inline]
    pub fn run(&mut self, layer: &Dense<'_>) {
        let mut outputs = [0; MAX_WIDTH];
        let room = layer.outputs().min(MAX_WIDTH);
        layer.run(&self.values, &mut outputs[..room]);
        for (value, output) in self.values.iter_mut().zip(&outputs[..room]) {
            *value = squeezed(*output);
        }
        for (logit, output) in self.logits.iter_mut().zip(&outputs[..room]) {
            *logit = (*output).clamp(-MOST, MOST);
        }
    }

    /// What the last layer came to, in [`LOGIT_STEPS`].
    pub const fn logits(&self) -> &[i32; Action::COUNT] {
        &self.logits
    }

    /// The action, once the last layer was run. `random` is asked for a byte for each action where it is drawn.
    pub fn action(&self, mode: Mode, mut random: impl FnMut() -> u8) -> Action {
        let mut best = (i32::MIN, Action::Stand);
        for (logit, action) in self.logits.iter().zip(Action::ALL) {
            let value = match mode {
                Mode::Best => *logit,
                Mode::Drawn => logit + chance(random()),
            };
            // Of equal ones the first.
            if value > best.0 {
                best = (value, action);
            }
        }
        best.1
    }
}

/// Runs the whole network.
pub fn choose(
    policy: &Policy<'_>,
    observation: &Observation,
    random: impl FnMut() -> u8,
) -> Action {
    let mut scratch = Scratch::new(observation);
    for layer in policy.layers() {
        scratch.run(layer);
    }
    scratch.action(policy.mode, random)
}
