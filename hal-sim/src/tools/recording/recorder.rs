//! Writing a recording while a world runs.

use std::collections::BTreeMap;
use std::path::PathBuf;

use crawler_app::perception::Sight;
use crawler_hal::{Duration, Instant};
use serde_json::{Value, json};

use super::file::{RecordFile, topics};
use super::{RecordError, scene};
use crate::VERSION;
use crate::run::Simulation;
use crate::run::event_log::{Event, EventLogs, Track, What};
use crate::run::journal::{Entry, Input};

/// How often what is on the event logs is taken, and a small fleet is looked at.
const PERIOD: Duration = Duration::from_millis(100);
/// Robots that are looked at in each period; a larger fleet takes turns of several.
const ROBOTS_PER_LOOK: usize = 100;
/// Periods after which a chunk ends in any case.
const PERIODS_PER_CHUNK: u64 = 20;
/// Longest journal that goes into the metadata as well.
const MAX_JOURNAL: usize = 1024 * 1024;

/// Where a recording goes, and who makes it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RecordTo {
    /// The file.
    pub file: PathBuf,
    /// What tells this build of the whole program from others: where it is the same, the same scenario and seed give
    /// the same history.
    pub build: String,
}

/// What became of a recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recorded {
    /// The file.
    pub path: PathBuf,
    /// Messages in it.
    pub messages: u64,
    /// Device events that there was no room for in memory. With any, it cannot be replayed.
    pub lost: u64,
}

/// Writes what happens in one world to a file.
///
/// Made before the world, since its robots boot with a tap on every device:
/// [`Recorder::create`], [`Simulation::recorded`] with its [`Recorder::event_logs`], then
/// [`Recorder::run_until`] or [`Recorder::observe`], and [`Recorder::finish`]. Memory is bounded by
/// a chunk and by what a fleet does in 100 ms.
pub struct Recorder {
    file: RecordFile,
    event_logs: EventLogs,
    /// What was said of the world beforehand.
    words: BTreeMap<String, String>,
    begun: bool,
    next: Instant,
    periods: u64,
    hashes: usize,
    entries: usize,
    lost: u64,
    boots: BTreeMap<usize, u32>,
    decisions: BTreeMap<usize, Value>,
}

impl std::fmt::Debug for Recorder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Recorder")
            .field("path", &self.file.path())
            .field("messages", &self.file.messages())
            .finish_non_exhaustive()
    }
}

impl Recorder {
    /// Begins a recording in a new file, or over an old one.
    ///
    /// # Errors
    /// [`RecordError`] when the file cannot be written.
    pub fn create(to: &RecordTo) -> Result<Self, RecordError> {
        Ok(Self {
            file: RecordFile::create(&to.file)?,
            event_logs: EventLogs::default(),
            words: BTreeMap::from([("build".to_owned(), to.build.clone())]),
            begun: false,
            next: Instant::BOOT + PERIOD,
            periods: 0,
            hashes: 0,
            entries: 0,
            lost: 0,
            boots: BTreeMap::new(),
            decisions: BTreeMap::new(),
        })
    }

    /// The event logs, for [`Simulation::recorded`].
    #[must_use]
    pub fn event_logs(&self) -> EventLogs {
        self.event_logs.clone()
    }

    /// Whether [`Recorder::observe`] has something to do by now.
    #[must_use]
    pub fn is_due(&self, now: Instant) -> bool {
        !self.begun || now >= self.next
    }

    /// Lets time pass up to `end`, and writes what happens.
    ///
    /// # Errors
    /// [`RecordError`], with time standing where the file stopped taking more.
    pub fn run_until(
        &mut self,
        simulation: &mut Simulation,
        end: Instant,
    ) -> Result<(), RecordError> {
        self.observe(simulation)?;
        while simulation.now() < end {
            simulation.run_until(self.next.min(end));
            self.observe(simulation)?;
        }
        Ok(())
    }

    /// Writes what happened since the last time. To be called about ten times in a second of the
    /// world, when nothing is left to do at the present moment of it.
    ///
    /// # Errors
    /// See [`RecordError`].
    pub fn observe(&mut self, simulation: &Simulation) -> Result<(), RecordError> {
        if !self.begun {
            self.begun = true;
            self.begin(simulation)?;
        }
        let now = simulation.now();
        self.take_inputs(simulation)?;
        self.take_tapes(simulation)?;
        if now >= self.next {
            while self.next <= now {
                self.next += PERIOD;
            }
            self.periods += 1;
            let turns = simulation.robots().div_ceil(ROBOTS_PER_LOOK).max(1) as u64;
            if self.periods.is_multiple_of(turns) {
                self.look(simulation)?;
            }
            self.take_hashes(simulation)?;
        }
        let at_us = now.as_micros();
        self.file
            .add(topics::MARK, at_us, &json!({ "at_us": at_us }))?;
        if self.periods.is_multiple_of(PERIODS_PER_CHUNK) {
            self.file.flush()?;
        }
        Ok(())
    }

    /// Ends the recording.
    ///
    /// # Errors
    /// See [`RecordError`].
    pub fn finish(mut self, simulation: &Simulation) -> Result<Recorded, RecordError> {
        self.observe(simulation)?;
        self.look(simulation)?;
        let journal = simulation.journal();
        let mut words = BTreeMap::from([
            ("at_us", simulation.now().as_micros().to_string()),
            ("hash", format!("{:016x}", simulation.history_hash())),
            ("inputs_lost", journal.lost().to_string()),
            ("inputs_withheld", journal.withheld().to_string()),
            ("events_lost", self.lost.to_string()),
        ]);
        let text = serde_json::to_string(journal.entries()).unwrap_or_default();
        if text.len() <= MAX_JOURNAL {
            words.insert("journal", text);
        }
        let recorded = Recorded {
            path: self.file.path().to_owned(),
            messages: self.file.messages(),
            lost: self.lost,
        };
        self.file.finish(owned(words))?;
        Ok(recorded)
    }

    /// Says something of where the world comes from that it does not know itself: a name, and a text. To be said
    /// before the recording begins; a later text under one name replaces an earlier one.
    pub fn say(&mut self, name: &str, text: String) {
        self.words.insert(name.to_owned(), text);
    }

    fn begin(&mut self, simulation: &Simulation) -> Result<(), RecordError> {
        let link = match simulation.link() {
            Some(link) => serde_json::to_string(&link).unwrap_or_default(),
            None => "\"live\"".to_owned(),
        };
        let words = BTreeMap::from([
            ("format", "1".to_owned()),
            ("version", VERSION.to_owned()),
            (
                "randomisation",
                simulation.scenario().randomisation.name().to_owned(),
            ),
            ("seed", simulation.seed().to_string()),
            ("link", link.trim_matches('"').to_owned()),
            ("fleet", simulation.fleet().as_str().to_owned()),
            (
                "scenario",
                simulation.scenario().to_whole_toml().unwrap_or_default(),
            ),
        ]);
        let mut said = std::mem::take(&mut self.words);
        said.extend(owned(words));
        self.file.start(said)?;
        let arena = scene::arena(&simulation.world().arena(), 0);
        self.file.add(topics::ARENA, 0, &arena)?;
        self.look(simulation)
    }

    fn take_inputs(&mut self, simulation: &Simulation) -> Result<(), RecordError> {
        let entries: &[Entry] = simulation.journal().entries();
        for entry in entries.get(self.entries..).unwrap_or_default() {
            self.file.add(topics::INPUTS, entry.at_us, entry)?;
            let breaks = matches!(
                entry.input,
                Input::Fault { .. } | Input::Heal { .. } | Input::Cut { .. } | Input::Crash { .. }
            );
            if breaks {
                self.file.add(topics::FAULTS, entry.at_us, entry)?;
            }
            // As it is after all of them: what is looked at next is what counts.
            if matches!(entry.input, Input::Drop { .. } | Input::Take { .. }) {
                let arena = scene::arena(&simulation.world().arena(), entry.at_us);
                self.file.add(topics::ARENA, entry.at_us, &arena)?;
            }
        }
        self.entries = entries.len();
        Ok(())
    }

    fn take_tapes(&mut self, simulation: &Simulation) -> Result<(), RecordError> {
        let Self {
            file,
            event_logs,
            boots,
            ..
        } = self;
        let (mut result, mut all_lost) = (Ok(()), 0);
        event_logs.drain(|track, events, lost| {
            all_lost += lost;
            if result.is_ok() {
                let name = simulation.id(track.robot).map_or("", |id| id.as_str());
                let boot = boots.entry(track.robot).or_default();
                *boot += u32::from(!track.told);
                result = write_track(file, track, name, *boot, events, lost);
            }
        });
        self.lost += all_lost;
        result
    }

    fn take_hashes(&mut self, simulation: &Simulation) -> Result<(), RecordError> {
        let hashes = simulation.second_hashes();
        for (number, hash) in hashes.iter().enumerate().skip(self.hashes) {
            let second = number as u64 + 1;
            let line = json!({ "second": second, "hash": format!("{hash:016x}") });
            self.file.add(topics::HASH, second * 1_000_000, &line)?;
        }
        self.hashes = hashes.len();
        Ok(())
    }

    /// Truth, readings, decisions and the scene.
    fn look(&mut self, simulation: &Simulation) -> Result<(), RecordError> {
        let at_us = simulation.now().as_micros();
        let (mut truth, mut readings, mut decisions) = (Vec::new(), Vec::new(), Vec::new());
        for robot in 0..simulation.robots() {
            let (Some(seen), Some(id)) = (simulation.observe(robot), simulation.id(robot)) else {
                continue;
            };
            if !seen.present {
                continue;
            }
            let id = id.as_str();
            truth.push(json!({
                "robot": id,
                "x": seen.pose.x,
                "y": seen.pose.y,
                "theta": seen.pose.theta,
                "speed": seen.speed,
                "turn": seen.turn,
                "contacts": seen.contacts,
                "charge": seen.charge,
                "powered": seen.powered,
            }));
            let Some(program) = simulation.robot(robot) else {
                continue;
            };
            let told = program.snapshot();
            let tally = program.tally();
            readings.push(json!({
                "robot": id,
                "range_mm": told.reading.sight.map(|(sight, _)| match sight {
                    Sight::Range(range) => json!(range.0),
                    Sight::Clear => json!("clear"),
                    Sight::Touching => json!("touching"),
                }),
                "temperature_c": told.reading.temperature.map(|celsius| celsius.0),
                "battery_mv": told.battery.voltage.map(|voltage| voltage.0),
            }));
            let decision = json!({
                "robot": id,
                "state": told.state.name(),
                "behaviour": told.behaviour.name(),
                "duty": seen.duty,
                "carried_out": {
                    "commands": tally.commands,
                    "numbers": tally.numbers,
                },
            });
            if self.decisions.get(&robot) != Some(&decision) {
                self.decisions.insert(robot, decision.clone());
                decisions.push(decision);
            }
        }
        let list = |robots: Vec<Value>| json!({ "at_us": at_us, "robots": robots });
        let file = &mut self.file;
        file.add(topics::SCENE, at_us, &scene::robots(simulation, at_us))?;
        file.add(topics::TRUTH, at_us, &list(truth))?;
        file.add(topics::READINGS, at_us, &list(readings))?;
        if !decisions.is_empty() {
            file.add(topics::DECISIONS, at_us, &list(decisions))?;
        }
        Ok(())
    }
}

fn owned(words: BTreeMap<&str, String>) -> BTreeMap<String, String> {
    words
        .into_iter()
        .map(|(key, word)| (key.to_owned(), word))
        .collect()
}

/// What one boot of a robot has to tell: its beginning, what happened, its end.
fn write_track(
    file: &mut RecordFile,
    track: &Track,
    robot: &str,
    boot: u32,
    events: Vec<Event>,
    lost: u64,
) -> Result<(), RecordError> {
    if !track.told {
        let begun = track.event_log.begun();
        let line = json!({
            "at_us": begun, "robot": robot, "number": track.robot, "boot": boot,
            "life": track.life,
        });
        file.add(topics::BOOTS, begun, &line)?;
    }
    let mut quiet = Vec::new();
    for event in events {
        let (direction, topic, payload, qos, retain) = match &event.1 {
            What::Published {
                topic,
                payload,
                qos,
                retain,
            } => ("published", topic, payload, *qos, *retain),
            What::Delivered { topic, payload } => ("delivered", topic, payload, 0, false),
            _ => {
                quiet.push(event);
                continue;
            }
        };
        let line = json!({
            "at_us": event.0, "robot": robot, "boot": boot, "direction": direction,
            "topic": topic, "payload": payload, "qos": qos, "retain": retain,
        });
        file.add(topics::MESSAGES, event.0, &line)?;
    }
    if let Some(last) = quiet
        .last()
        .map(|event| event.0)
        .or((lost > 0).then_some(0))
    {
        let line = json!({ "robot": robot, "boot": boot, "lost": lost, "events": quiet });
        file.add(topics::DEVICES, last, &line)?;
    }
    if let Some(ended) = track.event_log.ended() {
        let line = json!({ "at_us": ended, "robot": robot, "boot": boot });
        file.add(topics::ENDS, ended, &line)?;
    }
    Ok(())
}
