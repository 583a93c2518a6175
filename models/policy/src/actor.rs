//! An environment that is acted in, episode after episode.

use crate::environment::{Environment, Episode, Interface, Seed, Status};

/// See the [module](self).
#[derive(Debug)]
pub(crate) struct Actor<E> {
    pub(crate) environment: E,
    interface: Interface,
    run: u64,
    /// Which environment of the run this is.
    pub(crate) number: u32,
    /// How many episodes have begun.
    begun: u32,
    /// The actions of the running episode.
    taken: Vec<u8>,
    reward: f32,
    /// Since somebody looked.
    pub(crate) finished: Vec<Episode>,
}

/// What an actor goes on from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Progress {
    pub(crate) begun: u32,
    pub(crate) taken: Vec<u8>,
}

/// The steps kept do not fit the environment: it ended the episode before they did.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Mismatch;

impl<E: Environment> Actor<E> {
    /// Begins the first episode.
    pub(crate) fn new(environment: E, run: u64, number: u32) -> Self {
        let interface = environment.interface();
        let mut actor = Self {
            environment,
            interface,
            run,
            number,
            begun: 0,
            taken: Vec::new(),
            reward: 0.0,
            finished: Vec::new(),
        };
        actor.begin();
        actor
    }

    /// Begins the next episode.
    pub(crate) fn begin(&mut self) {
        let seed = Seed::training(self.run, self.number, self.begun);
        self.environment.reset(seed);
        self.begun = self.begun.wrapping_add(1);
        self.taken.clear();
        self.reward = 0.0;
    }

    /// Every agent acts. After the end of an episode the next one has to be begun.
    pub(crate) fn step(&mut self, actions: &[u8], rewards: &mut [f32]) -> Status {
        let status = self.environment.step(actions, rewards);
        self.taken.extend_from_slice(actions);
        self.reward += rewards.iter().sum::<f32>() / rewards.len() as f32;
        if status != Status::Running {
            self.finished.push(Episode {
                reward: self.reward,
                length: (self.taken.len() / self.interface.agents) as u32,
                succeeded: self.environment.succeeded(),
            });
        }
        status
    }

    /// Writes what each agent observes, one after the other.
    pub(crate) fn observe(&self, out: &mut [f32]) {
        for (agent, out) in out.chunks_exact_mut(self.interface.observation).enumerate() {
            self.environment.observe(agent, out);
        }
    }

    /// Writes what a privileged critic sees for each agent.
    pub(crate) fn state(&self, out: &mut [f32]) {
        for (agent, out) in out.chunks_exact_mut(self.interface.state).enumerate() {
            self.environment.state(agent, out);
        }
    }

    /// The last action of each agent; none at the beginning of an episode.
    pub(crate) fn last(&self) -> &[u8] {
        let earlier = self.taken.len().saturating_sub(self.interface.agents);
        &self.taken[earlier..]
    }

    pub(crate) fn progress(&self) -> Progress {
        Progress {
            begun: self.begun,
            taken: self.taken.clone(),
        }
    }

    /// Goes on from there: the running episode is begun again, and the same actions taken. `each` is called
    /// after every one of them with what was observed before, the actions, their rewards, and what is observed now.
    ///
    /// # Errors
    /// See [`Mismatch`].
    pub(crate) fn resume(
        &mut self,
        progress: &Progress,
        mut each: impl FnMut(&[f32], &[u8], &[f32], &[f32]),
    ) -> Result<(), Mismatch> {
        self.begun = progress.begun.checked_sub(1).ok_or(Mismatch)?;
        self.begin();
        let agents = self.interface.agents;
        let mut observed = vec![0.0; agents * self.interface.observation];
        let mut now = observed.clone();
        let mut rewards = vec![0.0; agents];
        self.observe(&mut observed);
        for actions in progress.taken.chunks(agents) {
            let known = |action: &u8| usize::from(*action) < self.interface.actions;
            if actions.len() < agents || !actions.iter().all(known) {
                return Err(Mismatch);
            }
            if self.step(actions, &mut rewards) != Status::Running {
                return Err(Mismatch);
            }
            self.observe(&mut now);
            each(&observed, actions, &rewards, &now);
            core::mem::swap(&mut observed, &mut now);
        }
        Ok(())
    }
}
