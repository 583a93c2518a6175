//! Numbers of commands that rise across servers without asking anybody.
//!
//! A number is the time, in 64ths of a millisecond, times sixteen, plus the server's slot. Two
//! servers never give the same one, and whoever gives one later gives a greater one, as far as their
//! clocks agree; the time is that of Redis, which all of them can see. A server that hears of a
//! greater number goes on above it.

use crate::SLOTS;

/// Numbers of one slot in a millisecond. Sixteen slots of it stay below 2^53 until the year 2248.
pub const TICKS_PER_MS: u64 = 64;
/// How far a server may reserve numbers ahead of its clock: more than a minute of them.
pub const LONGEST_BLOCK: u64 = 100_000 * TICKS_PER_MS * SLOTS as u64;

/// How a server numbers its commands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Numbers {
    slot: u8,
    /// What the shared clock is ahead of ours, in microseconds.
    ahead_us: i64,
}

impl Numbers {
    /// The numbers of a slot, by a clock that is `ahead_us` microseconds ahead of the caller's.
    ///
    /// # Panics
    /// When there is no such slot.
    #[must_use]
    pub const fn new(slot: u8, ahead_us: i64) -> Self {
        assert!(slot < SLOTS, "a slot");
        Self { slot, ahead_us }
    }

    /// The slot.
    #[must_use]
    pub const fn slot(&self) -> u8 {
        self.slot
    }

    /// The least number of this slot that is not below `least` nor before the time `unix_us`, which
    /// is the caller's.
    #[must_use]
    pub const fn next(&self, unix_us: u64, least: u64) -> u64 {
        let now = unix_us.saturating_add_signed(self.ahead_us);
        // In this order nothing overflows before the year 292,000.
        let ticks = now.saturating_mul(TICKS_PER_MS) / 1_000;
        let timely = ticks.saturating_mul(SLOTS as u64);
        let least = if timely > least { timely } else { least };
        let (whole, rest) = (least / SLOTS as u64, least % SLOTS as u64);
        let whole = if rest > self.slot as u64 {
            whole + 1
        } else {
            whole
        };
        whole * SLOTS as u64 + self.slot as u64
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// 2200-01-01.
    const LATEST_US: u64 = 7_258_118_400_000_000;

    proptest! {
        /// Whatever the clocks do, numbers rise, no two servers give the same one, and every reader
        /// of JSON can count to them.
        #[test]
        fn numbers_rise_and_belong_to_one_slot(
            slots in proptest::collection::vec((0..SLOTS, -5_000_000_i64..5_000_000), 1..5),
            steps in proptest::collection::vec((0..5_usize, 0..LATEST_US), 1..200),
        ) {
            let mut last = vec![0_u64; slots.len()];
            for (which, now) in steps {
                let which = which % slots.len();
                let (slot, ahead) = slots[which];
                let number = Numbers::new(slot, ahead).next(now, last[which] + 1);
                prop_assert!(number > last[which]);
                prop_assert_eq!(number % u64::from(SLOTS), u64::from(slot));
                prop_assert!(number < 1 << 53);
                last[which] = number;
            }
        }

        /// A server that has heard of another's number goes on above it, whatever its clock says;
        /// without having heard, it is the clock that orders.
        #[test]
        fn who_knows_of_a_number_goes_above_it(
            a in 0..SLOTS, b in 0..SLOTS, now in 0..LATEST_US, later in 16_u64..1_000_000,
        ) {
            let first = Numbers::new(a, 0).next(now, 0);
            prop_assert!(Numbers::new(b, -3_000_000).next(now, first + 1) > first);
            prop_assert!(Numbers::new(b, 0).next(now + 2 * later, 0) > first);
        }
    }
}
