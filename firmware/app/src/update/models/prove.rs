//! The trial of a model: begun without a restart, observed, and ended.

use crawler_boot::ModelTrial;
use crawler_boot::model_trial::ModelObservation;
use crawler_boot::trial::Verdict;
use crawler_hal::Clock;
use crawler_protocol::Level;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_storage_async::nor_flash::MultiwriteNorFlash;

use super::{ModelHost, ModelStore as _, WithModels, rolled_back};
use crate::update::proving::CONFIRM;
use crate::update::slots::{Slot, Subject, build_of, known};
use crate::update::transfer::{Step, Transfer};
use crate::update::{Activity, Failed, Installed, LOOK, Next, Stock};

impl<M: RawMutex, F: MultiwriteNorFlash, C: Clock, B: ModelHost, const MODELS: usize>
    Activity<'_, M, F, C, WithModels<B>, MODELS>
{
    /// What a step of a transfer means besides, of a model.
    pub(super) async fn go_on_with_model(&mut self, step: Step) -> Result<(), Failed> {
        match step {
            Step::CheckAll => {
                let bytes = self.transfer.as_ref().map_or(0, Transfer::size);
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
