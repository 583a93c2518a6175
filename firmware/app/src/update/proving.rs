//! The start, and the trial: what runs, and whether it is to stay.

use crawler_boot::Trial;
use crawler_boot::otadata::Standing;
use crawler_boot::trailer::{Outcome as Fate, Record};
use crawler_boot::trial::{Observation, Sensors, Verdict};
use crawler_hal::Clock;
use crawler_protocol::{Level, ReleaseId, UpdateOutcome};
use crawler_release::{Kind, Manifest};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_storage_async::nor_flash::MultiwriteNorFlash;

use super::mailbox::Outcome;
use super::slots::Slot;
use super::steps::{blocks_of, is_unfinished, manifest_at};
use super::{Activity, EVENT, Failed, Installed, LOOK, Next};
use crate::order::UpdateWish;
use crate::perception::SensorHealth;
use crate::state::Fault;

/// What the manifest in a trailer says.
struct Known {
    release: ReleaseId,
    sequence: u32,
    floor: u32,
    size: u32,
    block: u32,
    /// It is of a program of this build.
    is_ours: bool,
}

impl Known {
    fn of(manifest: &Manifest<'_>, release: ReleaseId, build: &str) -> Self {
        Self {
            release,
            sequence: manifest.sequence,
            floor: manifest.floor,
            size: manifest.size,
            block: manifest.block_size,
            is_ours: manifest.kind == Kind::Program && manifest.build == build,
        }
    }
}

impl<M: RawMutex, F: MultiwriteNorFlash, C: Clock> Activity<'_, M, F, C> {
    /// Finds out what runs and what lies in the spare slot, and goes on with what a restart has interrupted.
    pub(super) async fn start(&mut self) {
        if self.look().await.is_err() {
            let text = format_args!("the slots cannot be read: no release is taken");
            self.robot.log(Level::Error, EVENT, text, self.clock.now());
        }
    }

    async fn look(&mut self) -> Result<(), Failed> {
        let standing = self.slots.standing().await?;
        let running = self.slots.trailer(Slot::Running).await?;
        let known = self.known(Slot::Running, &running).await?;
        let spare = self.slots.trailer(Slot::Spare).await?;
        let other = self.known(Slot::Spare, &spare).await?;

        let identity = self.updates.identity();
        let ours = known.as_ref().filter(|known| known.is_ours);
        let confirmed = [(&running, &known), (&spare, &other)];
        let floors = confirmed.iter().filter_map(|(trailer, known)| {
            let floor = known.as_ref()?.floor;
            (trailer.outcome() == Some(Fate::Confirmed)).then_some(floor)
        });
        let floor = floors.max().unwrap_or(0);
        let mut installed = Installed {
            release: ours.map(|known| known.release),
            sequence: ours
                .map_or(0, |known| known.sequence)
                .max(identity.sequence),
            floor,
            next_floor: ours.map_or(0, |known| known.floor).max(floor),
        };

        if let Some(known) = &other {
            if let Some(reason) = spare.rolled_back() {
                self.given_up = Some(Outcome {
                    release: known.release,
                    came_to: UpdateOutcome::RolledBack,
                    reason: Some(reason.code()),
                    lasting: None,
                });
            } else if is_unfinished(&spare) {
                let blocks = blocks_of(&spare);
                let bytes = blocks.bytes(known.size, known.block);
                self.unfinished = Some((known.release, bytes));
            }
        }

        let activated = ours.is_some() && running.outcome() == Some(Fate::Activated);
        match standing {
            Standing::OnTrial(counts) if counts.way_back => {
                let before = running.staged().unwrap_or_default();
                self.trial = Some(Trial::new(self.clock.now(), before));
            }
            // There is nothing to go back to, so there is no trial.
            Standing::OnTrial(_) => self.slots.confirm(activated).await?,
            // The power went between otadata and the trailer.
            Standing::Proven | Standing::Returned if activated => {
                self.slots.record(Slot::Running, Record::Confirmed).await?;
            }
            Standing::Proven | Standing::Returned => {}
        }
        if activated && self.trial.is_none() {
            installed.floor = installed.next_floor;
        }
        self.installed = Some(installed);
        Ok(())
    }

    async fn known(
        &mut self,
        slot: Slot,
        trailer: &crawler_boot::trailer::Trailer,
    ) -> Result<Option<Known>, Failed> {
        let length = self.slots.load(slot, trailer, self.updates).await?;
        let build = self.updates.identity().build.as_str();
        Ok(manifest_at(self.updates, length, |manifest, release| {
            Known::of(manifest, release, build)
        }))
    }

    /// The sensors that work. That of a camera is not among them: it is looked through on demand, and nobody knows of
    /// one that is not.
    pub(super) fn sensors(&self) -> Sensors {
        let ranger = self.robot.reading().health == SensorHealth::Good;
        let battery = self.robot.battery().voltage.is_some();
        let mut sensors = Sensors::NONE;
        if ranger {
            sensors = sensors.with(Sensors::RANGER);
        }
        if battery {
            sensors = sensors.with(Sensors::BATTERY);
        }
        sensors
    }

    /// Observes the program on trial once.
    pub(super) async fn prove(&mut self) -> Next {
        let now = self.clock.now();
        let (received, delivered) = self.updates.linked();
        let is_release = self
            .installed
            .is_some_and(|installed| installed.release.is_some());
        let seen = Observation {
            missed: self.robot.missed_periods(),
            sensors: self.sensors(),
            received,
            delivered,
            // What runs is not what its manifest says, or cannot move its wheels.
            failed: !is_release || self.robot.snapshot().fault == Some(Fault::Motor),
        };
        let Some(trial) = &mut self.trial else {
            return Next::Soon;
        };
        let verdict = trial.observe(now, &seen);
        let release = self.installed.and_then(|installed| installed.release);
        match verdict {
            Verdict::Pending => {}
            Verdict::Confirm => {
                // A flash that does not take it is asked again.
                if self.slots.confirm(true).await.is_ok() {
                    self.trial = None;
                    if let Some(installed) = &mut self.installed {
                        installed.floor = installed.next_floor;
                    }
                    self.tell_have();
                    if let Some(release) = release {
                        self.tell_confirmed(release);
                        self.log(Level::Info, release, format_args!("is proven"));
                    }
                    return Next::Soon;
                }
            }
            Verdict::RollBack(reason) => {
                let text = format_args!("given up: {}", reason.code());
                self.robot.log(Level::Error, EVENT, text, now);
                self.trial = None;
                if self.slots.give_up(reason).await {
                    self.leaving = true;
                    self.robot.wish(UpdateWish::Restart);
                } else {
                    let text = format_args!("there is no other program: it stays");
                    self.robot.log(Level::Error, EVENT, text, now);
                }
                return Next::Soon;
            }
        }
        Next::At(now + LOOK)
    }
}
