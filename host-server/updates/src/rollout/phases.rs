//! Phase by phase: who is offered the release now, and whether the next phase may begin.

use crawler_protocol::RobotId;

use super::engine::Rollout;
use super::event::{Happening, Message, Now};
use super::judge::Verdict;
use super::progress::{PauseReason, PhaseState, RolloutState};
use super::reports::seconds;
use super::robot::{Reason, UpdateState};

impl Rollout {
    /// Draws every conclusion from what is known at `now`.
    pub(super) fn settle(&mut self, now: Now) {
        if self.document.state.is_over() {
            return;
        }
        let at = self.now_ms(now);
        while let Some(robot) = self.roster.due(at) {
            self.due(&robot, at);
        }
        match self.document.state {
            RolloutState::Running => {
                self.judge(at);
                self.admit(now);
            }
            RolloutState::Aborting if self.roster.in_flight() == 0 => {
                self.document.state = RolloutState::Aborted;
                self.tell(Happening::Aborted);
            }
            RolloutState::Aborting
            | RolloutState::Paused(_)
            | RolloutState::Aborted
            | RolloutState::Done => {}
        }
    }

    /// A phase begins.
    pub(super) fn begin_phase(&mut self, phase: u8, at: u64) {
        self.document.phase = phase;
        self.set_phase(PhaseState::Active { since_ms: at });
        self.tell(Happening::PhaseBegan(phase));
    }

    fn set_phase(&mut self, state: PhaseState) {
        let phase = usize::from(self.document.phase);
        self.document.phases[phase] = state;
    }

    /// Judges the phase that is served, and goes on to those after it.
    fn judge(&mut self, at: u64) {
        loop {
            let phase = self.document.phase;
            let planned = &self.document.plan.phases[usize::from(phase)];
            let soak = seconds(planned.soak_s);
            let tally = self.roster.tally(phase);
            let state = self.document.phases[usize::from(phase)];
            let known = at >= self.grace_ends_ms() || tally.members() == 0;
            match planned.judge(tally) {
                Verdict::Stop(PauseReason::Failures) => {
                    return self.pause(PauseReason::Failures, at);
                }
                Verdict::Stop(reason) if known => return self.pause(reason, at),
                Verdict::Pass if known => {}
                Verdict::GoOn | Verdict::Pass | Verdict::Stop(_) => {
                    if let PhaseState::Passed { at_ms, .. } = state {
                        self.finish(at_ms, at);
                    }
                    return;
                }
            }
            let empty = tally.members() == 0;
            let since_ms = match state {
                PhaseState::Pending => at,
                PhaseState::Active { since_ms } if empty || soak == 0 => since_ms,
                PhaseState::Active { since_ms } => {
                    let until_ms = at + soak;
                    self.set_phase(PhaseState::Soaking { since_ms, until_ms });
                    return self.tell(Happening::PhaseSoaks(phase));
                }
                PhaseState::Soaking { until_ms, .. } if at < until_ms => return,
                PhaseState::Soaking { since_ms, .. } => since_ms,
                PhaseState::Passed { at_ms, .. } => return self.finish(at_ms, at),
            };
            let at_ms = at;
            self.set_phase(PhaseState::Passed { since_ms, at_ms });
            self.tell(Happening::PhasePassed(phase));
            if usize::from(phase) + 1 < self.document.phases.len() {
                self.carry(phase);
                self.begin_phase(phase + 1, at);
            }
        }
    }

    /// Robots of a phase that still wait belong to the next.
    fn carry(&mut self, phase: u8) {
        let waiting =
            |row: &super::robot::RobotRow| row.phase == Some(phase) && row.state.is_waiting();
        for robot in self.roster.select(waiting) {
            self.roster
                .change(&robot, |row| row.phase = Some(phase + 1));
        }
    }

    /// The last phase has passed: the end, once nobody is at work and nobody is waited for any more.
    fn finish(&mut self, passed_ms: u64, at: u64) {
        let wait = self.document.plan.limits.wait_s;
        if wait.is_some_and(|wait| at >= passed_ms.saturating_add(seconds(wait))) {
            for robot in self.roster.select(|row| row.state.is_waiting()) {
                let reason = Some(Reason::NeverReached);
                self.enter(&robot, UpdateState::Skipped, reason, at);
            }
        }
        let open = |state: UpdateState| !state.is_over();
        if self
            .roster
            .tallies()
            .iter()
            .all(|tally| tally.sum(open) == 0)
        {
            self.document.state = RolloutState::Done;
            self.tell(Happening::Done);
        }
    }

    /// Offers the release to as many robots as may have it now.
    fn admit(&mut self, now: Now) {
        let at = self.now_ms(now);
        while self.has_room(now) {
            let Some(robot) = self.roster.next_ready(self.document.phase) else {
                return;
            };
            self.offer(&robot, at);
        }
    }

    /// Whether a robot that is at work by itself may go on.
    pub(super) fn may_admit(&self, robot: &RobotId, now: Now) -> bool {
        let fits = self.roster.row(robot).is_some_and(|row| {
            let pauses = row.state == UpdateState::Waiting && row.due_ms.is_some();
            row.phase == Some(self.document.phase) && !pauses
        });
        fits && self.has_room(now)
    }

    fn has_room(&self, now: Now) -> bool {
        self.document.state == RolloutState::Running
            && self.is_window_open(now)
            && self.roster.in_flight() < self.document.plan.limits.parallel
    }

    fn is_window_open(&self, now: Now) -> bool {
        let window = self.document.plan.window;
        window.is_none_or(|window| window.is_open(now.unix_ms))
    }

    /// In how many milliseconds the window opens, if robots wait for that.
    pub(super) fn window_opens_in_ms(&self, now: Now) -> Option<u64> {
        let waits = self.document.state == RolloutState::Running
            && self.roster.next_ready(self.document.phase).is_some();
        let window = self.document.plan.window.filter(|_| waits)?;
        (!window.is_open(now.unix_ms)).then(|| window.opens_in_ms(now.unix_ms))
    }

    /// When the phase must be judged again although nothing happens.
    pub(super) fn next_phase_ms(&self, at: u64) -> Option<u64> {
        if self.document.state != RolloutState::Running {
            return None;
        }
        let phase = match self.document.phases[usize::from(self.document.phase)] {
            PhaseState::Soaking { until_ms, .. } => Some(until_ms),
            PhaseState::Passed { at_ms, .. } => {
                let wait = self.document.plan.limits.wait_s;
                wait.map(|wait| at_ms.saturating_add(seconds(wait)))
            }
            PhaseState::Pending | PhaseState::Active { .. } => None,
        };
        let times = [phase, Some(self.grace_ends_ms())].into_iter().flatten();
        times.filter(|time| *time > at).min()
    }

    /// Offers nothing more until it goes on.
    pub(super) fn pause(&mut self, reason: PauseReason, at: u64) {
        self.recall_all(UpdateState::Waiting, &Reason::Paused, at);
        self.document.state = RolloutState::Paused(reason);
        self.tell(Happening::Paused(reason));
    }

    /// Every robot that has not started the new program gives it up.
    pub(super) fn recall_all(&mut self, state: UpdateState, reason: &Reason, at: u64) {
        for robot in self.roster.select(|row| row.state.is_before_trial()) {
            self.enter(&robot, state, Some(reason.clone()), at);
            self.roster.change(&robot, |row| row.recalled = true);
            self.send(&robot, Message::Cancel);
        }
    }
}
