//! What a policy came to, on worlds that nobody learned from.

use std::fmt::Write as _;
use std::sync::Arc;

use crawler_app::policy::{Mode, Policy as Blob, choose};
use crawler_policy::{Choice, Compute, Environment, Episode, Policy, Seed, Status};
use crawler_sim::scenario::Scenario;
use rand_core::Rng as _;
use rand_pcg::Pcg32;
use serde_json::{Value, json};

use crate::export::{Header, Unfit, export, training};
use crate::spread::Spread;

/// Episodes that a policy is judged on in the bare world.
pub const JUDGED: u32 = 300;

/// What a policy came to on episodes that nobody learned from, in the bare world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Judged {
    /// Share of the episodes.
    pub success: f32,
    /// Decisions, mean over the episodes.
    pub length: f32,
}

impl Judged {
    fn of(episodes: &[Episode]) -> Self {
        let all = episodes.len() as f32;
        let succeeded = episodes.iter().filter(|episode| episode.succeeded).count();
        let lengths: f32 = episodes.iter().map(|episode| episode.length as f32).sum();
        Self {
            success: succeeded as f32 / all,
            length: lengths / all,
        }
    }
}

/// What a run came to.
#[derive(Debug, Clone, PartialEq)]
pub struct Summary {
    /// In floats.
    pub floats: Judged,
    /// In int8, as robots have it.
    pub whole: Judged,
    /// The blob.
    pub blob: Vec<u8>,
}

impl Summary {
    /// Judges a policy in worlds of `scenario`.
    pub(crate) fn of(
        policy: &Policy,
        scenario: &Arc<Scenario>,
        compute: &Compute,
    ) -> Result<Self, Unfit> {
        let make = || Spread::new(Arc::clone(scenario));
        let episodes = policy.evaluate(Choice::Sampled, compute, 0..JUDGED, make);
        let floats = Judged::of(&episodes);
        let blob = so_far(policy)?;
        let whole = Judged::of(&by_blob(&blob, scenario, compute));
        let header = Header {
            mode: Mode::Drawn,
            score: Some((whole.success * 1_000.0) as u16),
        };
        let blob = export(policy, header)?;
        Ok(Self {
            floats,
            whole,
            blob,
        })
    }

    /// For `run.json`.
    pub(crate) fn describe(
        &self,
        policy: &Policy,
        scenario: &Scenario,
        options: &Value,
        rounds: u64,
    ) -> String {
        let judged = |judged: &Judged| {
            json!({
                "episodes": JUDGED,
                "success": judged.success,
                "decisions": judged.length,
            })
        };
        let mut hash = String::new();
        for byte in training(policy) {
            // A string takes everything.
            let _ = write!(hash, "{byte:02x}");
        }
        let told = json!({
            "program": env!("CARGO_PKG_VERSION"),
            "scenario": scenario.name,
            "randomisation": scenario.randomisation,
            "options": options,
            "rounds": rounds,
            "floats": judged(&self.floats),
            "int8": judged(&self.whole),
            "bytes": self.blob.len(),
            "training": hash,
        });
        format!("{told:#}\n")
    }
}

/// The policy as robots have it; nobody has judged it.
pub(crate) fn so_far(policy: &Policy) -> Result<Vec<u8>, Unfit> {
    let header = Header {
        mode: Mode::Drawn,
        score: None,
    };
    export(policy, header)
}

/// Plays the episodes of the evaluation by the blob, as a robot would.
fn by_blob(blob: &[u8], scenario: &Arc<Scenario>, compute: &Compute) -> Vec<Episode> {
    let threads = compute.threads() as u32;
    let share = JUDGED.div_ceil(threads);
    std::thread::scope(|scope| {
        let parts = (0..threads).map(|thread| {
            let numbers = thread * share..((thread + 1) * share).min(JUDGED);
            scope.spawn(move || {
                let mut world = Spread::new(Arc::clone(scenario));
                let played = numbers.map(|number| play(&mut world, blob, number));
                played.collect::<Vec<_>>()
            })
        });
        let parts: Vec<_> = parts.collect();
        let joined = parts
            .into_iter()
            .map(|part| part.join().unwrap_or_default());
        joined.flatten().collect()
    })
}

/// Plays an episode of the evaluation by a blob.
fn play(world: &mut Spread, blob: &[u8], number: u32) -> Episode {
    let agents = world.interface().agents;
    let mut episode = Episode {
        reward: 0.0,
        length: 0,
        succeeded: false,
    };
    let Ok(policy) = Blob::new(blob) else {
        return episode;
    };
    let mut rng = Pcg32::new(u64::from(number), 0x6A75_6467);
    let (mut actions, mut rewards) = (vec![0; agents], vec![0.0; agents]);
    world.reset(Seed::evaluation(number));
    loop {
        for (agent, action) in actions.iter_mut().enumerate() {
            let observation = world.observation(agent);
            *action = choose(&policy, &observation, || rng.next_u32() as u8) as u8;
        }
        let status = world.step(&actions, &mut rewards);
        episode.reward += rewards.iter().sum::<f32>() / agents as f32;
        episode.length += 1;
        if status != Status::Running {
            episode.succeeded = world.succeeded();
            return episode;
        }
    }
}
