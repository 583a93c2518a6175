//! What ends motion from outside of it: faults, a lost link, time, and halts.

use crawler_hal::Instant;
use crawler_protocol::{Reason, ResponseStatus};

use super::orders::reason_of;
use super::{Controller, Inputs, Note, Outputs};
use crate::goal::Goal;
use crate::order::Halt;
use crate::perception::{Charge, LinkHealth};
use crate::state::{Event, Fault, State};

impl Controller {
    /// Raises and clears faults; whether the wheels have to stand because of one.
    pub(super) fn check_faults(
        &mut self,
        inputs: &Inputs<'_>,
        out: &mut Outputs,
        now: Instant,
    ) -> bool {
        let ranger = inputs.reading.health.is_fault();
        let fault = if inputs.motor_fault {
            Some(Fault::Motor)
        } else if inputs.charge == Charge::Critical {
            Some(Fault::Battery)
        } else if ranger && self.tuning.avoidance {
            Some(Fault::Ranger)
        } else {
            None
        };
        let before = self.state.fault();
        match fault {
            Some(fault) if before != Some(fault) => {
                if fault == Fault::Ranger {
                    self.resumption.interrupt(self.state.goal(), now);
                } else {
                    self.resumption.forget();
                }
                if before != Some(Fault::EmergencyStop) {
                    self.finish(Err(reason_of(fault)), out);
                    out.note(Note::Raised(fault));
                }
                self.state = self.state.step(Event::Fault(fault), now);
            }
            None if before.is_some_and(|fault| fault != Fault::EmergencyStop) => {
                self.state = self.state.step(Event::Recovered, now);
                if let Some(before) = before {
                    out.note(Note::Cleared(before));
                }
            }
            Some(_) | None => {}
        }
        // With avoidance off a bad ranger is no fault of manual driving, but what needs it ends.
        if ranger && self.needs_view() && self.is_under_way() {
            self.resumption.interrupt(self.state.goal(), now);
            self.finish(Err(Reason::NoRange), out);
            self.state = self.state.step(Event::End, now);
            return true;
        }
        self.state.fault().is_some()
    }

    /// Whether the wheels have to stand because the link was lost.
    pub(super) fn check_link(&mut self, link: LinkHealth, out: &mut Outputs, now: Instant) -> bool {
        if link != LinkHealth::Lost {
            self.link_lost_since = None;
            return false;
        }
        let since = *self.link_lost_since.get_or_insert(now);
        if self.state.goal().is_some_and(|e| e.is_autonomous())
            && now - since < self.tuning.link_grace
        {
            return false;
        }
        if self.is_under_way() {
            self.resumption.interrupt(self.state.goal(), now);
            self.finish(Err(Reason::LinkLost), out);
            self.state = self.state.step(Event::End, now);
        }
        true
    }

    /// Ends what has lasted long enough; whether the wheels have to stand because it was continuous
    /// driving. They do already unless steps came late: see [`Controller::drive`].
    pub(super) fn check_time(&mut self, out: &mut Outputs, now: Instant) -> bool {
        let ended = match self.state {
            State::Moving(goal) | State::Caution(goal) | State::Avoiding(goal, _) => match goal {
                Goal::Manual { until, bounded, .. } if now >= until => Some(if bounded {
                    Ok(())
                } else {
                    Err(Reason::Timeout)
                }),
                Goal::Goto { deadline, .. } if now >= deadline => Some(Err(Reason::Timeout)),
                Goal::Manual { .. }
                | Goal::Goto { .. }
                | Goal::Wander { .. }
                | Goal::Swarm(_)
                | Goal::Policy { .. }
                | Goal::Mission { .. } => None,
            },
            State::Scanning { deadline } if now >= deadline => Some(Err(Reason::Timeout)),
            State::Scanning { .. }
            | State::Initializing
            | State::Idle
            | State::Error(_)
            | State::Updating => None,
        };
        let Some(result) = ended else {
            return false;
        };
        let continuous = self.state.goal().is_some_and(|e| e.is_continuous());
        self.finish(result, out);
        self.state = self.state.step(Event::End, now);
        continuous
    }

    pub(super) fn halt(&mut self, halt: &Halt, out: &mut Outputs, now: Instant) {
        self.resumption.forget();
        if self.is_under_way() {
            self.finish(Err(Reason::Interrupted), out);
            self.state = self.state.step(Event::End, now);
        }
        if halt.emergency && self.state.fault() != Some(Fault::EmergencyStop) {
            self.state = self.state.step(Event::Fault(Fault::EmergencyStop), now);
            out.note(Note::Raised(Fault::EmergencyStop));
        }
        for sender in &halt.senders {
            out.answer(sender.clone(), ResponseStatus::Completed, None);
        }
    }
}
