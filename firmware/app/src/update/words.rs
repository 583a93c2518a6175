//! What the server says, and what the robot answers.

use crawler_hal::Clock;
use crawler_protocol::{ReleaseId, UpdateOutcome, UpdateStage};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_storage_async::nor_flash::MultiwriteNorFlash;

use super::mailbox::{Outcome, Progress, Word};
use super::{Activity, Asked, STANDS_WITHIN};
use crate::order::UpdateWish;

impl<M: RawMutex, F: MultiwriteNorFlash, C: Clock> Activity<'_, M, F, C> {
    /// Tells a new session what there is to know.
    pub(super) fn greet(&mut self) {
        self.tell_have();
        if let Some(transfer) = &mut self.transfer {
            transfer.ask_again();
            self.told = None;
        } else if let Some(release) = self.on_trial() {
            self.tell_trial(release);
        } else if let Some(outcome) = self.given_up {
            self.tell_outcome(outcome);
        }
    }

    pub(super) fn obey(&mut self, word: Word) {
        match word {
            Word::Offer(release, patch) => {
                self.tell_have();
                self.offered(release, patch);
            }
            Word::Confirm(release) => {
                if !self.tell_installed(release) {
                    match self.given_up {
                        Some(outcome) if outcome.release == release => self.tell_outcome(outcome),
                        Some(_) | None => self.tell_have(),
                    }
                }
            }
            Word::Cancel(release) => self.cancelled(release),
        }
    }

    fn offered(&mut self, release: ReleaseId, patch: Option<u32>) {
        if self.tell_installed(release) {
            return;
        }
        let at_work = self.transfer.as_ref().map(super::Transfer::release);
        let at_work = at_work.or(self.asked.map(|asked| asked.release));
        if at_work == Some(release) {
            // It is told again where it stands.
            self.told = None;
        } else if self.trial.is_some() {
            self.defer(release, "trial");
        } else if at_work.is_some() {
            self.defer(release, "busy");
        } else if let Some(hindrance) = self.hindrance() {
            self.defer(release, hindrance);
        } else {
            self.robot.wish(UpdateWish::Stand);
            let until = self.clock.now() + STANDS_WITHIN;
            self.asked = Some(Asked {
                release,
                patch,
                until,
            });
        }
    }

    /// Gives a release up, whether it was begun, or never heard of; not one that runs.
    fn cancelled(&mut self, release: ReleaseId) {
        if self.tell_installed(release) {
            return;
        }
        let at_work = self.transfer.as_ref().map(super::Transfer::release);
        if at_work == Some(release) || self.asked.is_some_and(|asked| asked.release == release) {
            self.leave();
        }
        self.tell_outcome(Outcome {
            release,
            came_to: UpdateOutcome::Withdrawn,
            reason: None,
            lasting: None,
        });
    }

    /// Tells where the release stands if it is the one that runs. Whether it is.
    fn tell_installed(&self, release: ReleaseId) -> bool {
        let runs = self.installed.and_then(|installed| installed.release);
        if runs != Some(release) {
            return false;
        }
        if self.trial.is_some() {
            self.tell_trial(release);
        } else {
            self.tell_confirmed(release);
        }
        true
    }

    fn on_trial(&self) -> Option<ReleaseId> {
        self.trial.as_ref()?;
        self.installed?.release
    }

    fn tell_trial(&self, release: ReleaseId) {
        self.tell(Progress {
            release,
            stage: UpdateStage::Trial,
            reason: None,
            bytes: 0,
        });
    }

    pub(super) fn tell_confirmed(&self, release: ReleaseId) {
        self.tell_outcome(Outcome {
            release,
            came_to: UpdateOutcome::Confirmed,
            reason: None,
            lasting: None,
        });
    }
}
