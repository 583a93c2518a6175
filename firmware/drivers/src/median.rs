//! Median filter for ranges.
//!
//! A median, and not a mean: an ultrasonic ranger errs by whole metres at a time (a lost echo, the
//! burst of another robot), and a mean would spread one such error over the whole window.

use crawler_hal::Millimeters;

/// The median of the last `N` ranges.
///
/// `N` is odd, which is checked at compile time. While fewer than `N` ranges have come, the median
/// is that of those that have; of an even number, the nearer of the two in the middle, because a
/// robot that believes an obstacle nearer than it is errs on the safe side.
#[derive(Debug, Clone, PartialEq, Eq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(bound(
        serialize = "[Millimeters; N]: serde::Serialize",
        deserialize = "[Millimeters; N]: serde::Deserialize<'de>"
    ))
)]
pub struct Median<const N: usize> {
    /// A ring: the oldest is overwritten.
    window: [Millimeters; N],
    #[cfg_attr(feature = "serde", serde(deserialize_with = "place::<_, N>"))]
    next: usize,
    #[cfg_attr(feature = "serde", serde(deserialize_with = "place::<_, N>"))]
    filled: usize,
}

/// A count that cannot lead out of a window of `N`, whatever was written.
#[cfg(feature = "serde")]
fn place<'de, D: serde::Deserializer<'de>, const N: usize>(from: D) -> Result<usize, D::Error> {
    let place = <usize as serde::Deserialize>::deserialize(from)?;
    if place <= N {
        Ok(place)
    } else {
        Err(serde::de::Error::custom("outside of the window"))
    }
}

impl<const N: usize> Median<N> {
    /// An empty window.
    #[must_use]
    pub const fn new() -> Self {
        const { assert!(N % 2 == 1, "the window of a median has an odd length") };
        Self {
            window: [Millimeters(0); N],
            next: 0,
            filled: 0,
        }
    }

    /// Takes one range in and returns the median of the window.
    pub fn push(&mut self, range: Millimeters) -> Millimeters {
        if let Some(slot) = self.window.get_mut(self.next) {
            *slot = range;
        }
        self.next = (self.next + 1) % N;
        self.filled = (self.filled + 1).min(N);
        self.median().unwrap_or(range)
    }

    /// The median of the window; `None` while it is empty.
    #[must_use]
    pub fn median(&self) -> Option<Millimeters> {
        let mut sorted = self.window;
        // Before the ring is full, its first `filled` slots are the ones written.
        let sorted = sorted.get_mut(..self.filled)?;
        sorted.sort_unstable();
        sorted.get(self.filled.checked_sub(1)? / 2).copied()
    }

    /// Forgets everything: what came before a gap says nothing about what comes after it.
    pub fn clear(&mut self) {
        *self = Self::new();
    }
}

impl<const N: usize> Default for Median<N> {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests;
