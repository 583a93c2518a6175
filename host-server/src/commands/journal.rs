//! Commands that must outlive this process, in a file that only grows until it is rewritten.
//!
//! One JSON object a line. What is accepted is on the disk before anybody is told so. That a
//! delivery is done need not be: at worst a robot is asked once more and answers from memory. A
//! last line that was cut short is a crash; it promised nothing.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use crawler_protocol::{Command, MAX_MESSAGE, RobotId};
use serde::{Deserialize, Serialize};

/// Lines beyond which the file is rewritten, when few of them still count.
const MANY: usize = 1_024;
/// A larger file is none of ours.
const MAX_BYTES: u64 = 256 * 1024 * 1024;

/// A command that has not reached all its robots.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Owed {
    /// Name of its record.
    pub(super) id: u64,
    /// Until when it may be delivered, Unix milliseconds.
    pub(super) expires: u64,
    /// Whether it was for all robots.
    pub(super) swarm: bool,
    /// The command as it was given, as JSON text.
    command: String,
    /// Robots that have not answered.
    pub(super) robots: BTreeMap<String, Leg>,
}

/// One robot's part of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Leg {
    /// Under which number it went, if it went.
    pub(super) seq: u64,
    /// How often the robot had started by then.
    pub(super) boot: Option<u32>,
}

#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Line {
    Accepted(Owed),
    Numbered { id: u64, robot: String, leg: Leg },
    Done { id: u64, robot: String },
}

impl Owed {
    /// Of the command `command.seq`; `None` when it cannot be written.
    pub(super) fn new(
        command: &Command,
        expires: u64,
        swarm: bool,
        robots: impl IntoIterator<Item = (RobotId, Option<u32>)>,
    ) -> Option<Self> {
        let mut buffer = [0; MAX_MESSAGE];
        let length = command.to_json(&mut buffer).ok()?;
        let text = std::str::from_utf8(buffer.get(..length)?).ok()?;
        let seq = command.seq;
        let legs = robots.into_iter();
        Some(Self {
            id: seq,
            expires,
            swarm,
            command: text.to_owned(),
            robots: legs
                .map(|(robot, boot)| (robot.as_str().to_owned(), Leg { seq, boot }))
                .collect(),
        })
    }

    /// The command; `None` when a newer or older server wrote what is none here.
    pub(super) fn command(&self) -> Option<Command> {
        Command::parse(self.command.as_bytes()).ok()
    }
}

/// See the [module](self).
#[derive(Debug)]
pub(crate) struct Journal {
    path: PathBuf,
    file: File,
    owed: BTreeMap<u64, Owed>,
    lines: usize,
    /// A write failed, so nobody knows how the file ends.
    damaged: bool,
}

impl Journal {
    /// Opens the file, or makes it, and drops what no longer counts.
    ///
    /// # Errors
    /// When the file cannot be read or written.
    pub(crate) fn open(path: &Path) -> io::Result<Self> {
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
        let file = rewrite(path, &owed)?;
        Ok(Self {
            path: path.to_owned(),
            file,
            lines: owed.len(),
            owed,
            damaged: false,
        })
    }

    /// What is owed, oldest first.
    pub(super) fn owed(&self) -> impl Iterator<Item = &Owed> {
        self.owed.values()
    }

    /// Notes a command; it is on the disk when this returns.
    pub(super) fn accepted(&mut self, owed: Owed) {
        if !owed.robots.is_empty() {
            self.write(Line::Accepted(owed), true);
        }
    }

    /// Notes under which new number a command is about to go; it is on the disk when this returns.
    pub(super) fn numbered(&mut self, id: u64, robot: &RobotId, seq: u64, boot: Option<u32>) {
        if self.is_owed(id, robot) {
            let robot = robot.as_str().to_owned();
            let leg = Leg { seq, boot };
            self.write(Line::Numbered { id, robot, leg }, true);
        }
    }

    /// Notes that nothing more is to be delivered.
    pub(super) fn done(&mut self, id: u64, robot: &RobotId) {
        if self.is_owed(id, robot) {
            let robot = robot.as_str().to_owned();
            self.write(Line::Done { id, robot }, false);
        }
    }

    /// The commands in it.
    pub(crate) fn ids(&self) -> Vec<u64> {
        self.owed.keys().copied().collect()
    }

    /// Drops what another server delivers by now, or has delivered: everything that `ours` denies.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub(crate) fn keep(&mut self, ours: impl Fn(u64) -> bool) -> io::Result<()> {
        self.owed.retain(|id, _| ours(*id));
        self.damaged = true;
        self.file = rewrite(&self.path, &self.owed)?;
        self.lines = self.owed.len();
        self.damaged = false;
        Ok(())
    }

    fn is_owed(&self, id: u64, robot: &RobotId) -> bool {
        self.owed
            .get(&id)
            .is_some_and(|owed| owed.robots.contains_key(robot.as_str()))
    }

    fn write(&mut self, line: Line, sync: bool) {
        let text = serde_json::to_vec(&line);
        apply(&mut self.owed, line);
        let result = text.map_err(io::Error::from).and_then(|mut text| {
            let many = self.lines > MANY && self.lines > 4 * self.owed.len();
            if self.damaged || many {
                self.file = rewrite(&self.path, &self.owed)?;
                self.lines = self.owed.len();
                self.damaged = false;
                return Ok(());
            }
            text.push(b'\n');
            self.damaged = true;
            self.file.write_all(&text)?;
            if sync {
                self.file.sync_data()?;
            }
            self.damaged = false;
            self.lines += 1;
            Ok(())
        });
        if let Err(error) = result {
            // Telling the robot matters more than telling the disk.
            tracing::error!(%error, "commands on their way are not safe across a restart");
        }
    }
}

fn apply(owed: &mut BTreeMap<u64, Owed>, line: Line) {
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

/// Replaces the file by one that says what `owed` says, whole or not at all.
fn rewrite(path: &Path, owed: &BTreeMap<u64, Owed>) -> io::Result<File> {
    let new = path.with_extension("new");
    let mut file = File::create(&new)?;
    for command in owed.values() {
        let mut text = serde_json::to_vec(&Line::Accepted(command.clone()))?;
        text.push(b'\n');
        file.write_all(&text)?;
    }
    file.sync_all()?;
    fs::rename(&new, path)?;
    if let Some(folder) = path.parent() {
        File::open(folder)?.sync_all()?;
    }
    Ok(file)
}

#[cfg(test)]
mod tests {
    use crawler_protocol::{Action, Source};

    use super::*;

    fn scratch(name: &str) -> PathBuf {
        let folder =
            std::env::temp_dir().join(format!("crawler-journal-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).expect("a folder");
        folder.join("commands")
    }

    fn owed(seq: u64, robots: &[&str]) -> Owed {
        let command = Command {
            action: Action::Identify,
            timestamp: 5,
            seq,
            source: Source::new("server").expect("source"),
        };
        let robots = robots.iter().map(|robot| (id(robot), Some(3)));
        Owed::new(&command, 99, robots.len() > 1, robots).expect("a command")
    }

    fn id(text: &str) -> RobotId {
        RobotId::new(text).expect("robot id")
    }

    fn all(journal: &Journal) -> Vec<(u64, Vec<(String, u64)>)> {
        let legs = |owed: &Owed| -> Vec<_> {
            let legs = owed.robots.iter();
            legs.map(|(robot, leg)| (robot.clone(), leg.seq)).collect()
        };
        journal.owed().map(|owed| (owed.id, legs(owed))).collect()
    }

    /// Wherever a crash cuts the file, what was accepted before is still there, and nothing that
    /// was not.
    #[test]
    fn a_file_cut_anywhere_tells_what_was_on_it() {
        let path = scratch("cut");
        let mut journal = Journal::open(&path).expect("open");
        let mut states = vec![(0, all(&journal))];
        let length = || fs::metadata(&path).expect("file").len() as usize;
        journal.accepted(owed(7, &["a", "b"]));
        states.push((length(), all(&journal)));
        journal.numbered(7, &id("b"), 12, Some(4));
        states.push((length(), all(&journal)));
        journal.done(7, &id("a"));
        states.push((length(), all(&journal)));
        journal.accepted(owed(13, &["a"]));
        states.push((length(), all(&journal)));
        journal.done(7, &id("b"));
        journal.done(99, &id("b"));
        states.push((length(), all(&journal)));
        assert_eq!(all(&journal), [(13, vec![("a".to_owned(), 13)])]);
        drop(journal);
        let whole = fs::read(&path).expect("read");
        for cut in 0..=whole.len() {
            fs::write(&path, &whole[..cut]).expect("write");
            let journal = Journal::open(&path).expect("open");
            // A line counts with or without its end.
            let known = states
                .iter()
                .rev()
                .find(|(at, _)| at.saturating_sub(1) <= cut);
            assert_eq!(all(&journal), known.expect("a state").1, "cut at {cut}");
        }
        fs::remove_dir_all(path.parent().expect("folder")).expect("clean up");
    }

    #[test]
    fn it_is_rewritten_before_it_is_long_and_refuses_what_is_huge() {
        let path = scratch("long");
        let mut journal = Journal::open(&path).expect("open");
        journal.accepted(owed(1, &["kept"]));
        for number in 2..5_000 {
            journal.accepted(owed(number, &["a"]));
            journal.done(number, &id("a"));
        }
        let lines = fs::read_to_string(&path).expect("read").lines().count();
        assert!(lines <= MANY + 2, "{lines} lines");
        drop(journal);
        let journal = Journal::open(&path).expect("open");
        assert_eq!(all(&journal), [(1, vec![("kept".to_owned(), 1)])]);
        assert_eq!(
            journal
                .owed()
                .next()
                .and_then(Owed::command)
                .map(|c| c.action),
            Some(Action::Identify)
        );
        drop(journal);
        File::create(&path)
            .and_then(|file| file.set_len(MAX_BYTES + 1))
            .expect("grow");
        assert!(Journal::open(&path).is_err());
        fs::remove_dir_all(path.parent().expect("folder")).expect("clean up");
    }

    #[test]
    fn garbage_between_lines_costs_only_itself() {
        let path = scratch("garbage");
        let mut journal = Journal::open(&path).expect("open");
        journal.accepted(owed(1, &["a"]));
        drop(journal);
        let mut bytes = fs::read(&path).expect("read");
        let good = bytes.clone();
        bytes.extend_from_slice(b"\xff\x00nonsense\n{\"accepted\":{\"id\":3}}\n");
        bytes.extend_from_slice(
            &String::from_utf8(good)
                .expect("text")
                .replace(":1,", ":2,")
                .into_bytes(),
        );
        fs::write(&path, bytes).expect("write");
        let journal = Journal::open(&path).expect("open");
        let ids: Vec<u64> = journal.owed().map(|owed| owed.id).collect();
        assert_eq!(ids, [1, 2]);
        fs::remove_dir_all(path.parent().expect("folder")).expect("clean up");
    }
}
