//! The flash with both slots, as an update uses it.
//!
//! One function does everything there is to do to it: each place that waits for a flash takes code, and there are
//! few of them.

use crawler_boot::flash::{FlashError, Operation, SECTOR, WORD};
use crawler_boot::otadata::{Bootloader, Goal, Otadata, Slots as Count, Standing};
use crawler_boot::trailer::{Begin, ENVELOPE_AT, Record, Trailer};
use crawler_hal::{ModelRegion, SlotPort, SlotRegion};
use crawler_protocol::{BuildId, ModelName, ReleaseId};
use crawler_release::{BlockHasher, ENVELOPE_MAX, Kind, Manifest, Signed};

use embassy_futures::yield_now;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_storage_async::nor_flash::MultiwriteNorFlash;

use super::mailbox::Updates;
use super::patch::{PIECE, Patch};
use super::transfer::{Blocks, Failed, Shape};

/// Bytes that are read, hashed or written between two looks at whatever else there is to do: 16,896
/// instructions of SHA-256, a tenth of a millisecond.
const SLICE: usize = 256;

/// Pieces of a patch that are made before the robot is looked at again.
const AT_ONCE: usize = 32;

/// Which of the two slots.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Slot {
    /// The one whose program runs.
    Running,
    /// The other one.
    Spare,
}

/// One thing to do.
#[derive(Debug, Clone, Copy)]
pub(super) enum Work {
    /// Nothing.
    Rest,
    /// See what otadata says of the running program, and what is in the trailer of a slot; its envelope is copied to
    /// where chunks arrive.
    Look(Slot),
    /// Append to a trailer. Without a trailer, or with a worn one, the reason for giving up is lost and nothing else.
    Record(Slot, Record),
    /// Bring otadata there.
    Reach(Aim),
    /// Begin the spare trailer anew with the envelope of this length that lies where chunks arrive.
    Begin(usize),
    /// Erase a sector of the spare slot.
    Erase(u32),
    /// Write the chunk that waits, of this length, to there in the spare slot.
    Write(u32, usize),
    /// Write what comes next of the patch of which a chunk waits, of this length.
    Patch(usize),
    /// Hold a block of a slot against its hash, or all of it.
    Check(Slot, Option<u8>),
}

/// A goal for otadata.
#[derive(Debug, Clone, Copy)]
pub(super) enum Aim {
    Keep,
    Activate,
    Confirm,
    GiveUp,
}

/// What was looked at last.
#[derive(Debug, Clone, Copy)]
pub(super) struct Seen {
    pub(super) standing: Standing,
    /// What is to be in use next, of a model.
    pub(super) selected: u8,
    pub(super) trailer: Trailer,
    /// Length of the envelope that lies where chunks arrive.
    pub(super) envelope: Option<usize>,
}

/// What a release replaces.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Subject {
    /// The program, by the one in the other slot.
    Program,
    /// The model of the detector, by the one in the other place, or in either where the program runs its own.
    Eyes,
    /// The policy that a release has brought, in the same way.
    Policy,
}

impl Subject {
    /// Those that lie in places beside the program.
    pub(super) const MODELS: [Self; 2] = [Self::Eyes, Self::Policy];

    /// Which of [`Self::MODELS`] it is; `None` for the program.
    pub(super) const fn model(self) -> Option<usize> {
        match self {
            Self::Program => None,
            Self::Eyes => Some(0),
            Self::Policy => Some(1),
        }
    }

    /// The kind of its releases.
    pub(super) const fn kind(self) -> Kind {
        match self {
            Self::Program => Kind::Program,
            Self::Eyes => Kind::Model,
            Self::Policy => Kind::Policy,
        }
    }
}

/// Two regions of the flash, and the select entries between them.
#[derive(Debug, Clone, Copy)]
pub(super) struct Site {
    otadata: u32,
    regions: [SlotRegion; 2],
    /// The number of what is in use, as select entries count it.
    running: u8,
}

impl Site {
    fn is_usable(&self) -> bool {
        let fits = |region: &SlotRegion| {
            region.start.is_multiple_of(SECTOR)
                && region.length.is_multiple_of(SECTOR)
                && region.length >= 2 * SECTOR
                && region.start.checked_add(region.length).is_some()
        };
        self.running < 2 && self.otadata.is_multiple_of(SECTOR) && self.regions.iter().all(fits)
    }
}

/// The sites that a body has, one of which is meant: a body without models has no code to tell them apart.
pub(super) trait Sites {
    /// Has the site of `subject` meant from now on.
    fn turn_to(&mut self, subject: Subject);
    /// Whose site is meant.
    fn subject(&self) -> Subject;
    /// The site that is meant.
    fn site(&self) -> &Site;
    /// Whether all of them are what can be.
    fn are_usable(&self) -> bool;
}

/// The site of programs, where there is no other.
pub(super) struct OnlyPrograms(pub(super) Site);

impl Sites for OnlyPrograms {
    fn turn_to(&mut self, _: Subject) {}

    fn subject(&self) -> Subject {
        Subject::Program
    }

    fn site(&self) -> &Site {
        &self.0
    }

    fn are_usable(&self) -> bool {
        self.0.is_usable()
    }
}

/// The site of programs, and those of models, as far as there are any.
pub(super) struct ProgramsAndModels {
    programs: Site,
    models: [Option<Site>; Subject::MODELS.len()],
    subject: Subject,
}

impl ProgramsAndModels {
    /// Programs are meant; of models what the program was built with is in use.
    pub(super) fn new(
        programs: Site,
        models: [Option<ModelRegion>; Subject::MODELS.len()],
    ) -> Self {
        let site = |model: ModelRegion| Site {
            otadata: model.select,
            regions: model.places,
            running: 0,
        };
        Self {
            programs,
            models: models.map(|model| model.map(site)),
            subject: Subject::Program,
        }
    }

    fn meant(&self) -> Option<&Site> {
        self.models.get(self.subject.model()?)?.as_ref()
    }
}

impl Sites for ProgramsAndModels {
    fn turn_to(&mut self, subject: Subject) {
        self.subject = subject;
    }

    fn subject(&self) -> Subject {
        self.subject
    }

    fn site(&self) -> &Site {
        // Nobody turns to what is not there.
        self.meant().unwrap_or(&self.programs)
    }

    fn are_usable(&self) -> bool {
        let mut models = self.models.iter().flatten();
        self.programs.is_usable() && models.all(Site::is_usable)
    }
}

/// See the [module](self).
pub(super) struct Slots<F, S> {
    flash: F,
    chip: u16,
    sites: S,
    patch: Patch,
}

impl<F, S> Slots<F, S> {
    /// What a body says of its flash, with the sites that it has.
    pub(super) fn of(port: SlotPort<F>, sites: impl FnOnce(Site) -> S) -> Self {
        let programs = Site {
            otadata: port.otadata,
            regions: port.slots,
            running: port.running,
        };
        Self {
            flash: port.flash,
            chip: port.chip,
            sites: sites(programs),
            patch: Patch::NONE,
        }
    }
}

impl<F> Slots<F, ProgramsAndModels> {
    /// Has this number in use from now on, of the model that is meant.
    pub(super) fn use_model(&mut self, running: u8) {
        let meant = self.sites.subject.model();
        let site = meant.and_then(|model| self.sites.models.get_mut(model));
        if let Some(Some(site)) = site {
            site.running = running;
        }
    }
}

impl<F: MultiwriteNorFlash, S: Sites> Slots<F, S> {
    /// Itself, unless the body says what cannot be.
    pub(super) fn usable(self) -> Option<Self> {
        let usable = self.sites.are_usable()
            && WORD.is_multiple_of(F::WRITE_SIZE)
            && WORD.is_multiple_of(F::READ_SIZE);
        usable.then_some(self)
    }

    pub(super) const fn chip(&self) -> u16 {
        self.chip
    }

    /// Has the regions of `subject` meant from now on.
    pub(super) fn turn_to(&mut self, subject: Subject) {
        self.sites.turn_to(subject);
    }

    /// Whose regions are meant.
    pub(super) fn subject(&self) -> Subject {
        self.sites.subject()
    }

    /// What the select entries count: two slots; or what the program was built with, and two places.
    fn count(&self) -> Count {
        match self.subject() {
            Subject::Program => Count::TWO,
            Subject::Eyes | Subject::Policy => Count::THREE,
        }
    }

    /// The number of the first region.
    fn first(&self) -> u8 {
        match self.subject() {
            Subject::Program => 0,
            Subject::Eyes | Subject::Policy => 1,
        }
    }

    /// The number of what is in use, as select entries count it.
    pub(super) fn running(&self) -> u8 {
        self.sites.site().running
    }

    /// The number of the slot that is not in use.
    pub(super) fn spare(&self) -> u8 {
        let first = self.first();
        // While what the program was built with is in use, that is the first.
        first + u8::from(self.running() == first)
    }

    /// `None` of the slot in use while that is what the program was built with.
    fn region(&self, slot: Slot) -> Option<SlotRegion> {
        let number = match slot {
            Slot::Running => self.running(),
            Slot::Spare => self.spare(),
        };
        let [first, second] = self.sites.site().regions;
        let index = number.checked_sub(self.first())?;
        Some(if index == 0 { first } else { second })
    }

    /// Where a slot begins.
    fn start(&self, slot: Slot) -> u32 {
        self.region(slot).map_or(0, |region| region.start)
    }

    /// The flash, and where a slot begins in it.
    pub(super) fn start_of(&mut self, slot: Slot) -> Option<(&mut F, u32)> {
        let region = self.region(slot)?;
        Some((&mut self.flash, region.start))
    }

    /// Bytes that the spare slot has for an image.
    pub(super) fn capacity(&self) -> u32 {
        let spare = self.region(Slot::Spare);
        spare.map_or(0, |region| region.length - SECTOR)
    }

    /// Begins to make an image of that shape out of the program that runs.
    pub(super) fn begin_patch(&mut self, shape: Shape) {
        self.patch.begin(self.capacity(), shape);
    }

    /// Says which blocks are there: of these nothing is written.
    pub(super) const fn patch_around(&mut self, blocks: Blocks) {
        self.patch.there = blocks;
    }

    /// How much of the image the patch has made, once the chunk is used up.
    pub(super) fn patched(&self) -> Option<u32> {
        self.patch.made()
    }

    fn trailer_at(&self, slot: Slot) -> Option<u32> {
        let region = self.region(slot)?;
        Some(region.start + region.length - SECTOR)
    }

    fn goal(&self, aim: Aim) -> Goal {
        let running = self.running();
        match aim {
            Aim::Keep => Goal::Keep { running },
            Aim::Activate => Goal::Activate {
                slot: self.spare(),
                running,
            },
            Aim::Confirm => Goal::Confirm { running },
            Aim::GiveUp => Goal::GiveUp { running },
        }
    }

    /// Does one thing after the other, up to the first one that fails.
    pub(super) async fn run<M: RawMutex, const MODELS: usize>(
        &mut self,
        works: [Work; 2],
        place: &Updates<M, MODELS>,
    ) -> Result<Seen, Failed> {
        let mut seen = Seen {
            standing: Standing::Proven,
            selected: 0,
            trailer: Trailer::EMPTY,
            envelope: None,
        };
        let spare = self.start(Slot::Spare);
        for work in works {
            match work {
                Work::Rest => {}
                Work::Look(slot) => self.look(slot, place, &mut seen).await?,
                Work::Record(slot, record) => {
                    let Some(at) = self.trailer_at(slot) else {
                        continue;
                    };
                    let done = Trailer::record_async(&mut self.flash, at, record).await;
                    if done.is_err() && !matches!(record, Record::RolledBack(_)) {
                        return Err(Failed::Flash);
                    }
                }
                Work::Reach(aim) => {
                    let (goal, count) = (self.goal(aim), self.count());
                    let (at, flash) = (self.sites.site().otadata, &mut self.flash);
                    match Otadata::reach_async(flash, at, count, goal).await {
                        Ok(_) => {}
                        Err(FlashError::Refused(_)) => return Err(Failed::NoWayBack),
                        Err(FlashError::Flash(_) | FlashError::Worn) => return Err(Failed::Flash),
                    }
                }
                Work::Begin(length) => {
                    let at = self.trailer_at(Slot::Spare).unwrap_or(0);
                    let mut index = 0;
                    while let Some(operation) = operation(place, length, index) {
                        let done = operation.execute_async(&mut self.flash, at).await;
                        done.map_err(|_| Failed::Flash)?;
                        index += 1;
                    }
                    self.look(Slot::Spare, place, &mut seen).await?;
                    if seen.envelope != Some(length) || seen.trailer.blocks() > 0 {
                        return Err(Failed::Flash);
                    }
                }
                Work::Erase(sector) => {
                    let at = spare + sector * SECTOR;
                    let erased = self.flash.erase(at, at + SECTOR).await;
                    erased.map_err(|_| Failed::Flash)?;
                }
                Work::Write(at, length) => {
                    for done in (0..length).step_by(SLICE) {
                        // Whole words; what is left of the last one programs nothing.
                        let mut piece = [0xFF; SLICE];
                        let count = (length - done).min(SLICE);
                        let (bytes, _) = piece.split_at_mut(count);
                        place.copy_out(done, bytes);
                        let words = &piece[..count.next_multiple_of(WORD)];
                        let written = self.flash.write(spare + at + done as u32, words).await;
                        written.map_err(|_| Failed::Flash)?;
                    }
                }
                Work::Patch(length) => {
                    let running = self.start(Slot::Running);
                    for _ in 0..AT_ONCE {
                        let Some(made) = self.patch.next(place, length)? else {
                            break;
                        };
                        if let Some(from) = made.old {
                            let mut old = [0; PIECE + 2 * WORD];
                            let lead = from as usize % WORD;
                            let words = (lead + made.length).next_multiple_of(WORD);
                            let at = running + from - lead as u32;
                            let read = self.flash.read(at, &mut old[..words]).await;
                            read.map_err(|_| Failed::Flash)?;
                            self.patch.add(&made, &old[lead..]);
                        }
                        if let Some((at, words)) = self.patch.full(&made) {
                            let written = self.flash.write(spare + at, words).await;
                            written.map_err(|_| Failed::Flash)?;
                        }
                        yield_now().await;
                    }
                }
                Work::Check(slot, block) => {
                    self.look(slot, place, &mut seen).await?;
                    let hasher = hasher(place, seen.envelope, block);
                    let (mut hasher, at) = hasher.ok_or(Failed::Flash)?;
                    let mut at = at + self.start(slot);
                    while hasher.left() > 0 {
                        let mut piece = [0; SLICE];
                        let read = self.flash.read(at, &mut piece).await;
                        read.map_err(|_| Failed::Flash)?;
                        let count = (hasher.left() as usize).min(SLICE);
                        // No more than are left of it.
                        let _ = hasher.update(&piece[..count]);
                        at += SLICE as u32;
                        yield_now().await;
                    }
                    hasher.finish().map_err(|_| Failed::Content)?;
                }
            }
        }
        Ok(seen)
    }

    async fn look<M: RawMutex, const MODELS: usize>(
        &mut self,
        slot: Slot,
        place: &Updates<M, MODELS>,
        seen: &mut Seen,
    ) -> Result<(), Failed> {
        let count = self.count();
        let (at, flash) = (self.trailer_at(slot), &mut self.flash);
        let otadata = Otadata::read_async(flash, self.sites.site().otadata, count).await;
        let otadata = otadata.map_err(|_| Failed::Flash)?;
        seen.standing = otadata.standing(self.sites.site().running);
        if self.sites.subject() != Subject::Program {
            seen.selected = otadata.select(Bootloader::Plain).slot.unwrap_or(0);
        }
        let Some(at) = at else {
            (seen.trailer, seen.envelope) = (Trailer::EMPTY, None);
            return Ok(());
        };
        let trailer = Trailer::read_async(flash, at).await;
        seen.trailer = trailer.map_err(|_| Failed::Flash)?;
        seen.envelope = seen.trailer.envelope().map(usize::from);
        for offset in (0..ENVELOPE_MAX).step_by(SLICE) {
            let mut piece = [0; SLICE];
            let read = flash
                .read(at + ENVELOPE_AT + offset as u32, &mut piece)
                .await;
            read.map_err(|_| Failed::Flash)?;
            place.copy_in(offset, &piece);
        }
        Ok(())
    }
}

/// One operation on the way to a trailer with the envelope that lies where chunks arrive. The envelope is on the stack
/// meanwhile, and not in the future of whoever waits for the flash.
#[inline(never)]
fn operation<M: RawMutex, const MODELS: usize>(
    place: &Updates<M, MODELS>,
    length: usize,
    index: usize,
) -> Option<Operation> {
    let mut envelope = [0; ENVELOPE_MAX];
    place.copy_out(0, &mut envelope);
    Begin::new(envelope.get(..length)?).ok()?.nth(index)
}

/// What the envelope says that lies where chunks arrive, without asking who signed it: for one that was believed before
/// it was written into a trailer.
fn unverified(
    envelope: &[u8; ENVELOPE_MAX],
    length: Option<usize>,
) -> Option<(Manifest<'_>, ReleaseId)> {
    let signed = Signed::parse(envelope.get(..length?)?).ok()?;
    Some((signed.unverified().ok()?, ReleaseId::new(signed.id())))
}

/// The hasher of a block, or of all, and where that begins.
#[inline(never)]
fn hasher<M: RawMutex, const MODELS: usize>(
    place: &Updates<M, MODELS>,
    length: Option<usize>,
    block: Option<u8>,
) -> Option<(BlockHasher, u32)> {
    let mut envelope = [0; ENVELOPE_MAX];
    place.copy_out(0, &mut envelope);
    let (manifest, _) = unverified(&envelope, length)?;
    Some(match block {
        Some(block) => {
            let at = u32::from(block) * manifest.block_size;
            (BlockHasher::new(&manifest, block.into())?, at)
        }
        None => (BlockHasher::whole(&manifest), 0),
    })
}

/// What a manifest says.
#[derive(Debug, Clone, Copy)]
pub(super) struct Known {
    pub(super) release: ReleaseId,
    pub(super) sequence: u32,
    pub(super) floor: u32,
    pub(super) shape: Shape,
    pub(super) kind: Kind,
    /// It is of a program of this build.
    pub(super) is_ours: bool,
}

/// What the envelope says that was looked at.
#[inline(never)]
pub(super) fn known<M: RawMutex, const MODELS: usize>(
    place: &Updates<M, MODELS>,
    length: Option<usize>,
) -> Option<Known> {
    let mut envelope = [0; ENVELOPE_MAX];
    place.copy_out(0, &mut envelope);
    let (manifest, release) = unverified(&envelope, length)?;
    let build = place.identity().build.as_str();
    Some(Known {
        release,
        sequence: manifest.sequence,
        floor: manifest.floor,
        shape: Shape::of(&manifest),
        kind: manifest.kind,
        is_ours: manifest.kind == Kind::Program && manifest.build == build,
    })
}

/// What the model is called whose envelope was looked at, and what names its contents.
#[inline(never)]
pub(super) fn model_of<M: RawMutex, const MODELS: usize>(
    place: &Updates<M, MODELS>,
    length: Option<usize>,
) -> Option<(ModelName, BuildId)> {
    let mut envelope = [0; ENVELOPE_MAX];
    place.copy_out(0, &mut envelope);
    let (manifest, _) = unverified(&envelope, length)?;
    let name = ModelName::new(manifest.name?).ok()?;
    Some((name, BuildId::new(manifest.build).ok()?))
}

// Blocks begin where sectors do, and slices end where they do.
const _: () = assert!(crawler_release::BLOCK_SIZES[0].is_multiple_of(SECTOR));
const _: () = assert!((SECTOR as usize).is_multiple_of(SLICE));
