//! What the robot says by itself.

use std::time::Duration;

use crawler_protocol::{Action, MAX_MESSAGE, PROTOCOL_VERSION, ParameterValue};

use super::super::case::Verdict;
use super::super::{ANSWER, Bench, Failure, Word};
use super::check;

/// Long enough that a pause of a second does not decide.
const LISTEN: Duration = Duration::from_secs(6);
/// Share of the messages of QoS 0 that must arrive.
const ARRIVE: f64 = 0.7;
/// How much faster or slower than it says a robot may send, by its own clock. That of an emulated
/// or simulated robot stands still while its machine has other things to do, and this machine's
/// does not.
const RATE: f64 = 0.25;
/// How far the robot's clock may be off: as much as makes a command expire.
const CLOCK_MS: u64 = 2_000;

pub(in super::super) async fn status(bench: &mut Bench) -> Verdict {
    check(bench.book.status_retained, || {
        "the status was not there before we asked".into()
    })?;
    let topic = crawler_protocol::Topic::Status(bench.target().robot.clone());
    bench.retained(&topic).await?;
    let status = bench
        .status()
        .ok_or_else(|| Failure::Failed("no status".into()))?;
    check(status.online, || "it says it is offline".into())?;
    check(status.protocol >= PROTOCOL_VERSION, || {
        format!("protocol {} is before {PROTOCOL_VERSION}", status.protocol)
    })?;
    check(!status.firmware.is_empty(), || "no firmware version".into())?;
    check(!status.board.is_empty(), || "no board".into())?;
    check(status.boot.count > 0, || {
        "boot 0: the flash cannot be read".into()
    })?;
    let twice = status
        .capabilities
        .iter()
        .enumerate()
        .any(|(index, capability)| status.capabilities[..index].contains(capability));
    check(!twice, || {
        format!("a capability comes twice: {:?}", status.capabilities)
    })
}

pub(in super::super) async fn parameters(bench: &mut Bench) -> Verdict {
    check(bench.book.parameters_retained, || {
        "the parameters were not there before we asked".into()
    })?;
    let topic = crawler_protocol::Topic::Parameters(bench.target().robot.clone());
    bench.retained(&topic).await?;
    let parameters = bench
        .parameters()
        .ok_or_else(|| Failure::Failed("no parameters".into()))?;
    check(!parameters.values.is_empty(), || "there are none".into())?;
    for report in &parameters.values {
        let name = &report.name;
        for value in [Some(&report.value), report.default.as_ref()]
            .into_iter()
            .flatten()
        {
            let least = report.min.unwrap_or(f32::MIN);
            let most = report.max.unwrap_or(f32::MAX);
            if let ParameterValue::Number(value) = value {
                check((least..=most).contains(value), || {
                    format!("{name} is {value}, outside of {least} to {most}")
                })?;
            }
        }
        if let Some(default) = &report.default {
            let same = std::mem::discriminant(default) == std::mem::discriminant(&report.value);
            check(same, || {
                format!("{name} is of another type than its default")
            })?;
        }
    }
    bench.number("telemetry_hz").map(drop)
}

pub(in super::super) async fn heartbeat(bench: &mut Bench) -> Verdict {
    let heard = bench.listen(LISTEN).await?;
    let beats: Vec<(u64, u64)> = heard
        .iter()
        .filter_map(|message| match &message.word {
            Word::Heartbeat(beat) => Some((beat.seq, beat.uptime_ms)),
            _ => None,
        })
        .collect();
    for pair in beats.windows(2) {
        check(pair[0].1 < pair[1].1, || {
            format!("the uptime went from {} to {} ms", pair[0].1, pair[1].1)
        })?;
    }
    regular("heartbeats", &beats, 1.0, LISTEN)
}

/// Checks that `came`, pairs of number and milliseconds of the robot's clock, came at `hz` within
/// `span` of this machine's clock.
fn regular(what: &str, came: &[(u64, u64)], hz: f64, span: Duration) -> Verdict {
    let count = came.len();
    let seconds = span.as_secs_f64();
    let (Some(first), Some(last)) = (came.first(), came.last()) else {
        return Err(Failure::Failed(format!("no {what} in {seconds:.0} s")));
    };
    let most = (hz * seconds * 1.5).ceil() as usize + 1;
    let least = ((hz * seconds * 0.3).floor() as usize).max(2);
    check((least..=most).contains(&count), || {
        format!("{count} {what} in {seconds:.0} s at {hz} Hz")
    })?;
    let sent = last.0.saturating_sub(first.0);
    check((count - 1) as f64 >= sent as f64 * ARRIVE, || {
        format!("{count} {what} came of {} that were sent", sent + 1)
    })?;
    let lasted = last.1.saturating_sub(first.1);
    let rate = sent as f64 * 1_000.0 / lasted.max(1) as f64;
    check((rate / hz - 1.0).abs() <= RATE, || {
        format!("{sent} {what} in {lasted} ms of the robot's clock, at {hz} Hz")
    })
}

pub(in super::super) async fn telemetry(bench: &mut Bench) -> Verdict {
    let hz = bench.number("telemetry_hz")?;
    // Ten messages at least, as far as a minute allows.
    let span = LISTEN.max(Duration::from_secs_f32(10.0 / hz).min(Duration::from_secs(50)));
    bench.rate(hz, span).await
}

pub(in super::super) async fn clock(bench: &mut Bench) -> Verdict {
    bench.synchronised().await?;
    let (told, at) = bench
        .wait("a heartbeat", ANSWER, |message| match &message.word {
            Word::Heartbeat(beat) => Some((beat.timestamp, message.at)),
            _ => None,
        })
        .await?;
    // As of when it arrived: it may have waited for us.
    let waited = at.elapsed().as_millis() as u64;
    let off = bench.clock.now_ms().saturating_sub(waited).abs_diff(told);
    check(off <= CLOCK_MS, || format!("it is {off} ms off"))
}

pub(in super::super) async fn contract(bench: &mut Bench) -> Verdict {
    // Something after the last case too, so that nothing goes unread.
    bench.ask(Action::Identify).await?;
    bench.catch_up()?;
    let book = &bench.book;
    check(book.wrong == 0, || {
        let (wrong, all) = (book.wrong, book.messages);
        format!(
            "{wrong} of {all} messages are not as they must be: {}",
            book.findings.join("; ")
        )
    })?;
    // Only a robot of a later version may say what this one has not.
    let newer = bench
        .status()
        .is_some_and(|status| status.protocol > PROTOCOL_VERSION);
    check(newer || book.unknown.is_none(), || {
        let (fields, words) = (book.unknown.fields, book.unknown.words);
        format!("{fields} fields and {words} words that protocol {PROTOCOL_VERSION} has not")
    })?;
    check(book.messages > 0, || {
        format!("no message of at most {MAX_MESSAGE} bytes")
    })
}

impl Bench {
    /// Checks that telemetry comes `hz` times a second for `span`.
    pub(super) async fn rate(&mut self, hz: f32, span: Duration) -> Verdict {
        self.synchronised().await?;
        let heard = self.listen(span).await?;
        let came: Vec<(u64, u64)> = heard
            .iter()
            .filter_map(|message| match &message.word {
                Word::Telemetry(telemetry) => Some((telemetry.seq, telemetry.timestamp)),
                _ => None,
            })
            .collect();
        regular("telemetry messages", &came, f64::from(hz), span)
    }

    /// Waits until the robot knows what time it is.
    pub(super) async fn synchronised(&mut self) -> Verdict {
        let known = |message: &super::super::Message| match &message.word {
            Word::Heartbeat(beat) => (beat.timestamp != 0).then_some(()),
            _ => None,
        };
        let limit = Duration::from_secs(20);
        self.wait("the robot's clock is synchronised", limit, known)
            .await
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn series(count: u64, step: u64, period_ms: u64) -> Vec<(u64, u64)> {
        (0..count)
            .map(|i| (7 + i * step, 90 + i * period_ms))
            .collect()
    }

    #[test]
    fn a_regular_series_passes_and_others_do_not() {
        let six = Duration::from_secs(6);
        let fine = |came: &[(u64, u64)], hz| regular("it", came, hz, six).is_ok();
        assert!(fine(&series(30, 1, 200), 5.0));
        // A machine that stood still for half of the time.
        assert!(fine(&series(15, 1, 200), 5.0));
        // Two of three arrive.
        assert!(!fine(&series(20, 3, 600), 5.0));
        // Half as fast, twice as fast, by the robot's own clock.
        assert!(!fine(&series(15, 1, 400), 5.0));
        assert!(!fine(&series(60, 1, 100), 5.0));
        assert!(!fine(&series(3, 2, 2_000), 1.0));
        assert!(!fine(&[], 1.0));
        assert!(!fine(&series(1, 1, 1_000), 1.0));
    }
}
