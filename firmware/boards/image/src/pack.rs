//! From an ELF to what is written into flash.

use std::path::Path;

use espflash::flasher::{FlashData, FlashSettings, FlashSize};
use espflash::image_format::Segment;
use espflash::image_format::idf::IdfBootloaderFormat;
use espflash::target::Chip;
use object::{Architecture, Object as _};

use crate::app_image;
use crate::failure::{Context as _, Failure, Outcome, quietly};
use crate::partitions;

/// The section that every ESP-IDF bootloader reads first.
const DESCRIPTOR: &str = ".flash.appdesc";

/// A board's flash and chip.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Target<'a> {
    /// Which chip.
    pub(crate) chip: Chip,
    /// How much flash is soldered to it.
    pub(crate) flash: FlashSize,
    /// Its partition table, as CSV.
    pub(crate) partitions: &'a Path,
}

/// What packing makes of an ELF.
#[derive(Debug)]
pub(crate) struct Images {
    /// Bootloader, partition table and program, to be written from address 0.
    pub(crate) merged: Vec<u8>,
    /// The program alone, as an update carries it.
    pub(crate) update: Vec<u8>,
}

/// Reads `esp32s3`, `esp32c3` or `esp32c6`.
///
/// # Errors
/// On any other chip.
pub(crate) fn chip(text: &str) -> Outcome<Chip> {
    match text {
        "esp32s3" => Ok(Chip::Esp32s3),
        "esp32c3" => Ok(Chip::Esp32c3),
        "esp32c6" => Ok(Chip::Esp32c6),
        other => Err(Failure(format!(
            "'{other}' is no chip of this project: esp32s3, esp32c3, esp32c6"
        ))),
    }
}

/// Packs `elf` for `target`.
///
/// # Errors
/// When the ELF is none, is for another processor, has no application descriptor, does not fit
/// an update slot, or when the partition table is not fit.
pub(crate) fn pack(elf: &[u8], target: &Target<'_>) -> Outcome<Images> {
    partitions::load(target.partitions, target.flash)?;
    inspect(elf, target.chip)?;
    let settings = FlashSettings::new(None, Some(target.flash), None);
    let data = FlashData::new(
        settings,
        0,
        None,
        target.chip,
        target.chip.default_xtal_frequency(),
    );
    let format = quietly("espflash", || {
        IdfBootloaderFormat::new(
            elf,
            &data,
            Some(target.partitions),
            None,
            Some(partitions::OFFSET),
            Some("ota_0"),
        )
    })?
    .when("espflash cannot make an image of it")?;
    let update = match format.clone().ota_segments().collect::<Vec<_>>().as_slice() {
        [slot] => slot.data().to_vec(),
        others => {
            return Err(Failure(format!(
                "espflash made {} parts of one update",
                others.len()
            )));
        }
    };
    app_image::read(&update).when("espflash made an image that cannot start")?;
    Ok(Images {
        merged: merge(format.flash_segments().collect())?,
        update,
    })
}

/// Refuses what the image format would only trip over later.
fn inspect(elf: &[u8], chip: Chip) -> Outcome {
    let file = object::File::parse(elf).when("not an ELF file")?;
    let expected = match chip {
        Chip::Esp32s3 => Architecture::Xtensa,
        _ => Architecture::Riscv32,
    };
    if file.architecture() != expected {
        return Err(Failure(format!(
            "an ELF for {:?}, but {chip} is {expected:?}",
            file.architecture()
        )));
    }
    if file.section_by_name(DESCRIPTOR).is_none() {
        return Err(Failure(format!(
            "no {DESCRIPTOR}: the program lacks esp_bootloader_esp_idf::esp_app_desc!()"
        )));
    }
    Ok(())
}

/// Lays the parts out from address 0, erased flash between them.
fn merge(mut parts: Vec<Segment<'_>>) -> Outcome<Vec<u8>> {
    parts.sort();
    let mut merged = Vec::new();
    for part in parts {
        let start = part.addr as usize;
        if start < merged.len() {
            return Err(Failure(format!(
                "the part at {start:#x} begins inside the one before, which ends at {:#x}",
                merged.len()
            )));
        }
        merged.resize(start, 0xff);
        merged.extend_from_slice(part.data());
    }
    Ok(merged)
}

#[cfg(test)]
#[path = "pack_tests.rs"]
mod tests;
