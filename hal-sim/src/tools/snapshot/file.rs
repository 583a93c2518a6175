//! Snapshots as files.
//!
//! Two lines of text: what it is and in which version, with a fingerprint of what follows; then
//! one JSON object. Everything in it is checked before anything is made of it.

use std::io::{Read, Write};

use crawler_hal::Instant;
use serde::{Deserialize, Serialize};

use super::{BUILD, RestoreError, Snapshot, SnapshotError};
use crate::run::Link;
use crate::run::journal::{Entry, MAX_ENTRIES};
use crate::scenario::Scenario;
use crate::world::Fingerprint;

/// Largest snapshot file, in bytes.
pub const MAX_FILE: usize = 64 * 1024 * 1024;
const KIND: &str = "terracrawler-snapshot";
const VERSION: u32 = 1;

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Contents {
    build: String,
    link: Link,
    /// TOML, so that every number is read as it was.
    scenario: String,
    seed: u64,
    at_us: u64,
    hash: String,
    seconds: Vec<String>,
    journal: Vec<Entry>,
}

/// Writes a snapshot.
///
/// # Errors
/// [`std::io::Error`] of the target, also when the snapshot cannot be written as a file.
pub fn write_to(snapshot: &Snapshot, mut target: impl Write) -> std::io::Result<()> {
    let bytes = snapshot.to_bytes().map_err(std::io::Error::other)?;
    target.write_all(&bytes)?;
    target.flush()
}

/// Reads a snapshot; never more than [`MAX_FILE`] bytes.
///
/// # Errors
/// [`RestoreError::File`] with what is wrong.
pub fn read_from(source: impl Read) -> Result<Snapshot, RestoreError> {
    let mut bytes = Vec::new();
    source
        .take(MAX_FILE as u64 + 1)
        .read_to_end(&mut bytes)
        .map_err(|error| RestoreError::File(error.to_string()))?;
    Snapshot::from_bytes(&bytes)
}

fn fingerprint(bytes: &[u8]) -> u64 {
    let mut print = Fingerprint::new();
    print.bytes(bytes);
    print.value()
}

fn hex(word: u64) -> String {
    format!("{word:016x}")
}

fn wrong(text: impl Into<String>) -> RestoreError {
    RestoreError::File(text.into())
}

fn word(text: &str) -> Result<u64, RestoreError> {
    match u64::from_str_radix(text, 16) {
        Ok(word) if text.len() == 16 => Ok(word),
        _ => Err(wrong(format!("`{text:.20}` is no fingerprint"))),
    }
}

impl Snapshot {
    /// The file as bytes.
    ///
    /// # Errors
    /// [`SnapshotError::Scenario`] and [`SnapshotError::TooLarge`].
    pub fn to_bytes(&self) -> Result<Vec<u8>, SnapshotError> {
        let scenario = (self.scenario.to_whole_toml())
            .map_err(|error| SnapshotError::Scenario(error.to_string()))?;
        match Scenario::parse(&scenario) {
            Ok(mut read) => {
                // Files hold no detector; whoever restores the world gives it one.
                read.detector = self.scenario.detector;
                read.policy.clone_from(&self.scenario.policy);
                if read != self.scenario {
                    return Err(SnapshotError::Scenario("a number changes".to_owned()));
                }
            }
            Err(error) => return Err(SnapshotError::Scenario(error.to_string())),
        }
        let body = Contents {
            build: self.build.clone(),
            link: self.link,
            scenario,
            seed: self.seed,
            at_us: self.at.as_micros(),
            hash: hex(self.hash),
            seconds: self.seconds.iter().map(|&second| hex(second)).collect(),
            journal: self.entries.clone(),
        };
        let body = serde_json::to_vec(&body)
            .map_err(|error| SnapshotError::Scenario(error.to_string()))?;
        let mut bytes = format!("{KIND} {VERSION} {}\n", hex(fingerprint(&body))).into_bytes();
        bytes.extend_from_slice(&body);
        bytes.push(b'\n');
        if bytes.len() > MAX_FILE {
            return Err(SnapshotError::TooLarge);
        }
        Ok(bytes)
    }

    /// Reads what [`Snapshot::to_bytes`] wrote. Hostile bytes cost no more than reading them.
    ///
    /// # Errors
    /// [`RestoreError::File`] with what is wrong.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, RestoreError> {
        if bytes.len() > MAX_FILE {
            return Err(wrong(format!("it is larger than {MAX_FILE} bytes")));
        }
        let (head, body) = bytes
            .iter()
            .take(80)
            .position(|&byte| byte == b'\n')
            .map(|end| (&bytes[..end], &bytes[end + 1..]))
            .ok_or_else(|| wrong("its first line is missing"))?;
        let head = std::str::from_utf8(head).map_err(|_| wrong("its first line is no text"))?;
        let mut words = head.split(' ');
        if words.next() != Some(KIND) {
            return Err(wrong(format!("it does not begin with `{KIND}`")));
        }
        match words.next().and_then(|version| version.parse::<u32>().ok()) {
            Some(VERSION) => {}
            Some(other) => {
                let text = format!("it has version {other}, and this program reads {VERSION}");
                return Err(wrong(text));
            }
            None => return Err(wrong("its version is no number")),
        }
        let told = word(words.next().unwrap_or_default())?;
        let body = body.strip_suffix(b"\n").unwrap_or(body);
        if words.next().is_some() || told != fingerprint(body) {
            return Err(wrong("it is damaged: its fingerprint is another"));
        }
        let body: Contents =
            serde_json::from_slice(body).map_err(|error| wrong(error.to_string()))?;
        body.check()
    }
}

impl Contents {
    fn check(self) -> Result<Snapshot, RestoreError> {
        if self.build.len() > BUILD.len().max(64) {
            return Err(wrong("the name of its build is too long"));
        }
        // So the time that making the world again takes is bounded by the length of the file.
        if self.at_us / 1_000_000 != self.seconds.len() as u64 {
            return Err(wrong("its time and its fingerprints do not go together"));
        }
        if self.journal.len() > MAX_ENTRIES {
            return Err(wrong("its journal is too long"));
        }
        let times = || self.journal.iter().map(|entry| entry.at_us);
        if !times().is_sorted() || times().next_back().is_some_and(|last| last > self.at_us) {
            return Err(wrong("the times of its journal are out of order"));
        }
        let scenario =
            Scenario::parse(&self.scenario).map_err(|error| wrong(format!("scenario: {error}")))?;
        let seconds: Result<Vec<u64>, _> = self.seconds.iter().map(|text| word(text)).collect();
        Ok(Snapshot {
            build: self.build,
            link: self.link,
            scenario,
            seed: self.seed,
            at: Instant::from_micros(self.at_us),
            hash: word(&self.hash)?,
            seconds: seconds?,
            entries: self.journal,
        })
    }
}
