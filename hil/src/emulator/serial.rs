//! The serial line: records in, lines of text out.
//!
//! The records are decoded by a program of its own, `firmware/boards/log`, whose dependencies do
//! not go with ours.

use std::collections::VecDeque;
use std::fmt;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use super::{EmulatorError, built};

/// Where the decoder lies below a target directory.
const DECODER: &str = "boards/debug/crawler-log";
/// How an ELF file begins.
const ELF: [u8; 4] = *b"\x7FELF";

/// Lines remembered.
const LINES: usize = 20_000;
/// Longest line taken from the decoder.
const LONGEST: u64 = 64 * 1024;

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

impl Line {
    /// Reads a line of the decoder: time, level and text, apart by tabs.
    fn parse(line: &str) -> Option<Self> {
        let mut fields = line.strip_suffix('\n')?.splitn(3, '\t');
        let time = fields.next()?.to_owned();
        let level = fields.next()?;
        let known = ["trace", "debug", "info", "warn", "error"];
        Some(Self {
            time,
            level: known.into_iter().find(|name| *name == level).unwrap_or(""),
            text: fields.next()?.to_owned(),
        })
    }
}

impl fmt::Display for Line {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:>12} {:<5} {}", self.time, self.level, self.text)
    }
}

/// What a board logged.
pub(super) struct Log {
    /// What tells what its records mean.
    decoder: PathBuf,
    image: PathBuf,
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
        let mut start = [0; ELF.len()];
        std::fs::File::open(image)
            .and_then(|mut file| file.read(&mut start))
            .map_err(|error| match error.kind() {
                std::io::ErrorKind::NotFound => EmulatorError::NoImage(path()),
                _ => EmulatorError::File(path(), error),
            })?;
        if start != ELF {
            return Err(EmulatorError::NotAnImage(path(), "no ELF file".into()));
        }
        let decoder = built(DECODER).ok_or(EmulatorError::NoDecoder)?;
        let check = Command::new(&decoder)
            .arg("--check")
            .arg(image)
            .stdin(Stdio::null())
            .output()
            .map_err(|error| EmulatorError::File(decoder.clone(), error))?;
        if !check.status.success() {
            let said = String::from_utf8_lossy(&check.stderr).trim().to_owned();
            return Err(EmulatorError::NotAnImage(path(), said));
        }
        Ok(Self {
            decoder,
            image: path(),
            kept: Mutex::default(),
            more: Condvar::new(),
        })
    }

    fn kept(&self) -> MutexGuard<'_, Kept> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Reads the line to its end.
    pub(super) fn read(&self, serial: impl Into<Stdio>) {
        let decoder = Command::new(&self.decoder)
            .arg(&self.image)
            .stdin(serial)
            .stdout(Stdio::piped())
            .spawn();
        let mut decoder = match decoder {
            Ok(decoder) => decoder,
            Err(error) => return self.complain(&format!("the log cannot be read: {error}")),
        };
        if let Some(text) = decoder.stdout.take() {
            let mut text = BufReader::new(text);
            let mut raw = Vec::new();
            while let Ok(1..) = (&mut text).take(LONGEST).read_until(b'\n', &mut raw) {
                if let Some(line) = Line::parse(&String::from_utf8_lossy(&raw)) {
                    self.add(line);
                }
                raw.clear();
            }
        }
        // It ends with the line it reads; what it came to is told where it began.
        if let Err(error) = decoder.wait() {
            self.complain(&format!("the log broke off: {error}"));
        }
    }

    fn complain(&self, text: &str) {
        self.add(Line {
            time: String::new(),
            level: "error",
            text: text.to_owned(),
        });
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
