//! The event file of a run, which `TensorBoard` shows.
//!
//! | what | where its format is |
//! |---|---|
//! | a record: length, its checksum, contents, their checksum | `tensorflow/core/lib/io/record_writer.h` of TensorFlow |
//! | the checksum: CRC-32C, turned and with a constant added | `tensorflow/core/lib/hash/crc32c.h` |
//! | `Event`, `SessionLog` | `tensorflow/core/util/event.proto` |
//! | `Summary`, `Value` | `tensorflow/core/framework/summary.proto` |
//!
//! It only grows, since `TensorBoard` may be reading it. A run that was killed makes the rounds after its checkpoint again: it says
//! so by a `SessionLog` of the kind `START`, whose step `TensorBoard` takes for the first one that does not hold any more.
//! Only what cannot have come from a run alone, damage and checkpoints without end, has the file made anew.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write as _};
use std::path::Path;

use crc::{CRC_32_ISCSI, Crc};
use prost::Message as _;

use crate::curve::Line;

/// What it is called: `TensorBoard` looks for `tfevents` in a name.
pub const NAME: &str = "events.out.tfevents.terracrawler";
/// What it is called while it is made anew: `TensorBoard` shall not look.
const BESIDE: &str = "events.new";
/// First record of every file of this format.
const VERSION: &str = "brain.Event:2";
/// What a [`SessionLog`] says where a run begins, or goes on.
const START: i32 = 1;
/// Checksum of records, before it is [masked].
const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISCSI);
/// Bytes of a record beside its contents.
const FRAME: usize = 16;
/// Bytes of a round, at the most.
const ROUND: u64 = 640;
/// Bytes that rounds which were made again may take before the file is made anew.
const SPARE: u64 = 1 << 20;

#[derive(Clone, PartialEq, prost::Message)]
struct Event {
    /// Seconds since 1970.
    #[prost(double, tag = "1")]
    wall_time: f64,
    #[prost(int64, tag = "2")]
    step: i64,
    #[prost(oneof = "What", tags = "3, 5, 7")]
    what: Option<What>,
}

#[derive(Clone, PartialEq, prost::Oneof)]
enum What {
    #[prost(string, tag = "3")]
    FileVersion(String),
    #[prost(message, tag = "5")]
    Summary(Summary),
    #[prost(message, tag = "7")]
    SessionLog(SessionLog),
}

#[derive(Clone, PartialEq, prost::Message)]
struct Summary {
    #[prost(message, repeated, tag = "1")]
    value: Vec<Value>,
}

#[derive(Clone, PartialEq, prost::Message)]
struct Value {
    #[prost(string, tag = "1")]
    tag: String,
    #[prost(float, optional, tag = "2")]
    simple_value: Option<f32>,
}

#[derive(Clone, PartialEq, prost::Message)]
struct SessionLog {
    #[prost(int32, tag = "1")]
    status: i32,
}

/// The file of a run under way.
#[derive(Debug)]
pub(crate) struct Events {
    file: File,
}

impl Events {
    /// Goes on with the file in `folder` after the rounds of `curve`, or begins one. `now_s` is the time in seconds since 1970.
    ///
    /// # Errors
    /// When the file cannot be read or written.
    pub(crate) fn open(folder: &Path, curve: &[Line], now_s: f64) -> io::Result<Self> {
        let path = folder.join(NAME);
        let steps = curve.last().map_or(0, |line| line.steps);
        let found = match read(&path, ROUND * curve.len() as u64 + SPARE) {
            Ok(bytes) => Found::of(&bytes),
            Err(error) if error.kind() == io::ErrorKind::NotFound => None,
            Err(error) => return Err(error),
        };
        let Some(found) = found.filter(|found| found.steps >= steps) else {
            make(folder, &path, curve, now_s)?;
            let file = OpenOptions::new().append(true).open(&path)?;
            return Ok(Self { file });
        };
        let file = OpenOptions::new().append(true).open(&path)?;
        // A record that nobody has finished.
        file.set_len(found.bytes)?;
        let mut events = Self { file };
        if found.steps > steps {
            events.write(&record(
                now_s,
                steps + 1,
                What::SessionLog(SessionLog { status: START }),
            ))?;
        }
        Ok(events)
    }

    /// Adds a round, which has taken `took_s` seconds.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub(crate) fn add(
        &mut self,
        line: &Line,
        own_steps: u64,
        took_s: f64,
        now_s: f64,
    ) -> io::Result<()> {
        let mut values = values(line);
        if took_s > 0.0 {
            values.push(value(
                "speed/steps_per_second",
                (own_steps as f64 / took_s) as f32,
            ));
        }
        self.write(&record(
            now_s,
            line.steps,
            What::Summary(Summary { value: values }),
        ))
    }

    /// Has everything on the disk.
    ///
    /// # Errors
    /// When it cannot be written.
    pub(crate) fn sync(&self) -> io::Result<()> {
        self.file.sync_all()
    }

    fn write(&mut self, record: &[u8]) -> io::Result<()> {
        self.file.write_all(record)
    }
}

/// The bytes of a file; none of one that is longer than `most`.
fn read(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    if fs::metadata(path)?.len() > most {
        return Ok(Vec::new());
    }
    fs::read(path)
}

/// Makes the file anew, of a curve. Nothing tells when its rounds were made.
fn make(folder: &Path, path: &Path, curve: &[Line], now_s: f64) -> io::Result<()> {
    let mut bytes = record(now_s, 0, What::FileVersion(VERSION.to_owned()));
    for line in curve {
        let values = values(line);
        bytes.extend(record(
            now_s,
            line.steps,
            What::Summary(Summary { value: values }),
        ));
    }
    let beside = folder.join(BESIDE);
    let mut file = File::create(&beside)?;
    file.write_all(&bytes)?;
    file.sync_all()?;
    fs::rename(&beside, path)
}

/// What a file has that goes on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Found {
    /// All whole records together.
    bytes: u64,
    /// The last step that holds.
    steps: u64,
}

impl Found {
    /// `None` for what is no such file.
    fn of(file: &[u8]) -> Option<Self> {
        let (first, mut rest) = split(file)?;
        if first.what != Some(What::FileVersion(VERSION.to_owned())) {
            return None;
        }
        let mut steps = 0;
        while let Some((event, after)) = split(rest) {
            let step = u64::try_from(event.step).ok()?;
            match event.what {
                Some(What::Summary(_)) => steps = step,
                Some(What::SessionLog(_)) => steps = step.saturating_sub(1),
                _ => return None,
            }
            rest = after;
        }
        Some(Self {
            bytes: (file.len() - rest.len()) as u64,
            steps,
        })
    }
}

/// The first event of a file and what follows it, when the record is whole.
fn split(file: &[u8]) -> Option<(Event, &[u8])> {
    let (length, rest) = file.split_at_checked(8)?;
    let (sum, rest) = rest.split_at_checked(4)?;
    if sum != masked(length).to_le_bytes() {
        return None;
    }
    let length = u64::from_le_bytes(length.try_into().ok()?);
    let (contents, rest) = rest.split_at_checked(usize::try_from(length).ok()?)?;
    let (sum, rest) = rest.split_at_checked(4)?;
    if sum != masked(contents).to_le_bytes() {
        return None;
    }
    Some((Event::decode(contents).ok()?, rest))
}

fn record(wall_time: f64, step: u64, what: What) -> Vec<u8> {
    let event = Event {
        wall_time,
        // More steps than that take longer than anything lasts.
        step: i64::try_from(step).unwrap_or(i64::MAX),
        what: Some(what),
    };
    let contents = event.encode_to_vec();
    let length = (contents.len() as u64).to_le_bytes();
    let mut bytes = Vec::with_capacity(contents.len() + FRAME);
    bytes.extend(length);
    bytes.extend(masked(&length).to_le_bytes());
    bytes.extend(&contents);
    bytes.extend(masked(&contents).to_le_bytes());
    bytes
}

/// The checksum as records have it, so that checksums of checksums say something.
fn masked(bytes: &[u8]) -> u32 {
    CRC.checksum(bytes)
        .rotate_right(15)
        .wrapping_add(0xA282_EAD8)
}

fn value(tag: &str, value: f32) -> Value {
    Value {
        tag: tag.to_owned(),
        simple_value: Some(value),
    }
}

/// What a curve has of a round, by the names that `TensorBoard` sorts by.
fn values(line: &Line) -> Vec<Value> {
    let Line {
        round: _,
        steps: _,
        episodes,
        reward,
        success,
        length,
        entropy,
        divergence,
        clipped,
        critic,
        loss,
        vetoes,
    } = *line;
    let all = [
        ("train/reward", reward),
        ("train/success", success),
        ("train/length", length),
        ("train/episodes", episodes as f32),
        ("train/entropy", entropy as f32),
        ("train/divergence", divergence as f32),
        ("train/clipped", clipped as f32),
        ("loss/policy", loss as f32),
        ("loss/value", critic as f32),
        ("shield/vetoes", vetoes),
    ];
    // What is not there has no number.
    let told = all.into_iter().filter(|(_, number)| number.is_finite());
    told.map(|(tag, number)| value(tag, number)).collect()
}

#[cfg(test)]
pub(crate) mod tests;
