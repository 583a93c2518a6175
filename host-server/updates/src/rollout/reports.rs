//! What a robot says, what it is seen to be, and what it does not say in time.

use crawler_protocol::RobotId;

use super::engine::Rollout;
use super::event::{Message, Now, Report, Sighting};
use super::names::ReleaseId;
use super::plan::{Plan, Retries};
use super::progress::RolloutState;
use super::robot::{Reason, RobotRow, UpdateState};
use super::transition::{Next, next};

/// How long after a message without an answer it goes again.
pub const RESEND_AFTER_MS: u64 = 15_000;

impl Rollout {
    /// Takes in what a robot says about a release.
    pub(super) fn told(&mut self, robot: &RobotId, release: &ReleaseId, report: &Report, now: Now) {
        let at = self.now_ms(now);
        let Some(row) = self.roster.row(robot) else {
            return;
        };
        let own = self.release(row).filter(|own| own.release == *release);
        let Some(own) = own.filter(|_| row.offers > 0) else {
            return;
        };
        let next = next(row.state, report, &own.build);
        let bytes = own.bytes;
        let gave_up = matches!(
            report,
            Report::Withdrawn
                | Report::Refused { .. }
                | Report::RolledBack(_)
                | Report::Confirmed(_)
        );
        if gave_up {
            self.roster.change(robot, |row| row.recalled = false);
        }
        let over = self.document.state.is_over();
        match next {
            Next::Cancel | Next::AtWork(_) if over => self.recall(robot),
            _ if over => {}
            Next::Stay => {}
            Next::Enter(state, reason) => self.enter(robot, state, reason, at),
            Next::AtWork(state) if self.may_admit(robot, now) => {
                self.roster.change(robot, |row| row.recalled = false);
                self.enter(robot, state, None, at);
            }
            Next::AtWork(_) | Next::Cancel => self.recall(robot),
            Next::AttemptFailed { reason, lasting } => {
                self.attempt_failed(robot, reason, lasting, at);
            }
        }
        if let Report::Receiving(received) = report {
            self.received(robot, bytes.min(*received), at);
        }
    }

    /// Takes in how much of the image a robot has: as long as it becomes more, there is time.
    fn received(&mut self, robot: &RobotId, received: u32, at: u64) {
        let due = due_ms(&self.document.plan, UpdateState::Receiving, at);
        self.roster.change(robot, |row| {
            if row.state == UpdateState::Receiving && received > row.received {
                row.received = received;
                row.due_ms = due;
            }
        });
    }

    /// What follows from what a robot is seen to be.
    pub(super) fn seen(&mut self, robot: &RobotId, before: Option<&Sighting>, at: u64) {
        use UpdateState::{
            Confirmed, Deferred, Failed, NotApplicable, Offered, Preparing, Receiving, RolledBack,
            Skipped, Staged, Superseded, Trial, Verifying, Waiting,
        };
        let (Some(row), Some(seen)) = (self.roster.row(robot), self.roster.seen(robot)) else {
            return;
        };
        let Some(own) = self.release(row) else {
            return;
        };
        let right = seen.build == own.build;
        let newer = seen.boot > row.boot;
        let came = seen.online && before.is_none_or(|b| !b.online || b.boot != seen.boot);
        let (boot, online, offered) = (seen.boot, seen.online, row.offers > 0);
        let owed = row.recalled && came;
        if self.document.state.is_over() {
            if owed {
                self.send(robot, Message::Cancel);
            }
            return;
        }
        match row.state {
            Waiting if right && !offered => {
                self.enter(robot, Confirmed, Some(Reason::AlreadyThere), at);
            }
            Waiting | Deferred | Offered | Preparing | Receiving | Verifying | Staged | Failed
                if right && offered =>
            {
                self.enter(robot, Trial, None, at);
            }
            Offered | Preparing | Receiving if !online => {
                self.enter(robot, Waiting, Some(Reason::Interrupted), at);
            }
            Offered | Preparing | Receiving if came && boot != row.boot => {
                self.roster.change(robot, |row| row.boot = boot);
                self.send(robot, Message::Offer);
            }
            Trial | Confirmed if newer && right => {
                self.roster.change(robot, |row| row.boot = boot);
            }
            Trial | Confirmed if newer => {
                self.enter(robot, RolledBack, Some(Reason::OldBuild), at);
            }
            Waiting | Deferred | Failed | Skipped | Superseded | RolledBack if owed => {
                self.send(robot, Message::Cancel);
            }
            NotApplicable | Waiting | Deferred | Offered | Preparing | Receiving | Verifying
            | Staged | Trial | Confirmed | RolledBack | Failed | Skipped | Superseded => {}
        }
    }

    /// Does what is due of a robot.
    pub(super) fn due(&mut self, robot: &RobotId, at: u64) {
        let Some(row) = self.roster.row(robot) else {
            return;
        };
        let (state, reason) = (row.state, row.reason.clone());
        let late = |time: Option<u64>| time.is_some_and(|time| time <= at);
        let timed_out = late(row.due_ms) || late(row.attempt_ends_ms);
        if state.is_waiting() {
            // Its pause is over.
            self.roster.change(robot, |row| {
                row.enter(UpdateState::Waiting, reason, None, row.since_ms);
            });
        } else if timed_out && state.is_before_trial() {
            self.attempt_failed(robot, Reason::TimedOut(state), false, at);
            self.recall(robot);
        } else if timed_out && state == UpdateState::Trial {
            let reason = Some(Reason::TimedOut(state));
            self.enter(robot, UpdateState::Failed, reason, at);
        } else {
            let message = match state {
                UpdateState::Offered => Some(Message::Offer),
                UpdateState::Trial => Some(Message::Confirm),
                _ => None,
            };
            self.roster.change(robot, |row| {
                row.resend_ms = message.map(|_| at + RESEND_AFTER_MS);
                if state.is_over() {
                    row.due_ms = None;
                    row.attempt_ends_ms = None;
                }
            });
            if let Some(message) = message {
                self.send(robot, message);
            }
        }
    }

    /// A robot stands elsewhere. Where it stands already nothing changes, nor has it more time.
    pub(super) fn enter(
        &mut self,
        robot: &RobotId,
        state: UpdateState,
        reason: Option<Reason>,
        at: u64,
    ) {
        let plan = &self.document.plan;
        let due = due_ms(plan, state, at);
        let attempt_ends = at + seconds(plan.timeouts.attempt_s);
        let row = self.roster.row(robot);
        let bytes = row.and_then(|row| self.release(row)).map(|own| own.bytes);
        let boot = self.roster.seen(robot).map(|seen| seen.boot);
        if row.is_none_or(|row| row.state == state) {
            return;
        }
        self.roster.change(robot, |row| {
            row.enter(state, reason, due, at);
            match state {
                UpdateState::Offered => row.resend_ms = Some(at + RESEND_AFTER_MS),
                UpdateState::Verifying | UpdateState::Staged => {
                    row.received = bytes.unwrap_or(row.received);
                }
                UpdateState::Trial | UpdateState::Confirmed => {
                    row.received = bytes.unwrap_or(row.received);
                    row.boot = row.boot.max(boot.unwrap_or(0));
                    row.recalled = false;
                    row.forgiven = false;
                }
                _ => {}
            }
            if state == UpdateState::Trial {
                row.resend_ms = Some(at + RESEND_AFTER_MS);
            }
            if state.is_before_trial() && row.attempt_ends_ms.is_none() {
                row.attempt_ends_ms = Some(attempt_ends);
            }
        });
        if state == UpdateState::Trial {
            self.send(robot, Message::Confirm);
        }
    }

    /// An attempt is lost: there is another one after a pause, or the robot has failed.
    fn attempt_failed(&mut self, robot: &RobotId, reason: Reason, lasting: bool, at: u64) {
        let retries = self.document.plan.retries.clone();
        let ends = self.document.state == RolloutState::Aborting;
        self.roster.change(robot, |row| {
            row.attempts = row.attempts.saturating_add(1);
            if lasting || ends || row.attempts >= retries.attempts {
                row.enter(UpdateState::Failed, Some(reason), None, at);
            } else {
                let pause = pause_ms(&retries, row.attempts);
                row.enter(UpdateState::Waiting, Some(reason), Some(at + pause), at);
            }
        });
    }

    /// Tells a robot to give up what it is at.
    pub(super) fn recall(&mut self, robot: &RobotId) {
        self.roster.change(robot, |row| row.recalled = true);
        self.send(robot, Message::Cancel);
    }

    /// Offers a robot its release.
    pub(super) fn offer(&mut self, robot: &RobotId, at: u64) {
        let boot = self.roster.seen(robot).map(|seen| seen.boot);
        self.enter(robot, UpdateState::Offered, None, at);
        self.roster.change(robot, |row: &mut RobotRow| {
            row.offers = row.offers.saturating_add(1);
            row.boot = boot.unwrap_or(row.boot);
            row.recalled = false;
        });
        self.send(robot, Message::Offer);
    }
}

/// A time of a plan.
pub(super) fn seconds(seconds: u32) -> u64 {
    u64::from(seconds) * 1_000
}

/// The pause after so many failed attempts.
fn pause_ms(retries: &Retries, attempts: u8) -> u64 {
    let doubled = u32::from(attempts.saturating_sub(1)).min(31);
    let pause = seconds(retries.pause_s) << doubled;
    pause.min(seconds(retries.longest_pause_s))
}

/// When the time in a state is over that was entered at `at`.
fn due_ms(plan: &Plan, state: UpdateState, at: u64) -> Option<u64> {
    let timeouts = &plan.timeouts;
    let time = match state {
        UpdateState::Offered => timeouts.offered_s,
        UpdateState::Deferred => plan.retries.deferred_s,
        UpdateState::Preparing => timeouts.preparing_s,
        UpdateState::Receiving => timeouts.receiving_s,
        UpdateState::Verifying => timeouts.verifying_s,
        UpdateState::Staged => timeouts.staged_s,
        UpdateState::Trial => timeouts.trial_s,
        UpdateState::NotApplicable
        | UpdateState::Waiting
        | UpdateState::Confirmed
        | UpdateState::RolledBack
        | UpdateState::Failed
        | UpdateState::Skipped
        | UpdateState::Superseded => return None,
    };
    Some(at + seconds(time))
}
