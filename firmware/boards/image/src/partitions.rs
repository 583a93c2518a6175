//! The partition table of a board, and what this project asks of one.

use std::fmt;
use std::path::Path;

use esp_idf_part::{AppType, DataType, PartitionTable, SubType, Type};
use espflash::flasher::FlashSize;

use crate::failure::{Context as _, Failure, Outcome, quietly, read};

/// Where the bootloader looks for the table (`CONFIG_PARTITION_TABLE_OFFSET`).
pub(crate) const OFFSET: u32 = 0x8000;

/// The two update slots.
const SLOTS: [AppType; 2] = [AppType::Ota_0, AppType::Ota_1];

/// Data partitions the boards look for by name, and their smallest size in bytes: two erase blocks
/// of 4 KiB each for a map that survives power cuts, four where values change often.
const NAMED: [(&str, u32); 3] = [
    ("settings", 0x2000),
    ("params", 0x4000),
    ("coredump", 0x1000),
];

/// A table that was read and checked.
#[derive(Debug)]
pub(crate) struct Table {
    /// Bytes in one update slot.
    pub(crate) slot: u32,
}

/// Reads a table in Espressif's CSV form.
///
/// # Errors
/// When the file cannot be read, is no partition table, or lacks what the robot program needs on
/// a flash of `flash` bytes.
pub(crate) fn load(path: &Path, flash: FlashSize) -> Outcome<Table> {
    let text = String::from_utf8(read(path)?).when(path.display())?;
    check(&text, flash).when(path.display())
}

/// Why a table is not fit for the robot program.
#[derive(Debug)]
enum TableError {
    /// It made the library panic.
    Contradiction(Failure),
    /// It is no partition table.
    Malformed(esp_idf_part::Error),
    /// A partition ends here, behind the flash of so many bytes.
    BehindFlash { name: String, end: u64, flash: u32 },
    /// A partition lies on the table itself.
    OnTable(String),
    /// Nothing says which slot starts.
    NoOtaData,
    /// There are not two update slots.
    OneSlot,
    /// An image has to fit both slots.
    UnequalSlots,
    /// A partition that boards look for is missing.
    Missing(&'static str),
    /// It is smaller than so many bytes.
    TooSmall(&'static str, u32),
}

impl fmt::Display for TableError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Contradiction(Failure(reason)) => f.write_str(reason),
            Self::Malformed(error) => error.fmt(f),
            Self::BehindFlash { name, end, flash } => write!(
                f,
                "{name} ends at {end:#x}, behind the {flash:#x} bytes of flash"
            ),
            Self::OnTable(name) => write!(f, "{name} lies on the partition table itself"),
            Self::NoOtaData => f.write_str("otadata is missing: nothing says which slot starts"),
            Self::OneSlot => f.write_str("two update slots are needed: ota_0 and ota_1"),
            Self::UnequalSlots => {
                f.write_str("ota_0 and ota_1 differ in size: an image must fit both")
            }
            Self::Missing(name) => write!(f, "the partition '{name}' is missing"),
            Self::TooSmall(name, smallest) => {
                write!(f, "'{name}' is smaller than {smallest:#x} bytes")
            }
        }
    }
}

fn check(text: &str, flash: FlashSize) -> Result<Table, TableError> {
    let table = quietly("esp-idf-part", || PartitionTable::try_from_str(text))
        .map_err(TableError::Contradiction)?
        .map_err(TableError::Malformed)?;
    for partition in table.partitions() {
        let end = u64::from(partition.offset()) + u64::from(partition.size());
        if end > u64::from(flash.size()) {
            return Err(TableError::BehindFlash {
                name: partition.name(),
                end,
                flash: flash.size(),
            });
        }
        if partition.offset() < OFFSET + 0x1000 {
            return Err(TableError::OnTable(partition.name()));
        }
    }
    let find = |kind, subtype| table.find_by_subtype(kind, subtype);
    if find(Type::Data, SubType::Data(DataType::Ota)).is_none() {
        return Err(TableError::NoOtaData);
    }
    let [Some(first), Some(second)] = SLOTS.map(|slot| find(Type::App, SubType::App(slot))) else {
        return Err(TableError::OneSlot);
    };
    if first.size() != second.size() {
        return Err(TableError::UnequalSlots);
    }
    for (name, smallest) in NAMED {
        let partition = table.find(name).ok_or(TableError::Missing(name))?;
        if partition.size() < smallest {
            return Err(TableError::TooSmall(name, smallest));
        }
    }
    Ok(Table { slot: first.size() })
}

/// Reads `4mb` or `8mb`, as the command line of espflash does.
///
/// # Errors
/// On any size that no board of this project has.
pub(crate) fn flash_size(text: &str) -> Outcome<FlashSize> {
    match text.parse() {
        Ok(size @ (FlashSize::_4Mb | FlashSize::_8Mb)) => Ok(size),
        _ => Err(Failure(format!("'{text}' is no flash size: 4mb, 8mb"))),
    }
}

#[cfg(test)]
mod tests {
    use espflash::flasher::FlashSize;

    use super::{check, flash_size};

    const SMALL: &str = include_str!("../../partitions.csv");
    const LARGE: &str = include_str!("../../partitions-8mb.csv");

    fn refused(text: &str, because: &str) {
        let error = check(text, FlashSize::_4Mb).expect_err(because).to_string();
        assert!(error.contains(because), "{error}");
    }

    #[test]
    fn the_tables_of_the_boards_are_fit() {
        assert_eq!(check(SMALL, FlashSize::_4Mb).expect("4 MB").slot, 0x1e_0000);
        assert_eq!(check(LARGE, FlashSize::_8Mb).expect("8 MB").slot, 0x38_0000);
    }

    #[test]
    fn both_tables_keep_what_an_update_must_find_again() {
        let line = |text: &str, name: &str| {
            text.lines()
                .find(|line| line.starts_with(name))
                .map(str::to_owned)
        };
        for name in ["otadata", "phy_init", "settings"] {
            assert!(line(SMALL, name).is_some());
            assert_eq!(line(SMALL, name), line(LARGE, name));
        }
    }

    #[test]
    fn a_table_must_fit_the_flash() {
        refused(LARGE, "behind the 0x400000 bytes of flash");
    }

    #[test]
    fn what_the_robot_needs_must_be_there() {
        let without = |name: &str| {
            SMALL
                .lines()
                .filter(|line| !line.starts_with(name))
                .fold(String::new(), |text, line| text + line + "\n")
        };
        refused(&without("otadata"), "otadata is missing");
        refused(&without("ota_1"), "two update slots");
        refused(&without("params"), "'params' is missing");
        refused(&without("settings"), "'settings' is missing");
        refused(&without("coredump"), "'coredump' is missing");
    }

    #[test]
    fn slots_are_alike_and_regions_apart() {
        refused(
            &SMALL.replace("0x1f0000, 0x1e0000", "0x1f0000, 0x1d0000"),
            "differ in size",
        );
        refused(
            &SMALL.replace("0xc000,   0x4000", "0xc000,   0x8000"),
            "overlap",
        );
        refused(
            &SMALL.replace("0x3d0000, 0x10000", "0x3d0000, 0x1000"),
            "'params' is smaller",
        );
    }

    #[test]
    fn anything_else_is_no_table() {
        for text in [
            "",
            "otadata",
            "a,b,c,d,e\n",
            "\u{0}\u{1}",
            "x,data,ota,0xfffff000,0xffffffff\n",
        ] {
            assert!(check(text, FlashSize::_4Mb).is_err(), "{text:?}");
        }
    }

    #[test]
    fn sizes_are_those_of_the_boards() {
        assert_eq!(flash_size("4mb").expect("4 MB"), FlashSize::_4Mb);
        assert_eq!(flash_size("8mb").expect("8 MB"), FlashSize::_8Mb);
        for wrong in ["", "4", "16mb", "_4mb"] {
            assert!(flash_size(wrong).is_err(), "{wrong}");
        }
    }
}
