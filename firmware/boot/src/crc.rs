//! CRC-32 as the ROM of the ESP32 family computes it.

/// Reversed polynomial of CRC-32 (IEEE 802.3, 3.2.9).
const POLYNOMIAL: u32 = 0xEDB8_8320;

/// Continues the CRC-32 `crc` over `bytes`; `0` begins a plain CRC-32. Same as `esp_rom_crc32_le`, and
/// as `crc32` of zlib.
///
/// Bit by bit, without a table: a robot checks a kilobyte per start, and a table is a kilobyte of flash.
#[must_use]
// Once in flash, not at each of its callers.
#[inline(never)]
pub const fn crc32_le(crc: u32, bytes: &[u8]) -> u32 {
    let mut register = !crc;
    let mut at = 0;
    while at < bytes.len() {
        register ^= bytes[at] as u32;
        let mut bit = 0;
        while bit < 8 {
            register = (register >> 1) ^ (POLYNOMIAL & (register & 1).wrapping_neg());
            bit += 1;
        }
        at += 1;
    }
    !register
}

#[cfg(test)]
mod tests {
    use super::crc32_le;

    #[test]
    fn gives_the_check_value_of_the_catalogue() {
        assert_eq!(crc32_le(0, b"123456789"), 0xCBF4_3926);
        let (head, tail) = b"123456789".split_at(4);
        assert_eq!(crc32_le(crc32_le(0, head), tail), 0xCBF4_3926);
    }

    /// Values that ESP-IDF's otatool.py writes: `zlib.crc32(sequence, 0xFFFFFFFF)`.
    #[test]
    fn gives_the_values_of_select_entries() {
        assert_eq!(crc32_le(u32::MAX, &1_u32.to_le_bytes()), 0x4743_989A);
        assert_eq!(crc32_le(u32::MAX, &2_u32.to_le_bytes()), 0x55F6_3774);
    }
}
