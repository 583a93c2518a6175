//! Parameters.

use std::time::Duration;

use crawler_protocol::{
    Action, ParameterValue, ParameterValues, ParametersMessage, Reason, ResponseStatus, Topic,
};

use super::super::case::Verdict;
use super::super::{ANSWER, Bench, Failure, Word};
use super::{check, completed, is};

/// Parameters in one command.
const AT_ONCE: usize = crawler_protocol::MAX_SET;

/// A command that sets one parameter.
pub(super) fn setting(name: &str, value: ParameterValue) -> Result<Action, Failure> {
    settings(&[(name, value)])
}

fn settings(pairs: &[(&str, ParameterValue)]) -> Result<Action, Failure> {
    let mut values = ParameterValues::new();
    for (name, value) in pairs {
        let name = (*name)
            .try_into()
            .map_err(|_| Failure::Failed(format!("the name {name} is too long")))?;
        values
            .push((name, value.clone()))
            .map_err(|_| Failure::Failed("too many parameters at once".into()))?;
    }
    Ok(Action::Set(values))
}

pub(super) fn text(value: &str) -> ParameterValue {
    // Ours are short.
    ParameterValue::Text(value.try_into().unwrap_or_default())
}

pub(in super::super) async fn set(bench: &mut Bench) -> Verdict {
    let before = bench.number("telemetry_hz")?;
    let wanted = if before < 4.0 { 8.0 } else { 2.0 };
    let action = setting("telemetry_hz", ParameterValue::Number(wanted))?;
    completed(&bench.ask(action).await?)?;
    bench
        .reported("telemetry_hz", &ParameterValue::Number(wanted))
        .await?;
    let topic = Topic::Parameters(bench.target().robot.clone());
    let kept = ParametersMessage::from_json(&bench.retained(&topic).await?)
        .map_err(|error| Failure::Failed(format!("the retained parameters: {error}")))?;
    let kept = value_in(&kept, "telemetry_hz");
    check(kept == Some(&ParameterValue::Number(wanted)), || {
        format!("the broker keeps {kept:?} instead of {wanted}")
    })?;
    // One period of the old rate may still be running.
    bench.listen(Duration::from_secs(1)).await?;
    bench.rate(wanted, Duration::from_secs(5)).await
}

pub(in super::super) async fn all_or_none(bench: &mut Bench) -> Verdict {
    let before = bench.number("telemetry_hz")?;
    let wanted = ParameterValue::Number(if before < 4.0 { 8.0 } else { 2.0 });
    let hz = ("telemetry_hz", wanted);
    for (other, reason) in [
        (
            ("no_such_parameter", ParameterValue::Bool(true)),
            Reason::UnknownParameter,
        ),
        (
            ("max_speed", ParameterValue::Number(-1.0)),
            Reason::OutOfRange,
        ),
        (("max_speed", text("fast")), Reason::WrongType),
        // Each within its range, but the robot would have to stop before it slows down.
        (
            ("critical_distance_mm", ParameterValue::Number(1_500.0)),
            Reason::OutOfRange,
        ),
    ] {
        let mut pairs = vec![hz.clone(), other];
        if reason == Reason::OutOfRange && pairs[1].0 == "critical_distance_mm" {
            pairs.push(("safe_distance_mm", ParameterValue::Number(100.0)));
        }
        let answer = bench.ask(settings(&pairs)?).await?;
        is(&answer, ResponseStatus::Rejected, Some(reason))?;
    }
    // Nothing changed: neither what is reported nor what is done.
    bench.rate(before, Duration::from_secs(5)).await?;
    let now = bench.number("telemetry_hz")?;
    check(now == before, || {
        format!("telemetry_hz was {before} and is {now}")
    })
}

/// The value of `name` in a report.
fn value_in<'a>(parameters: &'a ParametersMessage, name: &str) -> Option<&'a ParameterValue> {
    let report = parameters.values.iter().find(|report| report.name == name);
    report.map(|report| &report.value)
}

impl Bench {
    /// The value of `name` as last reported.
    pub fn parameter(&self, name: &str) -> Option<&ParameterValue> {
        value_in(self.parameters()?, name)
    }

    /// The value of the number `name` as last reported.
    pub(super) fn number(&self, name: &str) -> Result<f32, Failure> {
        match self.parameter(name) {
            Some(ParameterValue::Number(number)) => Ok(*number),
            other => Err(Failure::Failed(format!("parameter {name} is {other:?}"))),
        }
    }

    /// Time between two telemetry messages.
    pub(in super::super) fn telemetry_period(&self) -> Duration {
        match self.number("telemetry_hz") {
            Ok(hz) if hz > 0.0 => Duration::from_secs_f32(1.0 / hz.max(0.01)),
            Ok(_) | Err(_) => Duration::ZERO,
        }
    }

    /// Waits until `name` is reported to be `value`.
    ///
    /// # Errors
    /// [`Failure::Failed`] when that does not happen; as [`Bench::next`].
    pub async fn reported(&mut self, name: &str, value: &ParameterValue) -> Verdict {
        self.catch_up()?;
        if self.parameter(name) == Some(value) {
            return Ok(());
        }
        let what = format!("parameter {name} reported as {value:?}");
        self.wait(&what, ANSWER, |message| match &message.word {
            Word::Parameters(new) if value_in(new, name) == Some(value) => Some(()),
            _ => None,
        })
        .await
    }

    /// Gives parameters back the values they had.
    pub(in super::super) async fn restore(&mut self, found: &ParametersMessage) -> Verdict {
        self.catch_up()?;
        let changed: Vec<(&str, ParameterValue)> = found
            .values
            .iter()
            .filter(|report| self.parameter(&report.name) != Some(&report.value))
            .map(|report| (report.name.as_str(), report.value.clone()))
            .collect();
        for some in changed.chunks(AT_ONCE) {
            completed(&self.ask(settings(some)?).await?)?;
            for (name, value) in some {
                self.reported(name, value).await?;
            }
        }
        Ok(())
    }
}
