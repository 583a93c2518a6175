//! The next operation on the way to a goal.
//!
//! Each step is computed from what is in flash, so a power cut needs no care of its own: whoever looks
//! again goes on from there. What makes every point between safe:
//!
//! - The entry that proves the running program is never erased or changed while it is the only one.
//! - An entry is written sequence number first, CRC last, a word at a time. Until the last bit of the CRC
//!   has fallen it does not fit the sequence number, whichever other bits have, and no bootloader goes by
//!   the entry. (With the CRC still blank it would fit sequence number 0 alone, which is never written.)
//! - A decision clears bits of the state, and nothing else: `UNDEFINED` to `VALID`, `UNDEFINED` to
//!   `ABORTED`. A torn one is neither, and the next start decides again; if all bits but one have fallen it
//!   may read `INVALID`, and the program before is started.
//! - An entry on trial is given up before its sector is erased. Bits that rise while it is erased make
//!   no `VALID` of `ABORTED`, so nothing unproven becomes proven in a torn erase; an entry that comes back as
//!   one on trial leads to the slot of the image that is about to be tried. An entry whose sequence
//!   number was changed by a torn erase is held off by its CRC: by chance, 1 in 2³².

use super::{Counter, Entry, ImageState, Otadata, at};
use crate::flash::{Operation, SECTOR, WORD};

/// What the entries are to say.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Goal {
    /// The program of `slot` starts next, on trial, and that of `running` if it fails. The image of
    /// `slot` is complete and verified.
    Activate {
        /// The slot to start.
        slot: u8,
        /// The slot that runs.
        running: u8,
    },
    /// The running program has proven itself.
    Confirm {
        /// The slot that runs.
        running: u8,
    },
    /// The running program, on trial, is not started again; the one before is.
    GiveUp {
        /// The slot that runs.
        running: u8,
    },
    /// The running program, proven, is the one that starts, and otadata says so: after
    /// [`super::Standing::Returned`], and before the spare slot is erased. Without an entry a bootloader
    /// starts the first image that is intact, which would be that of an update as soon as it is complete.
    Keep {
        /// The slot that runs.
        running: u8,
    },
}

/// Why there is no way to a goal. Nothing is to be written then.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlanError {
    /// There is no such slot, or it is the one that runs: a mistake of the caller.
    Slot,
    /// The running program is on trial: settle that first.
    OnTrial,
    /// The running program is proven, so it is not given up: activate another one.
    Proven,
    /// There is nothing else to start.
    NoWayBack,
    /// The sequence numbers are used up, which takes a foreign entry: flash the board anew.
    Exhausted,
}

impl Otadata {
    /// The next operation on the way to `goal`; `None` when it is reached. Do it, read the entries again,
    /// and ask again.
    ///
    /// # Errors
    /// See [`PlanError`].
    // Once in flash, not at each of its callers.
    #[inline(never)]
    pub fn toward(&self, goal: Goal) -> Result<Option<Operation>, PlanError> {
        let (Goal::Activate { running, .. }
        | Goal::Confirm { running }
        | Goal::GiveUp { running }
        | Goal::Keep { running }) = goal;
        if running >= self.slots.count() {
            return Err(PlanError::Slot);
        }
        match goal {
            Goal::Activate { slot, .. } => self.activate(slot, running),
            Goal::Confirm { .. } => self.confirm(running),
            Goal::GiveUp { .. } => self.give_up(running),
            Goal::Keep { .. } => self.keep(running),
        }
    }

    /// Counts a start of the program on trial in the slot `running`; `None` when it is not on trial, or
    /// when the count is full.
    #[must_use]
    pub fn count(&self, running: u8, counter: Counter) -> Option<Operation> {
        let index = self.active()?;
        let entry = self.entries.get(index)?;
        let counted = entry.word(counter.at());
        let free =
            entry.state() != ImageState::Valid && self.slot_of(entry) == running && counted != 0;
        // The lowest bit that is set falls.
        free.then(|| program(index, counter.at(), counted & (counted - 1)))
    }

    fn activate(&self, slot: u8, running: u8) -> Result<Option<Operation>, PlanError> {
        if slot == running || slot >= self.slots.count() {
            return Err(PlanError::Slot);
        }
        let Some((index, active, other)) = self.indexed() else {
            return self.keep(running);
        };
        if self.proves(active, running) {
            let sequence = self.slots.sequence(active.sequence(), slot);
            let next = Entry::new(sequence.ok_or(PlanError::Exhausted)?, ImageState::Undefined);
            return Ok(self.write(1 - index, &next));
        }
        let activated = self.slot_of(active) == slot && active.is_fresh();
        if activated && self.proves(other, running) {
            return Ok(None);
        }
        self.keep(running)
    }

    fn confirm(&self, running: u8) -> Result<Option<Operation>, PlanError> {
        match self.indexed() {
            Some((index, active, _)) if self.slot_of(active) == running => {
                let valid = ImageState::Valid.word();
                match active.word(at::STATE) {
                    state if state == valid => Ok(None),
                    state if state & valid == valid => Ok(Some(program(index, at::STATE, valid))),
                    // Bits have fallen that cannot rise: a new entry in the place of the way back.
                    _ => self.adopt(1 - index, active.sequence(), running),
                }
            }
            _ => self.keep(running),
        }
    }

    fn give_up(&self, running: u8) -> Result<Option<Operation>, PlanError> {
        let Some((index, active, other)) = self.indexed() else {
            return Ok(None);
        };
        if self.slot_of(active) != running {
            return Ok(None);
        }
        if active.state() == ImageState::Valid {
            return Err(PlanError::Proven);
        }
        if !other.is_usable() || self.slot_of(other) == running {
            return Err(PlanError::NoWayBack);
        }
        Ok(Some(refuse(index, active)))
    }

    fn keep(&self, running: u8) -> Result<Option<Operation>, PlanError> {
        let Some((index, active, other)) = self.indexed() else {
            // Nothing counts: the first sector that can be written without an erase.
            let entry = Entry::new(self.sequence(0, running)?, ImageState::Valid);
            let index = usize::from(!self.takes(0, &entry) && self.takes(1, &entry));
            return Ok(self.write(index, &entry));
        };
        if self.proves(active, running) {
            Ok(None)
        } else if self.slot_of(active) == running {
            Err(PlanError::OnTrial)
        } else if self.proves(other, running) {
            Ok(Some(refuse(index, active)))
        } else {
            self.adopt(1 - index, active.sequence(), running)
        }
    }

    /// Writes that the slot `running` is proven, with a sequence number beyond `after`.
    fn adopt(&self, index: usize, after: u32, running: u8) -> Result<Option<Operation>, PlanError> {
        let entry = Entry::new(self.sequence(after, running)?, ImageState::Valid);
        Ok(self.write(index, &entry))
    }

    fn sequence(&self, after: u32, slot: u8) -> Result<u32, PlanError> {
        self.slots.sequence(after, slot).ok_or(PlanError::Exhausted)
    }

    /// The active entry with its index, and the other one.
    fn indexed(&self) -> Option<(usize, &Entry, &Entry)> {
        let (active, other) = self.active_and_other()?;
        Some((self.active()?, active, other))
    }

    /// Whether this sector takes `entry` without being erased: only bits that are to fall have fallen, and
    /// in the order of [`Otadata::write`].
    fn takes(&self, index: usize, entry: &Entry) -> bool {
        let Some(present) = self.entries.get(index) else {
            return false;
        };
        let falls = present
            .0
            .iter()
            .zip(&entry.0)
            .all(|(now, then)| now & then == *then);
        let mut later = ORDER
            .iter()
            .skip_while(|&&at| present.word(at) == entry.word(at))
            .skip(1);
        falls && later.all(|&at| present.word(at) == u32::MAX || present.word(at) == entry.word(at))
    }

    /// The next step of writing `entry` into a sector that no bootloader goes by.
    fn write(&self, index: usize, entry: &Entry) -> Option<Operation> {
        if !self.takes(index, entry) {
            let present = self.entries.get(index)?;
            let on_trial = present.is_usable() && present.state() != ImageState::Valid;
            return Some(if on_trial {
                refuse(index, present)
            } else {
                Operation::Erase {
                    at: address(index, 0),
                }
            });
        }
        let present = self.entries.get(index)?;
        let at = ORDER
            .iter()
            .find(|&&at| present.word(at) != entry.word(at))?;
        Some(program(index, *at, entry.word(*at)))
    }
}

/// The order in which the words of an entry are written.
const ORDER: [usize; 3] = [at::SEQUENCE, at::STATE, at::CRC];

/// Makes an entry unusable: as `ABORTED` where its state allows it, otherwise by its CRC.
fn refuse(index: usize, entry: &Entry) -> Operation {
    let aborted = ImageState::Aborted.word();
    if entry.word(at::STATE) & aborted == aborted {
        program(index, at::STATE, aborted)
    } else if entry.word(at::CRC) != 0 {
        program(index, at::CRC, 0)
    } else {
        // The one sequence number whose CRC is 0.
        program(index, at::SEQUENCE, 0)
    }
}

fn program(index: usize, at: usize, word: u32) -> Operation {
    Operation::word(address(index, at), word)
}

const fn address(index: usize, at: usize) -> u32 {
    index as u32 * SECTOR + (at * WORD) as u32
}
