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
//!
//! A policy is a model as well, with places of its own ([`PolicyHost`]). Nothing is done by it before somebody asks for the
//! behaviour, by its name, so there is nothing to observe: it is confirmed in the step in which it is activated. One that
//! is damaged at a start, or that the program does not drive by any more, stays where it is, and whoever asks for it is
//! told why: the next program may drive by it.
//!
//! `find` says which model is in use, from the flash; `prove` has what follows once one was activated; `policies` holds the
//! policy.

mod find;
mod policies;
mod prove;

use crawler_boot::{ModelTrial, RollbackReason};
use crawler_hal::{Clock, Duration, ModelRegion};
use crawler_protocol::{ModelName, ReleaseId, UpdateOutcome};
use crawler_release::Kind;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_storage_async::nor_flash::{MultiwriteNorFlash, ReadNorFlash};

use super::mailbox::Outcome;
use super::slots::{OnlyPrograms, ProgramsAndModels, Seen, Site, Sites, Subject, Work};
use super::steps::Planned;
use super::{Activity, Blocks, Failed, Next, Stock};
use crate::vision::DetectorError;

pub use policies::PolicyHost;
pub(super) use policies::PolicyPlace;

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
    /// What a release of this kind replaces, if that can be replaced.
    fn subject(&self, kind: Kind) -> Option<Subject>;
    /// What is known of [`Subject::MODELS`].
    fn stocks(&self) -> &[Stock];
    fn stock_mut(&mut self, subject: Subject) -> Option<&mut Stock>;
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

    fn subject(&self, _: Kind) -> Option<Subject> {
        None
    }

    fn stocks(&self) -> &[Stock] {
        &[]
    }

    fn stock_mut(&mut self, _: Subject) -> Option<&mut Stock> {
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

/// The detector of a body without one that takes models: there is no value of this type, and no code for it.
#[derive(Debug, Clone, Copy)]
pub enum NoEyes {}

impl ModelHost for NoEyes {
    fn name(&self) -> &ModelName {
        match *self {}
    }

    fn region(&self) -> ModelRegion {
        match *self {}
    }

    async fn load<F: ReadNorFlash>(
        &mut self,
        _: &mut F,
        _: u32,
        _: u32,
    ) -> Result<(), LoadError<F::Error>> {
        match *self {}
    }

    fn adopt(&mut self) {
        match *self {}
    }

    fn use_own(&mut self) {
        match *self {}
    }

    fn looks(&self) -> ModelLooks {
        match *self {}
    }
}

/// A body with models.
pub(super) struct WithModels<B, P> {
    eyes: Option<B>,
    policies: P,
    stocks: [Stock; Subject::MODELS.len()],
    /// Of the model of the eyes that is in use.
    trial: Option<ModelTrial>,
    /// An outcome that waits until the one of a program was told.
    later: Option<Outcome>,
}

impl<B: ModelHost, P: PolicyPlace> WithModels<B, P> {
    pub(super) fn new(eyes: Option<B>, policies: P) -> Self {
        Self {
            eyes,
            policies,
            stocks: [Stock::default(); Subject::MODELS.len()],
            trial: None,
            later: None,
        }
    }

    /// Those that the body takes.
    fn subjects(&self) -> impl Iterator<Item = Subject> + use<B, P> {
        let there = [self.eyes.is_some(), self.policies.region().is_some()];
        let all = Subject::MODELS.into_iter().zip(there);
        all.filter_map(|(subject, there)| there.then_some(subject))
    }
}

impl<B: ModelHost, P: PolicyPlace> ModelStore for WithModels<B, P> {
    type Sites = ProgramsAndModels;

    fn sites(&self, programs: Site) -> ProgramsAndModels {
        let eyes = self.eyes.as_ref().map(ModelHost::region);
        ProgramsAndModels::new(programs, [eyes, self.policies.region()])
    }

    fn name(&self) -> Option<&str> {
        self.eyes.as_ref().map(|eyes| eyes.name().as_str())
    }

    fn subject(&self, kind: Kind) -> Option<Subject> {
        self.subjects().find(|subject| subject.kind() == kind)
    }

    fn stocks(&self) -> &[Stock] {
        &self.stocks
    }

    fn stock_mut(&mut self, subject: Subject) -> Option<&mut Stock> {
        self.stocks.get_mut(subject.model()?)
    }

    fn is_on_trial(&self) -> bool {
        self.trial.is_some()
    }

    async fn start<M: RawMutex, F: MultiwriteNorFlash, C: Clock, const MODELS: usize>(
        activity: &mut Activity<'_, M, F, C, Self, MODELS>,
    ) {
        activity.start().await;
        if activity.models.policies.region().is_some() {
            activity.updates.take_policies();
        }
        let mut there = activity.models.subjects().peekable();
        for subject in Subject::MODELS {
            if there.next_if_eq(&subject).is_some() {
                activity.find_model(subject).await;
            } else if MODELS >= Subject::MODELS.len() {
                // A body that takes one model has one place to tell of it.
                activity.updates.set_model(subject, None);
            }
        }
    }

    async fn turn<M: RawMutex, F: MultiwriteNorFlash, C: Clock, const MODELS: usize>(
        activity: &mut Activity<'_, M, F, C, Self, MODELS>,
    ) -> Next {
        let next = activity.turn().await;
        if activity.is_at_work() {
            return next;
        }
        if activity.models.policies.is_unsettled() {
            // What was looked at has not come to be used.
            activity.find_model(Subject::Policy).await;
        }
        activity.prove_model().await
    }

    async fn run<M: RawMutex, F: MultiwriteNorFlash, C: Clock, const MODELS: usize>(
        activity: &mut Activity<'_, M, F, C, Self, MODELS>,
        works: [Work; 2],
        step: Planned,
    ) -> Result<Seen, Failed> {
        let seen = activity.slots.run(works, activity.updates).await?;
        if let Planned::Step(step) = step
            && activity.slots.subject() != Subject::Program
        {
            activity.go_on_with_model(step).await?;
        }
        Ok(seen)
    }

    async fn lying<M: RawMutex, F: MultiwriteNorFlash, C: Clock, const MODELS: usize>(
        activity: &mut Activity<'_, M, F, C, Self, MODELS>,
        release: ReleaseId,
    ) -> Option<Blocks> {
        let models = activity.models.subjects();
        for subject in models.chain([Subject::Program]) {
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

const fn rolled_back(release: ReleaseId, reason: RollbackReason, of: Subject) -> Outcome {
    Outcome {
        release,
        came_to: UpdateOutcome::RolledBack,
        reason: Some(reason.code()),
        lasting: None,
        of,
    }
}
