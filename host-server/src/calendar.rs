//! Moments and days, as people read them.

/// A moment for people: UTC, to the second. Nothing here happened before 1970 or after 9999.
pub(crate) fn moment(unix_ms: i64) -> String {
    let seconds = unix_ms.clamp(0, 253_402_300_799_999) / 1_000;
    let of_day = seconds % 86_400;
    let (year, month, day) = date(seconds / 86_400);
    format!(
        "{year:04}-{month:02}-{day:02} {:02}:{:02}:{:02}Z",
        of_day / 3_600,
        of_day / 60 % 60,
        of_day % 60
    )
}

/// The day that is `days` after 1970-01-01.
pub(crate) fn date(days: i64) -> (i64, i64, i64) {
    // Days from 0000-03-01, so that a leap day is the last of its year.
    let days = days + 719_468;
    let before = |year: i64| 365 * year + year / 4 - year / 100 + year / 400;
    // Never too late, since no year is longer.
    let mut year = days / 366;
    while before(year + 1) <= days {
        year += 1;
    }
    let of_year = days - before(year);
    // From March on, five months have 153 days.
    let month = (5 * of_year + 2) / 153;
    let day = of_year - (153 * month + 2) / 5 + 1;
    if month < 10 {
        (year, month + 3, day)
    } else {
        (year + 1, month - 9, day)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_are_those_of_the_calendar() {
        for (unix_ms, text) in [
            (0, "1970-01-01 00:00:00Z"),
            (951_782_400_000, "2000-02-29 00:00:00Z"),
            (951_868_800_000, "2000-03-01 00:00:00Z"),
            (1_648_372_964_000, "2022-03-27 09:22:44Z"),
            (1_709_251_199_999, "2024-02-29 23:59:59Z"),
            (1_735_689_599_000, "2024-12-31 23:59:59Z"),
            (4_102_444_800_000, "2100-01-01 00:00:00Z"),
            (4_107_542_400_000, "2100-03-01 00:00:00Z"),
        ] {
            assert_eq!(moment(unix_ms), text);
        }
        // Whatever a damaged record says, there is an answer.
        assert_eq!(moment(i64::MIN), "1970-01-01 00:00:00Z");
        assert_eq!(moment(i64::MAX), "9999-12-31 23:59:59Z");
    }
}
