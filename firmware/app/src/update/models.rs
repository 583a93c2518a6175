//! Models that come as releases: into one of two places, tried without a restart, and the way back.
//!
//! A program is built with a model, and that one serves where there is no other. A release of the kind `model` brings
//! another one under the same name, by the way that a program comes ([`update`](super)), as far as its last step:
//!
//! | step | of a program | of a model |
//! |---|---|---|
//! | where it lies | in the slot that does not run | in the place that is not in use, or in either while the program's own is |
//! | what decides | otadata of two slots | the same select entries, of three: the program's own model, and two places |
//! | sequence, floor | of the slots | of the places |
//! | verified | the whole image against its hash | and it must be a model that this program can run: `bad_model` otherwise |
//! | activated | the robot restarts | it is used from the next look on; the robot leaves `UPDATING` |
//! | trial | of the program by itself | half a minute of health, and looks in time, which the camera takes meanwhile in any case |
//! | given up | by a restart into the other slot | the one before is loaded again, from its place or from the program |
//! | a restart meanwhile | is counted | ends the trial: the one before is used |
//!
//! So nothing here is written that is not written for programs as well, and what holds for those when the power goes at
//! any byte holds for models. A place is believed at a start only if it was confirmed, matches the hash of its manifest
//! as a whole, and can be run; if not, the other place is looked at, and then there is the program's own.
//!
//! What is in use `status` tells by the name of the model and the build of its manifest; of the program's own model
//! it tells nothing. A body says by [`ModelHost`] where its places are and how a model is loaded. One without has no
//! code for all this: [`NoModels`].

use crawler_boot::model_trial::ModelObservation;
use crawler_boot::otadata::{Slots as Count, Standing};
use crawler_boot::trailer::{Outcome as Fate, Record};
use crawler_boot::trial::Verdict;
use crawler_boot::{ModelTrial, RollbackReason};
use crawler_hal::{Clock, Duration, ModelRegion, ResetCause};
use crawler_protocol::{BuildId, Level, ModelName, ReleaseId, UpdateOutcome};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_storage_async::nor_flash::{MultiwriteNorFlash, ReadNorFlash};

use super::mailbox::Outcome;
use super::proving::CONFIRM;
use super::slots::{
    Aim, OnlyPrograms, ProgramsAndModel, Seen, Site, Sites, Slot, Subject, Work, build_of, known,
};
use super::steps::{Planned, blocks_of, is_unfinished};
use super::transfer::Step;
use super::{Activity, Blocks, EVENT, Failed, Installed, LOOK, Next, Refused, Stock};
use crate::vision::DetectorError;

/// Why a model is not loaded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LoadError<E> {
    /// The flash cannot be read.
    Flash(E),
    /// It is no model that this program can run, or there is no room for it.
    Unfit(DetectorError),
}

/// What was seen with a model since it is in use.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ModelLooks {
    /// Looks that were taken to their end.
    pub taken: u32,
    /// The longest that the model took for one, its frame not counted.
    pub slowest: Duration,
}

/// What runs the detector of a body, and where its models are.
pub trait ModelHost {
    /// What the model is called that it runs.
    fn name(&self) -> &ModelName;

    /// Where the places for it are, in the flash of the slots.
    fn region(&self) -> ModelRegion;

    /// Reads the model of `bytes` bytes that begins at `at` of `flash`, and keeps it at hand beside the one that is in
    /// use, which stays so.
    ///
    /// # Errors
    /// See [`LoadError`]. Nothing is at hand then.
    async fn load<F: ReadNorFlash>(
        &mut self,
        flash: &mut F,
        at: u32,
        bytes: u32,
    ) -> Result<(), LoadError<F::Error>>;

    /// Uses the model that is at hand from the next look on, and counts looks anew.
    fn adopt(&mut self);

    /// Uses the model of the program from the next look on, and counts looks anew.
    fn use_own(&mut self);

    /// What was seen with the model that is in use.
    fn looks(&self) -> ModelLooks;
}

/// What the update activity of a body knows of models, and what it does besides for them. All of it is in these
/// places, so that the activity of a body without models is what it would be if there were none.
pub(super) trait ModelStore: Sized {
    /// What in the flash can be replaced.
    type Sites: Sites;

    fn sites(&self, programs: Site) -> Self::Sites;
    fn name(&self) -> Option<&str>;
    fn stock(&self) -> Option<&Stock>;
    fn stock_mut(&mut self) -> Option<&mut Stock>;
    fn is_on_trial(&self) -> bool;

    /// [`Activity::start`], and what runs of models.
    fn start<M: RawMutex, F: MultiwriteNorFlash, C: Clock, const MODELS: usize>(
        activity: &mut Activity<'_, M, F, C, Self, MODELS>,
    ) -> impl Future<Output = ()>;
    /// [`Activity::turn`], and what a model on trial needs.
    fn turn<M: RawMutex, F: MultiwriteNorFlash, C: Clock, const MODELS: usize>(
        activity: &mut Activity<'_, M, F, C, Self, MODELS>,
    ) -> impl Future<Output = Next>;
    /// [`Slots::run`] for a step, and what that means for a model besides.
    fn run<M: RawMutex, F: MultiwriteNorFlash, C: Clock, const MODELS: usize>(
        activity: &mut Activity<'_, M, F, C, Self, MODELS>,
        works: [Work; 2],
        step: Planned,
    ) -> impl Future<Output = Result<Seen, Failed>>;
    /// [`Activity::lying`], wherever it may lie.
    fn lying<M: RawMutex, F: MultiwriteNorFlash, C: Clock, const MODELS: usize>(
        activity: &mut Activity<'_, M, F, C, Self, MODELS>,
        release: ReleaseId,
    ) -> impl Future<Output = Option<Blocks>>;
    /// Tells a new session what there is to know of models.
    fn greet<M: RawMutex, F: MultiwriteNorFlash, C: Clock, const MODELS: usize>(
        activity: &mut Activity<'_, M, F, C, Self, MODELS>,
    );
}

/// A body without models.
pub(super) struct NoModels;

impl ModelStore for NoModels {
    type Sites = OnlyPrograms;

    fn sites(&self, programs: Site) -> OnlyPrograms {
        OnlyPrograms(programs)
    }

    fn name(&self) -> Option<&str> {
        None
    }

    fn stock(&self) -> Option<&Stock> {
        None
    }

    fn stock_mut(&mut self) -> Option<&mut Stock> {
        None
    }

    fn is_on_trial(&self) -> bool {
        false
    }

    fn start<M: RawMutex, F: MultiwriteNorFlash, C: Clock, const MODELS: usize>(
        activity: &mut Activity<'_, M, F, C, Self, MODELS>,
    ) -> impl Future<Output = ()> {
        activity.start()
    }

    fn turn<M: RawMutex, F: MultiwriteNorFlash, C: Clock, const MODELS: usize>(
        activity: &mut Activity<'_, M, F, C, Self, MODELS>,
    ) -> impl Future<Output = Next> {
        activity.turn()
    }

    fn run<M: RawMutex, F: MultiwriteNorFlash, C: Clock, const MODELS: usize>(
        activity: &mut Activity<'_, M, F, C, Self, MODELS>,
        works: [Work; 2],
        _: Planned,
    ) -> impl Future<Output = Result<Seen, Failed>> {
        activity.slots.run(works, activity.updates)
    }

    fn lying<M: RawMutex, F: MultiwriteNorFlash, C: Clock, const MODELS: usize>(
        activity: &mut Activity<'_, M, F, C, Self, MODELS>,
        release: ReleaseId,
    ) -> impl Future<Output = Option<Blocks>> {
        activity.lying(release)
    }

    fn greet<M: RawMutex, F: MultiwriteNorFlash, C: Clock, const MODELS: usize>(
        _: &mut Activity<'_, M, F, C, Self, MODELS>,
    ) {
    }
}

/// A body with models.
pub(super) struct WithModels<B> {
    host: B,
    stock: Stock,
    /// Of the model in use.
    trial: Option<ModelTrial>,
    /// An outcome that waits until the one of a program was told.
    later: Option<Outcome>,
}

impl<B: ModelHost> WithModels<B> {
    pub(super) fn new(host: B) -> Self {
        Self {
            host,
            stock: Stock::default(),
            trial: None,
            later: None,
        }
    }
}

impl<B: ModelHost> ModelStore for WithModels<B> {
    type Sites = ProgramsAndModel;

    fn sites(&self, programs: Site) -> ProgramsAndModel {
        ProgramsAndModel::new(programs, &self.host.region())
    }

    fn name(&self) -> Option<&str> {
        Some(self.host.name().as_str())
    }

    fn stock(&self) -> Option<&Stock> {
        Some(&self.stock)
    }

    fn stock_mut(&mut self) -> Option<&mut Stock> {
        Some(&mut self.stock)
    }

    fn is_on_trial(&self) -> bool {
        self.trial.is_some()
    }

    async fn start<M: RawMutex, F: MultiwriteNorFlash, C: Clock, const MODELS: usize>(
        activity: &mut Activity<'_, M, F, C, Self, MODELS>,
    ) {
        activity.start().await;
        activity.find_model().await;
    }

    async fn turn<M: RawMutex, F: MultiwriteNorFlash, C: Clock, const MODELS: usize>(
        activity: &mut Activity<'_, M, F, C, Self, MODELS>,
    ) -> Next {
        let next = activity.turn().await;
        if activity.is_at_work() {
            next
        } else {
            activity.prove_model().await
        }
    }

    async fn run<M: RawMutex, F: MultiwriteNorFlash, C: Clock, const MODELS: usize>(
        activity: &mut Activity<'_, M, F, C, Self, MODELS>,
        works: [Work; 2],
        step: Planned,
    ) -> Result<Seen, Failed> {
        let seen = activity.slots.run(works, activity.updates).await?;
        if let Planned::Step(step) = step
            && activity.is_of_model()
        {
            activity.go_on_with_model(step).await?;
        }
        Ok(seen)
    }

    async fn lying<M: RawMutex, F: MultiwriteNorFlash, C: Clock, const MODELS: usize>(
        activity: &mut Activity<'_, M, F, C, Self, MODELS>,
        release: ReleaseId,
    ) -> Option<Blocks> {
        for subject in [Subject::Model, Subject::Program] {
            activity.slots.turn_to(subject);
            let lying = activity.lying(release).await;
            if lying.is_some() {
                return lying;
            }
        }
        None
    }

    fn greet<M: RawMutex, F: MultiwriteNorFlash, C: Clock, const MODELS: usize>(
        activity: &mut Activity<'_, M, F, C, Self, MODELS>,
    ) {
        activity.greet_of_model();
    }
}

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

    async fn give_model_up(&mut self, reason: RollbackReason) -> Result<(), Failed> {
        let record = Work::Record(Slot::Running, Record::RolledBack(reason));
        let works = [record, Work::Reach(Aim::GiveUp)];
        self.slots.run(works, self.updates).await.map(|_| ())
    }

    async fn look_at_model(&mut self) -> Result<Seen, Failed> {
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

    async fn load(&mut self, slot: Slot, bytes: u32) -> Result<(), Failed> {
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
    fn tell_model(&mut self, build: Option<BuildId>) {
        let name = self.models.host.name().clone();
        self.updates.set_model(build.map(|build| (name, build)));
        self.robot.outbox.nudge();
    }

    /// What a step of a transfer means besides, of a model.
    pub(super) async fn go_on_with_model(&mut self, step: Step) -> Result<(), Failed> {
        match step {
            Step::CheckAll => {
                let bytes = self.transfer.as_ref().map_or(0, super::Transfer::size);
                self.load(Slot::Spare, bytes).await
            }
            Step::Activate => self.begin_model_trial().await,
            _ => Ok(()),
        }
    }

    /// Uses the model that was activated.
    async fn begin_model_trial(&mut self) -> Result<(), Failed> {
        let (before, spare) = (self.slots.running(), self.slots.spare());
        self.slots.use_model(spare);
        let looked = self.look_at_model().await;
        let known = looked.map(|seen| (known(self.updates, seen.envelope), seen.envelope));
        let Ok((Some(known), envelope)) = known else {
            self.slots.use_model(before);
            return Err(Failed::Flash);
        };
        let build = build_of(self.updates, envelope);
        let (now, sensors) = (self.clock.now(), self.sensors());
        let models = &mut self.models;
        let floor = models
            .stock
            .installed
            .map_or(0, |installed| installed.floor);
        models.stock = Stock {
            installed: Some(Installed {
                release: Some(known.release),
                sequence: known.sequence,
                floor,
                next_floor: floor.max(known.floor),
            }),
            given_up: None,
            unfinished: None,
        };
        models.host.adopt();
        models.trial = Some(ModelTrial::new(now, sensors));
        self.robot.try_out_eyes(true);
        self.tell_model(build);
        self.leave();
        self.tell_trial(known.release, true);
        self.log(Level::Info, known.release, format_args!("is tried"));
        Ok(())
    }

    /// Observes the model on trial once, where there is one.
    pub(super) async fn prove_model(&mut self) -> Next {
        let now = self.clock.now();
        let missed = self.robot.missed_periods();
        let sensors = self.sensors();
        let models = &mut self.models;
        if let Some(outcome) = models.later
            && self.updates.is_told()
        {
            models.later = None;
            self.tell_outcome(outcome);
            return Next::Soon;
        }
        let Some(trial) = &mut models.trial else {
            return Next::Word;
        };
        let looks = models.host.looks();
        let verdict = trial.observe(
            now,
            &ModelObservation {
                missed,
                sensors,
                looks: looks.taken,
                slowest: looks.slowest,
            },
        );
        let release = models.stock.release();
        self.slots.turn_to(Subject::Model);
        match verdict {
            Verdict::Pending => return Next::At(now + LOOK),
            Verdict::Confirm => {
                if self.slots.run(CONFIRM, self.updates).await.is_err() {
                    // A flash that does not take it is asked again.
                    return Next::At(now + LOOK);
                }
                self.end_looking();
                if let Some(installed) = self.models.stock.installed.as_mut() {
                    installed.floor = installed.next_floor;
                }
                if let Some(release) = release {
                    self.tell_confirmed(release, true);
                    self.log(Level::Info, release, format_args!("is proven"));
                }
            }
            Verdict::RollBack(reason) => {
                // What the flash does not take is done by `find_model`, or at the next start.
                let _ = self.give_model_up(reason).await;
                self.end_looking();
                self.find_model().await;
                if let Some(release) = release {
                    let outcome = rolled_back(release, reason);
                    self.models.stock.given_up = Some(outcome);
                    self.tell_outcome(outcome);
                    let text = format_args!("given up: {}", reason.code());
                    self.log(Level::Error, release, text);
                }
            }
        }
        Next::Soon
    }

    fn end_looking(&mut self) {
        self.models.trial = None;
        self.robot.try_out_eyes(false);
    }

    /// Tells a new session what there is to know of models.
    pub(super) fn greet_of_model(&mut self) {
        let stock = self.models.stock;
        if let Some(release) = stock.release().filter(|_| self.models.is_on_trial()) {
            self.tell_trial(release, true);
        } else if let Some(outcome) = stock.given_up {
            if self.programs.given_up.is_none() {
                self.tell_outcome(outcome);
            } else {
                self.models.later = Some(outcome);
            }
        }
    }
}

const fn rolled_back(release: ReleaseId, reason: RollbackReason) -> Outcome {
    Outcome {
        release,
        came_to: UpdateOutcome::RolledBack,
        reason: Some(reason.code()),
        lasting: None,
        of_model: true,
    }
}
