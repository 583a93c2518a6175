//! How many bytes may go out: a token bucket.

/// Thousandths of a byte: what a rate in bytes per second adds each millisecond.
type Milli = u64;

/// Lets bytes pass at a rate. In any stretch of time pass at most those of the rate, and a second's worth more.
#[derive(Debug, Clone)]
pub(super) struct Bucket {
    /// Bytes per second, and the most that it holds; no limit without.
    rate: Option<u32>,
    tokens: Milli,
    filled_ms: u64,
}

impl Bucket {
    /// An empty one: a server that was killed just after it sent a second's worth does not send another.
    pub(super) const fn new(rate: Option<u32>, now_ms: u64) -> Self {
        Self {
            rate,
            tokens: 0,
            filled_ms: now_ms,
        }
    }

    /// Takes `bytes` out.
    ///
    /// # Errors
    /// In how many milliseconds they are there, if nobody else takes them; `None` when they never are.
    pub(super) fn take(&mut self, bytes: u32, now_ms: u64) -> Result<(), Option<u64>> {
        let Some(rate) = self.rate else {
            return Ok(());
        };
        let passed = now_ms.saturating_sub(self.filled_ms);
        self.filled_ms = self.filled_ms.max(now_ms);
        let (full, wanted) = (Milli::from(rate) * 1_000, Milli::from(bytes) * 1_000);
        let added = passed.saturating_mul(rate.into());
        self.tokens = self.tokens.saturating_add(added).min(full);
        if wanted > full {
            return Err(None);
        }
        if let Some(left) = self.tokens.checked_sub(wanted) {
            self.tokens = left;
            return Ok(());
        }
        Err(Some((wanted - self.tokens).div_ceil(rate.into())))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn it_starts_empty_and_says_when() {
        let mut bucket = Bucket::new(Some(10_000), 500);
        assert_eq!(bucket.take(1_000, 500), Err(Some(100)));
        assert_eq!(bucket.take(1_000, 599), Err(Some(1)));
        assert_eq!(bucket.take(1_000, 600), Ok(()));
        assert_eq!(bucket.take(10_001, 9_000), Err(None));
        assert_eq!(bucket.take(10_000, 9_000), Ok(()));
        assert_eq!(bucket.take(1, 8_000), Err(Some(1)));
        assert_eq!(Bucket::new(None, 0).take(u32::MAX, 0), Ok(()));
    }

    proptest! {
        #[test]
        fn the_rate_holds_over_any_stretch(
            rate in 1_u32..100_000,
            asked in proptest::collection::vec((0_u64..500, 0_u32..5_000), 1..100),
        ) {
            let mut bucket = Bucket::new(Some(rate), 0);
            let mut passed = Vec::new();
            let mut now = 0;
            for (pause, bytes) in asked {
                now += pause;
                match bucket.take(bytes, now) {
                    Ok(()) => passed.push((now, u64::from(bytes))),
                    Err(Some(wait)) => {
                        prop_assert!(wait > 0);
                        let mut later = bucket.clone();
                        prop_assert!(later.take(bytes, now + wait - 1).is_err());
                        prop_assert_eq!(later.take(bytes, now + wait), Ok(()));
                    }
                    Err(None) => prop_assert!(bytes > rate),
                }
            }
            for (at, &(from, _)) in passed.iter().enumerate() {
                let mut sum = 0;
                for &(until, bytes) in &passed[at..] {
                    sum += bytes;
                    let most = u64::from(rate) * (until - from + 1_000);
                    prop_assert!(sum * 1_000 <= most, "{sum} bytes from {from} to {until}");
                }
            }
        }
    }
}
