//! The two select entries of Espressif's otadata partition, and what a bootloader makes of them.
//!
//! Layout and decision are those of ESP-IDF (`esp_flash_partitions.h`, `bootloader_common_loader.c` and
//! `bootloader_utility.c`, release/v6.1), without a factory partition and without the anti-rollback by
//! eFuses: our partition tables have neither. `tests/boot/selection.rs` holds it against answers of a shipped
//! bootloader.

mod plan;
mod store;

use crate::crc::crc32_le;
use crate::flash::{SECTOR, WORD};

pub use plan::{Goal, PlanError};

/// Bytes of the partition that count: a sector for each entry.
pub const OTADATA_BYTES: u32 = 2 * SECTOR;

/// How many slots there are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Slots(u8);

impl Slots {
    /// Two slots, as in the partition tables of our boards.
    pub const TWO: Self = Self(2);
    /// What a program was built with, and the two places for what an update brings in its stead: of a model.
    pub const THREE: Self = Self(3);

    /// So many slots, 1 to 16; `None` for any other number.
    #[must_use]
    pub const fn new(count: u8) -> Option<Self> {
        match count {
            1..=16 => Some(Self(count)),
            _ => None,
        }
    }

    /// How many.
    #[must_use]
    pub const fn count(self) -> u8 {
        self.0
    }

    /// The slot that a sequence number stands for.
    const fn of_sequence(self, sequence: u32) -> u8 {
        (sequence.wrapping_sub(1) % self.0 as u32) as u8
    }

    /// The smallest sequence number beyond `after` that stands for `slot`.
    fn sequence(self, after: u32, slot: u8) -> Option<u32> {
        (1..=u32::from(self.0))
            .filter_map(|step| after.checked_add(step))
            .find(|&next| next != u32::MAX && self.of_sequence(next) == slot)
    }
}

/// `esp_ota_img_states_t` of ESP-IDF.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ImageState {
    /// 0: to be tried, by a bootloader with rollback.
    New,
    /// 1: being tried, by a bootloader with rollback.
    PendingVerify,
    /// 2: proven.
    Valid,
    /// 3: proven not to work.
    Invalid,
    /// 4: given up.
    Aborted,
    /// `0xFFFF_FFFF`: started like a proven one; with us: on trial.
    Undefined,
    /// No state of ESP-IDF, as a power cut leaves it. A bootloader starts it.
    Other(u32),
}

impl ImageState {
    /// The state of a word of flash.
    #[must_use]
    pub const fn from_word(word: u32) -> Self {
        match word {
            0 => Self::New,
            1 => Self::PendingVerify,
            2 => Self::Valid,
            3 => Self::Invalid,
            4 => Self::Aborted,
            u32::MAX => Self::Undefined,
            other => Self::Other(other),
        }
    }

    /// The word of flash.
    #[must_use]
    pub const fn word(self) -> u32 {
        match self {
            Self::New => 0,
            Self::PendingVerify => 1,
            Self::Valid => 2,
            Self::Invalid => 3,
            Self::Aborted => 4,
            Self::Undefined => u32::MAX,
            Self::Other(word) => word,
        }
    }
}

/// Where the words of an entry are, counted in words.
mod at {
    pub(super) const SEQUENCE: usize = 0;
    /// First word of `seq_label`, which no bootloader reads: a cleared bit for each attempt.
    pub(super) const ATTEMPTS: usize = 1;
    /// Second word of `seq_label`: a cleared bit for each restart that the program asked for.
    pub(super) const RESTARTS: usize = 2;
    pub(super) const STATE: usize = 6;
    pub(super) const CRC: usize = 7;
}

/// What is counted of the starts of a program on trial.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Counter {
    /// Starts after something went wrong.
    Attempts,
    /// Starts that the program itself asked for.
    Restarts,
}

/// Words of an entry.
const WORDS: usize = Entry::BYTES / WORD;

/// A select entry: `esp_ota_select_entry_t`, any 32 bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Entry([u32; WORDS]);

impl Entry {
    /// Bytes of an entry.
    pub const BYTES: usize = 32;
    /// The entry of an erased sector.
    pub const ERASED: Self = Self([u32::MAX; WORDS]);

    /// These bytes of flash.
    #[must_use]
    pub fn from_bytes(bytes: [u8; Self::BYTES]) -> Self {
        let mut entry = Self::ERASED;
        let (words, _) = bytes.as_chunks::<WORD>();
        for (kept, word) in entry.0.iter_mut().zip(words) {
            *kept = u32::from_le_bytes(*word);
        }
        entry
    }

    /// The bytes of flash.
    #[must_use]
    pub fn to_bytes(self) -> [u8; Self::BYTES] {
        let mut bytes = [0; Self::BYTES];
        for (kept, word) in bytes.as_chunks_mut::<WORD>().0.iter_mut().zip(self.0) {
            *kept = word.to_le_bytes();
        }
        bytes
    }

    /// An entry with this sequence number and state, and a CRC that fits.
    #[must_use]
    pub const fn new(sequence: u32, state: ImageState) -> Self {
        let mut entry = Self::ERASED;
        entry.0[at::SEQUENCE] = sequence;
        entry.0[at::STATE] = state.word();
        entry.0[at::CRC] = crc_of(sequence);
        entry
    }

    const fn word(&self, at: usize) -> u32 {
        self.0[at]
    }

    /// The sequence number: of two entries, the larger one counts.
    #[must_use]
    pub const fn sequence(&self) -> u32 {
        self.word(at::SEQUENCE)
    }

    /// What is known of the slot.
    #[must_use]
    pub const fn state(&self) -> ImageState {
        ImageState::from_word(self.word(at::STATE))
    }

    /// Whether the CRC is that of the sequence number. It covers nothing else, so the state may change.
    #[must_use]
    pub const fn is_intact(&self) -> bool {
        self.word(at::CRC) == crc_of(self.sequence())
    }

    /// Blank, or marked as not to be started (`bootloader_common_ota_select_invalid`).
    #[must_use]
    pub const fn is_refused(&self) -> bool {
        self.sequence() == u32::MAX
            || matches!(self.state(), ImageState::Invalid | ImageState::Aborted)
    }

    /// Whether a bootloader may go by it (`bootloader_common_ota_select_valid`).
    #[must_use]
    pub const fn is_usable(&self) -> bool {
        !self.is_refused() && self.is_intact()
    }

    /// How often this was counted.
    #[must_use]
    pub const fn count(&self, counter: Counter) -> u32 {
        self.word(counter.at()).count_zeros()
    }

    /// Nothing was counted and nothing decided since it was written.
    const fn is_fresh(&self) -> bool {
        let mut at = at::ATTEMPTS;
        while at < at::CRC {
            if self.word(at) != u32::MAX {
                return false;
            }
            at += 1;
        }
        self.is_usable()
    }
}

impl Counter {
    const fn at(self) -> usize {
        match self {
            Self::Attempts => at::ATTEMPTS,
            Self::Restarts => at::RESTARTS,
        }
    }
}

const fn crc_of(sequence: u32) -> u32 {
    crc32_le(u32::MAX, &sequence.to_le_bytes())
}

/// Which kind of bootloader decides.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Bootloader {
    /// Without `CONFIG_BOOTLOADER_APP_ROLLBACK_ENABLE`: as espflash ships them, and the boot stage of the
    /// emulated board.
    Plain,
    /// With it: starts a `NEW` image once, and gives it up when it is still `PENDING_VERIFY` then.
    RollsBack,
}

/// What a bootloader decides.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Selection {
    /// The entry that it goes by, 0 or 1; `None` when it goes by none.
    pub entry: Option<usize>,
    /// The slot that it tries first; `None` when all are equal to it.
    pub slot: Option<u8>,
    /// States that it writes into the entries before the program starts. It erases the sector first.
    pub writes: [Option<ImageState>; 2],
    /// Neither entry was ever written: it writes a `VALID` one for the slot that it starts into the first
    /// sector.
    pub initial: bool,
}

impl Selection {
    /// The slots in the order in which they are tried until one holds an intact image: from the selected
    /// one down, then up.
    pub fn tries(&self, slots: Slots) -> impl Iterator<Item = u8> + use<> {
        let count = slots.count();
        let below = self
            .slot
            .map_or(0, |slot| slot.saturating_add(1))
            .min(count);
        (0..below).rev().chain(below..count)
    }
}

/// Both entries, as they are in flash.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Otadata {
    entries: [Entry; 2],
    slots: Slots,
}

impl Otadata {
    /// The entries of the first and of the second sector.
    #[must_use]
    pub const fn new(entries: [Entry; 2], slots: Slots) -> Self {
        Self { entries, slots }
    }

    /// The entries.
    #[must_use]
    pub const fn entries(&self) -> &[Entry; 2] {
        &self.entries
    }

    /// How many slots there are.
    #[must_use]
    pub const fn slots(&self) -> Slots {
        self.slots
    }

    /// What a bootloader decides (`bootloader_utility_get_selected_boot_partition`).
    #[must_use]
    pub fn select(&self, bootloader: Bootloader) -> Selection {
        let mut present = *self;
        let mut writes = [None; 2];
        if bootloader == Bootloader::RollsBack {
            for (entry, write) in present.entries.iter_mut().zip(&mut writes) {
                if entry.state() == ImageState::PendingVerify {
                    entry.0[at::STATE] = ImageState::Aborted.word();
                    *write = Some(ImageState::Aborted);
                }
            }
        }
        let [first, second] = &present.entries;
        if first.is_refused() && second.is_refused() {
            let unwritten = |entry: &Entry| entry.sequence() == u32::MAX || !entry.is_intact();
            return Selection {
                entry: None,
                slot: Some(0),
                writes,
                initial: unwritten(first) && unwritten(second),
            };
        }
        let entry = present.active();
        let chosen =
            entry.and_then(|index| Some((present.entries.get(index)?, writes.get_mut(index)?)));
        let slot = chosen.map(|(entry, write)| {
            if bootloader == Bootloader::RollsBack && entry.state() == ImageState::New {
                *write = Some(ImageState::PendingVerify);
            }
            self.slots.of_sequence(entry.sequence())
        });
        Selection {
            entry,
            slot,
            writes,
            initial: false,
        }
    }

    /// The entry that counts: usable, and with the larger sequence number.
    fn active(&self) -> Option<usize> {
        let [first, second] = &self.entries;
        match (first.is_usable(), second.is_usable()) {
            (true, true) => Some(usize::from(second.sequence() > first.sequence())),
            (true, false) => Some(0),
            (false, true) => Some(1),
            (false, false) => None,
        }
    }

    fn slot_of(&self, entry: &Entry) -> u8 {
        self.slots.of_sequence(entry.sequence())
    }

    /// Whether this entry says that this slot is proven.
    fn proves(&self, entry: &Entry, slot: u8) -> bool {
        entry.is_usable() && entry.state() == ImageState::Valid && self.slot_of(entry) == slot
    }

    /// What the entries say of the program that runs, in the slot `running`.
    #[must_use]
    pub fn standing(&self, running: u8) -> Standing {
        let Some((active, other)) = self.active_and_other() else {
            return Standing::Proven;
        };
        if self.slot_of(active) != running {
            return if self.proves(other, running) {
                Standing::Returned
            } else {
                Standing::OnTrial(TrialCounts::WITHOUT_WAY_BACK)
            };
        }
        if active.state() == ImageState::Valid {
            return Standing::Proven;
        }
        let state = active.word(at::STATE);
        Standing::OnTrial(TrialCounts {
            attempts: active.count(Counter::Attempts),
            restarts: active.count(Counter::Restarts),
            way_back: other.is_usable() && self.slot_of(other) != running,
            // Only giving up clears bit 1 and leaves bit 2.
            giving_up: state & 0b110 == 0b100,
        })
    }

    fn active_and_other(&self) -> Option<(&Entry, &Entry)> {
        let [first, second] = &self.entries;
        match self.active()? {
            0 => Some((first, second)),
            _ => Some((second, first)),
        }
    }
}

/// What the entries say of the program that runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Standing {
    /// It is proven, or was put there by whoever flashed the board.
    Proven,
    /// It is proven, and runs because the slot that was to start holds no image that does.
    Returned,
    /// It is not proven.
    OnTrial(TrialCounts),
}

/// How a trial stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TrialCounts {
    /// Starts that were counted after something went wrong.
    pub attempts: u32,
    /// Starts that were counted after restarts that the program asked for.
    pub restarts: u32,
    /// There is another program to go back to.
    pub way_back: bool,
    /// It was being given up when the power went.
    pub giving_up: bool,
}

impl TrialCounts {
    const WITHOUT_WAY_BACK: Self = Self {
        attempts: 0,
        restarts: 0,
        way_back: false,
        giving_up: false,
    };
}
