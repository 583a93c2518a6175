//! What came of a run.

use std::collections::BTreeMap;
use std::fmt;

use super::judge::Kind;

/// What goes wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Fault {
    /// SIGKILL to the server; with its embedded broker, that is gone too.
    ServerKilled,
    /// SIGKILL to the outside broker.
    BrokerKilled,
    /// Both at the same moment.
    BothKilled,
    /// The server is killed while robots are cut off as in a partition, and is back before they are: what
    /// waits for them has to survive.
    KilledInPartition,
    /// Four robots in ten can neither be heard nor hear, and nobody is told.
    Partition,
    /// As a partition, for all robots.
    Stall,
    /// Every connection of a robot is reset, and none is accepted for a while.
    Cut,
}

/// What came of a run.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Report {
    /// Robots in the world.
    pub robots: usize,
    /// How long it took, seconds.
    pub seconds: u64,
    /// Every fault with the time from its end until all robots were online, milliseconds; `None` when
    /// they were not within the time they are given.
    pub faults: Vec<(Fault, Option<u64>)>,
    /// Commands by kind.
    pub commands: BTreeMap<Kind, Counts>,
    /// Messages with a command that reached robots, and of them those under a number that had been
    /// there before.
    pub deliveries: [u64; 2],
    /// Acknowledged commands that a robot neither ran nor refused, and that had not expired.
    pub lost: u64,
    /// Commands that ran more than once.
    pub twice: u64,
    /// Commands said to have run that did not, by the robots' own count.
    pub invented: u64,
    /// Robots whose parameter is not the one that was set last.
    pub wrong_settings: u64,
    /// Commands that the server still called open when it had had time to bring them to an end.
    pub open: u64,
    /// Times a wheel was driven though nobody steered, and the ramp of a `move` was over.
    pub runaways: u64,
    /// The longest a wheel was driven beyond the word it had, milliseconds.
    pub longest_beyond_ms: u64,
    /// Robots that started anew.
    pub reboots: u64,
    /// What the recording has lost: with any, nothing above is certain.
    pub unrecorded: u64,
    /// For whoever looks for the cause: robot and command of everything that ran too often.
    pub details: Vec<String>,
}

/// What became of commands of a kind.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    /// Acknowledged with 202.
    pub acknowledged: u64,
    /// Asked for while the server died: nobody knows whether it took them.
    pub unknown: u64,
    /// Refused by the server, as it may while its broker is away.
    pub refused_by_server: u64,
    /// Of those acknowledged: carried out by the robot.
    pub ran: u64,
    /// Refused by it, or overtaken.
    pub refused: u64,
    /// Motion that found no way to its robot while it was worth something.
    pub expired: u64,
}

impl Report {
    /// Counts that must be 0, by what they are.
    pub fn must_be_zero(&self) -> [(&'static str, u64); 8] {
        [
            ("acknowledged commands lost", self.lost),
            ("commands run twice", self.twice),
            ("commands said to have run that did not", self.invented),
            (
                "robots with another setting than the last",
                self.wrong_settings,
            ),
            ("commands left open by the server", self.open),
            ("times driven without a controller", self.runaways),
            ("robots that started anew", self.reboots),
            ("events that the recording lost", self.unrecorded),
        ]
    }

    /// Faults after which not all robots were online within `limit_ms`.
    pub fn late(&self, limit_ms: u64) -> usize {
        let late = |took: &Option<u64>| took.is_none_or(|took| took > limit_ms);
        self.faults.iter().filter(|(_, took)| late(took)).count()
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{} robots, {} s, {} faults; {} commands reached robots, {} of them again\n",
            self.robots,
            self.seconds,
            self.faults.len(),
            self.deliveries[0],
            self.deliveries[1]
        )?;
        writeln!(
            f,
            "| command | acknowledged | ran | refused or overtaken | expired | asked while the server \
             died | refused by the server |"
        )?;
        writeln!(f, "|---|---:|---:|---:|---:|---:|---:|")?;
        for (kind, counts) in &self.commands {
            writeln!(
                f,
                "| `{}` | {} | {} | {} | {} | {} | {} |",
                kind.name(),
                counts.acknowledged,
                counts.ran,
                counts.refused,
                counts.expired,
                counts.unknown,
                counts.refused_by_server
            )?;
        }
        writeln!(f, "\n| fault | all robots online after, s |\n|---|---:|")?;
        for (fault, took) in &self.faults {
            match took {
                Some(took) => writeln!(f, "| {fault:?} | {:.1} |", *took as f64 / 1e3)?,
                None => writeln!(f, "| {fault:?} | not |")?,
            }
        }
        writeln!(f, "\n| must be 0 | |\n|---|---:|")?;
        for (what, count) in self.must_be_zero() {
            writeln!(f, "| {what} | {count} |")?;
        }
        for line in &self.details {
            writeln!(f, "- {line}")?;
        }
        writeln!(
            f,
            "\nlongest that a wheel was driven beyond its word, ramp included: {} ms",
            self.longest_beyond_ms
        )
    }
}
