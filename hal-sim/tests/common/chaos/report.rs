//! What came of a run.

use std::collections::BTreeMap;
use std::fmt;

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Kind {
    BrokerRestart,
    SilentPartition,
    ServerCutOff,
    RadioPartition,
    ServerKilled,
    BothKilled,
}

/// What came of a run.
#[derive(Debug, Default)]
pub(crate) struct Report {
    pub(crate) robots: usize,
    pub(crate) virtual_s: u64,
    pub(crate) faults: BTreeMap<Kind, u32>,
    /// Commands by class, and of them those that ran, were refused or overtaken, or expired.
    pub(crate) commands: BTreeMap<&'static str, [u64; 4]>,
    pub(crate) sent: u64,
    pub(crate) again: u64,
    /// Without an answer, though there was time for one.
    pub(crate) lost: u64,
    pub(crate) twice: u64,
    /// Said to have run, and did not.
    pub(crate) invented: u64,
    /// Halts whose answer the server did not live to hear.
    pub(crate) forgotten_halts: u64,
    /// Motion that went, without an answer within its life.
    pub(crate) unanswered_motion: u64,
    /// Moments in which a robot moved and nobody steered it.
    pub(crate) runaways: u64,
    /// The longest that a robot moved after the last word of its controller.
    pub(crate) longest_alone_ms: u64,
    pub(crate) slowest_return_ms: BTreeMap<Kind, u64>,
    pub(crate) late_returns: u64,
    /// Robots whose parameter is not the one set last.
    pub(crate) wrong_settings: u64,
    pub(crate) reboots: u64,
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let faults: u32 = self.faults.values().sum();
        writeln!(
            f,
            "{} robots, {} min of virtual time, {faults} faults; {} commands sent, {} of them again",
            self.robots,
            self.virtual_s / 60,
            self.sent,
            self.again
        )?;
        writeln!(
            f,
            "\n| command | given | ran | refused or overtaken | expired |"
        )?;
        writeln!(f, "|---|---:|---:|---:|---:|")?;
        for (name, [given, ran, refused, expired]) in &self.commands {
            writeln!(f, "| {name} | {given} | {ran} | {refused} | {expired} |")?;
        }
        writeln!(
            f,
            "\n| fault | times | slowest return, s |\n|---|---:|---:|"
        )?;
        for (kind, times) in &self.faults {
            let slowest = self.slowest_return_ms.get(kind).copied().unwrap_or(0);
            let slowest = slowest as f64 / 1_000.0;
            writeln!(f, "| {kind:?} | {times} | {slowest:.1} |")?;
        }
        writeln!(f, "\n| must be 0 | |\n|---|---:|")?;
        for (what, count) in self.must_be_zero() {
            writeln!(f, "| {what} | {count} |")?;
        }
        writeln!(
            f,
            "\nlongest motion after the last word of a controller: {} ms",
            self.longest_alone_ms
        )?;
        writeln!(
            f,
            "halts whose answer the server did not live to hear: {}",
            self.forgotten_halts
        )?;
        writeln!(
            f,
            "motion that went and was not answered within its life: {}",
            self.unanswered_motion
        )
    }
}

impl Report {
    pub(crate) fn must_be_zero(&self) -> [(&'static str, u64); 7] {
        [
            ("QoS 1 commands lost", self.lost),
            ("QoS 1 commands run twice", self.twice),
            ("commands said to have run that did not", self.invented),
            (
                "robots with another setting than the last",
                self.wrong_settings,
            ),
            (
                "moments of motion 500 ms after the last word",
                self.runaways,
            ),
            (
                "faults after which not all were back within 10 s",
                self.late_returns,
            ),
            ("robots that started anew", self.reboots),
        ]
    }
}
