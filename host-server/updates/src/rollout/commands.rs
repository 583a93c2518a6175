//! What people do with a rollout.

use std::fmt;

use crawler_protocol::RobotId;

use super::engine::Rollout;
use super::event::{Command, Happening, Now, Step};
use super::progress::{PauseReason, RolloutState};
use super::robot::{Reason, RobotRow, UpdateState};

/// Why a command is not carried out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum CommandError {
    /// The rollout is over, or about to be.
    Over,
    /// It is paused already.
    Paused,
    /// It is not paused.
    NotPaused,
    /// No robot of that name belongs to it.
    UnknownRobot,
    /// The robot is left alone: no release is for it, or no phase selects it.
    NotApplicable,
    /// The robot runs the new program on trial, which is to come to its end.
    InTrial,
    /// There is nothing to try again: the robot waits, or is at work, or is done.
    NothingToRetry,
    /// The robot has come to its end.
    Ended,
}

impl fmt::Display for CommandError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Over => "the rollout is over",
            Self::Paused => "the rollout is paused already",
            Self::NotPaused => "the rollout is not paused",
            Self::UnknownRobot => "the rollout has no such robot",
            Self::NotApplicable => {
                "no release of the rollout is for this robot, or no phase selects it"
            }
            Self::InTrial => "the robot runs the new program on trial: wait for the end of that",
            Self::NothingToRetry => "the robot has neither failed nor was it left out",
            Self::Ended => "the robot has come to its end in this rollout",
        })
    }
}

impl std::error::Error for CommandError {}

impl Rollout {
    /// Carries out a command.
    ///
    /// # Errors
    /// [`CommandError`] when it makes no sense as things are; nothing has changed then.
    pub fn command(&mut self, command: &Command, now: Now) -> Result<Step, CommandError> {
        let state = self.document.state;
        if state.is_over() {
            return Err(CommandError::Over);
        }
        let at = self.now_ms(now);
        match command {
            Command::Pause | Command::Resume | Command::Abort | Command::Retry(_)
                if state == RolloutState::Aborting =>
            {
                return Err(CommandError::Over);
            }
            Command::Pause if state != RolloutState::Running => return Err(CommandError::Paused),
            Command::Pause => self.pause(PauseReason::Person, at),
            Command::Resume => self.resume(state)?,
            Command::Abort => self.abort(at),
            Command::Retry(robot) => self.retry(robot, at)?,
            Command::Skip(robot) => self.leave_out(robot, UpdateState::Skipped, at)?,
            Command::Supersede(robot) => self.leave_out(robot, UpdateState::Superseded, at)?,
        }
        self.settle(now);
        Ok(self.step(now))
    }

    fn resume(&mut self, state: RolloutState) -> Result<(), CommandError> {
        let RolloutState::Paused(reason) = state else {
            return Err(CommandError::NotPaused);
        };
        if reason != PauseReason::Person {
            let phase = self.document.phase;
            let failed = |row: &RobotRow| row.phase == Some(phase) && row.state.is_failure();
            for robot in self.roster.select(failed) {
                self.roster.change(&robot, |row| row.forgiven = true);
            }
        }
        self.document.state = RolloutState::Running;
        self.tell(Happening::Resumed);
        Ok(())
    }

    fn abort(&mut self, at: u64) {
        self.recall_all(UpdateState::Skipped, &Reason::Aborted, at);
        for robot in self.roster.select(|row| row.state.is_waiting()) {
            let reason = Some(Reason::Aborted);
            self.enter(&robot, UpdateState::Skipped, reason, at);
        }
        // That it is aborted is told once the last trial has ended.
        self.document.state = RolloutState::Aborting;
        self.touch();
    }

    fn retry(&mut self, robot: &RobotId, at: u64) -> Result<(), CommandError> {
        match self.state_of(robot)? {
            UpdateState::Failed | UpdateState::RolledBack | UpdateState::Skipped => {}
            UpdateState::NotApplicable => return Err(CommandError::NotApplicable),
            UpdateState::Waiting
            | UpdateState::Offered
            | UpdateState::Deferred
            | UpdateState::Preparing
            | UpdateState::Receiving
            | UpdateState::Verifying
            | UpdateState::Staged
            | UpdateState::Trial
            | UpdateState::Confirmed
            | UpdateState::Superseded => return Err(CommandError::NothingToRetry),
        }
        let phase = self.document.phase;
        self.enter(robot, UpdateState::Waiting, Some(Reason::Retried), at);
        self.roster.change(robot, |row| {
            row.attempts = 0;
            row.forgiven = false;
            row.phase = row.phase.max(Some(phase));
        });
        self.seen(robot, None, at);
        Ok(())
    }

    fn leave_out(
        &mut self,
        robot: &RobotId,
        state: UpdateState,
        at: u64,
    ) -> Result<(), CommandError> {
        let reason = match state {
            UpdateState::Superseded => Reason::NewerRollout,
            _ => Reason::LeftOut,
        };
        match self.state_of(robot)? {
            UpdateState::Waiting | UpdateState::Deferred => {
                self.enter(robot, state, Some(reason), at);
            }
            UpdateState::Offered
            | UpdateState::Preparing
            | UpdateState::Receiving
            | UpdateState::Verifying
            | UpdateState::Staged => {
                self.enter(robot, state, Some(reason), at);
                self.recall(robot);
            }
            UpdateState::Trial => return Err(CommandError::InTrial),
            UpdateState::NotApplicable => return Err(CommandError::NotApplicable),
            UpdateState::Confirmed
            | UpdateState::RolledBack
            | UpdateState::Failed
            | UpdateState::Skipped
            | UpdateState::Superseded => return Err(CommandError::Ended),
        }
        Ok(())
    }

    fn state_of(&self, robot: &RobotId) -> Result<UpdateState, CommandError> {
        let row = self.roster.row(robot).ok_or(CommandError::UnknownRobot)?;
        Ok(row.state)
    }
}
