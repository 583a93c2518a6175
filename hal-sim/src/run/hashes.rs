//! Fingerprints of a history, second by second.

use std::fmt;

use crawler_hal::Instant;

use crate::world::Fingerprint;

/// Most seconds that are kept: 48 days.
const MAX_SECONDS: usize = 1 << 22;

/// The fingerprints of a history at the end of each second.
///
/// Each is the sum of what the robots contribute, so that those of a world's shards add up to that
/// of the world.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Hashes(Vec<u64>);

/// The fingerprint of a history at the end of a second. Its text is a line for a log.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SecondHash {
    /// How many seconds had passed.
    pub second: u64,
    /// The fingerprint.
    pub hash: u64,
}

impl fmt::Display for SecondHash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "second {} hash {:016x}", self.second, self.hash)
    }
}

impl Hashes {
    /// All of them, the first second first.
    pub fn iter(&self) -> impl Iterator<Item = SecondHash> {
        let numbered = (1..).zip(&self.0);
        numbered.map(|(second, &hash)| SecondHash { second, hash })
    }

    /// All of them as mere numbers.
    #[must_use]
    pub fn as_slice(&self) -> &[u64] {
        &self.0
    }

    /// The first second in which this history and `other` differ; `None` when they are alike as
    /// long as both last.
    #[must_use]
    pub fn first_difference(&self, other: &Self) -> Option<u64> {
        let differs = self.0.iter().zip(&other.0).position(|(a, b)| a != b);
        differs.map(|index| index as u64 + 1)
    }

    pub(super) fn push(&mut self, share: u64) {
        if self.0.len() < MAX_SECONDS {
            self.0.push(share);
        }
    }

    /// Adds those of another shard of the same run.
    pub(super) fn add(&mut self, other: &Self) {
        debug_assert_eq!(self.0.len(), other.0.len());
        for (share, more) in self.0.iter_mut().zip(&other.0) {
            *share = share.wrapping_add(*more);
        }
    }
}

/// The fingerprint of a history, from the sum of its robots' shares.
pub(super) fn total(at: Instant, shares: u64) -> u64 {
    let mut print = Fingerprint::new();
    print.word(at.as_micros());
    print.word(shares);
    print.value()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hashes(shares: &[u64]) -> Hashes {
        let mut hashes = Hashes::default();
        for &share in shares {
            hashes.push(share);
        }
        hashes
    }

    #[test]
    fn the_first_difference_is_found_and_only_in_seconds_that_both_have() {
        let one = hashes(&[5, 6, 7]);
        assert_eq!(one.first_difference(&one), None);
        assert_eq!(one.first_difference(&hashes(&[5, 0, 0])), Some(2));
        assert_eq!(one.first_difference(&hashes(&[5, 6])), None);
        let lines: Vec<String> = one.iter().map(|second| second.to_string()).collect();
        assert_eq!(lines[1], "second 2 hash 0000000000000006");
        assert_eq!(lines.len(), 3);
    }

    #[test]
    fn shares_add_up_in_any_order() {
        let (mut a, mut b) = (hashes(&[5, u64::MAX]), hashes(&[7, 9]));
        let first = a.clone();
        a.add(&b);
        b.add(&first);
        assert_eq!(a, b);
        assert_eq!(a.as_slice(), [12, 8]);
    }
}
