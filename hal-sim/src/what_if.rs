//! What if: a run that was recorded, made again, and once more with something else in it.
//!
//! A world in virtual time is a function of its scenario, its seed and what was done to it, and a recording has all
//! three. [`Run::ask`] makes it again twice, side by side: as it was, and the same up to a moment at which something else
//! is done to it. From there on robots, broker and world go their own ways: nothing of the recording is played to
//! them. Before anything is told, the first of both has to be the run that was recorded, to the last bit: else
//! a difference would be of this build, and not of the change.

use std::collections::BTreeMap;
use std::fmt;
use std::io::Read;

use crawler_hal::Instant;
use mcap::records::Record;
use serde::Deserialize;

use crate::evaluate::{Trial, run_to_end};
use crate::run::journal::Entry;
use crate::run::{Link, Simulation, SimulationError};
use crate::scenario::Scenario;
use crate::tools::recording::{END, START, topics};
use crate::tools::replay::{MarkLine, ReadError, check_format, check_profile, line, scan, wrong};

/// How often robots are looked at, microseconds.
const LOOK_US: u64 = 500_000;
/// Robots of both worlds that are farther from each other have parted, metres.
const PARTED_M: f32 = 0.05;
/// Longest run, seconds: that of a day.
const LONGEST_S: f32 = 86_400.0;
/// Inputs that a recording may have: as many as a journal keeps.
const MOST_INPUTS: usize = crate::run::journal::MAX_ENTRIES;

/// A run that can be made again.
#[derive(Debug, Clone)]
pub struct Run {
    scenario: Scenario,
    seed: u64,
    link: Link,
    entries: Vec<Entry>,
    end: Instant,
    /// Fingerprints, by the number of the second.
    hashes: BTreeMap<u64, u64>,
    build: String,
}

/// Why there is no answer.
#[derive(Debug)]
#[non_exhaustive]
pub enum NoAnswer<E> {
    /// The run cannot be set up again.
    Simulation(SimulationError),
    /// This build makes another run of it.
    Differs {
        /// The first second that is not as it was.
        second: u64,
        /// The build that made it.
        made_by: String,
    },
    /// The moments are none of the run.
    Moments {
        /// When it ends, seconds.
        end_s: f64,
        /// What was asked for, seconds.
        asked_s: [f64; 2],
    },
    /// Something else cannot be done at that moment: why not.
    Change(E),
}

impl<E: fmt::Display> fmt::Display for NoAnswer<E> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Simulation(error) => error.fmt(f),
            Self::Differs { second, made_by } => write!(
                f,
                "this build makes another run of it, from second {second} on; it was made by {made_by}, and only a \
                 build that makes the same one can answer"
            ),
            Self::Moments { end_s, asked_s } => {
                let [from_s, to_s] = asked_s;
                write!(
                    f,
                    "the run ends after {end_s:.1} s: it cannot be asked from {from_s:.1} s on until {to_s:.1} s"
                )
            }
            Self::Change(why) => why.fmt(f),
        }
    }
}

impl<E: fmt::Debug + fmt::Display> std::error::Error for NoAnswer<E> {}

impl<E> From<SimulationError> for NoAnswer<E> {
    fn from(error: SimulationError) -> Self {
        Self::Simulation(error)
    }
}

/// A robot in both worlds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parting {
    /// Its number.
    pub robot: usize,
    /// When it was elsewhere than it had been, seconds; `None` when it never was.
    pub parted_s: Option<f64>,
    /// How far from where it had been it is in the end, metres; `None` where it is in one world only.
    pub apart_m: Option<f32>,
    /// Contacts, as it was and with the change.
    pub contacts: [u32; 2],
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub struct Answer {
    /// Seconds of the recording whose fingerprints were found again: all there are up to the end.
    pub same_s: usize,
    /// The run as it was.
    pub was: Trial,
    /// And with the change.
    pub would: Trial,
    /// Its robots.
    pub robots: Vec<Parting>,
}

#[derive(Deserialize)]
struct HashLine {
    second: u64,
    hash: String,
}

impl Run {
    /// Reads a recording; robots that have a camera see with `detector`, which no file holds.
    ///
    /// # Errors
    /// [`ReadError`] with what is wrong: with the file, or of a run that cannot be made again, since it ran in real time
    /// or its journal does not tell the whole story.
    pub fn read(source: impl Read, detector: Option<&'static [u8]>) -> Result<Self, ReadError> {
        let (mut words, mut ends) = (BTreeMap::new(), BTreeMap::new());
        let mut channels = BTreeMap::new();
        let (mut entries, mut hashes, mut end_us) = (Vec::new(), BTreeMap::new(), 0);
        scan(source, |record| match record {
            Record::Header(header) => check_profile(&header.profile),
            Record::Channel(channel) => {
                let known = [topics::INPUTS, topics::HASH, topics::MARK];
                if let Some(topic) = known.into_iter().find(|topic| *topic == channel.topic) {
                    channels.insert(channel.id, topic);
                }
                Ok(())
            }
            Record::Metadata(metadata) if metadata.name == START => {
                words.clone_from(&metadata.metadata);
                check_format(&words)
            }
            Record::Metadata(metadata) if metadata.name == END => {
                ends.clone_from(&metadata.metadata);
                Ok(())
            }
            Record::Message { header, data } => {
                match channels.get(&header.channel_id) {
                    Some(&topics::INPUTS) if entries.len() < MOST_INPUTS => {
                        entries.push(line(data)?);
                    }
                    Some(&topics::INPUTS) => return Err(wrong("more was done to it than fits")),
                    Some(&topics::HASH) => {
                        let HashLine { second, hash } = line(data)?;
                        let hash = u64::from_str_radix(&hash, 16);
                        let hash = hash.map_err(|_| wrong("a fingerprint that is none"))?;
                        hashes.insert(second, hash);
                    }
                    Some(&topics::MARK) => {
                        let MarkLine { at_us } = line(data)?;
                        end_us = end_us.max(at_us);
                    }
                    _ => {}
                }
                Ok(())
            }
            _ => Ok(()),
        })?;
        let word = |name: &str| {
            let word = words.get(name).map(String::as_str);
            word.ok_or_else(|| wrong(format!("it does not say its {name}")))
        };
        let link = match word("link")? {
            "live" => {
                return Err(wrong(
                    "it ran in real time, and such a run cannot be made again",
                ));
            }
            link => serde_json::from_value(link.into()).map_err(|_| wrong("its link is none"))?,
        };
        for what in ["inputs_lost", "inputs_withheld"] {
            if ends.get(what).is_some_and(|count| count != "0") {
                return Err(wrong("it does not have all that was done to it"));
            }
        }
        let mut scenario = Scenario::parse(word("scenario")?)
            .map_err(|error| wrong(format!("its scenario: {error}")))?;
        scenario.detector = detector;
        let seed = word("seed")?.parse();
        Ok(Self {
            scenario,
            seed: seed.map_err(|_| wrong("its seed is no number"))?,
            link,
            entries,
            end: Instant::from_micros(end_us),
            hashes,
            build: words.get("version").cloned().unwrap_or_default(),
        })
    }

    /// The scenario.
    #[must_use]
    pub const fn scenario(&self) -> &Scenario {
        &self.scenario
    }

    /// The seed.
    #[must_use]
    pub const fn seed(&self) -> u64 {
        self.seed
    }

    /// The same done to the world of another seed: a run that nobody has recorded.
    #[must_use]
    pub fn with_seed(&self, seed: u64) -> Self {
        Self {
            seed,
            hashes: BTreeMap::new(),
            ..self.clone()
        }
    }

    /// When the recording ends.
    #[must_use]
    pub const fn end(&self) -> Instant {
        self.end
    }

    /// Makes the run again up to `until`: as it was, and so that `change` does something else to it at a moment, with all that was
    /// done to it later.
    ///
    /// # Errors
    /// [`NoAnswer`].
    ///
    /// # Panics
    /// When simulator or program do: that would be a mistake in them.
    pub fn ask<E: Send>(
        &self,
        at: Instant,
        until: Instant,
        change: impl Fn(&mut Simulation) -> Result<(), E>,
    ) -> Result<Answer, NoAnswer<E>> {
        let moments = [at, until].map(|moment| moment.as_micros() as f64 * 1e-6);
        if at > self.end || until <= at || moments[1] > f64::from(LONGEST_S) {
            return Err(NoAnswer::Moments {
                end_s: self.end.as_micros() as f64 * 1e-6,
                asked_s: moments,
            });
        }
        // Nothing of one world gets into the other one.
        let (was, would) = std::thread::scope(|scope| {
            let was = scope.spawn(|| self.branch(at, until, |_| Ok(())));
            let would = self.branch(at, until, change);
            (was.join().expect("the world as it was"), would)
        });
        let (was, would) = (was?, would?);
        let mut same_s = 0;
        for (second, hash) in (1..).zip(&was.hashes) {
            match self.hashes.get(&second) {
                Some(recorded) if recorded != hash => {
                    return Err(NoAnswer::Differs {
                        second,
                        made_by: self.build.clone(),
                    });
                }
                Some(_) => same_s += 1,
                None => {}
            }
        }
        let robots = was.contacts.len().max(would.contacts.len());
        Ok(Answer {
            same_s,
            robots: (0..robots)
                .map(|robot| parting(robot, &was, &would))
                .collect(),
            was: was.trial,
            would: would.trial,
        })
    }

    fn branch<E>(
        &self,
        at: Instant,
        until: Instant,
        change: impl Fn(&mut Simulation) -> Result<(), E>,
    ) -> Result<Branch, NoAnswer<E>> {
        let simulation = Simulation::linked(self.link, self.scenario.clone(), self.seed)?;
        // It is looked at for as long as is asked; the world itself knows nothing of that.
        let watched = Scenario {
            duration_s: until.as_micros() as f32 * 1e-6,
            ends_early: false,
            ..self.scenario.clone()
        };
        let (mut followed, mut changed) = (0, false);
        let mut looks = Vec::new();
        let mut follow = |simulation: &mut Simulation, end: Instant| {
            let rest = &self.entries[followed..];
            let due = rest
                .iter()
                .take_while(|entry| entry.at_us <= end.as_micros());
            let due = due.count();
            simulation.follow(&rest[..due], end);
            followed += due;
        };
        let advance = |simulation: &mut Simulation, end: Instant| -> Result<(), NoAnswer<E>> {
            if !changed && end >= at {
                changed = true;
                follow(simulation, at);
                change(simulation).map_err(NoAnswer::Change)?;
            }
            follow(simulation, end);
            while looks.len() as u64 * LOOK_US <= end.as_micros() {
                let places = (0..simulation.robots()).map(|robot| {
                    let seen = simulation.observe(robot).filter(|seen| seen.present);
                    seen.map(|seen| [seen.pose.x, seen.pose.y])
                });
                looks.push(places.collect());
            }
            Ok(())
        };
        let (trial, simulation) = run_to_end(&watched, simulation, advance)?;
        let robots = 0..simulation.robots();
        let contacts =
            robots.map(|robot| simulation.observe(robot).map_or(0, |seen| seen.contacts));
        Ok(Branch {
            trial,
            looks,
            contacts: contacts.collect(),
            hashes: simulation.second_hashes().to_vec(),
        })
    }
}

/// One of both worlds.
struct Branch {
    trial: Trial,
    /// Where each robot was, every [`LOOK_US`].
    looks: Vec<Vec<Option<[f32; 2]>>>,
    contacts: Vec<u32>,
    hashes: Vec<u64>,
}

fn parting(robot: usize, was: &Branch, would: &Branch) -> Parting {
    let place = |look: &Vec<Option<[f32; 2]>>| look.get(robot).copied().flatten();
    let both = was.looks.iter().zip(&would.looks);
    let apart = both.map(|(was, would)| match (place(was), place(would)) {
        (Some(was), Some(would)) => Some((was[0] - would[0]).hypot(was[1] - would[1])),
        (None, None) => Some(0.0),
        _ => None,
    });
    let apart: Vec<Option<f32>> = apart.collect();
    let parted = apart
        .iter()
        .position(|apart| apart.is_none_or(|apart| apart > PARTED_M));
    let contacts = |branch: &Branch| branch.contacts.get(robot).copied().unwrap_or(0);
    Parting {
        robot,
        parted_s: parted.map(|look| look as f64 * LOOK_US as f64 * 1e-6),
        apart_m: apart.last().copied().flatten(),
        contacts: [contacts(was), contacts(would)],
    }
}
