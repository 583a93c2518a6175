//! The steps of a transfer, done.

use crawler_boot::flash::SECTOR;
use crawler_boot::trailer::{Outcome as Fate, Record, Trailer};
use crawler_hal::Clock;
use crawler_protocol::{Level, PROTOCOL_VERSION, ReleaseId, RobotState};
use crawler_release::{
    BlockHasher, Chip, ENVELOPE_MAX, Kind, Manifest, Refusal, Signed, Target, WholeHasher, verify,
};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_storage_async::nor_flash::MultiwriteNorFlash;

use super::mailbox::{Progress, Updates};
use super::slots::Slot;
use super::transfer::Step;
use super::{Activity, Blocks, Failed, LOOK_UPDATING, Next, Refused, Shape, TOLD_WITHIN};
use crate::order::UpdateWish;

impl<M: RawMutex, F: MultiwriteNorFlash, C: Clock> Activity<'_, M, F, C> {
    /// Goes on with what is under way, by one step.
    pub(super) async fn advance(&mut self) -> Next {
        let Some(transfer) = &mut self.transfer else {
            return Next::Word;
        };
        let (release, now) = (transfer.release(), self.clock.now());
        let silent = transfer.is_silent(now).then_some("no_data");
        let stands = self.robot.snapshot().state == RobotState::Updating;
        let hindrance = self
            .hindrance()
            .or(if stands { silent } else { Some("interrupted") });
        if let Some(hindrance) = hindrance {
            self.leave();
            self.defer(release, hindrance);
            return Next::Soon;
        }
        if self.take_chunk(now).await {
            return Next::Soon;
        }
        let Some(transfer) = &mut self.transfer else {
            return Next::Soon;
        };
        let step = transfer.next(now);
        self.tell_stage();
        match step {
            Step::Wait(at) => return Next::At(at.min(now + LOOK_UPDATING)),
            Step::Ask(want) => {
                // Chunks come over the envelope, if it lies there.
                self.envelope = None;
                self.updates.ask(want);
                self.robot.outbox.nudge();
                return Next::Soon;
            }
            Step::Judge
            | Step::Keep
            | Step::Begin
            | Step::Erase(_)
            | Step::Check(_)
            | Step::Note(_)
            | Step::CheckAll
            | Step::Stage
            | Step::Activate => {}
        }
        let done = self.perform(release, step).await;
        self.conclude(release, done);
        Next::Soon
    }

    /// Notes what a step came to.
    fn conclude(&mut self, release: ReleaseId, done: Result<(), Failed>) {
        let now = self.clock.now();
        let Some(transfer) = &mut self.transfer else {
            return;
        };
        match done {
            Ok(()) => transfer.done(now),
            Err(why) => {
                if let Err(refused) = transfer.failed(why) {
                    return self.refuse(release, refused);
                }
            }
        }
        if transfer.stage().is_some() {
            self.unfinished = Some((release, transfer.bytes()));
        }
        self.tell_stage();
    }

    async fn perform(&mut self, release: ReleaseId, step: Step) -> Result<(), Failed> {
        match step {
            Step::Wait(_) | Step::Ask(_) => Ok(()),
            Step::Judge => {
                if self.envelope.is_none() {
                    let trailer = self.slots.trailer(Slot::Spare).await?;
                    let loaded = self.slots.load(Slot::Spare, &trailer, self.updates).await;
                    self.envelope = loaded?;
                }
                let shape = self.judge(release)?;
                if let Some(transfer) = &mut self.transfer {
                    transfer.believed(shape);
                }
                self.log(Level::Info, release, format_args!("is taken"));
                Ok(())
            }
            Step::Keep => self.slots.keep().await,
            Step::Begin => {
                let Some(length) = self.envelope else {
                    return Err(Failed::Flash);
                };
                self.given_up = None;
                self.unfinished = None;
                self.slots.begin(length, self.updates).await
            }
            Step::Erase(sector) => self.slots.erase(sector).await,
            Step::Check(block) => self.check(block).await,
            Step::Note(block) => self.slots.record(Slot::Spare, Record::Block(block)).await,
            Step::CheckAll => self.check_all().await,
            Step::Stage => {
                let staged = Record::Staged(self.sensors());
                self.slots.record(Slot::Spare, staged).await
            }
            Step::Activate => self.activate(release).await,
        }
    }

    /// Takes the chunk that waits, if one does. Whether it did.
    async fn take_chunk(&mut self, now: crawler_hal::Instant) -> bool {
        let Some((index, length)) = self.updates.chunk() else {
            return false;
        };
        let Some(transfer) = &mut self.transfer else {
            return false;
        };
        if transfer.take_envelope(index) {
            self.updates.close();
            self.envelope = Some(length);
            return true;
        }
        let release = transfer.release();
        let Some(at) = transfer.place(index, length) else {
            // Nothing that was waited for is of such a length.
            self.updates.make_room();
            return true;
        };
        let written = self.slots.write(at, length, self.updates).await;
        match (written, &mut self.transfer) {
            (Ok(()), Some(transfer)) => {
                transfer.written(index, now);
                self.updates.make_room();
            }
            // It stays where it is, and is written again.
            (Err(why), Some(transfer)) => {
                if let Err(refused) = transfer.failed(why) {
                    self.refuse(release, refused);
                }
            }
            (_, None) => {}
        }
        true
    }

    /// The envelope where chunks arrive, against all that is asked of a release.
    // Its kilobyte and the arithmetic of the signature are on the stack, and not in a future.
    #[inline(never)]
    fn judge(&self, release: ReleaseId) -> Result<Shape, Failed> {
        let refuse = |code, lasting| Err(Failed::Refused(Refused { code, lasting }));
        let Some(installed) = self.installed else {
            return refuse("flash_failed", true);
        };
        let identity = self.updates.identity();
        let Some(keys) = &identity.keys else {
            return refuse("unknown_key", true);
        };
        let mut envelope = [0; ENVELOPE_MAX];
        self.updates.copy_out(0, &mut envelope);
        let envelope = envelope.get(..self.envelope.unwrap_or(0)).unwrap_or(&[]);
        let target = Target {
            kind: Kind::Program,
            name: None,
            board: self.robot.config().board,
            chip: Chip(self.slots.chip()),
            capacity: self.slots.capacity(),
            sequence: installed.sequence,
            floor: installed.floor,
            build: identity.build.as_str(),
            protocol: PROTOCOL_VERSION,
            now: self.robot.unix_ms(self.clock.now()).map(|ms| ms / 1_000),
            built_at: identity.built_at,
        };
        match verify(envelope, keys, &target) {
            Ok(manifest) => {
                let signed = Signed::parse(envelope);
                if signed.is_ok_and(|signed| signed.id() == release.bytes()) {
                    Ok(Shape::of(&manifest))
                } else {
                    refuse("wrong_release", false)
                }
            }
            Err(refusal) => refuse(refusal.code(), refusal != Refusal::Requires),
        }
    }

    /// Has the hasher of the image made from the manifest in the trailer, which was believed before.
    async fn hasher<T>(
        &mut self,
        make: impl FnOnce(&Manifest<'_>) -> Option<T>,
    ) -> Result<T, Failed> {
        let trailer = self.slots.trailer(Slot::Spare).await?;
        let length = self.slots.load(Slot::Spare, &trailer, self.updates).await?;
        manifest_at(self.updates, length, |manifest, _| make(manifest))
            .flatten()
            .ok_or(Failed::Flash)
    }

    async fn check(&mut self, block: u8) -> Result<(), Failed> {
        let (mut hasher, at) = self
            .hasher(|manifest| {
                let hasher = BlockHasher::new(manifest, block.into())?;
                Some((hasher, u32::from(block) * manifest.block_size))
            })
            .await?;
        let length = hasher.left();
        // Exactly as many bytes are read as it takes.
        let read = self.slots.read(at, length, |bytes| {
            let _ = hasher.update(bytes);
        });
        read.await?;
        hasher.finish().map_err(|_| Failed::Content)
    }

    async fn check_all(&mut self) -> Result<(), Failed> {
        let mut hasher = self
            .hasher(|manifest| Some(WholeHasher::new(manifest)))
            .await?;
        let length = hasher.left();
        let read = self.slots.read(0, length, |bytes| {
            let _ = hasher.update(bytes);
        });
        read.await?;
        hasher.finish().map_err(|_| Failed::Content)
    }

    /// Has the spare slot started, and the robot restart. What is said last is given time to arrive, and the server
    /// to say otherwise.
    async fn activate(&mut self, release: ReleaseId) -> Result<(), Failed> {
        let until = self.clock.now() + TOLD_WITHIN;
        while !self.updates.is_told() && self.clock.now() < until {
            self.clock.sleep(LOOK_UPDATING).await;
        }
        if self.updates.has_word() || self.hindrance().is_some() {
            return Ok(());
        }
        if let Err(why) = self.slots.activate().await {
            // Whatever came of it: this program is the one that is proven.
            self.slots.keep().await?;
            return Err(why);
        }
        self.log(Level::Info, release, format_args!("restarts for its trial"));
        self.leaving = true;
        self.robot.wish(UpdateWish::Restart);
        Ok(())
    }

    fn tell_stage(&mut self) {
        let Some(transfer) = &self.transfer else {
            return;
        };
        let Some(stage) = transfer.stage() else {
            return;
        };
        let bytes = transfer.bytes();
        if self.told != Some((stage, bytes)) {
            self.told = Some((stage, bytes));
            self.tell(Progress {
                release: transfer.release(),
                stage,
                reason: None,
                bytes,
            });
        }
    }

    /// The blocks of a release in the spare slot, if it is there and was not given up.
    pub(super) async fn lying(&mut self, release: ReleaseId) -> Option<Blocks> {
        let trailer = self.slots.trailer(Slot::Spare).await.ok()?;
        if !is_unfinished(&trailer) {
            return None;
        }
        let length = self.slots.load(Slot::Spare, &trailer, self.updates).await;
        let length = length.ok()??;
        let lies = manifest_at(self.updates, Some(length), |_, id| id == release);
        if lies != Some(true) {
            return None;
        }
        self.envelope = Some(length);
        Some(blocks_of(&trailer))
    }
}

/// Whether an image may be gone on with: it was not tried, or nobody knows that it was.
pub(super) fn is_unfinished(trailer: &Trailer) -> bool {
    matches!(trailer.outcome(), None | Some(Fate::Activated))
}

pub(super) fn blocks_of(trailer: &Trailer) -> Blocks {
    (0..64)
        .filter(|block| trailer.has_block(*block))
        .fold(Blocks::default(), Blocks::with)
}

/// What the envelope where chunks arrive says, without asking who signed it: for one that was believed before it was
/// written.
#[inline(never)]
pub(super) fn manifest_at<M: RawMutex, T>(
    updates: &Updates<M>,
    length: Option<usize>,
    read: impl FnOnce(&Manifest<'_>, ReleaseId) -> T,
) -> Option<T> {
    let mut envelope = [0; ENVELOPE_MAX];
    updates.copy_out(0, &mut envelope);
    let signed = Signed::parse(envelope.get(..length?)?).ok()?;
    let manifest = signed.unverified().ok()?;
    Some(read(&manifest, ReleaseId::new(signed.id())))
}

// Slices of blocks end where sectors do.
const _: () = assert!(crawler_release::BLOCK_SIZES[0].is_multiple_of(SECTOR));
