//! Commands that must outlive this process, in a file that only grows until it is rewritten.
//!
//! One JSON object a line. What is accepted is on the disk before anybody is told so. That a
//! delivery is done need not be: at worst a robot is asked once more and answers from memory. A
//! last line that was cut short is a crash; it promised nothing.
//!
//! The file belongs to a thread of its own ([`writer`]), which others hand lines to ([`queue`]): a slow
//! disk delays whoever waits for a line and nobody else.

mod queue;
#[cfg(test)]
mod slow_tests;
#[cfg(test)]
mod tests;
mod writer;

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use crawler_protocol::{Command, RobotId};
use serde::{Deserialize, Serialize};

use super::Target;
use super::pending::{CommandText, Leg};
use super::record::Record;
use crawler_system::data::Disk;

pub(super) use queue::{JournalQueue, Lines, Refused, Ticket};

/// Lines beyond which the file is rewritten, when few of them still count.
const MANY: usize = 1_024;
/// A larger file is none of ours.
const MAX_BYTES: u64 = 256 * 1024 * 1024;

/// A command that has not reached all its robots.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct JournalEntry {
    /// Name of its record.
    pub(super) id: u64,
    /// Until when it may be delivered, Unix milliseconds.
    pub(super) expires: u64,
    /// Whether it was for all robots.
    pub(super) swarm: bool,
    pub(super) command: CommandText,
    /// Robots that have not answered.
    pub(super) robots: BTreeMap<String, Leg>,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Line {
    Accepted(JournalEntry),
    Numbered { id: u64, robot: String, leg: Leg },
    Done { id: u64, robot: String },
}

impl JournalEntry {
    /// Of a command for `robots`, with how often each has started; `None` when it cannot be written.
    pub(super) fn new(
        record: &Record,
        expires: u64,
        robots: impl IntoIterator<Item = (RobotId, Option<u32>)>,
    ) -> Option<Self> {
        let seq = record.id;
        let legs = robots.into_iter();
        Some(Self {
            id: seq,
            expires,
            swarm: record.target == Target::Swarm,
            command: CommandText::new(&Command {
                seq,
                ..record.command.clone()
            })?,
            robots: legs
                .map(|(robot, boot)| (robot.as_str().to_owned(), Leg { seq, boot }))
                .collect(),
        })
    }
}

/// The file, and what it says. What robots are owed stands in it, over a restart of the server.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    disk: Disk,
    file: File,
    /// Bytes of the file that are as they are to be.
    length: u64,
    owed: BTreeMap<u64, JournalEntry>,
    lines: usize,
    /// A write failed, so nobody knows how the file ends, or it says more than is owed.
    damaged: bool,
}

impl Journal {
    /// Opens the file, or makes it, and drops what no longer counts.
    ///
    /// # Errors
    /// When the file cannot be read or written.
    pub fn open(path: &Path, disk: &Disk) -> io::Result<Self> {
        let mut owed = BTreeMap::new();
        match fs::metadata(path) {
            Ok(known) if known.len() > MAX_BYTES => {
                let text = format!(
                    "{} is too large to be a journal of commands",
                    path.display()
                );
                return Err(io::Error::new(io::ErrorKind::InvalidData, text));
            }
            Ok(_) => {
                for line in fs::read(path)?.split(|byte| *byte == b'\n') {
                    if line.is_empty() {
                        continue;
                    }
                    match serde_json::from_slice(line) {
                        Ok(line) => apply(&mut owed, line),
                        Err(error) => {
                            tracing::warn!(%error, "skipped a line of the journal of commands");
                        }
                    }
                }
            }
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => return Err(error),
        }
        let (file, length) = rewrite(path, disk, &owed)?;
        Ok(Self {
            path: path.to_owned(),
            disk: disk.clone(),
            file,
            length,
            lines: owed.len(),
            owed,
            damaged: false,
        })
    }

    /// What is owed, oldest first.
    pub(super) fn owed(&self) -> impl Iterator<Item = &JournalEntry> {
        self.owed.values()
    }

    /// The commands in it.
    pub fn ids(&self) -> Vec<u64> {
        self.owed.keys().copied().collect()
    }

    /// Drops what another server delivers by now, or has delivered: everything that `ours` denies.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn keep(&mut self, ours: impl Fn(u64) -> bool) -> io::Result<()> {
        self.owed.retain(|id, _| ours(*id));
        self.rewrite()
    }

    /// Writes `lines`, all of them with one wait for the disk, and returns when they are safe.
    ///
    /// # Errors
    /// When they are not. Commands that were to be accepted are not owed then; everything else is
    /// remembered and in the file once a later call succeeds.
    fn write(&mut self, lines: Vec<Line>) -> io::Result<()> {
        let mut accepted = Vec::new();
        let mut sync = false;
        let mut text: serde_json::Result<Vec<u8>> = Ok(Vec::new());
        let count = lines.len();
        for line in lines {
            if let Line::Accepted(owed) = &line {
                accepted.push(owed.id);
            }
            sync |= !matches!(line, Line::Done { .. });
            text = text.and_then(|mut text| {
                serde_json::to_writer(&mut text, &line)?;
                text.push(b'\n');
                Ok(text)
            });
            apply(&mut self.owed, line);
        }
        let many = self.lines > MANY && self.lines > 4 * self.owed.len();
        let written = if self.damaged || many {
            self.rewrite()
        } else {
            text.map_err(io::Error::from)
                .and_then(|text| self.append(&text, count, sync))
        };
        if written.is_err() {
            for id in accepted {
                self.owed.remove(&id);
            }
            // A process that ends now must not find at its next start what it refused.
            let _ = self.file.set_len(self.length);
        }
        written
    }

    /// Notes lines that are not written now, but for commands that were to be accepted; the next write
    /// says them.
    fn remember(&mut self, lines: Vec<Line>) {
        for line in lines {
            if !matches!(line, Line::Accepted(_)) {
                self.damaged = true;
                apply(&mut self.owed, line);
            }
        }
    }

    fn append(&mut self, text: &[u8], count: usize, sync: bool) -> io::Result<()> {
        if text.is_empty() {
            return Ok(());
        }
        self.damaged = true;
        self.file.write_all(text)?;
        if sync {
            self.disk.sync_data(&self.file)?;
        }
        self.damaged = false;
        self.length += text.len() as u64;
        self.lines += count;
        Ok(())
    }

    fn rewrite(&mut self) -> io::Result<()> {
        self.damaged = true;
        let (file, length) = rewrite(&self.path, &self.disk, &self.owed)?;
        (self.file, self.length) = (file, length);
        self.lines = self.owed.len();
        self.damaged = false;
        Ok(())
    }

    /// Forgets everything that is owed; the file says so with the next write.
    fn clear(&mut self) {
        self.owed.clear();
        self.damaged = true;
    }
}

fn apply(owed: &mut BTreeMap<u64, JournalEntry>, line: Line) {
    match line {
        Line::Accepted(command) => {
            owed.insert(command.id, command);
        }
        Line::Numbered { id, robot, leg } => {
            if let Some(known) = owed.get_mut(&id)
                && let Some(known) = known.robots.get_mut(&robot)
            {
                *known = leg;
            }
        }
        Line::Done { id, robot } => {
            if let Some(known) = owed.get_mut(&id) {
                known.robots.remove(&robot);
                if known.robots.is_empty() {
                    owed.remove(&id);
                }
            }
        }
    }
}

/// Replaces the file by one that says what `owed` says, whole or not at all; returns it with its length.
fn rewrite(
    path: &Path,
    disk: &Disk,
    owed: &BTreeMap<u64, JournalEntry>,
) -> io::Result<(File, u64)> {
    let new = path.with_extension("new");
    let mut file = File::create(&new)?;
    let mut length = 0;
    for command in owed.values() {
        let mut text = serde_json::to_vec(&Line::Accepted(command.clone()))?;
        text.push(b'\n');
        file.write_all(&text)?;
        length += text.len() as u64;
    }
    disk.sync_all(&file)?;
    fs::rename(&new, path)?;
    if let Some(folder) = path.parent() {
        disk.sync_all(&File::open(folder)?)?;
    }
    Ok((file, length))
}
