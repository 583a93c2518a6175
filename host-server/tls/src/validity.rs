//! From when to when a certificate is valid, read from its DER (RFC 5280, section 4.1).

/// Seconds of a day.
const DAY: i64 = 24 * 60 * 60;

/// The time a certificate is valid, in Unix seconds, both ends included.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Validity {
    pub(crate) from: i64,
    pub(crate) until: i64,
}

impl Validity {
    /// Reads it from a certificate; `None` when this is none.
    pub(crate) fn of(certificate: &[u8]) -> Option<Self> {
        let (certificate, _) = expect(certificate, SEQUENCE)?;
        let (body, _) = expect(certificate, SEQUENCE)?;
        // The version is left out by version 1.
        let body = match element(body)? {
            (VERSION, _, rest) => rest,
            _ => body,
        };
        let (_, body) = expect(body, INTEGER)?;
        let (_, body) = expect(body, SEQUENCE)?;
        let (_, body) = expect(body, SEQUENCE)?;
        let (validity, _) = expect(body, SEQUENCE)?;
        let (from, rest) = time(validity)?;
        let (until, _) = time(rest)?;
        Some(Self { from, until })
    }
}

const INTEGER: u8 = 0x02;
const UTC_TIME: u8 = 0x17;
const GENERALIZED_TIME: u8 = 0x18;
const SEQUENCE: u8 = 0x30;
const VERSION: u8 = 0xA0;

/// Tag and content of the first element, and what follows it.
fn element(input: &[u8]) -> Option<(u8, &[u8], &[u8])> {
    let (&[tag, first], rest) = input.split_first_chunk()?;
    let (length, rest) = if first & 0x80 == 0 {
        (usize::from(first), rest)
    } else {
        // More than three bytes of length would be no certificate.
        let bytes = usize::from(first & 0x7F);
        if !(1..=3).contains(&bytes) {
            return None;
        }
        let (length, rest) = rest.split_at_checked(bytes)?;
        let length = length
            .iter()
            .fold(0, |length, &byte| length << 8 | usize::from(byte));
        (length, rest)
    };
    let (content, rest) = rest.split_at_checked(length)?;
    Some((tag, content, rest))
}

fn expect(input: &[u8], tag: u8) -> Option<(&[u8], &[u8])> {
    match element(input)? {
        (found, content, rest) if found == tag => Some((content, rest)),
        _ => None,
    }
}

fn time(input: &[u8]) -> Option<(i64, &[u8])> {
    let (tag, text, rest) = element(input)?;
    let text = text.strip_suffix(b"Z")?;
    let (year, text) = match tag {
        UTC_TIME => {
            let (year, text) = number(text, 2)?;
            (if year < 50 { 2000 + year } else { 1900 + year }, text)
        }
        GENERALIZED_TIME => number(text, 4)?,
        _ => return None,
    };
    let (month, text) = number(text, 2)?;
    let (day, text) = number(text, 2)?;
    let (hour, text) = number(text, 2)?;
    let (minute, text) = number(text, 2)?;
    let (second, text) = number(text, 2)?;
    let plausible = (1..=12).contains(&month)
        && (1..=31).contains(&day)
        && hour < 24
        && minute < 60
        && second < 60
        && text.is_empty();
    let time = days(year, month, day) * DAY + hour * 3600 + minute * 60 + second;
    plausible.then_some((time, rest))
}

fn number(text: &[u8], digits: usize) -> Option<(i64, &[u8])> {
    let (number, rest) = text.split_at_checked(digits)?;
    let number = number.iter().try_fold(0, |number, &digit| {
        digit
            .is_ascii_digit()
            .then(|| number * 10 + i64::from(digit - b'0'))
    })?;
    Some((number, rest))
}

/// Days since 1970 in the Gregorian calendar. Years begin in March here, so that the day that is
/// not always there is the last.
const fn days(year: i64, month: i64, day: i64) -> i64 {
    let year = if month > 2 { year } else { year - 1 };
    let month = (month + 9) % 12;
    365 * year + year / 4 - year / 100 + year / 400 + (153 * month + 2) / 5 + day - 1 - 719_468
}

/// The day of a time in Unix seconds, as `2026-11-22`.
pub(crate) fn day_of(time: i64) -> String {
    let day = time.div_euclid(DAY);
    // Near enough to start from, and never too late.
    let mut year = 1970 + day.div_euclid(366);
    while days(year + 1, 1, 1) <= day {
        year += 1;
    }
    let month = (1..=12)
        .rev()
        .find(|&month| days(year, month, 1) <= day)
        .unwrap_or(1);
    format!("{year:04}-{month:02}-{:02}", day - days(year, month, 1) + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_are_those_of_the_calendar() {
        for (time, text) in [
            (0, "1970-01-01"),
            (951_782_400, "2000-02-29"),
            (1_709_164_800, "2024-02-29"),
            (1_709_251_200, "2024-03-01"),
            (1_798_761_599, "2026-12-31"),
            (4_102_444_800, "2100-01-01"),
        ] {
            assert_eq!(day_of(time), text);
        }
        for day in 0..60_000 {
            let text = day_of(day * DAY);
            let part = |range: std::ops::Range<usize>| text[range].parse::<i64>().expect("number");
            assert_eq!(days(part(0..4), part(5..7), part(8..10)), day, "{text}");
        }
    }

    #[test]
    fn a_certificate_tells_its_time_and_damaged_ones_do_not_panic() {
        let key = rcgen::KeyPair::generate().expect("key");
        let mut params = rcgen::CertificateParams::new(vec!["localhost".to_owned()]).expect("name");
        params.not_before = rcgen::date_time_ymd(2026, 11, 22);
        // From 2050 on the other form of time is used.
        params.not_after = rcgen::date_time_ymd(2050, 3, 1);
        let certificate = params.self_signed(&key).expect("certificate");
        let der = certificate.der().as_ref();
        let read = Validity::of(der).expect("validity");
        assert_eq!(day_of(read.from), "2026-11-22");
        assert_eq!(day_of(read.until), "2050-03-01");
        for length in 0..der.len() {
            assert_eq!(Validity::of(&der[..length]), None, "{length} bytes");
        }
        for at in 0..der.len() {
            for bit in 0..8 {
                let mut broken = der.to_vec();
                broken[at] ^= 1 << bit;
                let _ = Validity::of(&broken);
            }
        }
    }
}
