//! The hours of the day in which robots may be offered a release.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

const MINUTE_MS: u64 = 60_000;
const DAY_MS: u64 = 24 * 60 * MINUTE_MS;
/// The largest distance of a local time from UTC, in minutes: +14:00 on Kiritimati.
pub const MOST_OFFSET_MINUTES: i16 = 14 * 60;

/// A text that is no time of day.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NoTimeOfDay;

impl fmt::Display for NoTimeOfDay {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a time of day is written HH:MM, from 00:00 to 23:59")
    }
}

impl std::error::Error for NoTimeOfDay {}

/// Hours and minutes, as `22:30`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct TimeOfDay {
    /// Minutes since midnight, below 1,440.
    minutes: u16,
}

impl TimeOfDay {
    /// Minutes since midnight, below 1,440.
    #[must_use]
    pub const fn minutes(self) -> u16 {
        self.minutes
    }
}

impl FromStr for TimeOfDay {
    type Err = NoTimeOfDay;

    fn from_str(text: &str) -> Result<Self, NoTimeOfDay> {
        let (hours, minutes) = text.split_once(':').ok_or(NoTimeOfDay)?;
        let number = |text: &str, below: u16| {
            let digits = text.len() == 2 && text.bytes().all(|byte| byte.is_ascii_digit());
            let number: u16 = text.parse().map_err(|_| NoTimeOfDay)?;
            if digits && number < below {
                Ok(number)
            } else {
                Err(NoTimeOfDay)
            }
        };
        let minutes = number(hours, 24)? * 60 + number(minutes, 60)?;
        Ok(Self { minutes })
    }
}

impl TryFrom<String> for TimeOfDay {
    type Error = NoTimeOfDay;

    fn try_from(text: String) -> Result<Self, NoTimeOfDay> {
        text.parse()
    }
}

impl fmt::Display for TimeOfDay {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:02}:{:02}", self.minutes / 60, self.minutes % 60)
    }
}

impl From<TimeOfDay> for String {
    fn from(time: TimeOfDay) -> Self {
        time.to_string()
    }
}

/// A stretch of every day; it may cross midnight.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[schema(as = RolloutWindow)]
#[serde(deny_unknown_fields)]
pub struct Window {
    /// When it opens.
    #[schema(value_type = String, pattern = "^([01][0-9]|2[0-3]):[0-5][0-9]$")]
    pub from: TimeOfDay,
    /// When it closes. Before `from`, that is on the next day.
    #[schema(value_type = String, pattern = "^([01][0-9]|2[0-3]):[0-5][0-9]$")]
    pub to: TimeOfDay,
    /// How far the times of day are ahead of UTC, in minutes. It does not follow daylight saving time.
    #[serde(default)]
    pub offset_minutes: i16,
}

impl Window {
    /// Whether it is open at this Unix time.
    #[must_use]
    pub fn is_open(self, unix_ms: u64) -> bool {
        self.since_opening_ms(unix_ms) < self.length_ms()
    }

    /// In how many milliseconds from this Unix time on it opens; 0 while it is open.
    #[must_use]
    pub fn opens_in_ms(self, unix_ms: u64) -> u64 {
        if self.is_open(unix_ms) {
            0
        } else {
            DAY_MS - self.since_opening_ms(unix_ms)
        }
    }

    /// How long it is open each day.
    #[must_use]
    pub fn length_ms(self) -> u64 {
        let day = DAY_MS / MINUTE_MS;
        let to = u64::from(self.to.minutes) + day;
        (to - u64::from(self.from.minutes)) % day * MINUTE_MS
    }

    /// Milliseconds since it opened last, below a day.
    fn since_opening_ms(self, unix_ms: u64) -> u64 {
        let opens = i64::from(self.from.minutes) - i64::from(self.offset_minutes);
        let opens = opens.rem_euclid((DAY_MS / MINUTE_MS) as i64) as u64 * MINUTE_MS;
        (unix_ms % DAY_MS + DAY_MS - opens) % DAY_MS
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn window(from: &str, to: &str, offset_minutes: i16) -> Window {
        Window {
            from: from.parse().unwrap(),
            to: to.parse().unwrap(),
            offset_minutes,
        }
    }

    fn at(hours: u64, minutes: u64) -> u64 {
        20_000 * DAY_MS + (hours * 60 + minutes) * MINUTE_MS
    }

    #[test]
    fn it_opens_and_closes_on_time() {
        for (from, to, offset, hours, minutes, open, opens_in_minutes) in [
            ("01:00", "05:00", 0, 0, 59, false, 1),
            ("01:00", "05:00", 0, 1, 0, true, 0),
            ("01:00", "05:00", 0, 4, 59, true, 0),
            ("01:00", "05:00", 0, 5, 0, false, 20 * 60),
            // Across midnight.
            ("22:00", "04:30", 0, 23, 59, true, 0),
            ("22:00", "04:30", 0, 4, 29, true, 0),
            ("22:00", "04:30", 0, 4, 30, false, 17 * 60 + 30),
            // 01:00 two hours ahead of UTC is 23:00 of the day before.
            ("01:00", "02:00", 120, 22, 59, false, 1),
            ("01:00", "02:00", 120, 23, 0, true, 0),
            // 22:00 five and a half hours behind UTC is 03:30 of the next day.
            ("22:00", "23:00", -330, 3, 30, true, 0),
            ("22:00", "23:00", -330, 4, 30, false, 23 * 60),
        ] {
            let window = window(from, to, offset);
            let now = at(hours, minutes);
            let what = format!("{window:?} at {hours}:{minutes:02}");
            assert_eq!(window.is_open(now), open, "{what}");
            assert_eq!(
                window.opens_in_ms(now),
                opens_in_minutes * MINUTE_MS,
                "{what}"
            );
        }
    }

    #[test]
    fn only_times_of_day_are_read() {
        for text in [
            "", ":", "24:00", "12:60", "1:00", "001:00", "+1:00", "12:3", "12", "12:30:00", "ab:cd",
        ] {
            assert_eq!(text.parse::<TimeOfDay>(), Err(NoTimeOfDay), "{text:?}");
        }
        let json = r#"{"from":"22:00","to":"04:05","offset_minutes":60}"#;
        let window: Window = serde_json::from_str(json).unwrap();
        assert_eq!(serde_json::to_string(&window).unwrap(), json);
    }

    proptest! {
        #[test]
        fn it_is_open_when_it_says_so(
            from in 0_u16..1_440, to in 0_u16..1_440, offset_minutes in -840_i16..=840, now: u64,
        ) {
            let window = Window {
                from: TimeOfDay { minutes: from },
                to: TimeOfDay { minutes: to },
                offset_minutes,
            };
            let now = now / 2;
            let wait = window.opens_in_ms(now);
            prop_assert!(wait <= DAY_MS);
            if from != to {
                prop_assert!(window.is_open(now + wait));
                prop_assert!(wait == 0 || !window.is_open(now + wait - 1));
            }
        }
    }
}
