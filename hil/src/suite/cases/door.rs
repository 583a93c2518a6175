//! What must not get through, and must not disturb.
//!
//! None of these commands would move a robot, should it take them for good.

use std::time::Duration;

use crawler_protocol::{Action, BehaviourSpec, Level, MAX_MESSAGE, Reason, ResponseStatus};
use serde_json::{Value, json};

use super::super::case::Verdict;
use super::super::{ANSWER, Bench, Failure, Word, is_standing};
use super::settings::text;
use super::{check, completed, is};

/// Within this time an answer that must not come would have come.
const SILENCE: Duration = Duration::from_millis(1_500);
/// A minute, in which every motion command expires.
const MINUTE_MS: u64 = 60_000;
/// Refusals per second that a robot answers; after a flood it takes a second to recover.
const RECOVERY: Duration = Duration::from_secs(2);

impl Bench {
    /// Sends `payload`, which is command `seq`, and expects it to be rejected with `reason` while
    /// the robot stands as before.
    async fn refused(&mut self, seq: u64, payload: Vec<u8>, reason: Reason) -> Verdict {
        self.send_bytes(payload)?;
        let answer = self.answer(seq, ANSWER).await?;
        is(&answer, ResponseStatus::Rejected, Some(reason))?;
        self.stays("it stood before the bad command", 1, is_standing)
            .await
    }

    /// The same for a body of JSON, completed to a command.
    async fn refused_body(&mut self, body: Value, reason: Reason) -> Verdict {
        let (seq, command) = self.envelope(body);
        self.refused(seq, command.to_string().into_bytes(), reason)
            .await
    }
}

pub(in super::super) async fn unknown_command(bench: &mut Bench) -> Verdict {
    let bad = Reason::UnknownCommand;
    bench.refused_body(json!({"command": "fly"}), bad).await?;
    bench.refused_body(json!({"command": ""}), bad).await?;
    let long = "x".repeat(500);
    bench.refused_body(json!({"command": long}), bad).await
}

pub(in super::super) async fn unknown_field(bench: &mut Bench) -> Verdict {
    let bad = Reason::UnknownField;
    let field = json!({"command": "identify", "colour": "red"});
    bench.refused_body(field, bad).await?;
    let parameter = json!({"command": "identify", "parameters": {"colour": 1}});
    bench.refused_body(parameter, bad).await
}

pub(in super::super) async fn missing_field(bench: &mut Bench) -> Verdict {
    let bad = Reason::MissingField;
    bench
        .refused_body(json!({"command": "behave"}), bad)
        .await?;
    bench
        .refused_body(json!({"command": "set", "parameters": {}}), bad)
        .await?;
    let (seq, mut command) = bench.envelope(json!({"command": "identify"}));
    if let Some(fields) = command.as_object_mut() {
        fields.remove("timestamp");
    }
    bench.refused(seq, command.to_string().into(), bad).await
}

pub(in super::super) async fn duplicate_field(bench: &mut Bench) -> Verdict {
    let (seq, command) = bench.envelope(json!({"command": "identify"}));
    let twice = command.to_string().replacen('{', r#"{"source":"x","#, 1);
    bench
        .refused(seq, twice.into(), Reason::DuplicateField)
        .await
}

pub(in super::super) async fn wrong_type(bench: &mut Bench) -> Verdict {
    let bad = Reason::WrongType;
    bench.refused_body(json!({"command": 7}), bad).await?;
    let list = json!({"command": "identify", "parameters": [1]});
    bench.refused_body(list, bad).await?;
    let set = json!({"command": "set", "parameters": {"telemetry_hz": "often"}});
    bench.refused_body(set, bad).await
}

pub(in super::super) async fn out_of_range(bench: &mut Bench) -> Verdict {
    let bad = Reason::OutOfRange;
    let most = match bench.parameters() {
        Some(parameters) => parameters
            .values
            .iter()
            .find(|report| report.name == "telemetry_hz")
            .and_then(|report| report.max),
        None => None,
    };
    let beyond = most.map_or(1e6, |most| most * 1.01);
    for value in [json!(beyond), json!(-1), json!(1e300)] {
        let set = json!({"command": "set", "parameters": {"telemetry_hz": value}});
        bench.refused_body(set, bad).await?;
    }
    let (seq, mut command) = bench.envelope(json!({"command": "identify"}));
    command["source"] = "".into();
    bench.refused(seq, command.to_string().into(), bad).await
}

pub(in super::super) async fn unknown_behaviour(bench: &mut Bench) -> Verdict {
    let dance = json!({"command": "behave", "parameters": {"behaviour": "dance"}});
    bench.refused_body(dance, Reason::UnknownBehaviour).await
}

pub(in super::super) async fn unknown_parameter(bench: &mut Bench) -> Verdict {
    let bad = Reason::UnknownParameter;
    let set = json!({"command": "set", "parameters": {"no_such_parameter": 1}});
    bench.refused_body(set, bad).await?;
    let long = "x".repeat(200);
    let set = json!({"command": "set", "parameters": {long: 1}});
    bench.refused_body(set, bad).await
}

pub(in super::super) async fn malformed(bench: &mut Bench) -> Verdict {
    let bad = Reason::Malformed;
    for damage in [
        |text: String| text[..text.len() - 1].to_owned(),
        |text: String| text + "}",
        |text: String| text + " true",
        |text: String| text.replace('}', &format!(",\"parameters\":{}", "[".repeat(200))),
    ] {
        let (seq, command) = bench.envelope(json!({"command": "identify"}));
        bench
            .refused(seq, damage(command.to_string()).into(), bad)
            .await?;
    }
    Ok(())
}

pub(in super::super) async fn not_utf8(bench: &mut Bench) -> Verdict {
    let (seq, mut command) = bench.envelope(json!({"command": "identify"}));
    command["~"] = "?".into();
    let mut bytes = command.to_string().into_bytes();
    if let Some(byte) = bytes.iter_mut().rfind(|byte| **byte == b'?') {
        *byte = 0xff;
    }
    bench.refused(seq, bytes, Reason::Malformed).await
}

pub(in super::super) async fn oversized(bench: &mut Bench) -> Verdict {
    let (seq, command) = bench.envelope(json!({"command": "identify"}));
    let mut bytes = command.to_string().into_bytes();
    bytes.resize(MAX_MESSAGE + 76, b' ');
    let refused = bench.book.refused;
    bench.send_bytes(bytes)?;
    let until = tokio::time::Instant::now() + ANSWER;
    loop {
        // A broker may keep it from the robot, which is as good, if it says so.
        if bench.book.refused > refused {
            break;
        }
        if let Some(answer) = bench.book.answers.iter().find(|answer| answer.seq == seq) {
            is(answer, ResponseStatus::Rejected, Some(Reason::TooLarge))?;
            break;
        }
        let soon = tokio::time::Instant::now() + Duration::from_millis(200);
        bench.next(soon).await?;
        if tokio::time::Instant::now() >= until {
            return Err(bench.too_late("refused by the robot or the broker", ANSWER));
        }
    }
    bench.stays("it stood", 1, is_standing).await?;
    completed(&bench.ask(Action::Identify).await?)
}

pub(in super::super) async fn unreadable(bench: &mut Bench) -> Verdict {
    let nested = "[".repeat(900);
    for garbage in [
        b"".as_slice(),
        b"{",
        b"null",
        b"\xff\xfe",
        nested.as_bytes(),
    ] {
        bench.send_bytes(garbage.to_vec())?;
    }
    let begun = bench.book.answers.len();
    bench.listen(SILENCE).await?;
    check(bench.book.answers.len() == begun, || {
        format!("answered {:?}", bench.book.answers.back())
    })?;
    bench.stays("it stood", 1, is_standing).await?;
    completed(&bench.ask(Action::Identify).await?)
}

pub(in super::super) async fn logged(bench: &mut Bench) -> Verdict {
    // Few are logged while there are many.
    bench.listen(RECOVERY).await?;
    let (_, command) = bench.envelope(json!({"command": "fly"}));
    bench.send_bytes(command.to_string().into())?;
    bench
        .wait(
            "a log record of level warn",
            ANSWER,
            |message| match &message.word {
                Word::Log(record) if record.level == Level::Warn => Some(()),
                _ => None,
            },
        )
        .await
}

pub(in super::super) async fn flood(bench: &mut Bench) -> Verdict {
    let mut bad = Vec::new();
    for _ in 0..40 {
        let (seq, command) = bench.envelope(json!({"command": "fly"}));
        bench.send_bytes(command.to_string().into())?;
        bad.push(seq);
    }
    let good = bench.send(Action::Identify)?;
    completed(&bench.outcome(good, ANSWER).await?)?;
    bench.stays("it stood", 2, is_standing).await?;
    bench.listen(RECOVERY).await?;
    let mut answered = 0;
    for answer in &bench.book.answers {
        if bad.contains(&answer.seq) {
            let unknown = Some(Reason::UnknownCommand);
            is(answer, ResponseStatus::Rejected, unknown)?;
            answered += 1;
        }
    }
    check(answered > 0, || "none of the bad ones is answered".into())
}

pub(in super::super) async fn repeated(bench: &mut Bench) -> Verdict {
    let body = json!({"command": "set", "parameters": {"name": "hil one"}});
    let (seq, command) = bench.envelope(body);
    let command = command.to_string();
    bench.send_bytes(command.clone().into())?;
    completed(&bench.outcome(seq, ANSWER).await?)?;
    bench.reported("name", &text("hil one")).await?;
    // Another controller says something else meanwhile.
    let (other, mut overriding) = bench.envelope(json!({"command": "set"}));
    overriding["source"] = format!("{}+", bench.source()).into();
    overriding["parameters"] = json!({"name": "hil two"});
    bench.send_bytes(overriding.to_string().into())?;
    completed(&bench.outcome(other, ANSWER).await?)?;
    bench.reported("name", &text("hil two")).await?;

    bench.send_bytes(command.into())?;
    completed(&bench.answer(seq, ANSWER).await?)?;
    bench.listen(SILENCE).await?;
    let name = bench.parameter("name");
    check(name == Some(&text("hil two")), || {
        format!("the repetition was carried out: the name is {name:?}")
    })
}

pub(in super::super) async fn stale(bench: &mut Bench) -> Verdict {
    let seq = bench.send(Action::Identify)?;
    completed(&bench.outcome(seq, ANSWER).await?)?;
    let older = seq - 1;
    let (_, mut command) = bench.envelope(json!({"command": "set"}));
    command["seq"] = older.into();
    command["parameters"] = json!({"name": "hil stale"});
    bench.send_bytes(command.to_string().into())?;
    is(
        &bench.answer(older, ANSWER).await?,
        ResponseStatus::Stale,
        None,
    )?;
    bench.listen(SILENCE).await?;
    let name = bench.parameter("name");
    check(name != Some(&text("hil stale")), || {
        "the stale command was carried out".into()
    })
}

/// `behave manual`, which counts as motion and moves nothing, as if sent at `timestamp`.
async fn behave_at(
    bench: &mut Bench,
    timestamp: u64,
) -> Result<crawler_protocol::open::Response, Failure> {
    let (seq, mut command) =
        bench.envelope(json!({"command": "behave", "parameters": {"behaviour": "manual"}}));
    command["timestamp"] = timestamp.into();
    bench.send_bytes(command.to_string().into())?;
    bench.answer(seq, ANSWER).await
}

pub(in super::super) async fn expired(bench: &mut Bench) -> Verdict {
    bench.synchronised().await?;
    let then = bench.clock.now_ms().saturating_sub(MINUTE_MS);
    is(
        &behave_at(bench, then).await?,
        ResponseStatus::Expired,
        None,
    )?;
    let manual = Action::Behave(BehaviourSpec::Manual);
    completed(&bench.ask(manual).await?)
}

pub(in super::super) async fn from_the_future(bench: &mut Bench) -> Verdict {
    bench.synchronised().await?;
    let then = bench.clock.now_ms() + MINUTE_MS;
    let answer = behave_at(bench, then).await?;
    is(&answer, ResponseStatus::Rejected, Some(Reason::OutOfRange))
}

pub(in super::super) async fn late_stop(bench: &mut Bench) -> Verdict {
    let (seq, mut command) = bench.envelope(json!({"command": "stop"}));
    command["timestamp"] = 1.into();
    bench.send_bytes(command.to_string().into())?;
    completed(&bench.outcome(seq, ANSWER).await?)
}
