//! A flash that holds its caller to the rules, remembers what was done to it, and may be torn anywhere.

use std::collections::BTreeSet;
use std::hash::{DefaultHasher, Hash, Hasher};

use embedded_storage::nor_flash::{
    ErrorType, MultiwriteNorFlash, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};

pub(crate) const SECTOR: usize = 4_096;
/// Two sectors of otadata, then the last sector of each of two slots.
pub(crate) const BYTES: usize = 4 * SECTOR;
pub(crate) const TRAILERS: [u32; 2] = [2 * SECTOR as u32, 3 * SECTOR as u32];

/// What nobody but the test knows.
#[derive(Clone, Default, Hash)]
pub(crate) struct Truth {
    /// Versions that were flashed by a person, or have proven themselves.
    pub(crate) proven: BTreeSet<u32>,
    /// The version whose image is complete and verified in the spare slot.
    pub(crate) staged: Option<u32>,
}

/// An operation that was asked for.
#[derive(Clone)]
pub(crate) enum Asked {
    Erase(usize),
    Program(usize, Vec<u8>),
}

#[derive(Clone)]
pub(crate) struct Chip {
    pub(crate) bytes: Vec<u8>,
    /// The version of the image in each slot; `None` while it is not intact.
    pub(crate) images: [Option<u32>; 2],
    pub(crate) truth: Truth,
    pub(crate) erases: [u32; 4],
    /// What was asked for, each with the chip before it.
    pub(crate) history: Option<Vec<(Chip, Asked)>>,
    /// Bytes until the power goes, and what is drawn from for the byte where it does.
    pub(crate) budget: Option<(u64, u64)>,
}

#[derive(Debug, PartialEq, Eq)]
pub(crate) struct PowerLost;

impl NorFlashError for PowerLost {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

/// How a torn operation leaves the bytes that it did not get to.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Torn {
    /// Those before the cut are done, the one at the cut has these bits done.
    InOrder(u8),
    /// All bytes from the cut on have these bits done.
    Together(u8),
    /// Erasing only, which programs all cells first: all bytes from the cut on have these bits fallen.
    Programmed(u8),
}

impl Torn {
    pub(crate) const ALL: [Self; 9] = [
        Self::InOrder(0x00),
        Self::InOrder(0x0F),
        Self::InOrder(0x55),
        Self::InOrder(0xFE),
        Self::Together(0x01),
        Self::Together(0x52),
        Self::Together(0xAA),
        Self::Programmed(0x0F),
        Self::Programmed(0xFF),
    ];
}

impl Chip {
    pub(crate) fn new() -> Self {
        Self {
            bytes: vec![0xFF; BYTES],
            images: [None; 2],
            truth: Truth::default(),
            erases: [0; 4],
            history: None,
            budget: None,
        }
    }

    pub(crate) fn fingerprint(&self) -> u64 {
        let mut hasher = DefaultHasher::new();
        (&self.bytes, self.images, &self.truth).hash(&mut hasher);
        hasher.finish()
    }

    pub(crate) fn entries(&self) -> [&[u8]; 2] {
        [&self.bytes[..32], &self.bytes[SECTOR..SECTOR + 32]]
    }

    /// Does an operation up to byte `cut`, and tears it there.
    pub(crate) fn tear(&mut self, asked: &Asked, cut: usize, torn: Torn) {
        let (at, target) = match asked {
            Asked::Erase(at) => (*at, vec![0xFF; SECTOR]),
            Asked::Program(at, bytes) => (*at, bytes.clone()),
        };
        let erase = matches!(asked, Asked::Erase(_));
        for (index, &new) in target.iter().enumerate() {
            let byte = &mut self.bytes[at + index];
            let old = *byte;
            let full = if erase { 0xFF } else { old & new };
            let mixed = |bits: u8| (full & bits) | (old & !bits);
            *byte = match torn {
                _ if index < cut => full,
                Torn::InOrder(bits) if index == cut => mixed(bits),
                Torn::Together(bits) => mixed(bits),
                Torn::Programmed(bits) if erase => old & !bits,
                Torn::InOrder(_) | Torn::Programmed(_) => old,
            };
        }
    }

    fn note(&mut self, asked: Asked) -> Result<(), PowerLost> {
        if let Some(mut history) = self.history.take() {
            history.push((self.clone(), asked));
            self.history = Some(history);
            return Ok(());
        }
        let length = match &asked {
            Asked::Erase(_) => SECTOR,
            Asked::Program(_, bytes) => bytes.len(),
        } as u64;
        match &mut self.budget {
            Some((left, luck)) if *left < length => {
                let (cut, luck) = (*left as usize, *luck);
                self.budget = None;
                let torn = Torn::ALL[luck as usize % Torn::ALL.len()];
                self.tear(&asked, cut, torn);
                Err(PowerLost)
            }
            Some((left, _)) => {
                *left -= length;
                Ok(())
            }
            None => Ok(()),
        }
    }
}

impl ErrorType for Chip {
    type Error = PowerLost;
}

impl ReadNorFlash for Chip {
    const READ_SIZE: usize = 4;

    fn read(&mut self, at: u32, bytes: &mut [u8]) -> Result<(), PowerLost> {
        assert!(at.is_multiple_of(4) && bytes.len().is_multiple_of(4));
        bytes.copy_from_slice(&self.bytes[at as usize..at as usize + bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        BYTES
    }
}

impl NorFlash for Chip {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = SECTOR;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), PowerLost> {
        let from = from as usize;
        assert!(from.is_multiple_of(SECTOR) && to as usize == from + SECTOR);
        self.note(Asked::Erase(from))?;
        self.erases[from / SECTOR] += 1;
        self.bytes[from..from + SECTOR].fill(0xFF);
        Ok(())
    }

    fn write(&mut self, at: u32, bytes: &[u8]) -> Result<(), PowerLost> {
        let from = at as usize;
        assert!(from.is_multiple_of(4) && bytes.len().is_multiple_of(4));
        for (old, new) in self.bytes[from..from + bytes.len()].iter().zip(bytes) {
            assert_eq!(old & new, *new, "a bit would have to rise at {at:#x}");
        }
        self.note(Asked::Program(from, bytes.to_vec()))?;
        self.bytes[from..from + bytes.len()].copy_from_slice(bytes);
        Ok(())
    }
}

impl MultiwriteNorFlash for Chip {}
