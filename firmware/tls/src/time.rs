//! Points in time, as certificates write them.

use crate::der::{Der, GENERALIZED_TIME, UTC_TIME};
use crate::error::TlsError;

const WRONG: TlsError = TlsError::BadCertificate;
const DAY: u64 = 24 * 60 * 60;

/// Reads a time (RFC 5280, section 4.1.2.5), in seconds since 1970.
pub(crate) fn read(der: &mut Der<'_>) -> Result<u64, TlsError> {
    let value = der.next()?;
    let (year, rest) = match (value.tag, value.content) {
        (UTC_TIME, [a, b, rest @ ..]) => {
            let year = two(*a, *b)?;
            (if year < 50 { 2000 + year } else { 1900 + year }, rest)
        }
        (GENERALIZED_TIME, [a, b, c, d, rest @ ..]) => (100 * two(*a, *b)? + two(*c, *d)?, rest),
        _ => return Err(WRONG),
    };
    let [mo, nth, d, ay, h, our, m, in_, s, ec, b'Z'] = rest else {
        return Err(WRONG);
    };
    let (month, day) = (two(*mo, *nth)?, two(*d, *ay)?);
    let (hour, minute, second) = (two(*h, *our)?, two(*m, *in_)?, two(*s, *ec)?);
    let leap = (year % 4 == 0 && year % 100 != 0) || year % 400 == 0;
    let days = match month {
        4 | 6 | 9 | 11 => 30,
        2 if leap => 29,
        2 => 28,
        1..=12 => 31,
        _ => return Err(WRONG),
    };
    if !(1970..=9999).contains(&year) || !(1..=days).contains(&day) {
        return Err(WRONG);
    }
    if hour > 23 || minute > 59 || second > 59 {
        return Err(WRONG);
    }
    // With years that begin in March a leap day is the last of its year.
    let (march_year, march_month) = if month > 2 {
        (year, month - 3)
    } else {
        (year - 1, month + 9)
    };
    let before = 365 * march_year + march_year / 4 - march_year / 100 + march_year / 400;
    let in_year = (153 * march_month + 2) / 5 + day - 1;
    // Days from the first of March of the year 0 to the first of January 1970.
    let since = u64::from(before + in_year) - 719_468;
    Ok(since * DAY + u64::from(3600 * hour + 60 * minute + second))
}

fn two(tens: u8, ones: u8) -> Result<u32, TlsError> {
    let digit = |byte: u8| (byte as char).to_digit(10).ok_or(WRONG);
    Ok(10 * digit(tens)? + digit(ones)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    fn parse(tag: u8, text: &str) -> Result<u64, TlsError> {
        let mut der = Vec::from([tag, text.len() as u8]);
        der.extend_from_slice(text.as_bytes());
        read(&mut Der(&der))
    }

    #[test]
    fn times_are_those_of_the_calendar() {
        for (tag, text, seconds) in [
            (UTC_TIME, "700101000000Z", 0),
            (UTC_TIME, "991231235959Z", 946_684_799),
            (UTC_TIME, "240229120000Z", 1_709_208_000),
            (UTC_TIME, "491231235959Z", 2_524_607_999),
            (GENERALIZED_TIME, "20500101000000Z", 2_524_608_000),
            (GENERALIZED_TIME, "21000301000000Z", 4_107_542_400),
            (GENERALIZED_TIME, "99991231235959Z", 253_402_300_799),
        ] {
            assert_eq!(parse(tag, text), Ok(seconds), "{text}");
        }
    }

    #[test]
    fn what_is_no_time_is_refused() {
        for (tag, text) in [
            (UTC_TIME, "500101000000Z"),
            (UTC_TIME, "230229120000Z"),
            (UTC_TIME, "231301000000Z"),
            (UTC_TIME, "230100000000Z"),
            (UTC_TIME, "230101240000Z"),
            (UTC_TIME, "230101006000Z"),
            (UTC_TIME, "230101000060Z"),
            (UTC_TIME, "2301010000Z"),
            (UTC_TIME, "230101000000+0100"),
            (UTC_TIME, "23010a000000Z"),
            (UTC_TIME, ""),
            (GENERALIZED_TIME, "19691231235959Z"),
            (GENERALIZED_TIME, "21000229000000Z"),
            (GENERALIZED_TIME, "20230101000000.5Z"),
            (0x16, "230101000000Z"),
        ] {
            assert_eq!(parse(tag, text), Err(WRONG), "{text}");
        }
    }
}
