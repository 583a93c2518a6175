//! Where what is in the flash of the emulated board.
//!
//! The machine has two banks of 32 MiB. The first holds the boot stage and is read-only; the second holds
//! parameters and programs, in erase blocks of 256 KiB. A journal and select entries want sectors of 4 KiB that
//! are erased one by one, and an image is received anew in blocks of 64 KiB. So programs have an address space of
//! their own, in which each [`Group`] of sectors lies in an erase block of its own:
//!
//! | address of the slots' space | what | erase blocks |
//! |---|---|---|
//! | `0x10_0000` | slot 0: 15 groups of 64 KiB, one of 60 KiB, the trailer | 17, from 6 on |
//! | `0x20_0000` | slot 1 | 17, from 23 on |
//! | `0x30_0000` | select entries of the slots, two sectors | 2, from 40 on |
//! | `0x30_2000` | select entries of policies, two sectors | 2, from 43 on |
//! | `0x30_4000` | two places for a policy: 12 KiB, and a trailer | 2 each, from 45 on |
//!
//! Erase blocks 0 to 3 hold parameters, the next two settings; block 42 what a launcher remembers
//! ([`FLASHED`]).

use crawler_boot::flash::SECTOR;
use crawler_boot::otadata::OTADATA_BYTES;

/// Bytes of a bank.
pub const BANK: u32 = 32 * 1024 * 1024;
/// Address of the first bank, where the machine starts when it has one.
pub const BOOT_BANK: u32 = 0x2000_0000;
/// Address of the second bank.
pub const BANK_ADDRESS: u32 = 0x2200_0000;
/// Bytes of an erase block.
pub const ERASE_BLOCK: u32 = 256 * 1024;
/// Erase blocks at the start of the second bank that hold parameters.
pub const PARAMETER_BLOCKS: u16 = 4;
/// Erase blocks behind them that hold settings: one for each of the two records.
pub const SETTINGS_BLOCKS: u16 = 2;

/// Where the program is linked to run, and its region's bytes.
pub const PROGRAM: u32 = 0x8000_0000;
/// Most bytes of a program.
pub const PROGRAM_MAX: u32 = 736 * 1024;

/// Where the slots begin, in their own address space.
pub const SLOTS: [u32; 2] = [0x10_0000, 0x20_0000];
/// Bytes of a slot, with the trailer, its last sector.
pub const SLOT_BYTES: u32 = 0x10_0000;
/// Where the select entries begin, in the address space of the slots.
pub const OTADATA: u32 = 0x30_0000;
/// Where the select entries of policies begin, in that address space.
pub const POLICY_SELECT: u32 = OTADATA + OTADATA_BYTES;
/// Where the places for a policy begin, in that address space.
pub const POLICIES: [u32; 2] = [
    POLICY_SELECT + OTADATA_BYTES,
    POLICY_SELECT + OTADATA_BYTES + POLICY_BYTES,
];
/// Bytes of a place for a policy, with the trailer, its last sector.
pub const POLICY_BYTES: u32 = 4 * SECTOR;
/// End of the address space of the slots.
pub const END: u32 = POLICIES[1] + POLICY_BYTES;

/// Most bytes of a group.
pub const GROUP: u32 = 64 * 1024;

/// Offset in the second bank of what a launcher remembers: which image it put there.
pub const FLASHED: u32 = 42 * ERASE_BLOCK;

const GROUPS: u32 = SLOT_BYTES / GROUP;
const FIRST_BLOCK: u32 = PARAMETER_BLOCKS as u32 + SETTINGS_BLOCKS as u32;
const SLOT_BLOCKS: [u32; 2] = [FIRST_BLOCK, FIRST_BLOCK + GROUPS + 1];
const OTADATA_BLOCK: u32 = SLOT_BLOCKS[1] + GROUPS + 1;

const POLICY_BLOCK: u32 = FLASHED / ERASE_BLOCK + 1;

const _: () = assert!(FLASHED == (OTADATA_BLOCK + 2) * ERASE_BLOCK);
const _: () = assert!(PROGRAM_MAX + SECTOR <= SLOT_BYTES - SECTOR);

/// Sectors that share an erase block, and no other sector with them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Group {
    /// Address of the first byte, in the address space of the slots.
    pub start: u32,
    /// Bytes: whole sectors.
    pub length: u32,
    /// Offset of its erase block in the second bank. The group begins there.
    pub block: u32,
}

impl Group {
    /// The group of the byte at `address` of the slots' address space; `None` where there is nothing.
    #[must_use]
    pub const fn of(address: u32) -> Option<Self> {
        if address >= POLICIES[0] && address < END {
            let place = (address - POLICIES[0]) / POLICY_BYTES;
            return Some(Self::in_place(place, address));
        }
        if address >= OTADATA && address < POLICIES[0] {
            let sector = (address - OTADATA) / SECTOR;
            let of_policies = address >= POLICY_SELECT;
            return Some(Self {
                start: OTADATA + sector * SECTOR,
                length: SECTOR,
                block: ERASE_BLOCK
                    * if of_policies {
                        POLICY_BLOCK + (address - POLICY_SELECT) / SECTOR
                    } else {
                        OTADATA_BLOCK + sector
                    },
            });
        }
        let mut slot = 0;
        while slot < SLOTS.len() {
            let start = SLOTS[slot];
            if address >= start && address < start + SLOT_BYTES {
                return Some(Self::in_slot(start, address - start, SLOT_BLOCKS[slot]));
            }
            slot += 1;
        }
        None
    }

    const fn in_slot(slot: u32, within: u32, first: u32) -> Self {
        let trailer = SLOT_BYTES - SECTOR;
        if within >= trailer {
            return Self {
                start: slot + trailer,
                length: SECTOR,
                block: (first + GROUPS) * ERASE_BLOCK,
            };
        }
        let group = within / GROUP;
        let start = group * GROUP;
        Self {
            start: slot + start,
            length: if start + GROUP > trailer {
                trailer - start
            } else {
                GROUP
            },
            block: (first + group) * ERASE_BLOCK,
        }
    }

    const fn in_place(place: u32, address: u32) -> Self {
        let start = POLICIES[0] + place * POLICY_BYTES;
        let trailer = start + POLICY_BYTES - SECTOR;
        let block = POLICY_BLOCK + OTADATA_BYTES / SECTOR + 2 * place;
        if address >= trailer {
            Self {
                start: trailer,
                length: SECTOR,
                block: (block + 1) * ERASE_BLOCK,
            }
        } else {
            Self {
                start,
                length: trailer - start,
                block: block * ERASE_BLOCK,
            }
        }
    }

    /// Offset in the second bank of the byte at `address`, which is in this group.
    #[must_use]
    pub const fn offset(&self, address: u32) -> u32 {
        self.block + (address - self.start)
    }

    /// The pieces of a range of the slots' address space, group by group: offset in the second bank, and
    /// which bytes of the range. `None` when part of the range is nowhere.
    pub fn pieces(address: u32, length: usize) -> Option<impl Iterator<Item = Piece>> {
        let end = address.checked_add(u32::try_from(length).ok()?)?;
        if address < SLOTS[0] || end > END {
            return None;
        }
        let mut at = address;
        Some(core::iter::from_fn(move || {
            if at >= end {
                return None;
            }
            let group = Self::of(at)?;
            let until = end.min(group.start + group.length);
            let piece = Piece {
                offset: group.offset(at),
                from: (at - address) as usize,
                to: (until - address) as usize,
            };
            at = until;
            Some(piece)
        }))
    }
}

/// A part of a range that lies in one erase block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Piece {
    /// Offset in the second bank.
    pub offset: u32,
    /// First byte of the range that is in it.
    pub from: usize,
    /// Byte of the range after its last one.
    pub to: usize,
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;

    #[test]
    fn each_group_has_an_erase_block_to_itself() {
        let mut blocks = BTreeMap::new();
        let mut covered = 0;
        for sector in (SLOTS[0]..END).step_by(SECTOR as usize) {
            let group = Group::of(sector).expect("no hole between slots and select entries");
            assert!(group.start <= sector && sector + SECTOR <= group.start + group.length);
            assert!(group.length <= ERASE_BLOCK && group.block.is_multiple_of(ERASE_BLOCK));
            assert!(group.block >= FIRST_BLOCK * ERASE_BLOCK);
            assert_ne!(group.block, FLASHED);
            assert!(group.block < BANK);
            let other = *blocks.entry(group.block).or_insert(group.start);
            assert_eq!(other, group.start);
            covered += SECTOR;
        }
        assert_eq!(covered, 2 * (SLOT_BYTES + OTADATA_BYTES + POLICY_BYTES));
        assert_eq!(blocks.len(), 2 * 17 + 2 + 2 + 2 * 2);
    }

    #[test]
    fn a_trailer_and_each_select_entry_stand_alone() {
        let alone = SLOTS.map(|slot| slot + SLOT_BYTES - SECTOR);
        let of_policies = POLICIES.map(|place| place + POLICY_BYTES - SECTOR);
        let entries = [
            OTADATA,
            OTADATA + SECTOR,
            POLICY_SELECT,
            POLICY_SELECT + SECTOR,
        ];
        for sector in alone.into_iter().chain(of_policies).chain(entries) {
            let group = Group::of(sector).expect("there");
            assert_eq!((group.start, group.length), (sector, SECTOR));
        }
    }

    #[test]
    fn nothing_is_outside() {
        for outside in [0, SLOTS[0] - 1, END, u32::MAX] {
            assert_eq!(Group::of(outside), None);
        }
        for (address, length) in [
            (SLOTS[0] - 1, 1),
            (END - 1, 2),
            (0, 0),
            (SLOTS[0], usize::MAX),
        ] {
            assert!(Group::pieces(address, length).is_none(), "{address:#x}");
        }
        assert_eq!(Group::pieces(END, 0).expect("empty").count(), 0);
    }

    #[test]
    fn pieces_make_the_range_again() {
        let start = SLOTS[0] + GROUP - 10;
        let pieces: std::vec::Vec<_> = Group::pieces(start, 2 * GROUP as usize)
            .expect("there")
            .collect();
        let lengths = pieces.iter().map(|piece| piece.to - piece.from);
        assert_eq!(lengths.collect::<std::vec::Vec<_>>(), [10, 65_536, 65_526]);
        assert_eq!(pieces[0].offset, 6 * ERASE_BLOCK + GROUP - 10);
        assert_eq!(pieces[1].offset, 7 * ERASE_BLOCK);
        assert_eq!(
            (pieces[1].from, pieces[2].from, pieces[2].to),
            (10, 65_546, 131_072)
        );
    }
}
