//! A training run with its files: what was learned, a curve, and a checkpoint to go on from.
//!
//! | file | |
//! |---|---|
//! | `checkpoint` | all that the run needs to go on, of the last round that is a multiple of ten, or the last one |
//! | `curve.csv` | a line for each round |
//! | `events.out.tfevents.terracrawler` | the same for `TensorBoard`, as soon as a round is over |
//! | `policy.tcpo` | the policy for robots, once the run is over |
//! | `policy` | the same in floats |
//! | `run.json` | options, results and hashes |
//!
//! Whoever has a run stand between two rounds [keeps](Run::keep) it, so that nothing is done twice.
//!
//! But for the events, nothing in them tells the time of day or how fast the machine is: who runs the same options again, in one go or
//! killed and begun again ten times, on one thread or many, has the same bytes.

use std::error::Error;
use std::fmt::{self, Write as _};
use std::fs;
use std::io;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use crawler_app::policy::{Mode, Policy as Blob, choose};
use crawler_policy::ppo::{Config, Critic, Ppo};
use crawler_policy::{
    CheckpointError, Choice, Compute, ConfigError, Diverged, Environment, Episode, Policy, Seed,
    Status,
};
use crawler_sim::scenario::Scenario;
use rand_core::Rng as _;
use rand_pcg::Pcg32;
use serde_json::json;

use crate::curve::{COLUMNS, Line};
use crate::export::{Header, Unfit, export, training};
use crate::spread::Spread;
use crate::tensorboard::{Events, NAME as EVENTS};

/// Samples in a step of the optimiser.
const MINIBATCH: usize = 512;
/// Decisions for which a robot keeps to an action, on average, in the first round. The shield lets nobody drive who has not
/// looked around, and robots that choose anew every 100 ms do not come to look around, nor away from where they are.
const HOLD: f32 = 8.0;
/// Episodes that a policy is judged on in the bare world.
pub const JUDGED: u32 = 300;

/// What a run is made of.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Names the run.
    pub seed: u64,
    /// Steps of all agents, rounded up to whole rounds.
    pub steps: u64,
    /// Worlds side by side.
    pub worlds: usize,
    /// Units of both hidden layers.
    pub units: usize,
    /// Whether the critic sees what no robot knows.
    pub privileged: bool,
}

impl Options {
    /// Rounds that a run in worlds with so many robots comes to.
    #[must_use]
    pub fn rounds(&self, robots: u32) -> u64 {
        let round = Config::default().steps * self.worlds * robots as usize;
        self.steps.div_ceil(round.max(1) as u64).max(1)
    }
}

impl Default for Options {
    fn default() -> Self {
        Self {
            seed: 1,
            steps: 4_000_000,
            worlds: 64,
            units: 64,
            privileged: true,
        }
    }
}

/// Why a run ends without a result.
#[derive(Debug)]
pub enum RunError {
    /// A file.
    File(PathBuf, io::Error),
    /// An option.
    Config(ConfigError),
    /// The checkpoint that is there.
    Checkpoint(PathBuf, CheckpointError),
    /// The loss.
    Diverged(Diverged),
    /// The policy is none for robots.
    Unfit(Unfit),
}

impl fmt::Display for RunError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(path, error) => write!(f, "{}: {error}", path.display()),
            Self::Config(error) => error.fmt(f),
            Self::Checkpoint(path, error) => write!(
                f,
                "{}: {error}; with other options a run needs a folder of its own",
                path.display()
            ),
            Self::Diverged(error) => error.fmt(f),
            Self::Unfit(error) => error.fmt(f),
        }
    }
}

impl Error for RunError {}

impl From<ConfigError> for RunError {
    fn from(error: ConfigError) -> Self {
        Self::Config(error)
    }
}

impl From<Diverged> for RunError {
    fn from(error: Diverged) -> Self {
        Self::Diverged(error)
    }
}

impl From<Unfit> for RunError {
    fn from(error: Unfit) -> Self {
        Self::Unfit(error)
    }
}

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

/// A run under way.
pub struct Run {
    options: Options,
    folder: PathBuf,
    scenario: Arc<Scenario>,
    compute: Compute,
    ppo: Ppo<Spread>,
    rounds: u64,
    /// Of the round under way.
    vetoes: Arc<AtomicU64>,
    /// The curve so far.
    curve: String,
    /// The same for `TensorBoard`.
    events: Events,
}

impl Run {
    /// Begins a run with files in `folder`, or goes on with the one that is there.
    ///
    /// # Errors
    /// See [`RunError`].
    pub fn open(
        options: &Options,
        folder: &Path,
        scenario: Scenario,
        threads: NonZeroUsize,
    ) -> Result<Self, RunError> {
        let scenario = Arc::new(scenario);
        let compute = Compute::new(threads);
        let mut config = Config {
            seed: options.seed,
            critic: if options.privileged {
                Critic::Central
            } else {
                Critic::Own
            },
            ..Config::default()
        };
        config.hidden.units = vec![options.units; 2];
        config.entropy = 0.003;
        config.minibatch = MINIBATCH;
        config.hold = HOLD;
        config.rounds = options.rounds(scenario.robots);
        let rounds = config.rounds;
        let vetoes = Arc::new(AtomicU64::new(0));
        let world = |_| Spread::counting(Arc::clone(&scenario), Arc::clone(&vetoes));
        let worlds = (0..options.worlds).map(world);
        let ppo = Ppo::new(config, compute, worlds.collect())?;
        fs::create_dir_all(folder).map_err(|error| RunError::File(folder.to_owned(), error))?;
        let (ppo, curve) = recall(ppo, folder)?;
        // Decisions that were taken again are counted already.
        vetoes.store(0, Ordering::Relaxed);
        let lines: Vec<Line> = curve.lines().filter_map(Line::read).collect();
        let events = Events::open(folder, &lines, now_s())
            .map_err(|error| RunError::File(folder.join(EVENTS), error))?;
        Ok(Self {
            options: options.clone(),
            folder: folder.to_owned(),
            scenario,
            compute,
            ppo,
            rounds,
            vetoes,
            curve,
            events,
        })
    }

    /// The curve so far, as in its file.
    #[must_use]
    pub fn curve(&self) -> &str {
        &self.curve
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// Rounds so far, and of the whole run.
    pub const fn rounds(&self) -> (u64, u64) {
        (self.ppo.rounds(), self.rounds)
    }

    /// Goes on by a round; `None` when the run is over.
    ///
    /// # Errors
    /// See [`RunError`].
    pub fn round(&mut self) -> Result<Option<Line>, RunError> {
        if self.ppo.rounds() >= self.rounds {
            return Ok(None);
        }
        let began = Instant::now();
        let report = self.ppo.round()?;
        let took_s = began.elapsed().as_secs_f64();
        let decisions = report.agent_steps / report.round.max(1);
        let vetoes = self.vetoes.swap(0, Ordering::Relaxed);
        let line = Line::of(&report, vetoes as f32 / decisions as f32);
        let text = line.csv();
        self.curve += &text;
        // What the curve has, and not what it was rounded from: who goes on may have nothing else.
        let told = Line::read(&text).unwrap_or(line);
        let added = self.events.add(&told, decisions, took_s, now_s());
        added.map_err(|error| RunError::File(self.path(EVENTS), error))?;
        if line.is_kept() || line.round == self.rounds {
            self.keep()?;
        }
        Ok(Some(line))
    }

    /// Writes down all that the run needs to go on after the last round.
    ///
    /// # Errors
    /// [`RunError::File`]: what was kept before stays.
    pub fn keep(&self) -> Result<(), RunError> {
        let synced = self.events.sync();
        synced.map_err(|error| RunError::File(self.path(EVENTS), error))?;
        // These first: they may have more than the checkpoint, and never less.
        self.write("curve.csv", self.curve.as_bytes())?;
        self.write("checkpoint", &self.ppo.checkpoint())
    }

    /// What was learned so far, as robots have it; nobody has judged it.
    ///
    /// # Errors
    /// [`RunError::Unfit`] when it is none for robots.
    pub fn so_far(&self) -> Result<Vec<u8>, RunError> {
        let header = Header {
            mode: Mode::Drawn,
            score: None,
        };
        Ok(export(&self.ppo.policy(), header)?)
    }

    /// Judges what was learned, and writes it down.
    ///
    /// # Errors
    /// See [`RunError`].
    pub fn finish(&self) -> Result<Summary, RunError> {
        let policy = self.ppo.policy();
        let make = || Spread::new(Arc::clone(&self.scenario));
        let episodes = policy.evaluate(Choice::Sampled, &self.compute, 0..JUDGED, make);
        let floats = Judged::of(&episodes);
        let mut header = Header {
            mode: Mode::Drawn,
            score: None,
        };
        let blob = export(&policy, header)?;
        let whole = Judged::of(&self.judge(&blob));
        header.score = Some((whole.success * 1_000.0) as u16);
        let blob = export(&policy, header)?;
        self.write("policy", &policy.to_bytes())?;
        self.write("policy.tcpo", &blob)?;
        let summary = Summary {
            floats,
            whole,
            blob,
        };
        self.write("run.json", self.describe(&policy, &summary).as_bytes())?;
        Ok(summary)
    }

    fn describe(&self, policy: &Policy, summary: &Summary) -> String {
        let Options {
            seed,
            steps,
            worlds,
            units,
            privileged,
        } = &self.options;
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
            "scenario": self.scenario.name,
            "randomisation": self.scenario.randomisation,
            "options": {
                "seed": seed,
                "steps": steps,
                "worlds": worlds,
                "units": units,
                "privileged": privileged,
            },
            "rounds": self.rounds,
            "floats": judged(&summary.floats),
            "int8": judged(&summary.whole),
            "bytes": summary.blob.len(),
            "training": hash,
        });
        format!("{told:#}\n")
    }

    /// Plays the episodes of the evaluation by the blob, as a robot would.
    fn judge(&self, blob: &[u8]) -> Vec<Episode> {
        let threads = self.compute.threads() as u32;
        let share = JUDGED.div_ceil(threads);
        let scenario = &self.scenario;
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

    /// Writes a file so that there is the old one or the new one, whatever happens.
    fn write(&self, name: &str, bytes: &[u8]) -> Result<(), RunError> {
        let (path, beside) = (self.path(name), self.path(&format!("{name}.new")));
        let write = || {
            let mut file = fs::File::create(&beside)?;
            io::Write::write_all(&mut file, bytes)?;
            file.sync_all()?;
            fs::rename(&beside, &path)
        };
        write().map_err(|error| RunError::File(path.clone(), error))
    }
}

/// Goes on from the checkpoint in `folder`, where there is one; with the curve up to it.
fn recall(mut ppo: Ppo<Spread>, folder: &Path) -> Result<(Ppo<Spread>, String), RunError> {
    let path = folder.join("checkpoint");
    match fs::read(&path) {
        Ok(bytes) => {
            let resumed = ppo.resume(&bytes);
            resumed.map_err(|error| RunError::Checkpoint(path, error))?;
            let curve = recall_curve(&folder.join("curve.csv"), ppo.rounds())?;
            Ok((ppo, curve))
        }
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok((ppo, COLUMNS.to_owned())),
        Err(error) => Err(RunError::File(path, error)),
    }
}

/// The curve in a file up to the last of `rounds`.
fn recall_curve(path: &Path, rounds: u64) -> Result<String, RunError> {
    let text = fs::read_to_string(path).map_err(|error| RunError::File(path.to_owned(), error))?;
    let mut lines = text.split_inclusive('\n');
    let is_head = lines.next() == Some(COLUMNS);
    let kept: Vec<&str> = lines.take(rounds as usize).collect();
    let numbers = kept.iter().map(|line| Some(Line::read(line)?.round));
    if !is_head || !numbers.eq((1..=rounds).map(Some)) {
        let odd = io::Error::new(
            io::ErrorKind::InvalidData,
            "is damaged, or of another version",
        );
        return Err(RunError::File(path.to_owned(), odd));
    }
    let mut curve = COLUMNS.to_owned();
    curve.extend(kept);
    Ok(curve)
}

/// Seconds since 1970; 0 for a clock that is before.
fn now_s() -> f64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH);
    now.map_or(0.0, |now| now.as_secs_f64())
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

#[cfg(test)]
mod tests;
