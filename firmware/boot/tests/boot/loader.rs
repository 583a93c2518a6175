//! A bootloader's decision, written a second time from the description of ESP-IDF, on raw bytes.

/// CRC-32 with the register starting at 0, as the ROM does when it is handed `0xFFFF_FFFF`: long division,
/// bit by bit.
fn rom_crc(sequence: u32) -> u32 {
    let mut rest = u64::from(sequence.reverse_bits()) << 32;
    for shift in (32..64).rev() {
        if rest >> shift & 1 == 1 {
            rest ^= 0x1_04C1_1DB7 << (shift - 32);
        }
    }
    !(rest as u32).reverse_bits()
}

fn word(entry: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(entry[at..at + 4].try_into().unwrap())
}

/// What `bootloader_utility_get_selected_boot_partition` gives without a factory partition: the index, where
/// -1 is that of the factory partition, and whether the entries count as never written.
pub(crate) fn plain(entries: [&[u8]; 2], slots: u32) -> (i32, bool) {
    let sequence = entries.map(|entry| word(entry, 0));
    let blank = sequence.map(|number| number == 0xFFFF_FFFF);
    let refused = entries.map(|entry| [3, 4].contains(&word(entry, 24)));
    let fits = [0, 1].map(|i| word(entries[i], 28) == rom_crc(sequence[i]));
    if (blank[0] || refused[0]) && (blank[1] || refused[1]) {
        let initial = (blank[0] || !fits[0]) && (blank[1] || !fits[1]);
        return (0, initial);
    }
    let best = (0..2)
        .filter(|&i| !blank[i] && !refused[i] && fits[i])
        .map(|i| sequence[i])
        .max();
    (
        best.map_or(-1, |number| (number.wrapping_sub(1) % slots) as i32),
        false,
    )
}

/// As [`plain`], with rollback: the entries as the bootloader leaves them as well.
pub(crate) fn rolls_back(mut entries: [[u8; 32]; 2], slots: u32) -> (i32, bool, [[u8; 32]; 2]) {
    for entry in &mut entries {
        if word(entry, 24) == 1 {
            entry[24] = 4;
        }
    }
    let (index, initial) = plain([&entries[0], &entries[1]], slots);
    // The one that won: both may have the same sequence number, and then it is the first.
    let winner = (0..2)
        .filter(|&i| {
            let sequence = word(&entries[i], 0);
            sequence != u32::MAX
                && ![3, 4].contains(&word(&entries[i], 24))
                && word(&entries[i], 28) == rom_crc(sequence)
        })
        .max_by_key(|&i| (word(&entries[i], 0), -(i as i32)));
    if let Some(winner) = winner
        && word(&entries[winner], 24) == 0
    {
        entries[winner][24] = 1;
    }
    (index, initial, entries)
}

/// The order in which slots are tried.
pub(crate) fn order(index: i32, slots: i32) -> Vec<usize> {
    let mut order = Vec::new();
    let mut down = index;
    while down >= 0 {
        order.push(down as usize);
        down -= 1;
    }
    let mut up = index + 1;
    while up < slots {
        order.push(up as usize);
        up += 1;
    }
    order
}
