//! From a linked program to the bytes that it consists of in memory.
//!
//! Layout of ELF files: System V ABI, edition 4.1, chapters 4 and 5, for 32 bits and little-endian.

use core::fmt;
use std::vec::Vec;

use crate::header::Header;
use crate::layout::{BANK, BOOT_BANK, PROGRAM, PROGRAM_MAX};

/// Bytes of the file header, and of a program header.
const FILE_HEADER: usize = 52;
const PROGRAM_HEADER: usize = 32;
/// `PT_LOAD`.
const LOAD: u32 = 1;

/// Why an ELF file is no program for the emulated board.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum ElfError {
    /// It is no ELF file for 32 bits, little-endian.
    NotElf,
    /// It ends before it should.
    Truncated,
    /// It has a part outside of where programs are, at this address.
    Outside(u32),
    /// It does not begin where the machine begins to run.
    Entry(u32),
    /// There is nothing in it.
    Empty,
}

impl fmt::Display for ElfError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotElf => f.write_str("not an ELF file for 32 bits"),
            Self::Truncated => f.write_str("an ELF file that was cut off"),
            Self::Outside(address) => write!(f, "a part of the program is at {address:#x}"),
            Self::Entry(address) => write!(f, "the program begins at {address:#x}"),
            Self::Empty => f.write_str("an ELF file without a program"),
        }
    }
}

impl core::error::Error for ElfError {}

/// The robot program as an image for a slot: a header, and what the program consists of.
///
/// # Errors
/// [`ElfError`].
pub fn image(elf: &[u8]) -> Result<Vec<u8>, ElfError> {
    let program = flatten(elf, PROGRAM, PROGRAM_MAX)?;
    let header = Header::of(&program).ok_or(ElfError::Empty)?;
    Ok([&header.to_bytes()[..], &program].concat())
}

/// The boot stage, as it is in the first bank.
///
/// # Errors
/// [`ElfError`].
pub fn boot_stage(elf: &[u8]) -> Result<Vec<u8>, ElfError> {
    flatten(elf, BOOT_BANK, BANK)
}

/// What `elf` puts into `size` bytes of memory from `start` on, up to the last byte of it.
fn flatten(elf: &[u8], start: u32, size: u32) -> Result<Vec<u8>, ElfError> {
    // Class 32 bits, data little-endian.
    if !elf.starts_with(b"\x7FELF\x01\x01") {
        return Err(ElfError::NotElf);
    }
    let header = elf.get(..FILE_HEADER).ok_or(ElfError::Truncated)?;
    let entry = word(header, 24)?;
    if entry != start {
        return Err(ElfError::Entry(entry));
    }
    let table = word(header, 28)? as usize;
    let (entry_size, count) = (half(header, 42)?, half(header, 44)?);
    if usize::from(entry_size) != PROGRAM_HEADER {
        return Err(ElfError::NotElf);
    }
    let table = part(elf, table, usize::from(count) * PROGRAM_HEADER)?;
    let mut memory = Vec::new();
    for part_header in table.chunks_exact(PROGRAM_HEADER) {
        let in_file = word(part_header, 16)?;
        if word(part_header, 0)? != LOAD || in_file == 0 {
            continue;
        }
        let address = word(part_header, 12)?;
        let outside = ElfError::Outside(address);
        let at = address.checked_sub(start).ok_or(outside)?;
        let end = at.checked_add(in_file).filter(|end| *end <= size);
        let end = end.ok_or(outside)? as usize;
        let bytes = part(elf, word(part_header, 4)? as usize, in_file as usize)?;
        if memory.len() < end {
            memory.resize(end, 0);
        }
        memory[at as usize..end].copy_from_slice(bytes);
    }
    if memory.is_empty() {
        return Err(ElfError::Empty);
    }
    Ok(memory)
}

fn part(bytes: &[u8], at: usize, length: usize) -> Result<&[u8], ElfError> {
    let end = at.checked_add(length).ok_or(ElfError::Truncated)?;
    bytes.get(at..end).ok_or(ElfError::Truncated)
}

fn word(bytes: &[u8], at: usize) -> Result<u32, ElfError> {
    let bytes = part(bytes, at, 4)?
        .first_chunk()
        .ok_or(ElfError::Truncated)?;
    Ok(u32::from_le_bytes(*bytes))
}

fn half(bytes: &[u8], at: usize) -> Result<u16, ElfError> {
    let bytes = part(bytes, at, 2)?
        .first_chunk()
        .ok_or(ElfError::Truncated)?;
    Ok(u16::from_le_bytes(*bytes))
}

#[cfg(test)]
mod tests {
    use std::vec;

    use proptest::prelude::*;

    use super::*;

    /// An ELF file with these parts: address, bytes.
    fn elf(entry: u32, parts: &[(u32, &[u8])]) -> Vec<u8> {
        let mut head = b"\x7FELF\x01\x01\x01".to_vec();
        head.resize(FILE_HEADER, 0);
        head[24..28].copy_from_slice(&entry.to_le_bytes());
        head[28] = FILE_HEADER as u8;
        head[42] = PROGRAM_HEADER as u8;
        head[44] = parts.len() as u8;
        let mut body = vec![];
        let first = FILE_HEADER + parts.len() * PROGRAM_HEADER;
        for (address, bytes) in parts {
            let offset = (first + body.len()) as u32;
            let size = bytes.len() as u32;
            for value in [LOAD, offset, 0, *address, size, size, 0, 4] {
                head.extend(value.to_le_bytes());
            }
            body.extend_from_slice(bytes);
        }
        [head, body].concat()
    }

    #[test]
    fn parts_lie_where_they_are_to_lie() {
        let made =
            image(&elf(PROGRAM, &[(PROGRAM + 8, b"data"), (PROGRAM, b"code")])).expect("fits");
        let (head, program) = made.split_first_chunk().expect("longer");
        assert_eq!(program, b"code\0\0\0\0data");
        assert!(Header::parse(head).expect("a header").matches(program));
        let stage = boot_stage(&elf(BOOT_BANK, &[(BOOT_BANK, b"stage")])).expect("fits");
        assert_eq!(stage, b"stage");
    }

    #[test]
    fn what_does_not_belong_into_a_slot_is_refused() {
        let whole = elf(PROGRAM, &[(PROGRAM, b"code")]);
        let far = PROGRAM + PROGRAM_MAX;
        for (file, error) in [
            (vec![], ElfError::NotElf),
            (b"text".to_vec(), ElfError::NotElf),
            (b"\x7FELF\x02\x01".to_vec(), ElfError::NotElf),
            (whole[..40].to_vec(), ElfError::Truncated),
            (whole[..whole.len() - 1].to_vec(), ElfError::Truncated),
            (elf(PROGRAM, &[]), ElfError::Empty),
            (
                elf(PROGRAM + 4, &[(PROGRAM, b"code")]),
                ElfError::Entry(PROGRAM + 4),
            ),
            (
                elf(PROGRAM, &[(PROGRAM - 1, b"code")]),
                ElfError::Outside(PROGRAM - 1),
            ),
            (
                elf(PROGRAM, &[(far - 3, b"code")]),
                ElfError::Outside(far - 3),
            ),
            (
                elf(PROGRAM, &[(u32::MAX, b"code")]),
                ElfError::Outside(u32::MAX),
            ),
            (
                elf(BOOT_BANK, &[(BOOT_BANK, b"code")]),
                ElfError::Entry(BOOT_BANK),
            ),
        ] {
            assert_eq!(image(&file), Err(error));
        }
    }

    proptest! {
        #[test]
        fn no_file_makes_it_panic(changes in prop::collection::vec((0_usize..120, any::<u8>()), 0..20)) {
            let mut file = elf(PROGRAM, &[(PROGRAM, b"code"), (PROGRAM + 100, b"data")]);
            let length = file.len();
            for (at, byte) in changes {
                file[at % length] = byte;
            }
            if let Ok(made) = image(&file) {
                prop_assert!(made.len() <= PROGRAM_MAX as usize + Header::BYTES);
            }
        }
    }
}
