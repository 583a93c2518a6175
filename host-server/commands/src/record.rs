//! One command and what it came to.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use crawler_delivery::{Class, End, SETTINGS};
use crawler_protocol::open::{Open, Response};
use crawler_protocol::{Action, Command, Outcomes, Reason, ResponseStatus, RobotId, Source};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::Target;

/// A robot that has not answered at all by then will not.
const FIRST_ANSWER: Duration = Duration::from_secs(5);
/// What a lasting command may take beyond its own duration.
const GRACE: Duration = Duration::from_secs(5);
const LONGEST_SCAN: Duration = Duration::from_mins(1);
const LONGEST_GOTO: Duration = Duration::from_mins(10);

/// What a command came to with one robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum OutcomeStatus {
    /// Done, or in force.
    Completed,
    /// Older than another command; nothing changed.
    Stale,
    /// Came too late; nothing changed.
    Expired,
    /// Not acceptable; nothing changed.
    Rejected,
    /// Begun and not brought to its end.
    Failed,
    /// No answer in time.
    Timeout,
    /// Under way.
    Accepted,
    /// No answer yet, or not sent yet: the robot is away.
    Pending,
}

impl OutcomeStatus {
    /// As the API and the metrics say it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Completed => "completed",
            Self::Stale => "stale",
            Self::Expired => "expired",
            Self::Rejected => "rejected",
            Self::Failed => "failed",
            Self::Timeout => "timeout",
            Self::Accepted => "accepted",
            Self::Pending => "pending",
        }
    }

    pub(super) const fn is_open(self) -> bool {
        matches!(self, Self::Accepted | Self::Pending)
    }
}

impl From<Open<ResponseStatus>> for OutcomeStatus {
    fn from(status: Open<ResponseStatus>) -> Self {
        match status {
            // Of one that is not known the robot has the command, and what it says of the end nobody here
            // can tell: a word that is known may follow, and is waited for.
            Open::Known(ResponseStatus::Accepted) | Open::Unknown(_) => Self::Accepted,
            Open::Known(ResponseStatus::Completed) => Self::Completed,
            Open::Known(ResponseStatus::Rejected) => Self::Rejected,
            Open::Known(ResponseStatus::Expired) => Self::Expired,
            Open::Known(ResponseStatus::Stale) => Self::Stale,
            Open::Known(ResponseStatus::Failed) => Self::Failed,
        }
    }
}

/// What a command came to with one robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Outcome {
    pub(crate) status: OutcomeStatus,
    pub(crate) reason: Option<Open<Reason>>,
    pub(crate) timestamp: Option<u64>,
    /// When the command first went to the robot.
    pub(super) went: Option<Instant>,
}

impl Outcome {
    const PENDING: Self = Self {
        status: OutcomeStatus::Pending,
        reason: None,
        timestamp: None,
        went: None,
    };
}

/// What an answer changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Change {
    /// The robot's first answer that ends the matter.
    pub(super) first_final: bool,
    pub(super) completed: bool,
}

/// A command and its outcomes.
#[derive(Debug, Clone)]
pub(crate) struct Record {
    /// Its name, which is the number that it had first.
    pub(super) id: u64,
    /// Other numbers under which it went.
    pub(super) numbers: Vec<u64>,
    pub(crate) command: Command,
    pub(crate) target: Target,
    pub(crate) outcomes: BTreeMap<RobotId, Outcome>,
    pub(crate) sent_at: Instant,
    /// The source that a setting goes under, where it is not the usual one.
    pub(super) settings: Option<Source>,
    /// Outcomes that are not final.
    open: usize,
}

impl Record {
    pub(super) fn new(
        command: Command,
        target: Target,
        expected: impl IntoIterator<Item = RobotId>,
        now: Instant,
    ) -> Self {
        let outcomes: BTreeMap<_, _> = expected
            .into_iter()
            .map(|id| (id, Outcome::PENDING))
            .collect();
        Self {
            id: command.seq,
            numbers: Vec::new(),
            command,
            target,
            open: outcomes.len(),
            outcomes,
            sent_at: now,
            settings: None,
        }
    }

    /// Puts back what another server, or an earlier start, knew of a robot's outcome.
    pub(super) fn restore(&mut self, robot: &RobotId, outcome: Outcome) {
        if let Some(known) = self.outcomes.get_mut(robot)
            && known.status.is_open()
        {
            self.open -= usize::from(!outcome.status.is_open());
            *known = outcome;
        }
    }

    /// The source that it goes under.
    pub(super) fn source(&self) -> Source {
        let given = &self.command.source;
        if Class::of(&self.command.action) != Class::Setting {
            return given.clone();
        }
        let settings = self.settings.clone();
        settings.unwrap_or_else(|| Source::new(SETTINGS).unwrap_or_else(|_| given.clone()))
    }

    /// Notes a number under which it went.
    pub(super) fn went_as(&mut self, seq: u64) {
        if seq != self.id && !self.numbers.contains(&seq) {
            self.numbers.push(seq);
        }
    }

    /// Whether some robot has not answered for good.
    pub(super) const fn is_open(&self) -> bool {
        self.open > 0
    }

    /// Takes in an answer; `None` when it changes nothing.
    pub(super) fn answer(&mut self, response: &Response, known: bool) -> Option<Change> {
        let status = OutcomeStatus::from(response.status);
        let outcome = Outcome {
            status,
            reason: response.reason,
            timestamp: Some(response.timestamp),
            went: Some(self.sent_at),
        };
        let Some(current) = self.outcomes.get_mut(&response.robot) else {
            if self.target != Target::Swarm || !known {
                return None;
            }
            self.outcomes.insert(response.robot.clone(), outcome);
            self.open += usize::from(status.is_open());
            return Some(Change {
                first_final: !status.is_open(),
                completed: status == OutcomeStatus::Completed,
            });
        };
        // A late answer is worth more than our giving up; a final answer is never taken back, and
        // `accepted` does not follow `accepted`.
        let moves_on = match current.status {
            OutcomeStatus::Pending | OutcomeStatus::Timeout => true,
            OutcomeStatus::Accepted => !status.is_open(),
            OutcomeStatus::Completed
            | OutcomeStatus::Stale
            | OutcomeStatus::Expired
            | OutcomeStatus::Rejected
            | OutcomeStatus::Failed => false,
        };
        if !moves_on {
            return None;
        }
        // A timed-out robot that reports `accepted` after all has its first word, not a new wait.
        let was_open = current.status.is_open();
        if was_open && !status.is_open() {
            self.open -= 1;
        } else if !was_open && status.is_open() {
            self.open += 1;
        }
        let went = current.went.or(outcome.went);
        *current = Outcome { went, ..outcome };
        Some(Change {
            first_final: !status.is_open(),
            completed: status == OutcomeStatus::Completed,
        })
    }

    /// Whether the command has not gone to the robot yet.
    pub(super) fn waited(&self, robot: &RobotId) -> bool {
        let known = self.outcomes.get(robot);
        known.is_some_and(|outcome| outcome.went.is_none())
    }

    /// Notes that the command goes to a robot.
    pub(super) fn went(&mut self, robot: &RobotId, seq: u64, now: Instant) {
        if let Some(outcome) = self.outcomes.get_mut(robot) {
            outcome.went.get_or_insert(now);
        }
        if self.target != Target::Swarm {
            self.command.seq = seq;
        }
    }

    /// Notes that the command goes to all its robots.
    pub(super) fn went_to_all(&mut self, now: Instant) {
        for outcome in self.outcomes.values_mut() {
            outcome.went.get_or_insert(now);
        }
    }

    /// Notes that the command will not be sent to a robot any more. Returns what that makes of it,
    /// if it makes something new of it.
    pub(super) fn over(&mut self, robot: &RobotId, end: End) -> Option<OutcomeStatus> {
        let outcome = self.outcomes.get_mut(robot)?;
        if outcome.status != OutcomeStatus::Pending {
            return None;
        }
        outcome.status = match end {
            End::Expired => OutcomeStatus::Expired,
            End::Unanswered => OutcomeStatus::Timeout,
        };
        self.open -= 1;
        Some(outcome.status)
    }

    /// Turns overdue outcomes into time-outs and returns how many. One that waits to be sent is not
    /// overdue; one that is sent again still is, and a late answer is welcome.
    pub(super) fn expire(&mut self, now: Instant) -> usize {
        let end = longest(&self.command.action);
        let mut expired = 0;
        for outcome in self.outcomes.values_mut() {
            let age = outcome.went.map(|at| now.saturating_duration_since(at));
            let overdue = match (outcome.status, age) {
                (OutcomeStatus::Pending, Some(age)) => age >= FIRST_ANSWER,
                (OutcomeStatus::Accepted, Some(age)) => age >= end,
                _ => false,
            };
            if overdue {
                outcome.status = OutcomeStatus::Timeout;
                expired += 1;
            }
        }
        self.open -= expired;
        expired
    }

    pub(super) fn wire_outcomes(&self) -> Outcomes {
        let mut outcomes = Outcomes::default();
        for outcome in self.outcomes.values() {
            match outcome.status {
                OutcomeStatus::Completed => outcomes.add(ResponseStatus::Completed),
                OutcomeStatus::Stale => outcomes.add(ResponseStatus::Stale),
                OutcomeStatus::Expired => outcomes.add(ResponseStatus::Expired),
                OutcomeStatus::Rejected => outcomes.add(ResponseStatus::Rejected),
                OutcomeStatus::Failed => outcomes.add(ResponseStatus::Failed),
                OutcomeStatus::Accepted => outcomes.add(ResponseStatus::Accepted),
                OutcomeStatus::Timeout | OutcomeStatus::Pending => outcomes.unanswered += 1,
            }
        }
        outcomes
    }

    pub(crate) fn view(&self) -> CommandView {
        CommandView {
            outcomes: self.outcomes.iter().map(OutcomeView::new).collect(),
            ..self.summary()
        }
    }

    /// What it came to with one robot; `None` for one that it was not for.
    pub(super) fn view_of(&self, robot: &RobotId) -> Option<CommandView> {
        let outcome = self.outcomes.get_key_value(robot)?;
        Some(CommandView {
            outcomes: vec![OutcomeView::new(outcome)],
            ..self.summary()
        })
    }

    /// Without the outcomes of single robots.
    pub(super) fn summary(&self) -> CommandView {
        let mut counts = Counts::default();
        for outcome in self.outcomes.values() {
            *match outcome.status {
                OutcomeStatus::Completed => &mut counts.completed,
                OutcomeStatus::Stale => &mut counts.stale,
                OutcomeStatus::Expired => &mut counts.expired,
                OutcomeStatus::Rejected => &mut counts.rejected,
                OutcomeStatus::Failed => &mut counts.failed,
                OutcomeStatus::Timeout => &mut counts.timeout,
                OutcomeStatus::Accepted => &mut counts.accepted,
                OutcomeStatus::Pending => &mut counts.pending,
            } += 1;
        }
        // The order of the variants is that of how much is left to wish for.
        let decisive = self.outcomes.values().max_by_key(|outcome| outcome.status);
        let status = decisive.map_or(OutcomeStatus::Completed, |outcome| outcome.status);
        let reason = decisive.and_then(|outcome| outcome.reason);
        CommandView {
            id: self.id.to_string(),
            seq: self.command.seq,
            command: self.command.action.name(),
            robot: match &self.target {
                Target::Robot(id) => Some(id.as_str().to_owned()),
                Target::Swarm => None,
            },
            source: self.command.source.as_str().to_owned(),
            timestamp: self.command.timestamp,
            status,
            reason,
            counts,
            outcomes: Vec::new(),
        }
    }
}

/// By when a robot that has accepted must have come to an end.
fn longest(action: &Action) -> Duration {
    match action {
        Action::Move { duration_ms, .. } => Duration::from_millis((*duration_ms).into()) + GRACE,
        Action::Scan => LONGEST_SCAN,
        Action::Goto { .. } => LONGEST_GOTO,
        _ => FIRST_ANSWER + GRACE,
    }
}

/// A command and what it came to.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
#[schema(as = CommandRecord)]
pub struct CommandView {
    /// Name of this record in `/api/v1/commands/{id}`.
    pub id: String,
    /// The command's number on the wire. One that waited for its robot may get another than `id`
    /// when it goes.
    pub seq: u64,
    /// The command's name.
    pub command: &'static str,
    /// The robot it was for; `null` for all of them.
    pub robot: Option<String>,
    /// Who sent it, as robots see it.
    pub source: String,
    /// Unix milliseconds when it was sent.
    pub timestamp: u64,
    /// The least finished, then the worst, of the outcomes.
    pub status: OutcomeStatus,
    /// Why, in a stable code, of the outcome that gives `status`.
    #[schema(value_type = Option<String>)]
    pub reason: Option<Open<Reason>>,
    /// Robots by outcome.
    pub counts: Counts,
    /// Every robot's outcome; left out of the answer that a command to the swarm was sent.
    pub outcomes: Vec<OutcomeView>,
}

/// Robots by outcome.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, ToSchema)]
#[schema(as = CommandCounts)]
#[allow(missing_docs)] // the names are those of OutcomeStatus
pub struct Counts {
    pub pending: usize,
    pub accepted: usize,
    pub completed: usize,
    pub rejected: usize,
    pub expired: usize,
    pub stale: usize,
    pub failed: usize,
    pub timeout: usize,
}

/// What a command came to with one robot.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
#[schema(as = CommandOutcome)]
pub struct OutcomeView {
    /// The robot.
    pub robot: String,
    /// What it came to.
    pub status: OutcomeStatus,
    /// Why, in a stable code.
    #[schema(value_type = Option<String>)]
    pub reason: Option<Open<Reason>>,
    /// When the robot said so, in Unix milliseconds by its clock.
    pub timestamp: Option<u64>,
}

impl OutcomeView {
    fn new((id, outcome): (&RobotId, &Outcome)) -> Self {
        Self {
            robot: id.as_str().to_owned(),
            status: outcome.status,
            reason: outcome.reason,
            timestamp: outcome.timestamp,
        }
    }
}
