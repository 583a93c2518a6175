//! What happens before a program starts: which slot it is started from, and whether a program on trial is
//! given up.
//!
//! A robot leaves the factory with slot 0 holding the program that this simulator is compiled with, and with
//! nothing written in its flash. Every other image is a bundle.

use std::rc::Rc;

use crawler_boot::flash::{FlashError as Failure, SECTOR};
use crawler_boot::guard::{Decision, decide};
use crawler_boot::otadata::{Bootloader, Goal, Otadata, Slots};
use crawler_boot::trailer::{Record, Trailer};
use crawler_bundle::{Bundle, Defect, DefectKind, Digest, HEADER_MAX, Header, SIZE_MAX, decode};
use crawler_hal::{ResetCause, SlotRegion};
use embedded_storage::nor_flash::ReadNorFlash as _;

use super::flash::BootFlash;
use super::{Chip, FlashError, OTADATA_AT, SLOTS, WRITE_BYTES};
use crate::faults::RangerFault;
use crate::world::{Purpose, RobotIndex, stream, uniform};

const _: () = assert!(SIZE_MAX + SECTOR == SLOTS[0].length);

/// Starts until one succeeds. Giving up takes one, and a cut of the power can come but once.
const STARTS: usize = 8;

/// What was started.
#[derive(Debug, Clone)]
pub struct Started {
    /// The slot of the program.
    pub running: u8,
    /// What its image says; `None` for the program from the factory.
    pub bundle: Option<Rc<Bundle>>,
    /// What is wrong with it, at this robot.
    pub defects: Vec<Defect>,
    /// Why it was started, as the program is told.
    pub cause: ResetCause,
}

/// Whose robot it is, which decides what defects show.
#[derive(Debug, Clone, Copy)]
pub(super) struct DefectDraw {
    pub(super) seed: u64,
    pub(super) robot: RobotIndex,
}

/// An image that can be started.
enum Image {
    Factory,
    Bundle(Bundle),
}

enum Attempt {
    Started(u8, Image),
    /// The program was given up: the controller restarts.
    GivenUp,
    /// There is nothing to start.
    Nothing,
}

/// Starts a program; `None` when there is none left to start, which is what no update may bring about.
///
/// It takes no time. A cut of the power on the way is one more start.
pub(super) fn start(chip: &mut Chip, cause: ResetCause, draw: DefectDraw) -> Option<Started> {
    let mut cause = cause;
    if chip.has_unused_slots() {
        return Some(Started::new(0, Image::Factory, cause, draw));
    }
    for _ in 0..STARTS {
        match attempt(&mut BootFlash(chip), cause) {
            Ok(Attempt::Started(running, image)) => {
                return Some(Started::new(running, image, cause, draw));
            }
            Ok(Attempt::GivenUp) => cause = ResetCause::Software,
            Ok(Attempt::Nothing) => return None,
            Err(_) => {
                chip.restore_power();
                cause = ResetCause::BrownOut;
            }
        }
    }
    None
}

impl Started {
    fn new(running: u8, image: Image, cause: ResetCause, draw: DefectDraw) -> Self {
        let bundle = match image {
            Image::Factory => None,
            Image::Bundle(bundle) => Some(Rc::new(bundle)),
        };
        Self {
            running,
            defects: bundle
                .as_ref()
                .map_or_else(Vec::new, |bundle| shown(bundle, draw)),
            bundle,
            cause,
        }
    }
}

impl Started {
    /// What the program makes of the ranger, worse than it is.
    pub(super) fn ranger_defect(&self) -> Option<RangerFault> {
        self.defects.iter().find_map(|defect| match defect.kind {
            DefectKind::RangerDead => Some(RangerFault::Dead),
            DefectKind::RangerNoisy => {
                let mm = u16::try_from(defect.value).unwrap_or(u16::MAX);
                Some(RangerFault::Noisy(mm))
            }
            DefectKind::Panic
            | DefectKind::Hang
            | DefectKind::Restart
            | DefectKind::NeverLink
            | DefectKind::MissControl => None,
        })
    }

    /// Whether the program has this defect, at this robot.
    pub(crate) fn has(&self, kind: DefectKind) -> bool {
        self.defects.iter().any(|defect| defect.kind == kind)
    }
}

/// The defects of a program that show at this robot.
pub(super) fn shown(bundle: &Bundle, draw: DefectDraw) -> Vec<Defect> {
    let mut build = Digest::new();
    build.update(bundle.build.as_bytes());
    let seed = draw.seed ^ u64::from_le_bytes(build.finish());
    let mut rng = stream(seed, draw.robot.get(), Purpose::Defects);
    let defects = bundle.defects.iter().copied();
    defects
        .filter(|defect| uniform(&mut rng) * 100.0 < f32::from(defect.percent))
        .collect()
}

/// One start: boot stage, and the first lines of `main`.
fn attempt(flash: &mut BootFlash<'_>, cause: ResetCause) -> Result<Attempt, FlashError> {
    let otadata = Otadata::read(flash, OTADATA_AT, Slots::TWO)?;
    let mut found = None;
    for slot in otadata.select(Bootloader::Plain).tries(Slots::TWO) {
        if let Some(image) = image(flash, slot)? {
            found = Some((slot, image));
            break;
        }
    }
    let Some((running, image)) = found else {
        return Ok(Attempt::Nothing);
    };
    let recorded = Trailer::read(flash, journal(running))?.rolled_back();
    match decide(cause, otadata.standing(running), recorded) {
        Decision::Confirmed => {}
        Decision::Returned(reason) => {
            let other = journal(1 - running);
            is_done(&Trailer::record(flash, other, Record::RolledBack(reason)))?;
            let goal = Goal::Keep { running };
            is_done(&Otadata::reach(flash, OTADATA_AT, Slots::TWO, goal))?;
        }
        Decision::Run(counter) => {
            if let Some(operation) = otadata.count(running, counter) {
                operation.execute(flash, OTADATA_AT)?;
            }
        }
        Decision::RollBack(reason) => {
            let own = journal(running);
            is_done(&Trailer::record(flash, own, Record::RolledBack(reason)))?;
            let goal = Goal::GiveUp { running };
            if is_done(&Otadata::reach(flash, OTADATA_AT, Slots::TWO, goal))? {
                return Ok(Attempt::GivenUp);
            }
        }
    }
    Ok(Attempt::Started(running, image))
}

/// Whether something was done. What cannot be recorded keeps no program from running.
fn is_done<T, R>(done: &Result<T, Failure<FlashError, R>>) -> Result<bool, FlashError> {
    match done {
        Ok(_) => Ok(true),
        Err(Failure::Flash(error)) => Err(*error),
        Err(Failure::Refused(_) | Failure::Worn) => Ok(false),
    }
}

/// Where the journal of a slot is.
pub(super) fn journal(slot: u8) -> u32 {
    let SlotRegion { start, length } = SLOTS[usize::from(slot)];
    start + length - SECTOR
}

/// The image of a slot, if there is a whole one in it.
fn image(flash: &mut BootFlash<'_>, slot: u8) -> Result<Option<Image>, FlashError> {
    let region = SLOTS[usize::from(slot)];
    if slot == 0 && flash.0.is_untouched(region) {
        return Ok(Some(Image::Factory));
    }
    let mut front = [0; HEADER_MAX];
    flash.read(region.start, &mut front)?;
    let Ok(Header { size, .. }) = Header::decode(&front) else {
        return Ok(None);
    };
    let size = size as usize;
    // Whole words are read, of which the last may be in part behind the image.
    let mut image = vec![0; size.next_multiple_of(WRITE_BYTES)];
    flash.read(region.start, &mut image)?;
    Ok(decode(&image[..size]).ok().map(Image::Bundle))
}

/// Puts a bundle of so many bytes into slot 1 of a robot from the factory, as an update does, and has it
/// started next.
#[cfg(test)]
pub(crate) fn install(chip: &mut Chip, bundle: &Bundle, size: u32, seed: u64) {
    use crawler_boot::trial::Sensors;
    use embedded_storage::nor_flash::NorFlash as _;

    let image = bundle.image(size, seed).expect("a bundle");
    let flash = &mut BootFlash(chip);
    let reach = |flash: &mut BootFlash<'_>, goal| {
        Otadata::reach(flash, OTADATA_AT, Slots::TWO, goal).expect("a way to the goal");
    };
    reach(flash, Goal::Keep { running: 0 });
    Trailer::begin(flash, journal(1), b"signed manifest").expect("room");
    let words = image.len().next_multiple_of(WRITE_BYTES);
    let padded: Vec<u8> = image
        .into_iter()
        .chain([0xFF; WRITE_BYTES])
        .take(words)
        .collect();
    flash.write(SLOTS[1].start, &padded).expect("blank");
    for record in [Record::Staged(Sensors::NONE), Record::Activated] {
        Trailer::record(flash, journal(1), record).expect("room");
    }
    reach(
        flash,
        Goal::Activate {
            slot: 1,
            running: 0,
        },
    );
}
