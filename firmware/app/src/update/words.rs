//! What the server says, and what the robot answers.

use crawler_hal::Clock;
use crawler_protocol::{ReleaseId, UpdateOutcome, UpdateStage};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_storage_async::nor_flash::MultiwriteNorFlash;

use super::mailbox::{Outcome, Progress, Word};
use super::models::ModelStore;
use super::{Activity, Asked, STANDS_WITHIN, Subject};
use crate::order::UpdateWish;

impl<M: RawMutex, F: MultiwriteNorFlash, C: Clock, N: ModelStore, const MODELS: usize>
    Activity<'_, M, F, C, N, MODELS>
{
    /// Tells a new session what there is to know.
    pub(super) fn greet(&mut self) {
        self.tell_have();
        if let Some(transfer) = &mut self.transfer {
            transfer.ask_again();
            self.told = None;
        } else if let Some(release) = self.on_trial() {
            self.tell_trial(release, Subject::Program);
        } else if let Some(outcome) = self.programs.given_up {
            self.tell_outcome(outcome);
        }
        N::greet(self);
    }

    pub(super) fn obey(&mut self, word: Word) {
        match word {
            Word::Offer(release, patch) => {
                self.tell_have();
                self.offered(release, patch);
            }
            Word::Confirm(release) => {
                if !self.tell_installed(release) {
                    let is_it = |outcome: &Outcome| outcome.release == release;
                    let models = self.models.stocks().iter();
                    let mut all = core::iter::once(&self.programs).chain(models);
                    match all.find_map(|stock| stock.given_up.filter(is_it)) {
                        Some(outcome) => self.tell_outcome(outcome),
                        None => self.tell_have(),
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
        } else if self.trial.is_some() || self.models.is_on_trial() {
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
            of: Subject::Program,
        });
    }

    /// Tells where the release stands if it is the one that runs. Whether it is.
    fn tell_installed(&self, release: ReleaseId) -> bool {
        let mut all = [Subject::Program].into_iter().chain(Subject::MODELS);
        let of = all.find(|subject| self.stock_of(*subject).release() == Some(release));
        let Some(of) = of else {
            return false;
        };
        let on_trial = match of {
            Subject::Program => self.trial.is_some(),
            Subject::Eyes => self.models.is_on_trial(),
            // It is proven when it is there: nothing is done by it before it is asked for.
            Subject::Policy => false,
        };
        if on_trial {
            self.tell_trial(release, of);
        } else {
            self.tell_confirmed(release, of);
        }
        true
    }

    fn on_trial(&self) -> Option<ReleaseId> {
        self.trial.as_ref()?;
        self.programs.release()
    }

    pub(super) fn tell_trial(&self, release: ReleaseId, of: Subject) {
        self.tell(Progress {
            release,
            stage: UpdateStage::Trial,
            reason: None,
            bytes: 0,
            of,
        });
    }

    pub(super) fn tell_confirmed(&self, release: ReleaseId, of: Subject) {
        self.tell_outcome(Outcome {
            release,
            came_to: UpdateOutcome::Confirmed,
            reason: None,
            lasting: None,
            of,
        });
    }
}
