//! A world at hand: run, kept, taken back, recorded.

use std::fmt::Write as _;
use std::fs::File;
use std::io::{BufReader, BufWriter};
use std::path::Path;
use std::time::{Duration as StdDuration, Instant as RealInstant};

use crawler_sim::evaluate::{self, Trial};
use crawler_sim::run::{Instant, Link, Simulation};
use crawler_sim::scenario::Scenario;
use crawler_sim::tools::debugger::{Debugger, Step};
use crawler_sim::tools::recording::{RecordError, RecordTo, Recorded, Recorder};
use crawler_sim::tools::snapshot::{self, Snapshot};

use crawler_experiments::BUILD;
use crawler_experiments::scenarios::DETECTOR;
use crawler_system::cli_error::{CliError, OrSay as _};

/// Real time between two looks at the clock, while a world runs at a pace.
const TURN: StdDuration = StdDuration::from_millis(20);

/// See the [module](self).
pub(super) struct Session {
    debugger: Debugger,
    recorder: Option<Recorder>,
    /// Whether to keep pace with real time, or run as fast as it can.
    paced: bool,
}

/// Reads a snapshot from a file.
pub(super) fn read_snapshot(path: &Path) -> Result<Snapshot, CliError> {
    let told = |error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
    let file = File::open(path).or_say(|error| told(&error))?;
    let kept = snapshot::read_from(BufReader::new(file)).or_say(|error| told(&error))?;
    Ok(kept.with_detector(DETECTOR))
}

/// Records to a file, with the name of this build.
fn recorder(path: &Path) -> Result<Recorder, RecordError> {
    Recorder::create(&RecordTo {
        file: path.to_owned(),
        build: BUILD.to_owned(),
    })
}

impl Session {
    /// A world that has not begun; a recording of it has `words` for the command line that made it.
    pub(super) fn new(
        scenario: Scenario,
        seed: u64,
        record: Option<&Path>,
        words: String,
    ) -> Result<Self, CliError> {
        let mut recorder = record.map(recorder).transpose()?;
        if let Some(recorder) = &mut recorder {
            recorder.say("command", words);
        }
        let simulation = match &recorder {
            Some(recorder) => {
                Simulation::recorded(Link::Lockstep, scenario, seed, recorder.event_logs())
            }
            None => Simulation::lockstep(scenario, seed),
        };
        Ok(Self::of(simulation?, recorder))
    }

    /// Runs a world as `evaluate` does, up to the moment at which a criterion is lost for good.
    pub(super) fn run_to_failure(
        scenario: &Scenario,
        seed: u64,
        record: Option<&Path>,
        words: String,
    ) -> Result<(Trial, Self), CliError> {
        let begun = Self::new(scenario.clone(), seed, record, words)?;
        let Self {
            debugger,
            mut recorder,
            ..
        } = begun;
        let advance = |simulation: &mut Simulation, end: Instant| {
            if let Some(recorder) = &mut recorder {
                return recorder.run_until(simulation, end).map_err(CliError::from);
            }
            simulation.run_until(end);
            Ok(())
        };
        let (trial, simulation) =
            evaluate::run_to_failure(scenario, debugger.into_simulation(), advance)?;
        Ok((trial, Self::of(simulation, recorder)))
    }

    pub(super) fn restored(snapshot: &Snapshot, record: Option<&Path>) -> Result<Self, CliError> {
        let mut recorder = record.map(recorder).transpose()?;
        let simulation = match &mut recorder {
            Some(recorder) => snapshot.restore_recorded(recorder),
            None => snapshot.restore(),
        };
        Ok(Self::of(simulation?, recorder))
    }

    fn of(simulation: Simulation, recorder: Option<Recorder>) -> Self {
        Self {
            debugger: Debugger::new(simulation),
            recorder,
            paced: false,
        }
    }

    pub(super) fn world(&self) -> &Simulation {
        self.debugger.simulation()
    }

    pub(super) fn world_mut(&mut self) -> &mut Simulation {
        self.debugger.simulation_mut()
    }

    /// Runs to a moment, at once.
    fn run_to(&mut self, end: Instant) -> Result<(), CliError> {
        if let Some(recorder) = &mut self.recorder {
            let simulation = self.debugger.simulation_mut();
            recorder.run_until(simulation, end).map_err(CliError::from)
        } else {
            self.debugger.run_until(end);
            Ok(())
        }
    }

    /// Runs to a second, at the pace that was asked for.
    pub(super) fn run_until(&mut self, seconds: f64) -> Result<(), CliError> {
        let end = Instant::from_micros((seconds * 1e6).round() as u64);
        let mut looked = RealInstant::now();
        while self.paced && self.world().now() < end {
            std::thread::sleep(TURN);
            let passed = looked.elapsed();
            looked += passed;
            let span = passed.as_secs_f64() * self.debugger.factor() * 1e6;
            let next = self.world().now().as_micros() + span as u64;
            self.run_to(Instant::from_micros(next).min(end))?;
        }
        self.run_to(end.max(self.world().now()))
    }

    pub(super) fn step(&mut self, step: Step, count: u32) -> Result<(), CliError> {
        self.run_to(self.debugger.after(step, count))
    }

    /// Keeps pace at so many times real time; `None` is as fast as it can.
    pub(super) fn set_speed(&mut self, factor: Option<f64>) -> Result<(), CliError> {
        if let Some(factor) = factor {
            self.debugger.set_factor(factor)?;
        }
        self.paced = factor.is_some();
        Ok(())
    }

    /// Whether this world can give way to another one.
    fn may_leave(&self) -> Result<(), CliError> {
        if self.recorder.is_some() {
            return Err(CliError::new(
                "a recording is of one world: it ends with `record off` first",
            ));
        }
        Ok(())
    }

    pub(super) fn reset(&mut self, seed: Option<u64>) -> Result<(), CliError> {
        self.may_leave()?;
        self.debugger.reset(seed).map_err(CliError::from)
    }

    pub(super) fn keep(&self, path: &Path) -> Result<(), CliError> {
        let kept = self.debugger.snapshot()?;
        let told = |error: &std::io::Error| format!("{}: {error}", path.display());
        // Never half a snapshot in the place of a whole one.
        let draft = path.with_extension("part");
        let file = File::create(&draft).or_say(told)?;
        snapshot::write_to(&kept, BufWriter::new(file)).or_say(told)?;
        std::fs::rename(&draft, path).or_say(told)
    }

    pub(super) fn restore(&mut self, path: &Path) -> Result<(), CliError> {
        self.may_leave()?;
        self.debugger
            .restore(&read_snapshot(path)?)
            .map_err(CliError::from)
    }

    /// Records to a file, from the beginning of the world: it is made once more to that end.
    pub(super) fn record(&mut self, path: &Path) -> Result<(), CliError> {
        if self.recorder.is_some() {
            return Err(CliError::new("it is being recorded already"));
        }
        let kept = self.debugger.snapshot()?;
        let mut recorder = recorder(path)?;
        let simulation = kept.restore_recorded(&mut recorder)?;
        self.debugger.replace(simulation);
        self.recorder = Some(recorder);
        Ok(())
    }

    /// Ends the recording, if there is one.
    pub(super) fn finish(&mut self) -> Result<Option<Recorded>, CliError> {
        let recorder = self.recorder.take();
        let recorded = recorder.map(|recorder| recorder.finish(self.debugger.simulation()));
        recorded.transpose().map_err(CliError::from)
    }

    /// One line on the world.
    pub(super) fn summary(&self) -> String {
        let world = self.world();
        let mut line = format!(
            "{} seed {}: {:.6} s, {} robots, hash {:016x}",
            world.scenario().name,
            world.seed(),
            world.now().as_micros() as f64 / 1e6,
            world.present(),
            world.history_hash()
        );
        if self.recorder.is_some() {
            line.push_str(", recording");
        }
        if self.paced {
            // Writing to a String does not fail.
            let _ = write!(line, ", at {} times real time", self.debugger.factor());
        }
        line
    }
}
