//! Which model is in use, by what lies in the flash.

use crawler_boot::RollbackReason;
use crawler_boot::otadata::{Slots as Count, Standing};
use crawler_boot::trailer::{Outcome as Fate, Record};
use crawler_hal::{Clock, ResetCause};
use crawler_protocol::{BuildId, Level};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_storage_async::nor_flash::MultiwriteNorFlash;

use super::{LoadError, ModelHost, WithModels, rolled_back};
use crate::update::slots::{Aim, Seen, Slot, Subject, Work, build_of, known};
use crate::update::steps::{blocks_of, is_unfinished};
use crate::update::{Activity, EVENT, Failed, Installed, Refused, Stock};

/// What select entries count as the model of the program.
const OWN: u8 = 0;

impl<M: RawMutex, F: MultiwriteNorFlash, C: Clock, B: ModelHost, const MODELS: usize>
    Activity<'_, M, F, C, WithModels<B>, MODELS>
{
    /// Finds out which model is to be used, and has it used. A trial that goes on according to the flash was ended by
    /// a restart.
    pub(super) async fn find_model(&mut self) {
        self.slots.turn_to(Subject::Model);
        let found = match self.end_trial().await {
            Ok(selected) => self.first_that_runs(selected).await,
            Err(why) => Err(why),
        };
        let running = *found.as_ref().unwrap_or(&OWN);
        let looked = self.look_around(running).await;
        if running == OWN {
            self.models.host.use_own();
        } else {
            self.models.host.adopt();
        }
        if found.is_err() || looked.is_err() {
            let text = format_args!("the places for models cannot be read: no model is taken");
            self.robot.log(Level::Error, EVENT, text, self.clock.now());
        }
    }

    /// Gives a model up whose trial was ended by a restart. What is selected then.
    async fn end_trial(&mut self) -> Result<u8, Failed> {
        loop {
            self.slots.use_model(OWN);
            let seen = self.look_at_model().await?;
            if seen.selected == OWN {
                return Ok(OWN);
            }
            self.slots.use_model(seen.selected);
            let seen = self.look_at_model().await?;
            if !matches!(seen.standing, Standing::OnTrial(_)) {
                return Ok(seen.selected);
            }
            let reason = seen
                .trailer
                .rolled_back()
                .unwrap_or_else(|| self.ended_by());
            match self.give_model_up(reason).await {
                Ok(()) => {}
                // What was selected has no other beside it: whatever is there, it is not believed.
                Err(Failed::NoWayBack) => return Ok(OWN),
                Err(why) => return Err(why),
            }
        }
    }

    /// What a restart says of the model that was on trial before.
    fn ended_by(&self) -> RollbackReason {
        match self.robot.boot().cause {
            ResetCause::Panic => RollbackReason::Panic,
            ResetCause::Watchdog => RollbackReason::Watchdog,
            ResetCause::Software => RollbackReason::Restarts,
            // Power-on, brown-out, the reset pin, and what a later chip may name.
            _ => RollbackReason::PowerCycles,
        }
    }

    pub(super) async fn give_model_up(&mut self, reason: RollbackReason) -> Result<(), Failed> {
        let record = Work::Record(Slot::Running, Record::RolledBack(reason));
        let works = [record, Work::Reach(Aim::GiveUp)];
        self.slots.run(works, self.updates).await.map(|_| ())
    }

    pub(super) async fn look_at_model(&mut self) -> Result<Seen, Failed> {
        let look = [Work::Look(Slot::Running), Work::Rest];
        self.slots.run(look, self.updates).await
    }

    /// The first from `selected` down that runs; it is at hand then.
    async fn first_that_runs(&mut self, selected: u8) -> Result<u8, Failed> {
        for running in (OWN + 1..=selected).rev() {
            self.slots.use_model(running);
            if self.runs(running == selected).await {
                if running != selected {
                    self.slots
                        .run([Work::Reach(Aim::Keep), Work::Rest], self.updates)
                        .await?;
                }
                return Ok(running);
            }
            if running == selected {
                // Where there is no journal for it, nobody has to know.
                let bad = Work::Record(Slot::Running, Record::RolledBack(RollbackReason::BadImage));
                self.slots.run([bad, Work::Rest], self.updates).await?;
            }
        }
        self.slots.use_model(OWN);
        if selected != OWN {
            self.slots
                .run([Work::Reach(Aim::Keep), Work::Rest], self.updates)
                .await?;
        }
        Ok(OWN)
    }

    /// Whether the model that is meant was confirmed, is what was signed, and can be run; it is at hand then.
    /// `selected` is one of which otadata says that it is proven.
    async fn runs(&mut self, selected: bool) -> bool {
        let whole = [Work::Check(Slot::Running, None), Work::Rest];
        let Ok(seen) = self.slots.run(whole, self.updates).await else {
            return false;
        };
        let proven = match seen.trailer.outcome() {
            Some(Fate::Confirmed) => true,
            // The power went between otadata and the trailer.
            Some(Fate::Activated) => selected,
            Some(Fate::RolledBack(_)) | None => false,
        };
        let known = known(self.updates, seen.envelope).filter(|_| proven);
        let Some(known) = known else {
            return false;
        };
        if self.load(Slot::Running, known.shape.size()).await.is_err() {
            return false;
        }
        let confirmed = Work::Record(Slot::Running, Record::Confirmed);
        // Without that it is said again at the next start.
        let _ = self.slots.run([confirmed, Work::Rest], self.updates).await;
        true
    }

    pub(super) async fn load(&mut self, slot: Slot, bytes: u32) -> Result<(), Failed> {
        let Some((flash, at)) = self.slots.start_of(slot) else {
            return Err(Failed::Flash);
        };
        match self.models.host.load(flash, at, bytes).await {
            Ok(()) => Ok(()),
            Err(LoadError::Flash(_)) => Err(Failed::Flash),
            Err(LoadError::Unfit(_)) => Err(Failed::Refused(Refused {
                code: "bad_model",
                lasting: true,
            })),
        }
    }

    /// Takes in what both places hold, with `running` in use.
    async fn look_around(&mut self, running: u8) -> Result<(), Failed> {
        self.slots.use_model(running);
        let spare = self.slots.spare();
        let mut installed = Installed {
            release: None,
            sequence: 0,
            floor: 0,
            next_floor: 0,
        };
        let (mut stock, mut build, mut read) = (Stock::default(), None, Ok(()));
        for place in OWN + 1..Count::THREE.count() {
            self.slots.use_model(place);
            let seen = match self.look_at_model().await {
                Ok(seen) => seen,
                Err(why) => {
                    read = Err(why);
                    continue;
                }
            };
            let Some(known) = known(self.updates, seen.envelope) else {
                continue;
            };
            if seen.trailer.outcome() == Some(Fate::Confirmed) {
                installed.floor = installed.floor.max(known.floor);
            }
            if place == running {
                installed.release = Some(known.release);
                installed.sequence = known.sequence;
                build = build_of(self.updates, seen.envelope);
            } else if place == spare {
                if let Some(reason) = seen.trailer.rolled_back() {
                    stock.given_up = Some(rolled_back(known.release, reason));
                } else if is_unfinished(&seen.trailer) {
                    let bytes = blocks_of(&seen.trailer).bytes(known.shape);
                    stock.unfinished = Some((known.release, bytes));
                }
            }
        }
        self.slots.use_model(running);
        installed.next_floor = installed.floor;
        stock.installed = read.is_ok().then_some(installed);
        self.models.stock = stock;
        self.tell_model(build);
        read
    }

    /// Has the status tell what is in use.
    pub(super) fn tell_model(&mut self, build: Option<BuildId>) {
        let name = self.models.host.name().clone();
        self.updates.set_model(build.map(|build| (name, build)));
        self.robot.outbox.nudge();
    }
}
