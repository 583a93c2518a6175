//! Reading a recording. Whatever is in the file is checked before it is believed.

use std::collections::BTreeMap;
use std::fmt;
use std::io::Read;

use mcap::read::ChunkReader;
use mcap::records::{ChunkHeader, Record};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use serde::Deserialize;

use crate::run::event_log::life::Life;
use crate::run::event_log::{Event, What};
use crate::run::journal::Payload;
use crate::tools::recording::{START, topics};

/// Opcode and length of a record.
const RECORD_HEAD: usize = 1 + 8;
/// Longest record that is read, in bytes; a chunk of a recording is far shorter.
const MAX_RECORD: usize = 256 * 1024 * 1024;
/// Most events that are read.
const MAX_EVENTS: usize = 100_000_000;
/// Most robots, and most boots of all of them.
const MAX_BOOTS: usize = 1_000_000;
/// Longest time from one mark to the next, microseconds; they are written ten times in a second.
/// It keeps a short file from asking for a replay without an end.
const MAX_PAUSE: u64 = 2_000_000;

/// One boot of a robot, as recorded.
#[derive(Debug, Clone)]
pub(super) struct Boot {
    pub(super) begun: u64,
    /// `None` when it ran to the end of the recording.
    pub(super) ended: Option<u64>,
    pub(super) life: Life,
    pub(super) events: Vec<Event>,
}

/// What is in a recording.
#[derive(Debug, Clone, Default)]
pub struct Recording {
    /// What it says of itself: scenario, seed, build.
    pub words: BTreeMap<String, String>,
    /// Robots by name, each with its boots.
    pub(super) robots: BTreeMap<String, BTreeMap<u32, Boot>>,
    /// Everything up to this moment is there.
    pub(super) end: u64,
    /// Whether the file ends before the recording was finished.
    pub cut_off: bool,
    /// Device events that were lost when it was made.
    pub lost: u64,
}

/// Why a file is no usable recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ReadError(String);

impl fmt::Display for ReadError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "not a usable recording: {}", self.0)
    }
}

impl std::error::Error for ReadError {}

pub(crate) fn wrong(text: impl Into<String>) -> ReadError {
    ReadError(text.into())
}

#[derive(Deserialize)]
struct BootLine {
    at_us: u64,
    robot: String,
    boot: u32,
    life: Life,
}

#[derive(Deserialize)]
struct EndLine {
    at_us: u64,
    robot: String,
    boot: u32,
}

#[derive(Deserialize)]
struct DevicesLine {
    robot: String,
    boot: u32,
    lost: u64,
    events: Vec<Event>,
}

#[derive(Deserialize)]
struct MessageLine {
    at_us: u64,
    robot: String,
    boot: u32,
    direction: String,
    topic: String,
    payload: Payload,
    qos: u8,
    retain: bool,
}

#[derive(Deserialize)]
pub(crate) struct MarkLine {
    pub(crate) at_us: u64,
}

impl Recording {
    /// Reads a recording. One that was cut off, by a kill or a full disk, is good up to the last
    /// chunk that is whole.
    ///
    /// # Errors
    /// [`ReadError`] with what is wrong.
    pub fn read(source: impl Read) -> Result<Self, ReadError> {
        let mut reading = Reading::default();
        scan(source, |record| reading.take(record))?;
        reading.finish()
    }

    /// The robots in it.
    pub fn robots(&self) -> impl Iterator<Item = &str> {
        self.robots.keys().map(String::as_str)
    }

    /// Microseconds since the beginning of the world up to which it goes.
    #[must_use]
    pub const fn end_us(&self) -> u64 {
        self.end
    }
}

pub(crate) fn check_profile(profile: &str) -> Result<(), ReadError> {
    if profile == "terracrawler" {
        return Ok(());
    }
    Err(wrong("it is an MCAP file of another program"))
}

pub(crate) fn check_format(words: &BTreeMap<String, String>) -> Result<(), ReadError> {
    match words.get("format").map(String::as_str) {
        Some("1") => Ok(()),
        other => Err(wrong(format!(
            "it has format {}, and this program reads 1",
            other.unwrap_or("none")
        ))),
    }
}

/// What a message of the recording's own topics says.
pub(crate) fn line<'a, T: Deserialize<'a>>(data: &'a [u8]) -> Result<T, ReadError> {
    serde_json::from_slice(data).map_err(|error| wrong(error.to_string()))
}

/// Hands out the records of a file, those of its chunks one by one.
pub(crate) fn scan(
    mut source: impl Read,
    mut take: impl FnMut(&Record<'_>) -> Result<(), ReadError>,
) -> Result<(), ReadError> {
    let options = LinearReaderOptions::default()
        .with_skip_end_magic(true)
        .with_emit_chunks(true)
        .with_record_length_limit(MAX_RECORD);
    let mut reader = LinearReader::new_with_options(options);
    loop {
        let event = match reader.next_event() {
            Some(Ok(event)) => event,
            // The end, also of a file that was cut off.
            None | Some(Err(mcap::McapError::UnexpectedEof)) => return Ok(()),
            Some(Err(error)) => return Err(wrong(error.to_string())),
        };
        match event {
            LinearReadEvent::ReadRequest(need) => {
                let target = reader.insert(need);
                let taken = source
                    .read(target)
                    .map_err(|error| wrong(error.to_string()))?;
                reader.notify_read(taken);
            }
            LinearReadEvent::Record { data, opcode } => {
                let record =
                    mcap::parse_record(opcode, data).map_err(|error| wrong(error.to_string()))?;
                if let Record::Chunk { header, data } = &record {
                    chunk(header, data, &mut take)?;
                } else {
                    take(&record)?;
                }
            }
        }
    }
}

/// The records of a chunk, which end where it does.
fn chunk(
    header: &ChunkHeader,
    data: &[u8],
    take: &mut impl FnMut(&Record<'_>) -> Result<(), ReadError>,
) -> Result<(), ReadError> {
    if !header.compression.is_empty() {
        return Err(wrong(format!("it is compressed ({})", header.compression)));
    }
    // The reader of chunks trusts lengths: a record that is longer than what is left of its
    // chunk, or a chunk of another length than it says, makes it count below zero.
    let length = data.len() as u64;
    if (header.compressed_size, header.uncompressed_size) != (length, length) {
        return Err(wrong("a chunk does not have the length that it says"));
    }
    let mut rest = data;
    while !rest.is_empty() {
        let record = rest.split_first_chunk::<RECORD_HEAD>();
        let (head, body) = record.ok_or_else(|| wrong("a record is cut off by its chunk"))?;
        let [_, length @ ..] = *head;
        let length = usize::try_from(u64::from_le_bytes(length)).ok();
        let after = length.and_then(|length| body.get(length..));
        rest = after.ok_or_else(|| wrong("a record is longer than its chunk"))?;
    }
    let records = ChunkReader::new(header.clone(), data);
    for record in records.map_err(|error| wrong(error.to_string()))? {
        take(&record.map_err(|error| wrong(error.to_string()))?)?;
    }
    Ok(())
}

#[derive(Default)]
struct Reading {
    recording: Recording,
    channels: BTreeMap<u16, &'static str>,
    events: usize,
    boots: usize,
    finished: bool,
}

impl Reading {
    fn take(&mut self, record: &Record<'_>) -> Result<(), ReadError> {
        match record {
            Record::Header(header) => check_profile(&header.profile),
            Record::Channel(channel) => {
                let known = topics::ALL
                    .iter()
                    .find(|(topic, _)| *topic == channel.topic);
                if let Some((topic, _)) = known {
                    self.channels.insert(channel.id, topic);
                }
                Ok(())
            }
            Record::Metadata(metadata) if metadata.name == START => {
                self.recording.words.clone_from(&metadata.metadata);
                check_format(&self.recording.words)
            }
            Record::Message { header, data } => {
                let Some(&topic) = self.channels.get(&header.channel_id) else {
                    return Ok(());
                };
                self.message(topic, data)
                    .map_err(|error| wrong(format!("a message of {topic}: {}", error.0)))
            }
            Record::Footer(_) => {
                self.finished = true;
                Ok(())
            }
            _ => Ok(()),
        }
    }

    fn message(&mut self, topic: &str, data: &[u8]) -> Result<(), ReadError> {
        match topic {
            topics::BOOTS => {
                let line: BootLine = line(data)?;
                self.boots += 1;
                if self.boots > MAX_BOOTS || !line.life.is_sound() {
                    return Err(wrong("a boot that cannot have been"));
                }
                let boot = Boot {
                    begun: line.at_us,
                    ended: None,
                    life: line.life,
                    events: Vec::new(),
                };
                let boots = self.recording.robots.entry(line.robot).or_default();
                if boots.insert(line.boot, boot).is_some() {
                    return Err(wrong("the same boot twice"));
                }
            }
            topics::ENDS => {
                let line: EndLine = line(data)?;
                self.boot(&line.robot, line.boot)?.ended = Some(line.at_us);
            }
            topics::DEVICES => {
                let line: DevicesLine = line(data)?;
                self.recording.lost = self.recording.lost.saturating_add(line.lost);
                self.count(line.events.len())?;
                self.boot(&line.robot, line.boot)?
                    .events
                    .extend(line.events);
            }
            topics::MESSAGES => {
                let line: MessageLine = line(data)?;
                if line.direction == "published" {
                    self.count(1)?;
                    let what = What::Published {
                        topic: line.topic,
                        payload: line.payload,
                        qos: line.qos,
                        retain: line.retain,
                    };
                    let event = Event(line.at_us, what);
                    self.boot(&line.robot, line.boot)?.events.push(event);
                }
            }
            topics::MARK => {
                let line: MarkLine = line(data)?;
                if line.at_us < self.recording.end {
                    return Err(wrong("its time runs backwards"));
                }
                if line.at_us - self.recording.end > MAX_PAUSE {
                    return Err(wrong(format!(
                        "nothing is known of the time from {:.1} s to {:.1} s",
                        self.recording.end as f64 * 1e-6,
                        line.at_us as f64 * 1e-6
                    )));
                }
                self.recording.end = line.at_us;
            }
            _ => {}
        }
        Ok(())
    }

    fn count(&mut self, events: usize) -> Result<(), ReadError> {
        self.events += events;
        if self.events > MAX_EVENTS {
            return Err(wrong(format!("it has more than {MAX_EVENTS} events")));
        }
        Ok(())
    }

    fn boot(&mut self, robot: &str, boot: u32) -> Result<&mut Boot, ReadError> {
        let boots = self.recording.robots.get_mut(robot);
        boots
            .and_then(|boots| boots.get_mut(&boot))
            .ok_or_else(|| wrong(format!("boot {boot} of `{robot:.40}` has no beginning")))
    }

    fn finish(mut self) -> Result<Recording, ReadError> {
        if self.recording.words.is_empty() {
            return Err(wrong("it does not say what it is a recording of"));
        }
        let end = self.recording.end;
        self.recording.cut_off = !self.finished;
        for boots in self.recording.robots.values_mut() {
            // What came after the last mark may not be all there was.
            boots.retain(|_, boot| boot.begun <= end);
            for boot in boots.values_mut() {
                boot.ended = boot.ended.filter(|&ended| ended <= end);
                boot.events.retain(|event| event.0 <= end);
                if boot.ended.is_some_and(|ended| ended < boot.begun) {
                    return Err(wrong("a boot that ends before it begins"));
                }
            }
        }
        Ok(self.recording)
    }
}
