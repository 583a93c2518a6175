//! What an image takes: flash, static RAM and stack, from its ELF.

use std::collections::BTreeMap;

use espflash::target::Chip;
use object::{Object as _, ObjectSection, ObjectSymbol as _, SectionFlags, SectionKind};

use crate::failure::{Context as _, Outcome};

/// Where a section lives at run time.
struct Place {
    /// Whether it takes memory at all.
    loaded: bool,
    /// Whether the program may write to it.
    writable: bool,
}

fn place<'data>(section: &impl ObjectSection<'data>) -> Place {
    let flags = match section.flags() {
        SectionFlags::Elf { sh_flags, .. } => sh_flags.0,
        _ => 0,
    };
    Place {
        loaded: flags & object::elf::SHF_ALLOC.0 != 0,
        writable: flags & object::elf::SHF_WRITE.0 != 0,
    }
}

/// Bytes of one image.
#[derive(Debug, Default, Clone, PartialEq, Eq)]
pub(crate) struct Weight {
    /// Code, constants and initial values.
    pub(crate) flash: u64,
    /// Variables, and code that runs from RAM; without stack and heap regions.
    pub(crate) ram: u64,
    /// The region left for the main stack, where the image states one.
    pub(crate) stack: Option<u64>,
}

/// Weighs an ELF. With a chip, what lies outside of its flash counts as RAM, even when it is never
/// written: the ESP32 keeps code in RAM that runs while the flash is busy.
///
/// # Errors
/// When it is no ELF.
pub(crate) fn weigh(elf: &[u8], chip: Option<Chip>) -> Outcome<Weight> {
    let file = object::File::parse(elf).when("not an ELF file")?;
    let mut weight = Weight::default();
    for section in file.sections() {
        let place = place(&section);
        let name = section.name().unwrap_or_default();
        if !place.loaded || section.size() == 0 {
            continue;
        }
        let stored = section.kind() != SectionKind::UninitializedData;
        if name.starts_with(".stack") {
            *weight.stack.get_or_insert(0) += section.size();
            continue;
        }
        // Linker scripts of the ESP32 mirror regions that two buses reach, and reserve the heap.
        if name.starts_with(".heap") || (!stored && name.contains("dummy")) {
            continue;
        }
        if stored {
            weight.flash += section.size();
        }
        let outside = chip.is_some_and(|chip| !chip.addr_is_flash(section.address() as u32));
        if place.writable || outside {
            weight.ram += section.size();
        }
    }
    Ok(weight)
}

/// Bytes by crate, largest first, as far as symbols tell: inlined code counts where it was inlined.
///
/// # Errors
/// When it is no ELF.
pub(crate) fn by_crate(elf: &[u8]) -> Outcome<Vec<(String, Weight)>> {
    let file = object::File::parse(elf).when("not an ELF file")?;
    let mut crates: BTreeMap<String, Weight> = BTreeMap::new();
    // Several symbols may name the same place: count it once.
    let mut seen = std::collections::BTreeSet::new();
    for symbol in file.symbols() {
        let Some(section) = symbol
            .section_index()
            .and_then(|index| file.section_by_index(index).ok())
        else {
            continue;
        };
        let place = place(&section);
        if !place.loaded || symbol.size() == 0 || !seen.insert(symbol.address()) {
            continue;
        }
        let owner = crate_of(symbol.name().unwrap_or_default());
        let weight = crates.entry(owner).or_default();
        if section.kind() != SectionKind::UninitializedData {
            weight.flash += symbol.size();
        }
        if place.writable {
            weight.ram += symbol.size();
        }
    }
    let mut rows: Vec<_> = crates.into_iter().collect();
    rows.sort_by_key(|(_, weight)| std::cmp::Reverse(weight.flash + weight.ram));
    Ok(rows)
}

/// The crate that a mangled name begins with: of `<a::B as c::D>::e` it is `a`.
fn crate_of(symbol: &str) -> String {
    let name = format!("{:#}", rustc_demangle::demangle(symbol));
    let path = name.trim_start_matches(['<', '&', '*', '(', '[', ' ']);
    let path = path.strip_prefix("mut ").unwrap_or(path);
    let path = path.strip_prefix("dyn ").unwrap_or(path);
    let end = path
        .find(|letter: char| !letter.is_alphanumeric() && letter != '_')
        .unwrap_or(path.len());
    if name == symbol || !path[end..].starts_with("::") {
        return "(no crate)".to_owned();
    }
    path[..end].to_owned()
}

#[cfg(test)]
mod tests {
    use espflash::target::Chip;

    use super::{Weight, crate_of, weigh};
    use crate::elf_bench::{EXECUTE, RISCV, WRITE, bytes, elf, zeros};

    #[test]
    fn sections_count_where_they_lie() {
        let image = elf(
            RISCV,
            &[
                bytes(".text", 0x4200_0020, EXECUTE, vec![0; 1000]),
                bytes(".rodata", 0x3c00_0020, 0, vec![0; 100]),
                bytes(".rwtext", 0x4038_0000, EXECUTE, vec![0; 50]),
                bytes(".data", 0x3fc8_0000, WRITE, vec![0; 20]),
                zeros(".bss", 0x3fc8_0100, WRITE, 300),
                zeros(".rwtext_dummy", 0x3fc8_1000, WRITE, 4096),
                zeros(".stack", 0x3fc9_0000, WRITE, 8192),
            ],
        );
        assert_eq!(
            weigh(&image, Some(Chip::Esp32c3)).expect("ELF"),
            Weight {
                flash: 1170,
                ram: 370,
                stack: Some(8192),
            }
        );
        assert_eq!(weigh(&image, None).expect("ELF").ram, 320);
    }

    #[test]
    fn what_is_no_elf_is_refused() {
        assert!(weigh(b"no", None).is_err());
        assert!(weigh(&[], None).is_err());
    }

    #[test]
    fn symbols_name_their_crate() {
        for (symbol, owner) in [
            (
                "_ZN11crawler_app7control4step17h0123456789abcdefE",
                "crawler_app",
            ),
            ("_RNvNtCs1234_11crawler_app7control4step", "crawler_app"),
            ("memcpy", "(no crate)"),
            ("", "(no crate)"),
            ("_RNvXs_CsAbc_4coreuNtB2_3Foo3bar", "(no crate)"),
        ] {
            assert_eq!(crate_of(symbol), owner, "{symbol}");
        }
    }
}
