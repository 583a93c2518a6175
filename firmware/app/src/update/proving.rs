//! The start, and the trial: what runs, and whether it is to stay.

use crawler_boot::Trial;
use crawler_boot::otadata::Standing;
use crawler_boot::trailer::{Outcome as Fate, Record};
use crawler_boot::trial::{Observation, Sensors, Verdict};
use crawler_hal::Clock;
use crawler_protocol::{Level, UpdateOutcome};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_storage_async::nor_flash::MultiwriteNorFlash;

use super::mailbox::Outcome;
use super::models::ModelStore;
use super::slots::{Aim, Seen, Slot, Subject, Work, known};
use super::steps::{blocks_of, is_unfinished};
use super::{Activity, EVENT, Installed, LOOK, Next};
use crate::order::UpdateWish;
use crate::perception::SensorHealth;
use crate::state::Fault;

/// What makes a program the one that stays: first where it is decided what is started.
pub(super) const CONFIRM: [Work; 2] = [
    Work::Reach(Aim::Confirm),
    Work::Record(Slot::Running, Record::Confirmed),
];

impl<M: RawMutex, F: MultiwriteNorFlash, C: Clock, N: ModelStore, const MODELS: usize>
    Activity<'_, M, F, C, N, MODELS>
{
    /// Finds out what runs and what lies in the spare slot, and goes on with what a restart has interrupted.
    pub(super) async fn start(&mut self) {
        let mut works = [Work::Look(Slot::Running), Work::Rest];
        for slot in [Slot::Running, Slot::Spare] {
            works[0] = Work::Look(slot);
            match self.slots.run(works, self.updates).await {
                Ok(seen) if slot == Slot::Running => works[1] = self.see_running(&seen),
                Ok(seen) => self.see_spare(&seen),
                Err(_) => {
                    self.programs.installed = None;
                    self.trial = None;
                    let text =
                        format_args!("the slots cannot be read or written: no release is taken");
                    self.robot.log(Level::Error, EVENT, text, self.clock.now());
                    return;
                }
            }
        }
    }

    /// What runs; and what is to be done about it.
    fn see_running(&mut self, seen: &Seen) -> Work {
        let known = known(self.updates, seen.envelope);
        let ours = known.filter(|known| known.is_ours);
        let outcome = seen.trailer.outcome();
        let confirmed = known.filter(|_| outcome == Some(Fate::Confirmed));
        let floor = confirmed.map_or(0, |known| known.floor);
        let mut installed = Installed {
            release: ours.map(|known| known.release),
            sequence: ours.map_or(0, |known| known.sequence),
            floor,
            next_floor: ours.map_or(0, |known| known.floor).max(floor),
        };
        let activated = ours.is_some() && outcome == Some(Fate::Activated);
        let works = match seen.standing {
            Standing::OnTrial(counts) if counts.way_back => {
                let before = seen.trailer.staged().unwrap_or_default();
                self.trial = Some(Trial::new(self.clock.now(), before));
                Work::Rest
            }
            // There is nothing to go back to, so there is no trial.
            Standing::OnTrial(_) => Work::Reach(Aim::Confirm),
            // The power went between otadata and the trailer.
            Standing::Proven | Standing::Returned if activated => {
                installed.floor = installed.next_floor;
                Work::Record(Slot::Running, Record::Confirmed)
            }
            Standing::Proven | Standing::Returned => Work::Rest,
        };
        self.programs.installed = Some(installed);
        works
    }

    /// What lies in the spare slot.
    fn see_spare(&mut self, seen: &Seen) {
        let Some(known) = known(self.updates, seen.envelope) else {
            return;
        };
        if let Some(reason) = seen.trailer.rolled_back() {
            self.programs.given_up = Some(Outcome {
                release: known.release,
                came_to: UpdateOutcome::RolledBack,
                reason: Some(reason.code()),
                lasting: None,
                of: Subject::Program,
            });
        } else if is_unfinished(&seen.trailer) {
            let bytes = blocks_of(&seen.trailer).bytes(known.shape);
            self.programs.unfinished = Some((known.release, bytes));
        } else if let Some(installed) = &mut self.programs.installed {
            // It was confirmed once.
            installed.floor = installed.floor.max(known.floor);
            installed.next_floor = installed.next_floor.max(known.floor);
        }
    }

    /// The sensors that work. That of a camera is not among them: it is looked through on demand, and nobody knows of
    /// one that is not.
    pub(super) fn sensors(&self) -> Sensors {
        let mut sensors = Sensors::NONE;
        if self.robot.reading().health == SensorHealth::Good {
            sensors = sensors.with(Sensors::RANGER);
        }
        if self.robot.battery().voltage.is_some() {
            sensors = sensors.with(Sensors::BATTERY);
        }
        sensors
    }

    /// Observes the program on trial once.
    pub(super) async fn prove(&mut self) -> Next {
        self.slots.turn_to(Subject::Program);
        let verdict = self.observe();
        let works = match verdict {
            Verdict::Pending => [Work::Rest, Work::Rest],
            Verdict::Confirm => CONFIRM,
            Verdict::RollBack(reason) => [
                Work::Record(Slot::Running, Record::RolledBack(reason)),
                Work::Reach(Aim::GiveUp),
            ],
        };
        let done = self.slots.run(works, self.updates).await.map(|_| ());
        match (verdict, done) {
            // A flash that does not take it is asked again.
            (Verdict::Pending, _) | (Verdict::Confirm, Err(_)) => {
                return Next::At(self.clock.now() + LOOK);
            }
            (Verdict::Confirm, Ok(())) => self.confirmed(),
            (Verdict::RollBack(reason), done) => {
                let now = self.clock.now();
                let text = format_args!("given up: {}", reason.code());
                self.robot.log(Level::Error, EVENT, text, now);
                self.trial = None;
                if done == Err(super::Failed::NoWayBack) {
                    let text = format_args!("there is no other program: it stays");
                    self.robot.log(Level::Error, EVENT, text, now);
                } else {
                    self.leaving = true;
                    self.robot.wish(UpdateWish::Restart);
                }
            }
        }
        Next::Soon
    }

    fn observe(&mut self) -> Verdict {
        let (received, delivered) = self.updates.linked();
        let release = self.programs.release();
        let seen = Observation {
            missed: self.robot.missed_periods(),
            sensors: self.sensors(),
            received,
            delivered,
            // What runs is not what its manifest says, or cannot move its wheels.
            failed: release.is_none() || self.robot.snapshot().fault == Some(Fault::Motor),
        };
        match &mut self.trial {
            Some(trial) => trial.observe(self.clock.now(), &seen),
            None => Verdict::Pending,
        }
    }

    fn confirmed(&mut self) {
        self.trial = None;
        let Some(installed) = &mut self.programs.installed else {
            return;
        };
        installed.floor = installed.next_floor;
        let release = installed.release;
        self.tell_have();
        if let Some(release) = release {
            self.tell_confirmed(release, Subject::Program);
            self.log(Level::Info, release, format_args!("is proven"));
        }
    }
}
