//! The steps of a transfer, done.

use crawler_boot::trailer::{Outcome as Fate, Record, Trailer};
use crawler_hal::Clock;
use crawler_protocol::{Level, PROTOCOL_VERSION, ReleaseId, RobotState};
use crawler_release::{Chip, ENVELOPE_MAX, Refusal, Signed, Target, verify};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_storage_async::nor_flash::MultiwriteNorFlash;

use super::mailbox::Progress;
use super::models::ModelStore;
use super::slots::{Aim, Slot, Subject, Work, known};
use super::transfer::{Step, Transfer};
use super::{Activity, Blocks, Failed, LOOK_UPDATING, Next, Refused, Shape, TOLD_WITHIN};
use crate::order::UpdateWish;

impl<M: RawMutex, F: MultiwriteNorFlash, C: Clock, N: ModelStore, const MODELS: usize>
    Activity<'_, M, F, C, N, MODELS>
{
    /// Goes on with what is under way, by one step.
    pub(super) async fn advance(&mut self) -> Next {
        let (works, step) = match self.plan() {
            Ok(planned) => planned,
            Err(next) => return next,
        };
        let done = N::run(self, works, step).await;
        self.conclude(step, done.map(|seen| seen.envelope))
    }

    /// What is to be done to the flash, for which step; or, without that, when to go on.
    fn plan(&mut self) -> Result<([Work; 2], Planned), Next> {
        let now = self.clock.now();
        let Some(transfer) = &mut self.transfer else {
            return Err(Next::Word);
        };
        let release = transfer.release();
        let silent = transfer.is_silent(now).then_some("no_data");
        let stands = self.robot.snapshot().state == RobotState::Updating;
        let hindrance = self
            .hindrance()
            .or(if stands { silent } else { Some("interrupted") });
        if let Some(hindrance) = hindrance {
            self.leave();
            self.defer(release, hindrance);
            return Err(Next::Soon);
        }
        if self.transfer.as_ref().is_some_and(Transfer::awaits_chunk)
            && let Some((index, length)) = self.updates.chunk()
        {
            return self.plan_chunk(index, length);
        }
        let Some(transfer) = &mut self.transfer else {
            return Err(Next::Word);
        };
        let had_patch = transfer.without_patch().is_none();
        let step = transfer.next(now);
        if had_patch {
            self.tell_without_patch();
        }
        self.tell_stage();
        let works = match step {
            Step::Wait(at) => return Err(Next::At(at.min(now + LOOK_UPDATING))),
            Step::Ask(want) => {
                // Chunks come over the envelope, if it lies there.
                self.envelope = None;
                self.updates.ask(want);
                self.robot.outbox.nudge();
                return Err(Next::Soon);
            }
            Step::Judge if self.envelope.is_some() => [Work::Rest, Work::Rest],
            Step::Judge => [Work::Look(Slot::Spare), Work::Rest],
            Step::Keep => [Work::Reach(Aim::Keep), Work::Rest],
            Step::Begin => {
                let stock = self.stock();
                (stock.given_up, stock.unfinished) = (None, None);
                [Work::Begin(self.envelope.unwrap_or(0)), Work::Rest]
            }
            Step::Erase(sector) => [Work::Erase(sector), Work::Rest],
            Step::Check(block) => [Work::Check(Slot::Spare, Some(block)), Work::Rest],
            Step::Note(block) => {
                let note = Record::Block(block);
                [Work::Record(Slot::Spare, note), Work::Rest]
            }
            Step::CheckAll => {
                // Nothing more of a patch is of any use.
                self.updates.close();
                [Work::Check(Slot::Spare, None), Work::Rest]
            }
            Step::Stage => {
                let staged = Record::Staged(self.sensors());
                [Work::Record(Slot::Spare, staged), Work::Rest]
            }
            Step::Activate => {
                // What was said last is given time to arrive.
                let until = *self.told_by.get_or_insert(now + TOLD_WITHIN);
                if !self.updates.is_told() && now < until {
                    return Err(Next::At(until.min(now + LOOK_UPDATING)));
                }
                let activated = Work::Record(Slot::Spare, Record::Activated);
                [activated, Work::Reach(Aim::Activate)]
            }
        };
        Ok((works, Planned::Step(step)))
    }

    /// Takes the envelope, or says where the chunk that waits is written.
    fn plan_chunk(&mut self, index: u32, length: usize) -> Result<([Work; 2], Planned), Next> {
        if let Some(transfer) = &mut self.transfer {
            if transfer.take_envelope(index) {
                self.updates.close();
                self.envelope = Some(length);
                return Err(Next::Soon);
            }
            if let Some(at) = transfer.place(index, length) {
                let write = [Work::Write(at, length), Work::Rest];
                return Ok((write, Planned::Chunk(index)));
            }
            if transfer.is_next_of_patch(index, length) {
                self.slots.patch_around(transfer.blocks());
                let patch = [Work::Patch(length), Work::Rest];
                return Ok((patch, Planned::Patch(index)));
            }
        }
        // Nothing that is waited for, or not of such a length.
        self.updates.make_room();
        Err(Next::Soon)
    }

    /// Notes what a step came to.
    fn conclude(&mut self, planned: Planned, done: Result<Option<usize>, Failed>) -> Next {
        let now = self.clock.now();
        let judged = match (planned, done) {
            (Planned::Step(Step::Judge), Ok(looked)) => {
                self.envelope = self.envelope.or(looked);
                self.judge().map(Some)
            }
            (_, done) => done.map(|_| None),
        };
        let subject = self.slots.subject();
        let Some(transfer) = &mut self.transfer else {
            return Next::Soon;
        };
        let release = transfer.release();
        let had_patch = transfer.without_patch().is_none();
        let went = match (judged, planned) {
            (Ok(_), Planned::Chunk(index)) => {
                transfer.written(index, now);
                self.updates.make_room();
                Ok(())
            }
            (Ok(_), Planned::Patch(index)) => {
                if let Some(made) = self.slots.patched() {
                    transfer.patched(index, made, now);
                    // Blocks that it has completed come first: the place is needed for them.
                    if transfer.awaits_chunk() {
                        self.updates.make_room();
                    }
                }
                Ok(())
            }
            (Ok(_), Planned::Step(Step::Activate)) => {
                self.log(Level::Info, release, format_args!("restarts for its trial"));
                self.leaving = true;
                self.robot.wish(UpdateWish::Restart);
                return Next::Word;
            }
            (Ok(Some(shape)), Planned::Step(_)) => {
                if subject != Subject::Program {
                    // A patch is of programs.
                    transfer.ignore_patch();
                }
                transfer.believed(shape);
                self.slots.begin_patch(shape);
                self.log(Level::Info, release, format_args!("is taken"));
                Ok(())
            }
            (Ok(None), Planned::Step(_)) => transfer.done(now),
            // A chunk stays where it is, and is written again.
            (Err(why), _) => transfer.failed(why),
        };
        if let Err(refused) = went {
            self.refuse(release, refused);
            return Next::Soon;
        }
        if had_patch {
            self.tell_without_patch();
        }
        if let Some(transfer) = &self.transfer
            && transfer.stage().is_some()
        {
            let lies = (release, transfer.bytes());
            self.stock().unfinished = Some(lies);
        }
        self.tell_stage();
        Next::Soon
    }

    /// The envelope where chunks arrive, against all that is asked of a release.
    // Its kilobyte and the arithmetic of the signature are on the stack, and not in a future.
    #[inline(never)]
    fn judge(&mut self) -> Result<Shape, Failed> {
        let refuse = |code, lasting| Err(Failed::Refused(Refused { code, lasting }));
        // Where it belongs is what it says of itself, of which nothing is believed before it was verified.
        let says = known(self.updates, self.envelope).map(|known| known.kind);
        let subject = says.and_then(|kind| self.models.subject(kind));
        let subject = subject.unwrap_or(Subject::Program);
        self.slots.turn_to(subject);
        let installed = self.stock().installed;
        let (Some(installed), Some(transfer)) = (installed, &self.transfer) else {
            return refuse("flash_failed", true);
        };
        let identity = self.updates.identity();
        let Some(keys) = &identity.keys else {
            return refuse("unknown_key", true);
        };
        let mut envelope = [0; ENVELOPE_MAX];
        self.updates.copy_out(0, &mut envelope);
        let envelope = envelope.get(..self.envelope.unwrap_or(0)).unwrap_or(&[]);
        let model = self.updates.model_build(subject);
        let build = match &model {
            Some(build) => build.as_str(),
            None if subject != Subject::Program => "",
            None => identity.build.as_str(),
        };
        let target = Target {
            kind: subject.kind(),
            name: self.models.name().filter(|_| subject == Subject::Eyes),
            board: self.robot.config().board,
            chip: Chip(self.slots.chip()),
            capacity: self.slots.capacity(),
            sequence: installed.sequence,
            floor: installed.floor,
            build,
            protocol: PROTOCOL_VERSION,
            now: self.robot.unix_ms(self.clock.now()).map(|ms| ms / 1_000),
            // No program knows: until the clock is set, nothing is expired.
            built_at: 0,
        };
        match verify(envelope, keys, &target) {
            // Both are told by their names.
            Ok(manifest) if subject == Subject::Policy && manifest.name == self.models.name() => {
                refuse("wrong_kind", true)
            }
            Ok(manifest) => {
                let signed = Signed::parse(envelope);
                if signed.is_ok_and(|signed| signed.id() == transfer.release().bytes()) {
                    Ok(Shape::of(&manifest))
                } else {
                    refuse("wrong_release", false)
                }
            }
            Err(refusal) => refuse(refusal.code(), refusal != Refusal::Requires),
        }
    }

    /// Says why the patch was given up, if it was just now. Chunks of it are not taken any more.
    fn tell_without_patch(&mut self) {
        if let Some(transfer) = &self.transfer
            && let Some(why) = transfer.without_patch()
        {
            self.updates.close();
            self.told = None;
            let text = format_args!("comes as a whole image: {why}");
            self.log(Level::Warn, transfer.release(), text);
        }
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
                reason: transfer.without_patch(),
                bytes,
                of: self.slots.subject(),
            });
        }
    }

    /// The blocks of a release in the spare slot that is meant, if it is there and was not given up.
    pub(super) async fn lying(&mut self, release: ReleaseId) -> Option<Blocks> {
        let look = [Work::Look(Slot::Spare), Work::Rest];
        let seen = self.slots.run(look, self.updates).await.ok()?;
        let known = known(self.updates, seen.envelope)?;
        if !is_unfinished(&seen.trailer) || known.release != release {
            return None;
        }
        self.envelope = seen.envelope;
        Some(blocks_of(&seen.trailer))
    }
}

/// What was planned.
#[derive(Debug, Clone, Copy)]
pub(super) enum Planned {
    Step(Step),
    /// Writing this chunk.
    Chunk(u32),
    /// Writing what this chunk of a patch makes.
    Patch(u32),
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
