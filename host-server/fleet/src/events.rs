//! What an operator should know of, in words.

use std::collections::VecDeque;

use crawler_protocol::RobotId;
use crawler_records::{Event as Recorded, EventLevel};
use serde::Serialize;

use super::Presence;
use crate::recorder::{Known, Recorder};
use crawler_system::clock;

/// Events kept for readers who come later.
const KEPT: usize = 500;
/// When more robots than this do the same at once, one event tells of all of them.
pub(super) const ONE_BY_ONE: usize = 5;

/// How much an event matters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    /// As expected.
    Info,
    /// Worth a look.
    Warn,
    /// Needs somebody.
    Error,
}

/// One event, as the live feed sends it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Event {
    /// Unix milliseconds.
    pub time: u64,
    /// How grave it is.
    pub level: Level,
    /// Of whom it tells; of the server where there is none.
    pub robot: Option<RobotId>,
    /// For people.
    pub text: String,
}

impl Event {
    /// As the records keep it.
    fn to_recorded(&self) -> Recorded {
        Recorded {
            at: i64::try_from(self.time).unwrap_or(i64::MAX),
            level: match self.level {
                Level::Info => EventLevel::Info,
                Level::Warn => EventLevel::Warn,
                Level::Error => EventLevel::Error,
            },
            robot: self.robot.clone(),
            text: self.text.clone(),
        }
    }
}

/// The newest events, numbered through.
#[derive(Debug, Default)]
pub struct EventLog {
    events: VecDeque<Event>,
    /// Number of the event after the newest.
    next: u64,
    /// Where they are kept for longer.
    recorder: Option<Recorder>,
}

impl EventLog {
    /// From here on events are recorded as well.
    pub fn record_in(&mut self, recorder: Recorder) {
        self.recorder = Some(recorder);
    }

    /// Takes an event that this server alone knows of.
    pub fn push(&mut self, level: Level, robot: Option<RobotId>, text: String) {
        self.add(level, robot, text, Known::Here);
    }

    /// Takes an event that every server of the fleet finds out by itself, from what robots say.
    pub fn heard(&mut self, level: Level, robot: Option<RobotId>, text: String) {
        self.add(level, robot, text, Known::Everywhere);
    }

    fn add(&mut self, level: Level, robot: Option<RobotId>, text: String, known: Known) {
        let event = Event {
            time: clock::unix_ms(),
            level,
            robot,
            text,
        };
        if let Some(recorder) = &self.recorder {
            recorder.record(event.to_recorded(), known);
        }
        if self.events.len() == KEPT {
            self.events.pop_front();
        }
        self.events.push_back(event);
        self.next += 1;
    }

    /// The newest `count` events, oldest first.
    pub fn newest(&self, count: usize) -> impl Iterator<Item = &Event> {
        self.events
            .iter()
            .skip(self.events.len().saturating_sub(count))
    }

    /// Events since number `from`, how many in between are lost, and the number to ask for next.
    pub fn since(&self, from: u64) -> (impl Iterator<Item = &Event>, u64, u64) {
        let new = self.next.saturating_sub(from);
        let kept = (self.events.len() as u64).min(new);
        (self.newest(kept as usize), new - kept, self.next)
    }

    pub(super) fn presence_changes(&mut self, moves: &[(RobotId, Presence)]) {
        for presence in [Presence::Offline, Presence::Stale, Presence::Online] {
            let level = match presence {
                Presence::Online => Level::Info,
                Presence::Stale | Presence::Offline => Level::Warn,
            };
            let same: Vec<_> = moves.iter().filter(|(_, now)| *now == presence).collect();
            if same.len() > ONE_BY_ONE {
                let text = format!("{} robots are {}", same.len(), presence.name());
                self.heard(level, None, text);
            } else {
                for (id, _) in same {
                    self.heard(level, Some(id.clone()), presence.name().to_owned());
                }
            }
        }
    }
}
