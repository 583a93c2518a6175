//! The serial line: defmt records in, lines of text out.

use std::collections::VecDeque;
use std::fmt;
use std::io::Read;
use std::path::Path;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use defmt_decoder::{DecodeError, Table};

use super::EmulatorError;

/// Lines remembered.
const LINES: usize = 20_000;
/// Bytes without the end of a record, after which they are given up.
const LONGEST: usize = 64 * 1024;

/// One record of a board's log.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Line {
    /// When, by the board's own clock, as it writes it.
    pub time: String,
    /// `trace`, `debug`, `info`, `warn`, `error`; empty where a record has none.
    pub level: &'static str,
    /// What it says.
    pub text: String,
}

impl fmt::Display for Line {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:>12} {:<5} {}", self.time, self.level, self.text)
    }
}

/// What a board logged.
pub(super) struct Log {
    /// What its records mean.
    table: Table,
    kept: Mutex<Kept>,
    more: Condvar,
}

#[derive(Default)]
struct Kept {
    lines: VecDeque<Line>,
    /// All there ever were.
    count: u64,
}

impl Log {
    /// An empty log of the program in `image`.
    pub(super) fn read_by(image: &Path) -> Result<Self, EmulatorError> {
        let path = || image.to_owned();
        let elf = std::fs::read(image).map_err(|error| match error.kind() {
            std::io::ErrorKind::NotFound => EmulatorError::NoImage(path()),
            _ => EmulatorError::File(path(), error),
        })?;
        let table = Table::parse(&elf)
            .map_err(|error| EmulatorError::NotAnImage(path(), format!("{error:#}")))?
            .ok_or_else(|| EmulatorError::NotAnImage(path(), "it has no log records".into()))?;
        Ok(Self {
            table,
            kept: Mutex::default(),
            more: Condvar::new(),
        })
    }

    fn kept(&self) -> MutexGuard<'_, Kept> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Reads the line to its end.
    pub(super) fn read(&self, mut serial: impl Read) {
        let mut decoder = self.table.new_stream_decoder();
        let mut buffer = [0; 4_096];
        let mut since = 0;
        while let Ok(len @ 1..) = serial.read(&mut buffer) {
            decoder.received(&buffer[..len]);
            since += len;
            loop {
                match decoder.decode() {
                    Ok(frame) => {
                        since = 0;
                        let time = frame.display_timestamp();
                        self.add(Line {
                            time: time.map(|time| time.to_string()).unwrap_or_default(),
                            level: frame.level().map_or("", |level| level.as_str()),
                            text: frame.display_message().to_string(),
                        });
                    }
                    // A record that a reset cut off; the next one is whole again.
                    Err(DecodeError::Malformed) => since = 0,
                    Err(DecodeError::UnexpectedEof) => break,
                }
            }
            if since > LONGEST {
                decoder = self.table.new_stream_decoder();
                since = 0;
            }
        }
    }

    fn add(&self, line: Line) {
        let mut kept = self.kept();
        if kept.lines.len() == LINES {
            kept.lines.pop_front();
        }
        kept.lines.push_back(line);
        kept.count += 1;
        self.more.notify_all();
    }

    pub(super) fn lines(&self) -> Vec<Line> {
        self.kept().lines.iter().cloned().collect()
    }

    pub(super) fn count(&self) -> u64 {
        self.kept().count
    }

    /// The remembered lines after the first `count` ones; waits for one until `until`.
    pub(super) fn after(&self, count: u64, until: Instant) -> Vec<Line> {
        let mut kept = self.kept();
        loop {
            if kept.count > count {
                let new = usize::try_from(kept.count - count).unwrap_or(LINES);
                let skip = kept.lines.len().saturating_sub(new);
                return kept.lines.iter().skip(skip).cloned().collect();
            }
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Vec::new();
            }
            let woken = self.more.wait_timeout(kept, left);
            kept = woken.unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}
