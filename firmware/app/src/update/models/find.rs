//! Which model is in use, by what lies in the flash.

use crawler_boot::RollbackReason;
use crawler_boot::otadata::{Slots as Count, Standing};
use crawler_boot::trailer::{Outcome as Fate, Record};
use crawler_hal::{Clock, ResetCause};
use crawler_protocol::{BuildId, Level, ModelName};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_storage_async::nor_flash::MultiwriteNorFlash;

use super::policies::{OTHER, PolicyPlace};
use super::{LoadError, ModelHost, ModelStore as _, WithModels, rolled_back};
use crate::policy::Installed as Driven;
use crate::policy::decisions::named;
use crate::update::slots::{Aim, Seen, Slot, Subject, Work, known, model_of};
use crate::update::steps::{blocks_of, is_unfinished};
use crate::update::{Activity, EVENT, Failed, Installed, Refused, Stock};

/// What select entries count as the model of the program.
const OWN: u8 = 0;

impl<
    M: RawMutex,
    F: MultiwriteNorFlash,
    C: Clock,
    B: ModelHost,
    P: PolicyPlace,
    const MODELS: usize,
> Activity<'_, M, F, C, WithModels<B, P>, MODELS>
{
    /// Finds out which model is to be used, and has it used. A trial that goes on according to the flash was ended by
    /// a restart.
    pub(super) async fn find_model(&mut self, subject: Subject) {
        self.slots.turn_to(subject);
        let mut unfit = Driven::None;
        let found = match self.end_trial().await {
            Ok(selected) => self.first_that_runs(selected, &mut unfit).await,
            Err(why) => Err(why),
        };
        let running = *found.as_ref().unwrap_or(&OWN);
        let looked = self.look_around(running).await;
        let model = looked.as_ref().ok().and_then(Option::as_ref);
        self.use_model(model, unfit).await;
        if found.is_err() || looked.is_err() {
            let text = format_args!("the places for models cannot be read: no model is taken");
            self.robot.log(Level::Error, EVENT, text, self.clock.now());
        }
        let model = looked.ok().flatten();
        self.updates.set_model(subject, model);
        self.robot.outbox.nudge();
    }

    /// Uses the model that is at hand, which is called so, or that of the program where there is none. What is `unfit`
    /// whoever asks for it is told.
    pub(super) async fn use_model(&mut self, model: Option<&(ModelName, BuildId)>, unfit: Driven) {
        match (self.slots.subject(), &mut self.models.eyes) {
            (Subject::Policy, _) => {
                let name = model.map(|(name, _)| named(name.as_str()));
                self.models.policies.allow(name).await;
                let brought = name.map_or(Driven::None, Driven::Policy);
                self.robot.bring(brought, unfit);
            }
            (Subject::Eyes, Some(eyes)) if model.is_some() => eyes.adopt(),
            (Subject::Eyes, Some(eyes)) => eyes.use_own(),
            (Subject::Eyes | Subject::Program, _) => {}
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

    /// The first from `selected` down that runs; it is at hand then. Of a policy that does not nothing is written: the
    /// program may be another one at the next start.
    async fn first_that_runs(&mut self, selected: u8, unfit: &mut Driven) -> Result<u8, Failed> {
        let is_policy = self.slots.subject() == Subject::Policy;
        let keep = [Work::Reach(Aim::Keep), Work::Rest];
        for running in (OWN + 1..=selected).rev() {
            self.slots.use_model(running);
            let why = match self.runs(running == selected).await {
                Ok(()) => {
                    if running != selected && !is_policy {
                        self.slots.run(keep, self.updates).await?;
                    }
                    return Ok(running);
                }
                Err(why) => why,
            };
            if running != selected {
                continue;
            }
            if is_policy {
                *unfit = self.unfit(why).await;
            } else {
                // Where there is no journal for it, nobody has to know.
                let bad = Work::Record(Slot::Running, Record::RolledBack(RollbackReason::BadImage));
                self.slots.run([bad, Work::Rest], self.updates).await?;
            }
        }
        self.slots.use_model(OWN);
        if selected != OWN && !is_policy {
            self.slots.run(keep, self.updates).await?;
        }
        Ok(OWN)
    }

    /// What whoever asks for the policy that is meant is told, which is not driven by.
    async fn unfit(&mut self, why: Failed) -> Driven {
        let seen = self.look_at_model().await;
        let model = seen
            .ok()
            .and_then(|seen| model_of(self.updates, seen.envelope));
        let Some((name, _)) = model else {
            return Driven::None;
        };
        let text =
            format_args!("policy {name} is not driven by: it is damaged, or for another program");
        self.robot.log(Level::Error, EVENT, text, self.clock.now());
        let name = named(name.as_str());
        match why {
            Failed::Refused(Refused { code: OTHER, .. }) => Driven::Other(name),
            _ => Driven::Bad(name),
        }
    }

    /// Whether the model that is meant was confirmed, is what was signed, and can be run; it is at hand then.
    /// `selected` is one of which otadata says that it is proven.
    async fn runs(&mut self, selected: bool) -> Result<(), Failed> {
        let whole = [Work::Check(Slot::Running, None), Work::Rest];
        let seen = self.slots.run(whole, self.updates).await?;
        let proven = match seen.trailer.outcome() {
            Some(Fate::Confirmed) => true,
            // The power went between otadata and the trailer.
            Some(Fate::Activated) => selected,
            Some(Fate::RolledBack(_)) | None => false,
        };
        let known = known(self.updates, seen.envelope).filter(|_| proven);
        let known = known.ok_or(Failed::Content)?;
        self.load(Slot::Running, known.shape.size()).await?;
        let confirmed = Work::Record(Slot::Running, Record::Confirmed);
        // Without that it is said again at the next start.
        let _ = self.slots.run([confirmed, Work::Rest], self.updates).await;
        Ok(())
    }

    pub(super) async fn load(&mut self, slot: Slot, bytes: u32) -> Result<(), Failed> {
        let subject = self.slots.subject();
        let Some((flash, at)) = self.slots.start_of(slot) else {
            return Err(Failed::Flash);
        };
        if subject == Subject::Policy {
            return self.models.policies.put(flash, at, bytes).await;
        }
        let Some(eyes) = &mut self.models.eyes else {
            return Err(Failed::Flash);
        };
        match eyes.load(flash, at, bytes).await {
            Ok(()) => Ok(()),
            Err(LoadError::Flash(_)) => Err(Failed::Flash),
            Err(LoadError::Unfit(_)) => Err(Failed::Refused(Refused {
                code: "bad_model",
                lasting: true,
            })),
        }
    }

    /// Takes in what both places hold, with `running` in use. What that is called, and what names its contents.
    async fn look_around(&mut self, running: u8) -> Result<Option<(ModelName, BuildId)>, Failed> {
        let subject = self.slots.subject();
        self.slots.use_model(running);
        let spare = self.slots.spare();
        let mut installed = Installed {
            release: None,
            sequence: 0,
            floor: 0,
            next_floor: 0,
        };
        let (mut stock, mut model, mut read) = (Stock::default(), None, Ok(()));
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
                model = model_of(self.updates, seen.envelope);
            } else if place == spare {
                if let Some(reason) = seen.trailer.rolled_back() {
                    stock.given_up = Some(rolled_back(known.release, reason, subject));
                } else if is_unfinished(&seen.trailer) {
                    let bytes = blocks_of(&seen.trailer).bytes(known.shape);
                    stock.unfinished = Some((known.release, bytes));
                }
            }
        }
        self.slots.use_model(running);
        installed.next_floor = installed.floor;
        stock.installed = read.is_ok().then_some(installed);
        if let Some(own) = self.models.stock_mut(subject) {
            *own = stock;
        }
        read.map(|()| model)
    }
}
