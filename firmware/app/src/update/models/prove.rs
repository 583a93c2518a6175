//! What follows once a model was activated: the trial of one that looks, begun without a restart, observed, and ended; a
//! policy is confirmed at once.

use crawler_boot::ModelTrial;
use crawler_boot::model_trial::ModelObservation;
use crawler_boot::trial::Verdict;
use crawler_hal::Clock;
use crawler_protocol::Level;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_storage_async::nor_flash::MultiwriteNorFlash;

use super::{ModelHost, ModelStore as _, PolicyPlace, WithModels, rolled_back};
use crate::policy::Installed as Driven;
use crate::update::proving::CONFIRM;
use crate::update::slots::{Slot, Subject, known, model_of};
use crate::update::transfer::{Step, Transfer};
use crate::update::{Activity, Failed, Installed, LOOK, Next, Stock};

impl<
    M: RawMutex,
    F: MultiwriteNorFlash,
    C: Clock,
    B: ModelHost,
    P: PolicyPlace,
    const MODELS: usize,
> Activity<'_, M, F, C, WithModels<B, P>, MODELS>
{
    /// What a step of a transfer means besides, of a model.
    pub(super) async fn go_on_with_model(&mut self, step: Step) -> Result<(), Failed> {
        match step {
            Step::CheckAll => {
                let bytes = self.transfer.as_ref().map_or(0, Transfer::size);
                self.load(Slot::Spare, bytes).await
            }
            Step::Activate => self.begin_with_model().await,
            _ => Ok(()),
        }
    }

    /// Uses the model that was activated.
    async fn begin_with_model(&mut self) -> Result<(), Failed> {
        let subject = self.slots.subject();
        let (before, spare) = (self.slots.running(), self.slots.spare());
        self.slots.use_model(spare);
        let looked = self.look_at_model().await;
        let known = looked.map(|seen| (known(self.updates, seen.envelope), seen.envelope));
        let Ok((Some(known), envelope)) = known else {
            self.slots.use_model(before);
            return Err(Failed::Flash);
        };
        let model = model_of(self.updates, envelope);
        if subject == Subject::Policy
            && let Err(why) = self.slots.run(CONFIRM, self.updates).await
        {
            self.slots.use_model(before);
            return Err(why);
        }
        let stocks = self.models.stock_mut(subject);
        if let Some(stock) = stocks {
            let floor = stock.installed.map_or(0, |installed| installed.floor);
            let next_floor = floor.max(known.floor);
            *stock = Stock {
                installed: Some(Installed {
                    release: Some(known.release),
                    sequence: known.sequence,
                    floor: if subject == Subject::Policy {
                        next_floor
                    } else {
                        floor
                    },
                    next_floor,
                }),
                given_up: None,
                unfinished: None,
            };
        }
        self.use_model(model.as_ref(), Driven::None).await;
        self.updates.set_model(subject, model);
        self.robot.outbox.nudge();
        self.leave();
        if subject == Subject::Policy || self.models.eyes.is_none() {
            self.tell_confirmed(known.release, subject);
            self.log(
                Level::Info,
                known.release,
                format_args!("is there to drive by"),
            );
        } else {
            let (now, sensors) = (self.clock.now(), self.sensors());
            self.models.trial = Some(ModelTrial::new(now, sensors));
            self.robot.try_out_eyes(true);
            self.tell_trial(known.release, subject);
            self.log(Level::Info, known.release, format_args!("is tried"));
        }
        Ok(())
    }

    /// Observes the model on trial once, where there is one.
    pub(super) async fn prove_model(&mut self) -> Next {
        if let Some(outcome) = self.models.later
            && self.updates.is_told()
        {
            self.models.later = None;
            self.tell_outcome(outcome);
            return Next::Soon;
        }
        let now = self.clock.now();
        let missed = self.robot.missed_periods();
        let sensors = self.sensors();
        let models = &mut self.models;
        // Where there are no eyes nothing of what follows is compiled.
        let (Some(eyes), Some(trial)) = (&models.eyes, &mut models.trial) else {
            return Next::Word;
        };
        let looks = eyes.looks();
        let verdict = trial.observe(
            now,
            &ModelObservation {
                missed,
                sensors,
                looks: looks.taken,
                slowest: looks.slowest,
            },
        );
        let release = self.stock_of(Subject::Eyes).release();
        self.slots.turn_to(Subject::Eyes);
        match verdict {
            Verdict::Pending => return Next::At(now + LOOK),
            Verdict::Confirm => {
                if self.slots.run(CONFIRM, self.updates).await.is_err() {
                    // A flash that does not take it is asked again.
                    return Next::At(now + LOOK);
                }
                self.end_looking();
                if let Some(installed) = &mut self.stock().installed {
                    installed.floor = installed.next_floor;
                }
                if let Some(release) = release {
                    self.tell_confirmed(release, Subject::Eyes);
                    self.log(Level::Info, release, format_args!("is proven"));
                }
            }
            Verdict::RollBack(reason) => {
                // What the flash does not take is done by `find_model`, or at the next start.
                let _ = self.give_model_up(reason).await;
                self.end_looking();
                self.find_model(Subject::Eyes).await;
                if let Some(release) = release {
                    let outcome = rolled_back(release, reason, Subject::Eyes);
                    self.stock().given_up = Some(outcome);
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
        let eyes = self.stock_of(Subject::Eyes).release();
        if let Some(release) = eyes.filter(|_| self.models.is_on_trial()) {
            self.tell_trial(release, Subject::Eyes);
            return;
        }
        let mut models = self.models.stocks().iter();
        if let Some(outcome) = models.find_map(|stock| stock.given_up) {
            if self.programs.given_up.is_none() {
                self.tell_outcome(outcome);
            } else {
                self.models.later = Some(outcome);
            }
        }
    }
}
