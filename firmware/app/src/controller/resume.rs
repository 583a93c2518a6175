//! Taking a behaviour up again when what interrupted it has passed.
//!
//! A ranger that was silent for three seconds, or a network that hiccuped, shall not leave a robot
//! standing until somebody notices. What a person ended stays ended, and so does what lasted too long
//! to be a hiccup: whoever comes to mend a robot must not have it drive off in their hands.

use crawler_hal::{Duration, Instant};

use super::{Controller, Inputs, Note, Outputs};
use crate::goal::Goal;
use crate::perception::LinkHealth;
use crate::state::State;

/// Nothing has been in the way for so long before a behaviour goes on: a `stop` that waited at the
/// broker comes first.
pub const CALM: Duration = Duration::from_millis(1_000);
/// A behaviour that is interrupted again within this time waits twice as long as last time.
const SOON: Duration = Duration::from_secs(60);
/// So often the wait doubles.
const DOUBLINGS: u8 = 5;

/// A behaviour that waits to be taken up again.
#[derive(Debug, Clone, Copy, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Resumption {
    waiting: Option<Waiting>,
    /// Somebody has said since the start what the robot is to do, or not to do.
    decided: bool,
    /// Since when nothing is in its way.
    clear_since: Option<Instant>,
    /// When one was taken up last, and how many soon after each other.
    last: Option<(Instant, u8)>,
}

/// What waits, and for what.
#[derive(Debug, Clone, Copy)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Waiting {
    // As snapshots that are already on a disk have it.
    #[cfg_attr(feature = "serde", serde(rename = "errand"))]
    goal: Goal,
    /// When it was interrupted.
    since: Instant,
    /// By a restart: somebody who can stop the robot must be there first.
    restarted: bool,
}

impl Resumption {
    /// Notes that a behaviour was interrupted by something that may pass. Goals with an end are
    /// over: who gave them was told so.
    pub(super) fn interrupt(&mut self, goal: Option<Goal>, now: Instant) {
        if let Some(goal) = goal.filter(Goal::is_behaviour) {
            self.wait(goal, now, false);
        }
    }

    fn wait(&mut self, goal: Goal, since: Instant, restarted: bool) {
        self.waiting = Some(Waiting {
            goal,
            since,
            restarted,
        });
        self.clear_since = None;
    }

    /// Somebody has decided otherwise, or what came does not pass by itself.
    pub(super) fn forget(&mut self) {
        self.waiting = None;
        self.decided = true;
    }

    /// Whether a behaviour waits.
    pub(super) const fn is_waiting(&self) -> bool {
        self.waiting.is_some()
    }

    /// The behaviour to take up now; `clear` tells whether anything is in its way. What is in the way
    /// for longer than `within` ends the wait.
    fn due(&mut self, clear: bool, within: Duration, now: Instant) -> Option<Goal> {
        let Waiting { goal, since, .. } = self.waiting?;
        if !clear {
            self.clear_since = None;
            if now - since >= within {
                self.waiting = None;
            }
            return None;
        }
        let in_a_row = match self.last {
            Some((last, count)) if since - last < SOON => count,
            Some(_) | None => 0,
        };
        let wait = CALM * (1 << in_a_row.min(DOUBLINGS));
        if now - *self.clear_since.get_or_insert(now) < wait {
            return None;
        }
        self.waiting = None;
        self.last = Some((now, in_a_row.saturating_add(1)));
        Some(goal)
    }
}

impl Controller {
    /// Notes what the robot was at when it was told to restart, to be taken up once there is a link.
    pub(crate) fn was_at(&mut self, goal: Goal, now: Instant) {
        // Who has spoken since has the word.
        if !self.resumption.decided {
            self.resumption.wait(goal, now, true);
        }
    }

    /// Goes on with what was interrupted, once nothing is in its way.
    pub(super) fn resume(&mut self, inputs: &Inputs<'_>, out: &mut Outputs, now: Instant) {
        let Some(Waiting { restarted, .. }) = self.resumption.waiting else {
            return;
        };
        let linked = match inputs.link {
            LinkHealth::Up => true,
            LinkHealth::Absent => !restarted,
            LinkHealth::Lost => false,
        };
        // In this state there is no fault.
        let clear = self.state == State::Idle
            && !self.rebooting
            && linked
            && inputs.reading.fresh(now).is_some();
        let due = self.resumption.due(clear, self.tuning.resume_within, now);
        if let Some(goal) = due {
            self.start_goal(goal, out, now);
            out.note(Note::Resumed(goal.behaviour()));
        }
    }
}
