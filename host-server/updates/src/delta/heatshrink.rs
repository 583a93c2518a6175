//! Compression by heatshrink, as small as its format allows.
//!
//! A byte costs 9 bits and a copy of any length a fixed number, so of all ways to write something down the
//! cheapest takes, wherever it copies, the longest copy that there is: what follows never gets dearer by being
//! shorter. So it is found from the end, by one comparison at each place.

use crawler_delta::{LEAST_LENGTH_BITS, LEAST_WINDOW_BITS};

/// Bits of a byte that is not copied: a mark and the byte.
const BYTE_BITS: u32 = 9;

/// The longest copy of earlier bytes at one place. Its length is 0 where there is none.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Match {
    distance: u16,
    length: u16,
}

/// The longest copy at each place of `data`, with a window of 2^`window_bits` bytes, which are zeros before the
/// first. No match is longer than the window. Takes as many steps as `data` has bytes times the window's,
/// whatever they are.
pub(super) fn matches(data: &[u8], window_bits: u8) -> Vec<Match> {
    let window = 1_usize << window_bits;
    let padded = [&vec![0; window], data].concat();
    // For each distance, the farthest first: how many bytes from here on are those so far back.
    let mut runs = vec![0_u16; window];
    let mut found = Vec::with_capacity(data.len());
    for (at, byte) in data.iter().enumerate().rev() {
        let mut longest = 0;
        for (run, before) in runs.iter_mut().zip(&padded[at..at + window]) {
            let longer = run.saturating_add(1).min(window as u16);
            *run = if before == byte { longer } else { 0 };
            longest = longest.max(*run);
        }
        let place = runs.iter().rposition(|run| *run == longest);
        found.push(Match {
            distance: place.map_or(0, |place| (window - place) as u16),
            length: longest,
        });
    }
    found.reverse();
    found
}

/// Compresses `data`, of which the matches are known, behind a byte with the parameters as detools writes them.
pub(super) fn compress(
    data: &[u8],
    matches: &[Match],
    window_bits: u8,
    length_bits: u8,
) -> Vec<u8> {
    let most = 1 << length_bits;
    let copy_bits = 1 + u32::from(window_bits) + u32::from(length_bits);
    // Bits that it takes from each place on, and whether they begin with a copy.
    let mut costs = vec![0; data.len() + 1];
    let mut copied = vec![false; data.len()];
    for (at, copy) in matches.iter().enumerate().rev() {
        let byte = BYTE_BITS + costs[at + 1];
        costs[at] = byte;
        if copy.length > 0 {
            let cost = copy_bits + costs[at + usize::from(copy.length.min(most))];
            if cost < byte {
                costs[at] = cost;
                copied[at] = true;
            }
        }
    }
    let head = (window_bits - LEAST_WINDOW_BITS) << 4 | (length_bits - LEAST_LENGTH_BITS);
    let mut bits = Bits::after(head);
    let mut at = 0;
    while at < data.len() {
        if copied[at] {
            let length = matches[at].length.min(most);
            bits.push(0, 1);
            bits.push(matches[at].distance - 1, window_bits);
            bits.push(length - 1, length_bits);
            at += usize::from(length);
        } else {
            bits.push(1, 1);
            bits.push(data[at].into(), 8);
            at += 1;
        }
    }
    bits.finish()
}

/// Bytes that are written bit by bit, the highest first.
struct Bits {
    out: Vec<u8>,
    held: u32,
    count: u8,
}

impl Bits {
    fn after(head: u8) -> Self {
        Self {
            out: vec![head],
            held: 0,
            count: 0,
        }
    }

    /// Appends the lowest `count` bits of `value`, at most 16.
    fn push(&mut self, value: u16, count: u8) {
        self.held = self.held << count | u32::from(value);
        self.count += count;
        while self.count >= 8 {
            self.count -= 8;
            self.out.push((self.held >> self.count) as u8);
        }
    }

    /// Fills the last byte up with zeros.
    fn finish(mut self) -> Vec<u8> {
        if self.count > 0 {
            self.push(0, 8 - self.count);
        }
        self.out
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// The longest match at a place, by looking at every distance.
    fn longest(data: &[u8], at: usize, window: usize) -> usize {
        let before = |at: usize, distance: usize| at.checked_sub(distance).map_or(0, |at| data[at]);
        let run = |distance: usize| {
            let run = (at..data.len()).take_while(|at| data[*at] == before(*at, distance));
            run.count()
        };
        (1..=window).map(run).max().unwrap_or(0).min(window)
    }

    /// The fewest bits that a place and what follows can take, by trying every copy.
    fn fewest(data: &[u8], window_bits: u8, length_bits: u8) -> u32 {
        let mut costs = vec![0; data.len() + 1];
        for at in (0..data.len()).rev() {
            let length = longest(data, at, 1 << window_bits).min(1 << length_bits);
            let copy = 1 + u32::from(window_bits) + u32::from(length_bits);
            let copies = (1..=length).map(|length| copy + costs[at + length]);
            costs[at] = copies.fold(BYTE_BITS + costs[at + 1], u32::min);
        }
        costs[0]
    }

    proptest! {
        #[test]
        fn what_is_found_is_the_longest(data in prop::collection::vec(0_u8..3, 0..200)) {
            for (at, found) in matches(&data, 4).iter().enumerate() {
                prop_assert_eq!(usize::from(found.length), longest(&data, at, 16), "{}", at);
                if found.length > 0 {
                    prop_assert!((1..=16).contains(&found.distance));
                }
            }
        }

        #[test]
        fn nothing_is_smaller(
            data in prop::collection::vec(0_u8..3, 1..150),
            (window_bits, length_bits) in (4_u8..6).prop_flat_map(|bits| (Just(bits), 3..bits)),
        ) {
            let found = matches(&data, window_bits);
            let compressed = compress(&data, &found, window_bits, length_bits);
            let bits = fewest(&data, window_bits, length_bits);
            prop_assert_eq!(compressed.len(), 1 + bits.div_ceil(8) as usize);
        }
    }
}
