//! How long a chip takes.
//!
//! Typical times of a Winbond W25Q64JV (data sheet, revision I, 22 November 2017, "AC Electrical
//! Characteristics"); modules with an ESP32 carry chips like it. The longest that it allows are three to
//! thirteen times as long.

use crawler_hal::Duration;

use super::ERASE_BYTES;

/// Bytes that are programmed at once.
pub(super) const PAGE_BYTES: usize = 256;

/// `t_BP1`: the first byte of a page.
const FIRST_BYTE_NS: u64 = 30_000;
/// `t_BP2`: each byte behind it.
const NEXT_BYTE_NS: u64 = 2_500;
/// `t_PP`: a whole page, which is less than its bytes one by one.
const PAGE_NS: u64 = 400_000;
/// `t_SE`: a sector of 4 KiB.
const SECTOR_MS: u64 = 45;
/// `t_BE1`: a block of 32 KiB.
const HALF_BLOCK_MS: u64 = 120;
/// `t_BE2`: a block of 64 KiB.
const BLOCK_MS: u64 = 150;

/// Sectors of the larger blocks.
const BLOCK_SECTORS: u32 = 16;
const HALF_BLOCK_SECTORS: u32 = 8;

/// How long programming so many bytes of a page takes.
pub(super) fn program(bytes: usize) -> Duration {
    let behind = bytes.saturating_sub(1) as u64;
    let ns = (FIRST_BYTE_NS + NEXT_BYTE_NS * behind).min(PAGE_NS);
    Duration::from_micros(ns.div_ceil(1_000))
}

/// The largest block that begins at `from` and does not go past `to`, both multiples of a sector: its bytes,
/// and how long erasing it takes.
pub(super) fn erase(from: u32, to: u32) -> (u32, Duration) {
    let sector = ERASE_BYTES as u32;
    let fits = |sectors: u32| {
        from.is_multiple_of(sectors * sector) && to.saturating_sub(from) >= sectors * sector
    };
    let (sectors, ms) = if fits(BLOCK_SECTORS) {
        (BLOCK_SECTORS, BLOCK_MS)
    } else if fits(HALF_BLOCK_SECTORS) {
        (HALF_BLOCK_SECTORS, HALF_BLOCK_MS)
    } else {
        (1, SECTOR_MS)
    };
    (sectors * sector, Duration::from_millis(ms))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_those_of_the_data_sheet() {
        for (bytes, us) in [(1, 30), (4, 38), (100, 278), (149, 400), (256, 400)] {
            assert_eq!(program(bytes), Duration::from_micros(us), "{bytes}");
        }
        let (half, block) = (0x8000, 0x1_0000);
        for (from, to, bytes, ms) in [
            (0, 4_096, 4_096, 45),
            (4_096, 3 * block, 4_096, 45),
            (half, 3 * block, half, 120),
            (0, block - 4_096, half, 120),
            (block, 2 * block, block, 150),
            (0, 9 * block, block, 150),
        ] {
            assert_eq!(
                erase(from, to),
                (bytes, Duration::from_millis(ms)),
                "{from}..{to}"
            );
        }
    }
}
