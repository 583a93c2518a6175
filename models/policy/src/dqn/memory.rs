//! What was experienced, to be learned from again and again; the oldest is forgotten.

use crate::checkpoint::{CheckpointError, Reader, Writer};
use crate::environment::Interface;

/// One step of an agent, or a few in a row as one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Transition<'a> {
    pub(super) observation: &'a [f32],
    pub(super) action: u8,
    /// Of all steps, discounted.
    pub(super) reward: f32,
    /// What an estimate for `next` counts: 0 where the episode was over.
    pub(super) discount: f32,
    pub(super) next: &'a [f32],
}

/// See the [module](self).
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Memory {
    capacity: usize,
    observation: usize,
    actions: usize,
    /// Observation and next observation of each.
    observations: Vec<f32>,
    taken: Vec<u8>,
    /// Reward and discount of each.
    numbers: Vec<f32>,
    /// Where the next one goes.
    at: usize,
}

impl Memory {
    pub(super) fn new(capacity: usize, interface: &Interface) -> Self {
        Self {
            capacity,
            observation: interface.observation,
            actions: interface.actions,
            observations: Vec::new(),
            taken: Vec::new(),
            numbers: Vec::new(),
            at: 0,
        }
    }

    pub(super) const fn len(&self) -> usize {
        self.taken.len()
    }

    pub(super) fn push(&mut self, transition: &Transition<'_>) {
        let numbers = [transition.reward, transition.discount];
        if self.len() < self.capacity {
            self.observations.extend_from_slice(transition.observation);
            self.observations.extend_from_slice(transition.next);
            self.taken.push(transition.action);
            self.numbers.extend_from_slice(&numbers);
        } else {
            let width = 2 * self.observation;
            let row = &mut self.observations[self.at * width..][..width];
            let (observation, next) = row.split_at_mut(self.observation);
            observation.copy_from_slice(transition.observation);
            next.copy_from_slice(transition.next);
            self.taken[self.at] = transition.action;
            self.numbers[self.at * 2..][..2].copy_from_slice(&numbers);
        }
        self.at = (self.at + 1) % self.capacity;
    }

    /// Forgets everything.
    pub(super) fn clear(&mut self) {
        self.observations.clear();
        self.taken.clear();
        self.numbers.clear();
        self.at = 0;
    }

    /// The transition at `index`, which is below [`len`](Self::len).
    pub(super) fn get(&self, index: usize) -> Transition<'_> {
        let width = 2 * self.observation;
        let row = &self.observations[index * width..][..width];
        let (observation, next) = row.split_at(self.observation);
        Transition {
            observation,
            action: self.taken[index],
            reward: self.numbers[index * 2],
            discount: self.numbers[index * 2 + 1],
            next,
        }
    }

    pub(super) fn write(&self, writer: &mut Writer) {
        writer.u64(self.len() as u64);
        writer.u64(self.at as u64);
        writer.f32s(&self.observations);
        writer.raw(&self.taken);
        writer.f32s(&self.numbers);
    }

    pub(super) fn read(&mut self, reader: &mut Reader<'_>) -> Result<(), CheckpointError> {
        let invalid = CheckpointError::Invalid("memory");
        let length = usize::try_from(reader.u64()?).map_err(|_| invalid)?;
        let at = usize::try_from(reader.u64()?).map_err(|_| invalid)?;
        let follows = length == self.capacity || at == length % self.capacity;
        if length > self.capacity || at >= self.capacity || !follows {
            return Err(invalid);
        }
        // No more memory is taken than there are bytes.
        if reader.left() < length * self.observation {
            return Err(CheckpointError::Damaged);
        }
        self.at = at;
        self.observations.resize(length * 2 * self.observation, 0.0);
        reader.f32s(&mut self.observations, "memory")?;
        self.taken = reader.raw(length)?.to_vec();
        if self
            .taken
            .iter()
            .any(|action| usize::from(*action) >= self.actions)
        {
            return Err(invalid);
        }
        self.numbers.resize(length * 2, 0.0);
        reader.f32s(&mut self.numbers, "memory")
    }
}
