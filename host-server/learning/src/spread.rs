//! The task of the thesis as an environment: three robots are to get apart, and to touch nothing.
//!
//! | | |
//! |---|---|
//! | world | the built-in scenario `spread`, a new one for each episode |
//! | decision | every 100 ms; 500 of them at most, then the episode is broken off |
//! | success | each robot at least 1.2 m from each other one for 3 s on end |
//! | failure | any contact |
//!
//! The reward of a step is what the least distance of two robots has gained (4 for all of it), less 0.005 for the time;
//! 0.05 while they are apart; 5 in the end; −10 for who touches something, and −3 for the others. Where the shield had
//! to take something away it is 0.01 less: what it does is not to be leant on.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use crawler_app::controller::{PERIOD, Tuning};
use crawler_app::parameters::{Parameter, Parameters};
use crawler_app::policy::{Action, Observation, STEPS, WIDTH};
use crawler_hal::Duration;
use crawler_policy::{Environment, Interface, Seed, Status};
use crawler_sim::run::bare::{BareWorld, Steering};
use crawler_sim::scenario::{Scenario, ScenarioError};

use crate::agent::Agent;
use crate::outside::{Outside, index};

/// The scenario of the task.
const SCENARIO: &str = "spread";
/// Time from the beginning of a world to the order.
const BOOT: Duration = Duration::from_millis(1_200);
/// Most decisions of an episode.
const LONGEST: u32 = 500;
/// Robots are apart from here on, in metres.
const APART_M: f32 = 1.2;
/// More than this earns nothing, in metres.
const WANTED_M: f32 = 1.3;
/// For so many decisions they have to be.
const HELD: u32 = 30;
/// Numbers of what a privileged critic sees beside the observation.
const PRIVILEGED: usize = 8;
/// Where in an observation it says that the shield took something.
const LESS: usize = 46;

/// How an episode stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Outcome {
    Running,
    Apart,
    Touched,
    Late,
}

/// One episode after the other of the task.
#[derive(Debug, Clone)]
pub struct Spread {
    scenario: Arc<Scenario>,
    episode: Option<Episode>,
    /// Counts decisions from which the shield took something.
    vetoes: Option<Arc<AtomicU64>>,
}

#[derive(Debug, Clone)]
struct Episode {
    world: BareWorld,
    outside: Outside,
    agents: Vec<Agent>,
    tuning: Tuning,
    critical_mm: u16,
    contacts: Vec<u32>,
    least_m: f32,
    steps: u32,
    held: u32,
    outcome: Outcome,
}

/// How an episode went.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Driven {
    /// Seconds to its end.
    pub took_s: f32,
    /// Whether robots got apart.
    pub apart: bool,
    /// Whether one touched something.
    pub touched: bool,
}

impl Spread {
    /// The task, with parameters drawn as `scenario` says.
    pub const fn new(scenario: Arc<Scenario>) -> Self {
        Self {
            scenario,
            episode: None,
            vetoes: None,
        }
    }

    /// The same, adding to `vetoes` how many decisions the shield took something from.
    pub(crate) const fn counting(scenario: Arc<Scenario>, vetoes: Arc<AtomicU64>) -> Self {
        Self {
            scenario,
            episode: None,
            vetoes: Some(vetoes),
        }
    }

    /// The scenario of the task.
    ///
    /// # Errors
    /// Never: it is a part of this program, and a test reads it.
    pub fn scenario() -> Result<Scenario, ScenarioError> {
        Scenario::built_in(SCENARIO)
    }

    /// Whether worlds can be drawn from `scenario`. Takes long where not.
    pub fn can_be_drawn(scenario: &Scenario) -> bool {
        let mut world = Self::new(Arc::new(scenario.clone()));
        world.reset(Seed::training(0, 0, 0));
        world.episode.is_some()
    }

    /// How the last episode went, or has gone so far.
    pub fn driven(&self) -> Option<Driven> {
        self.episode.as_ref().map(|episode| Driven {
            took_s: episode.steps as f32 * 0.1,
            apart: episode.outcome == Outcome::Apart,
            touched: episode.outcome == Outcome::Touched,
        })
    }

    /// What `agent` observes, in whole numbers.
    pub fn observation(&self, agent: usize) -> Observation {
        let agent = self.episode.as_ref().and_then(|e| e.agents.get(agent));
        agent.map_or(Observation::NOTHING, |agent| *agent.observation())
    }
}

impl Episode {
    fn new(scenario: &Scenario, seed: u64) -> Option<Self> {
        let world = BareWorld::of_scenario(scenario, seed, Steering::Caller).ok()?;
        let robots = world.robots();
        let settings = Parameters::default();
        let boots = world.now() + BOOT;
        let mut episode = Self {
            outside: Outside::new(scenario.tracker, robots, seed, boots),
            agents: vec![Agent::default(); robots],
            tuning: *world.tuning(),
            // The table of parameters keeps it within 16 bits.
            critical_mm: settings.number(Parameter::CriticalDistance) as u16,
            contacts: Vec::new(),
            least_m: 0.0,
            steps: 0,
            held: 0,
            outcome: Outcome::Running,
            world,
        };
        episode.let_pass(BOOT);
        episode.outside.begin(&episode.world, &mut episode.agents);
        // Where it is comes first, then the order.
        episode.let_pass(PERIOD);
        for agent in &mut episode.agents {
            agent.begin();
        }
        episode.until_observed();
        episode.contacts = episode.counted();
        episode.least_m = episode.least();
        Some(episode)
    }

    /// Lets control steps pass.
    fn let_pass(&mut self, span: Duration) {
        let (tuning, critical_mm) = (self.tuning, self.critical_mm);
        let agents = &mut self.agents;
        self.world.step_with(span, |robot, senses| {
            let agent = agents.get_mut(robot.get() as usize)?;
            Some(agent.control(senses, &tuning, critical_mm))
        });
    }

    /// Lets control steps pass until there are observations.
    fn until_observed(&mut self) {
        for step in 0..STEPS {
            self.outside.pass(&self.world, &mut self.agents);
            // The first one takes it in.
            if step == 0 {
                let at = self.world.now() + PERIOD;
                self.outside.say_who_is_near(&mut self.agents, at);
            }
            self.let_pass(PERIOD);
        }
    }

    fn counted(&self) -> Vec<u32> {
        let robots = 0..self.agents.len();
        let contacts = |robot| {
            self.world
                .observe(index(robot))
                .map_or(0, |seen| seen.contacts)
        };
        robots.map(contacts).collect()
    }

    /// Least distance of two robots, in metres.
    fn least(&self) -> f32 {
        let places: Vec<_> = (0..self.agents.len())
            .filter_map(|robot| self.world.observe(index(robot)))
            .map(|seen| [seen.pose.x, seen.pose.y])
            .collect();
        let mut least = f32::INFINITY;
        for (number, a) in places.iter().enumerate() {
            for b in &places[..number] {
                least = least.min(libm::hypotf(a[0] - b[0], a[1] - b[1]));
            }
        }
        least
    }

    /// Takes a step, and returns from how many decisions the shield took something.
    fn step(&mut self, actions: &[u8], rewards: &mut [f32]) -> u64 {
        let mut vetoes = 0;
        for (agent, action) in self.agents.iter_mut().zip(actions) {
            agent.action = Some(*action);
        }
        self.until_observed();
        self.steps += 1;
        let least = self.least();
        let gain = worth(least) - worth(self.least_m);
        self.least_m = least;
        let apart = least >= APART_M;
        self.held = if apart { self.held + 1 } else { 0 };
        let contacts = self.counted();
        let touches = |robot: usize| contacts[robot] > self.contacts[robot];
        self.outcome = if (0..contacts.len()).any(touches) {
            Outcome::Touched
        } else if self.held >= HELD {
            Outcome::Apart
        } else if self.steps >= LONGEST {
            Outcome::Late
        } else {
            Outcome::Running
        };
        for (robot, reward) in rewards.iter_mut().enumerate() {
            let less = self.agents[robot].observation().numbers()[LESS] > 0;
            vetoes += u64::from(less);
            *reward = gain - 0.005 + if apart { 0.05 } else { 0.0 } - if less { 0.01 } else { 0.0 };
            *reward += match self.outcome {
                Outcome::Apart => 5.0,
                Outcome::Touched if touches(robot) => -10.0,
                Outcome::Touched => -3.0,
                Outcome::Running | Outcome::Late => 0.0,
            };
        }
        self.contacts = contacts;
        vetoes
    }

    /// What no robot knows: where the others really are, seen from it, and what is left.
    fn privileged(&self, agent: usize, out: &mut [f32]) {
        let Some(own) = self.world.observe(index(agent)) else {
            return;
        };
        let (sin, cos) = libm::sincosf(own.pose.theta);
        let others = (0..self.agents.len()).filter(|other| *other != agent);
        let mut put = out.iter_mut();
        let mut add = |value: f32| {
            if let Some(out) = put.next() {
                *out = value;
            }
        };
        add(self.least_m);
        add(self.held as f32 / HELD as f32);
        add(self.steps as f32 / LONGEST as f32);
        add(self
            .world
            .arena()
            .clearance(own.pose.x, own.pose.y)
            .min(1.0));
        for other in others.take(2) {
            let Some(seen) = self.world.observe(index(other)) else {
                continue;
            };
            let (x, y) = (seen.pose.x - own.pose.x, seen.pose.y - own.pose.y);
            add((x * cos + y * sin) * 0.5);
            add((y * cos - x * sin) * 0.5);
        }
    }
}

/// What a least distance is worth.
fn worth(least_m: f32) -> f32 {
    4.0 * least_m.min(WANTED_M) / WANTED_M
}

impl Environment for Spread {
    fn interface(&self) -> Interface {
        Interface {
            agents: self.scenario.robots as usize,
            observation: WIDTH,
            state: WIDTH + PRIVILEGED,
            actions: Action::COUNT,
        }
    }

    fn reset(&mut self, seed: Seed) {
        // A world that cannot be drawn is passed over: the next one has a seed of its own of the same kind.
        let tries = (0..1_000_u64).map(|attempt| seed.get() ^ (attempt << 40));
        let mut drawn = tries.map(|seed| Episode::new(&self.scenario, seed));
        self.episode = drawn.find_map(|episode| episode);
    }

    fn observe(&self, agent: usize, out: &mut [f32]) {
        let observation = self.observation(agent);
        for (out, number) in out.iter_mut().zip(observation.numbers()) {
            *out = f32::from(*number) * (1.0 / 127.0);
        }
    }

    fn state(&self, agent: usize, out: &mut [f32]) {
        let (seen, privileged) = out.split_at_mut(WIDTH);
        self.observe(agent, seen);
        if let Some(episode) = &self.episode {
            episode.privileged(agent, privileged);
        }
    }

    fn step(&mut self, actions: &[u8], rewards: &mut [f32]) -> Status {
        let Some(episode) = &mut self.episode else {
            rewards.fill(0.0);
            return Status::Terminated;
        };
        let vetoes = episode.step(actions, rewards);
        if let Some(counted) = &self.vetoes {
            counted.fetch_add(vetoes, Ordering::Relaxed);
        }
        match episode.outcome {
            Outcome::Running => Status::Running,
            Outcome::Apart | Outcome::Touched => Status::Terminated,
            Outcome::Late => Status::Truncated,
        }
    }

    fn succeeded(&self) -> bool {
        self.driven().is_some_and(|driven| driven.apart)
    }
}

#[cfg(test)]
mod tests;
