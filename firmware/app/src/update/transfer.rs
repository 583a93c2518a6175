//! A release on its way into the spare slot: what is to be done next. Pure: does nothing by itself, and time is
//! handed in.
//!
//! Whoever owns the flash asks for the next [`Step`], does it, and says what it came to. Everything that has to
//! outlive a restart is in the trailer of the slot by then, so going on after one is the same as beginning with
//! what the trailer says.

use crawler_boot::flash::SECTOR;
use crawler_hal::{Duration, Instant};
use crawler_protocol::{ReleaseId, UpdateStage};
use crawler_release::chunk::{self, PAYLOAD, Part};
use crawler_release::{MAX_BLOCKS, Manifest, WINDOW, Want};

/// How long chunks are waited for before they are asked for again, at first.
pub const ASK_AFTER: Duration = Duration::from_secs(2);
/// The same at most, after doubling each time nothing came.
pub const ASK_AFTER_MOST: Duration = Duration::from_secs(16);
/// A server that sends nothing that is waited for, for so long, is one that does not answer.
pub const SILENT_AFTER: Duration = Duration::from_secs(120);
/// The same of one that has said it had a patch, before it is asked for the image instead.
pub(crate) const NO_PATCH_AFTER: Duration = Duration::from_secs(60);
/// How often a step of the flash, and how often a block, may fail before the release is refused.
const FAILURES: u8 = 3;

/// The refusal of a release that the flash does not take.
const FLASH_FAILED: Result<(), Refused> = Err(Refused {
    code: "flash_failed",
    lasting: true,
});

/// What is to be done next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Step {
    /// Nothing, before this moment or before a chunk has come.
    Wait(Instant),
    /// Ask for these chunks.
    Ask(Want),
    /// Hold the envelope against all that is asked of a release.
    Judge,
    /// Have otadata name the running program as proven, before anything is erased.
    Keep,
    /// Begin the trailer anew with the envelope.
    Begin,
    /// Erase this sector of the slot.
    Erase(u32),
    /// Hold this block, as it is in flash, against its hash.
    Check(u8),
    /// Note in the trailer that the block is there.
    Note(u8),
    /// Hold the whole image, as it is in flash, against its hash.
    CheckAll,
    /// Note in the trailer that the image is complete.
    Stage,
    /// Have the image started next, and restart.
    Activate,
}

/// Why a step did not do what it was to do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Failed {
    /// The release is not one for this robot.
    Refused(Refused),
    /// The flash does not do what it is told.
    Flash,
    /// What is in flash is not what was signed.
    Content,
    /// There is no other program to go back to.
    NoWayBack,
    /// The patch is none, for this reason.
    Patch(&'static str),
}

/// Why a release is not taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Refused {
    /// A stable code.
    pub(crate) code: &'static str,
    /// Whether it would be the same tomorrow.
    pub(crate) lasting: bool,
}

/// What is known of an image once its manifest is believed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Shape {
    size: u32,
    block: u32,
}

impl Shape {
    pub(crate) const fn of(manifest: &Manifest<'_>) -> Self {
        Self {
            size: manifest.size,
            block: manifest.block_size,
        }
    }

    /// Bytes of the image.
    pub(crate) const fn size(self) -> u32 {
        self.size
    }

    /// Blocks of the image.
    const fn blocks(self) -> u8 {
        self.size.div_ceil(self.block) as u8
    }

    /// The block of a byte.
    pub(crate) const fn block_of(self, at: u32) -> u8 {
        (at / self.block) as u8
    }

    /// Where a block ends, in bytes.
    pub(crate) const fn end(self, block: u8) -> u32 {
        let end = (block as u32 + 1) * self.block;
        if end < self.size { end } else { self.size }
    }
}

/// The blocks that are in flash.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Blocks(u64);

const _: () = assert!(MAX_BLOCKS <= u64::BITS as usize);

impl Blocks {
    pub(crate) const NONE: Self = Self(0);

    pub(crate) const fn with(self, block: u8) -> Self {
        Self(self.0 | 1 << (block & 63))
    }

    pub(crate) const fn has(self, block: u8) -> bool {
        self.0 >> (block & 63) & 1 == 1
    }

    /// Bytes of an image of this shape that are in flash.
    pub(crate) fn bytes(self, shape: Shape) -> u32 {
        (0..shape.blocks())
            .filter(|block| self.has(*block))
            .map(|index| shape.end(index) - u32::from(index) * shape.block)
            .sum()
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// The envelope is asked for.
    Envelope,
    /// It is there: in the spare slot already, where an update goes on.
    Judge {
        resumed: bool,
    },
    Keep {
        resumed: bool,
    },
    Begin,
    /// This sector is erased next, unless its block is there.
    Erase(u32),
    /// Chunks of this block are received.
    Receive(u8),
    /// Chunks of the patch are received.
    Patch,
    Check(u8),
    Note(u8),
    CheckAll,
    Stage,
    Activate,
    /// It could not be activated: what was written of that is taken back, and then it is refused.
    Withdraw,
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub(crate) struct Transfer {
    release: ReleaseId,
    phase: Phase,
    shape: Shape,
    blocks: Blocks,
    want: Want,
    /// Bytes of the patch, for as long as the image comes by one; and why it does not any more.
    patch: Option<u32>,
    without_patch: Option<&'static str>,
    /// Bytes of the image that the patch has made.
    made: u32,
    /// When what is waited for is asked for again; `None` when it was not asked for yet.
    ask_at: Option<Instant>,
    patience: Duration,
    /// When something that was waited for came last.
    heard: Instant,
    /// Failures of the present step, and of what was received, in a row.
    failures: u8,
    spoiled: u8,
    /// How often it could not be activated.
    unactivated: u8,
    /// The whole image was not what was signed although its blocks were, and was begun anew.
    begun_anew: bool,
    /// State of a generator: a thousand robots shall not ask in step.
    random: u32,
}

impl Transfer {
    /// Begins with a release. `lying` are the blocks of it in the spare slot, if its envelope is there, which is then
    /// at hand. `patch` are the bytes of the patch that makes it out of the program that runs, if there is one.
    pub(crate) fn new(
        release: ReleaseId,
        lying: Option<Blocks>,
        patch: Option<u32>,
        random: u32,
        now: Instant,
    ) -> Self {
        Self {
            release,
            phase: match lying {
                Some(_) => Phase::Judge { resumed: true },
                None => Phase::Envelope,
            },
            shape: Shape { size: 0, block: 1 },
            blocks: lying.unwrap_or_default(),
            want: Want::window(release.tag(), Part::Manifest, 0, 1),
            patch,
            without_patch: None,
            made: 0,
            ask_at: None,
            patience: ASK_AFTER,
            heard: now,
            failures: 0,
            spoiled: 0,
            unactivated: 0,
            begun_anew: false,
            random: random | 1,
        }
    }

    pub(crate) const fn release(&self) -> ReleaseId {
        self.release
    }

    /// Bytes of the image; 0 before its manifest is believed.
    pub(crate) const fn size(&self) -> u32 {
        self.shape.size
    }

    /// What to tell of it; `None` before its manifest is believed.
    pub(crate) const fn stage(&self) -> Option<UpdateStage> {
        match self.phase {
            Phase::Envelope | Phase::Judge { .. } => None,
            Phase::Keep { .. } | Phase::Begin | Phase::Erase(_) => Some(UpdateStage::Preparing),
            Phase::Receive(_) | Phase::Patch | Phase::Check(_) | Phase::Note(_) => {
                Some(UpdateStage::Receiving)
            }
            Phase::CheckAll | Phase::Stage => Some(UpdateStage::Verifying),
            Phase::Activate | Phase::Withdraw => Some(UpdateStage::Staged),
        }
    }

    /// Bytes of the image that are in flash, in whole blocks.
    pub(crate) fn bytes(&self) -> u32 {
        self.blocks.bytes(self.shape)
    }

    /// The blocks that are in flash.
    pub(crate) const fn blocks(&self) -> Blocks {
        self.blocks
    }

    /// Why the image comes as it is although there was a patch.
    pub(crate) const fn without_patch(&self) -> Option<&'static str> {
        self.without_patch
    }

    /// Whether a chunk that waits is to be looked at: the place of chunks is not needed for anything else.
    pub(crate) const fn awaits_chunk(&self) -> bool {
        matches!(
            self.phase,
            Phase::Envelope | Phase::Receive(_) | Phase::Patch
        )
    }

    /// Whether the server has not answered for too long.
    pub(crate) fn is_silent(&self, now: Instant) -> bool {
        matches!(self.phase, Phase::Envelope | Phase::Receive(_))
            && now - self.heard >= SILENT_AFTER
    }

    /// What to do now.
    pub(crate) fn next(&mut self, now: Instant) -> Step {
        loop {
            return match self.phase {
                Phase::Patch if now - self.heard >= NO_PATCH_AFTER => {
                    self.give_patch_up("delta_no_data");
                    continue;
                }
                Phase::Envelope | Phase::Receive(_) | Phase::Patch => match self.ask_at {
                    Some(at) if now < at => Step::Wait(at),
                    _ => {
                        self.ask_at = Some(now + self.patience + self.jitter());
                        self.patience = (self.patience * 2).min(ASK_AFTER_MOST);
                        Step::Ask(self.want)
                    }
                },
                Phase::Judge { .. } => Step::Judge,
                Phase::Keep { .. } | Phase::Withdraw => Step::Keep,
                Phase::Begin => Step::Begin,
                Phase::Erase(sector) => {
                    let at = sector * SECTOR;
                    if at >= self.shape.size {
                        self.receive(now);
                        continue;
                    }
                    let block = (at / self.shape.block) as u8;
                    if self.blocks.has(block) {
                        self.phase = Phase::Erase(self.shape.end(block).div_ceil(SECTOR));
                        continue;
                    }
                    Step::Erase(sector)
                }
                Phase::Check(block) => Step::Check(block),
                Phase::Note(block) => Step::Note(block),
                Phase::CheckAll => Step::CheckAll,
                Phase::Stage => Step::Stage,
                Phase::Activate => Step::Activate,
            };
        }
    }

    /// The step that [`Self::next`] gave last was done, other than waiting and asking.
    ///
    /// # Errors
    /// Why the release is given up, which had to wait for that step.
    pub(crate) fn done(&mut self, now: Instant) -> Result<(), Refused> {
        self.failures = 0;
        self.phase = match self.phase {
            Phase::Keep { resumed: false } => Phase::Begin,
            Phase::Keep { resumed: true } | Phase::Begin => Phase::Erase(0),
            Phase::Erase(sector) => Phase::Erase(sector + 1),
            Phase::Check(block) => Phase::Note(block),
            Phase::Note(block) => {
                self.blocks = self.blocks.with(block);
                self.spoiled = 0;
                self.receive(now);
                return Ok(());
            }
            Phase::CheckAll => Phase::Stage,
            Phase::Stage => Phase::Activate,
            Phase::Withdraw => return FLASH_FAILED,
            same @ (Phase::Envelope
            | Phase::Receive(_)
            | Phase::Patch
            | Phase::Judge { .. }
            | Phase::Activate) => same,
        };
        Ok(())
    }

    /// The manifest is believed, and says this of the image.
    pub(crate) fn believed(&mut self, shape: Shape) {
        if let Phase::Judge { resumed } = self.phase {
            self.shape = shape;
            // One that has as many bytes as what it makes is of no use.
            self.patch = self.patch.filter(|bytes| (1..shape.size).contains(bytes));
            self.phase = Phase::Keep { resumed };
        }
    }

    /// Has the image come as it is.
    pub(crate) const fn ignore_patch(&mut self) {
        self.patch = None;
    }

    /// The step did not do what it was to do.
    ///
    /// # Errors
    /// Why the release is given up. Otherwise it is tried again.
    pub(crate) fn failed(&mut self, why: Failed) -> Result<(), Refused> {
        let refuse = |code, lasting| Err(Refused { code, lasting });
        match (why, self.phase) {
            (Failed::Refused(refused), _) => Err(refused),
            (Failed::Flash | Failed::NoWayBack, Phase::Activate) => {
                // Whatever came of it: the program that runs is the one that is proven, to begin with, and a
                // restart starts nothing that is refused.
                self.unactivated += 1;
                self.phase = if self.unactivated < FAILURES {
                    Phase::Keep { resumed: true }
                } else {
                    Phase::Withdraw
                };
                Ok(())
            }
            (Failed::Patch(why), _) => {
                self.give_patch_up(why);
                Ok(())
            }
            // What was to be written is not known any more.
            (Failed::Flash | Failed::NoWayBack, Phase::Patch) => {
                self.give_patch_up("flash_failed");
                Ok(())
            }
            (Failed::Content, Phase::Check(_)) if self.patch.is_some() => {
                self.give_patch_up("delta_mismatch");
                Ok(())
            }
            (Failed::Flash | Failed::NoWayBack, _) => {
                self.failures += 1;
                if self.failures < FAILURES {
                    Ok(())
                } else {
                    FLASH_FAILED
                }
            }
            (Failed::Content, Phase::Check(block)) => {
                self.spoiled += 1;
                if self.spoiled >= FAILURES {
                    return refuse("bad_block", false);
                }
                self.phase = Phase::Erase(u32::from(block) * (self.shape.block / SECTOR));
                Ok(())
            }
            // Each block is what was signed, or was when it was written. What the trailer says of them cannot be
            // taken back: begin anew, once.
            (Failed::Content, _) => {
                if self.begun_anew {
                    return refuse("bad_hash", true);
                }
                self.begun_anew = true;
                self.blocks = Blocks::default();
                self.phase = Phase::Judge { resumed: false };
                Ok(())
            }
        }
    }

    /// The envelope has come, if it is waited for. Whether it is.
    pub(crate) fn take_envelope(&mut self, index: u32) -> bool {
        if self.phase != Phase::Envelope || index != 0 {
            return false;
        }
        self.phase = Phase::Judge { resumed: false };
        true
    }

    /// Where a chunk of the image goes, in bytes from the start of the slot; `None` for one that is not waited for, or
    /// that has another length than its place.
    pub(crate) fn place(&self, index: u32, length: usize) -> Option<u32> {
        let wanted = matches!(self.phase, Phase::Receive(_))
            && self.want.indices().any(|wanted| wanted == index);
        let fits = chunk::length(self.shape.size, index) == Some(length);
        (wanted && fits).then(|| index * PAYLOAD as u32)
    }

    /// The chunk is in flash.
    pub(crate) fn written(&mut self, index: u32, now: Instant) {
        let Phase::Receive(block) = self.phase else {
            return;
        };
        if !self.want.take(self.want.tag, self.want.part, index) {
            return;
        }
        self.failures = 0;
        self.heard = now;
        self.patience = ASK_AFTER;
        self.ask_at = Some(now + self.patience);
        if self.want.missing == 0 {
            self.open(block, self.want.first + WINDOW);
        }
    }

    /// Whether a chunk of so many bytes is the next one of the patch.
    pub(crate) fn is_next_of_patch(&self, index: u32, length: usize) -> bool {
        self.phase == Phase::Patch
            && self.want.indices().next() == Some(index)
            && chunk::length(self.patch.unwrap_or(0), index) == Some(length)
    }

    /// The patch is read as far as that chunk, and has made so many bytes of the image, all of them in flash.
    pub(crate) fn patched(&mut self, index: u32, made: u32, now: Instant) {
        if self.phase != Phase::Patch || !self.want.take(self.want.tag, Part::Delta, index) {
            return;
        }
        self.made = made;
        self.patience = ASK_AFTER;
        self.ask_at = Some(now + self.patience);
        if self.want.missing == 0 {
            self.open_patch(self.want.first + WINDOW);
        }
        self.receive(now);
    }

    /// What was asked for may have been lost with the session: ask again at once.
    pub(crate) fn ask_again(&mut self) {
        self.ask_at = None;
        self.patience = ASK_AFTER;
    }

    /// Goes on with the first block that is not there.
    fn receive(&mut self, now: Instant) {
        self.heard = now;
        let missing = (0..self.shape.blocks()).find(|block| !self.blocks.has(*block));
        match missing {
            None => self.phase = Phase::CheckAll,
            Some(block) if self.patch.is_none() => {
                let first = u32::from(block) * (self.shape.block / PAYLOAD as u32);
                self.open(block, first);
            }
            Some(block) if self.made >= self.shape.end(block) => self.phase = Phase::Check(block),
            Some(_) => {
                self.phase = Phase::Patch;
                if self.want.part != Part::Delta {
                    self.open_patch(0);
                }
                if self.want.missing == 0 {
                    self.give_patch_up("delta_cut_off");
                }
            }
        }
    }

    /// Has the image come as it is: what is right of it stays, the rest is erased and received.
    fn give_patch_up(&mut self, why: &'static str) {
        self.patch = None;
        self.without_patch = Some(why);
        self.failures = 0;
        self.phase = Phase::Erase(0);
    }

    /// Opens the window of the patch that begins with this chunk.
    fn open_patch(&mut self, first: u32) {
        let count = chunk::count(self.patch.unwrap_or(0));
        self.want = Want::window(self.release.tag(), Part::Delta, first, count);
        self.ask_at = None;
        self.patience = ASK_AFTER;
    }

    /// Opens the window of a block that begins with this chunk; past its end the block is complete.
    fn open(&mut self, block: u8, first: u32) {
        let count = chunk::count(self.shape.end(block));
        self.want = Want::window(self.release.tag(), Part::Image, first, count);
        self.ask_at = None;
        self.patience = ASK_AFTER;
        self.phase = if self.want.missing == 0 {
            Phase::Check(block)
        } else {
            Phase::Receive(block)
        };
    }

    /// Up to a quarter of the present patience. Marsaglia's xorshift32.
    fn jitter(&mut self) -> Duration {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 17;
        self.random ^= self.random << 5;
        let most = self.patience.as_millis() as u32 / 4;
        Duration::from_millis(u64::from(self.random % most.max(1)))
    }
}
