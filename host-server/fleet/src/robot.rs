//! One robot.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use crawler_protocol::open::{Heartbeat, LogRecord, Open, StatusMessage, Telemetry, Unknown};
use crawler_protocol::{Detections, ParametersMessage, RobotId, RobotState};

use super::Presence;

/// Two robots under one id show as an uptime that keeps jumping back. A restart is one jump, a
/// robot in a boot loop one every few seconds at most; so many within [`DOUBLE_WINDOW`] are doubles
/// or as bad. A restart into another program, which an update brings about, is not among them.
const DOUBLE_JUMPS: usize = 3;
const DOUBLE_WINDOW: Duration = Duration::from_mins(1);

/// How much a robot has said that this server does not know, since the server knows the robot.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct UnknownCount {
    /// Fields that were passed over.
    pub fields: u64,
    /// Words that were kept as text.
    pub words: u64,
}

impl UnknownCount {
    pub(super) fn count(&mut self, unknown: Unknown) {
        self.fields = self.fields.saturating_add(unknown.fields.into());
        self.words = self.words.saturating_add(unknown.words.into());
    }
}

/// What is known of one robot.
pub struct Robot {
    /// Its name.
    pub id: RobotId,
    /// Its number in the live feed.
    pub index: u16,
    /// Whether it is there.
    pub presence: Presence,
    /// The newest.
    pub status: Option<StatusMessage>,
    /// The newest.
    pub telemetry: Option<Telemetry>,
    /// The newest.
    pub heartbeat: Option<Heartbeat>,
    /// What it saw last. Boxed: large, and few robots see.
    pub sees: Option<Box<Detections>>,
    /// Boxed: large, and seldom looked at.
    pub parameters: Option<Box<ParametersMessage>>,
    /// Oldest first.
    pub logs: VecDeque<LogRecord>,
    /// What it has said that this server does not know.
    pub unknown: UnknownCount,
    /// Since its first message.
    pub known_since: Instant,
    /// When it last said something itself.
    pub last_seen: Option<Instant>,
    /// Unix milliseconds of the same moment, for people.
    pub last_seen_ms: Option<u64>,
    /// Fences that it is on the wrong side of: a bit for each, in their order.
    pub(super) beyond: u64,
    goodbye: bool,
    jumps: VecDeque<Instant>,
    /// The highest count of boots that it told.
    boots: u32,
    /// Whether it told of a restart into another program, and no heartbeat of that has come yet.
    replaced: bool,
}

impl Robot {
    pub(super) fn new(id: RobotId, index: u16, now: Instant) -> Self {
        Self {
            id,
            index,
            presence: Presence::Stale,
            status: None,
            telemetry: None,
            heartbeat: None,
            sees: None,
            parameters: None,
            logs: VecDeque::new(),
            unknown: UnknownCount::default(),
            known_since: now,
            last_seen: None,
            last_seen_ms: None,
            beyond: 0,
            goodbye: false,
            jumps: VecDeque::new(),
            boots: 0,
            replaced: false,
        }
    }

    /// Takes what a robot says of itself.
    ///
    /// A program that was not started before, and is not the one before it, was put there. Of two robots that
    /// run different ones that is so at most once, since the count of neither rises.
    pub(super) fn introduce(&mut self, status: StatusMessage) {
        let count = status.boot.count;
        if let Some(last) = &self.status
            && count > self.boots
            && status.build != last.build
        {
            self.replaced = true;
        }
        self.boots = self.boots.max(count);
        self.status = Some(status);
    }

    pub(super) fn presence_at(&self, now: Instant) -> Presence {
        Presence::judge(
            self.goodbye,
            self.last_seen.map(|at| now.saturating_duration_since(at)),
            now.saturating_duration_since(self.known_since),
        )
    }

    /// Notes a live word. Whoever speaks is there, even after a goodbye: the will of a session that
    /// was taken over may arrive after the first words of the next one.
    pub(super) fn seen(&mut self, now: Instant, unix_ms: u64) {
        self.last_seen = Some(now);
        self.last_seen_ms = Some(unix_ms);
        self.goodbye = false;
    }

    /// Notes that the robot is going, by its own word or by its last will.
    pub(super) fn gone(&mut self) {
        self.goodbye = true;
    }

    /// Takes a heartbeat; true when it shows for the first time in a while that two robots share
    /// this id.
    pub(super) fn beat(&mut self, heartbeat: Heartbeat, now: Instant) -> bool {
        let jumped = self
            .heartbeat
            .as_ref()
            .is_some_and(|last| heartbeat.uptime_ms < last.uptime_ms);
        self.heartbeat = Some(heartbeat);
        self.forget_jumps(now);
        if !jumped || std::mem::take(&mut self.replaced) {
            return false;
        }
        self.jumps.push_back(now);
        if self.jumps.len() > 2 * DOUBLE_JUMPS {
            self.jumps.pop_front();
        }
        self.jumps.len() == DOUBLE_JUMPS
    }

    fn forget_jumps(&mut self, now: Instant) {
        while let Some(first) = self.jumps.front() {
            if now.saturating_duration_since(*first) < DOUBLE_WINDOW {
                break;
            }
            self.jumps.pop_front();
        }
    }

    /// Whether two robots seem to share this id.
    pub fn has_double(&self) -> bool {
        self.jumps.len() >= DOUBLE_JUMPS
    }

    /// The newest state, from whichever message told it last.
    pub fn state(&self) -> Option<Open<RobotState>> {
        match (&self.telemetry, &self.heartbeat) {
            (Some(telemetry), Some(heartbeat)) if heartbeat.timestamp > telemetry.timestamp => {
                Some(heartbeat.state)
            }
            (Some(telemetry), _) => Some(telemetry.state),
            (None, heartbeat) => heartbeat.as_ref().map(|heartbeat| heartbeat.state),
        }
    }

    pub(super) fn log(&mut self, record: LogRecord, keep: usize) {
        self.logs.push_back(record);
        while self.logs.len() > keep {
            self.logs.pop_front();
        }
    }
}
