//! How often a property is tried.
//!
//! proptest obeys `PROPTEST_CASES` only where a property says no number of its own. Those that do, because a case of
//! theirs takes long or hardly any time, say it here: the deep tier then tries them as many times more as the
//! others, and Miri as many times fewer.

use proptest::test_runner::Config;

/// What proptest tries where nobody says a number.
const USUAL: u64 = 256;

/// `cases` where `PROPTEST_CASES` is not set; else more or fewer of them, in the proportion of that to 256. At least one.
#[must_use]
pub fn cases(cases: u32) -> Config {
    scaled(cases, Config::default())
}

fn scaled(cases: u32, told: Config) -> Config {
    let cases = u64::from(cases) * u64::from(told.cases) / USUAL;
    Config {
        cases: u32::try_from(cases).unwrap_or(u32::MAX).max(1),
        ..told
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_of_its_own_is_scaled_as_that_of_the_others() {
        let tried = |own, told| scaled(own, Config::with_cases(told)).cases;
        assert_eq!(tried(64, 256), 64);
        assert_eq!(tried(24, 2_000), 187);
        assert_eq!(tried(2_000, 8), 62);
        assert_eq!(tried(8, 8), 1, "never none");
        assert_eq!(tried(u32::MAX, u32::MAX), u32::MAX);
    }
}
