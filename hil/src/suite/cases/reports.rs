//! What the robot says by itself.

use std::time::Duration;

use crawler_protocol::{Action, MAX_MESSAGE, PROTOCOL_VERSION, ParameterValue};

use super::super::case::Verdict;
use super::super::{ANSWER, Bench, Failure, Word};
use super::check;

/// Long enough that a pause of a second does not decide.
const LISTEN: Duration = Duration::from_secs(6);
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
    check(status.protocol == PROTOCOL_VERSION, || {
        format!("protocol {} instead of {PROTOCOL_VERSION}", status.protocol)
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
    let beats: Vec<_> = heard
        .iter()
        .filter_map(|message| match &message.word {
            Word::Heartbeat(beat) => Some(beat),
            _ => None,
        })
        .collect();
    // Six, give or take what a busy machine or a weak signal costs.
    let (count, seconds) = (beats.len(), LISTEN.as_secs());
    check((4..=8).contains(&count), || {
        format!("{count} heartbeats in {seconds} s")
    })?;
    for pair in beats.windows(2) {
        check(pair[0].uptime_ms < pair[1].uptime_ms, || {
            format!(
                "the uptime went from {} to {} ms",
                pair[0].uptime_ms, pair[1].uptime_ms
            )
        })?;
    }
    let (first, last) = (beats[0], beats[count - 1]);
    let lasted = last.uptime_ms - first.uptime_ms;
    let spans = 1_000 * (last.seq - first.seq);
    check(lasted.abs_diff(spans) <= 1_500, || {
        format!(
            "{} heartbeats in {lasted} ms of uptime",
            last.seq - first.seq
        )
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
    let beat = bench
        .wait("a heartbeat", ANSWER, |message| match &message.word {
            Word::Heartbeat(beat) => Some(beat.clone()),
            _ => None,
        })
        .await?;
    let now = bench.clock.now_ms();
    let off = now.abs_diff(beat.timestamp);
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
    check(book.messages > 0, || {
        format!("no message of at most {MAX_MESSAGE} bytes")
    })
}

impl Bench {
    /// Checks that telemetry comes about `hz` times a second for `span`.
    pub(super) async fn rate(&mut self, hz: f32, span: Duration) -> Verdict {
        let heard = self.listen(span).await?;
        let count = heard
            .iter()
            .filter(|message| matches!(message.word, Word::Telemetry(_)))
            .count();
        let expected = hz * span.as_secs_f32();
        let least = (expected * 0.6).floor() as usize;
        let most = (expected * 1.4).ceil() as usize + 1;
        check((least..=most).contains(&count), || {
            let seconds = span.as_secs_f32();
            format!("{count} telemetry messages in {seconds:.0} s at {hz} Hz")
        })
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
