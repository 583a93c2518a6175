//! What outlives the program, and what it must learn anew.

use std::time::Duration;

use crawler_protocol::{
    Action, BehaviourSpec, BootCause, ParametersMessage, Reason, ResponseStatus, Topic,
};

use super::super::case::Verdict;
use super::super::{ANSWER, Bench, Failure, Word, is_standing};
use super::settings::{setting, text};
use super::{check, completed, is};

/// To restart and to be connected again: joining a network alone may take 15 s, and a first
/// attempt may fail.
const BACK: Duration = Duration::from_mins(1);
const KEPT: &str = "hil kept";

impl Bench {
    /// Reboots the robot and waits until it is connected again. Gives the boot count before.
    async fn restart(&mut self) -> Result<u32, Failure> {
        let before = self
            .status()
            .map(|status| status.boot.count)
            .ok_or_else(|| Failure::Failed("no status".into()))?;
        completed(&self.ask(Action::Reboot).await?)?;
        self.wait(
            "the robot is back from its reboot",
            BACK,
            |message| match &message.word {
                Word::Status(status) => {
                    (status.online && status.boot.count != before).then_some(())
                }
                _ => None,
            },
        )
        .await?;
        Ok(before)
    }
}

pub(in super::super) async fn reboot(bench: &mut Bench) -> Verdict {
    completed(&bench.ask(setting("name", text(KEPT))?).await?)?;
    bench.reported("name", &text(KEPT)).await?;
    let uptime = bench.book.heartbeat.as_ref().map(|beat| beat.uptime_ms);

    let before = bench.restart().await?;
    let boot = bench
        .status()
        .map(|status| (status.boot.count, status.boot.cause));
    check(boot.is_some_and(|(count, _)| count == before + 1), || {
        format!("boot {before} is followed by {boot:?}")
    })?;
    check(
        boot.is_some_and(|(_, cause)| cause == BootCause::Software),
        || format!("the cause is not software: {boot:?}"),
    )?;
    // A clock that went on would mean that nothing was restarted.
    let beat = bench
        .wait("a heartbeat", ANSWER, |message| match &message.word {
            Word::Heartbeat(beat) => Some(beat.uptime_ms),
            _ => None,
        })
        .await?;
    check(uptime.is_none_or(|before| beat < before + 2_000), || {
        format!("an uptime of {beat} ms after a reboot")
    })?;
    let topic = Topic::Parameters(bench.target().robot.clone());
    let kept = ParametersMessage::from_json(&bench.retained(&topic).await?)
        .map_err(|error| Failure::Failed(format!("the retained parameters: {error}")))?;
    let name = kept.values.iter().find(|report| report.name == "name");
    check(
        name.is_some_and(|report| report.value == text(KEPT)),
        || format!("the name after the reboot is {name:?}"),
    )?;
    bench
        .stays("it stands after a reboot", 2, is_standing)
        .await
}

pub(in super::super) async fn no_clock(bench: &mut Bench) -> Verdict {
    if bench.clock.is_foreign() {
        return Err(Failure::Skipped(
            "somebody publishes the fleet's time, so the robot is never long without".into(),
        ));
    }
    bench.clock.hold();
    bench.restart().await?;
    let manual = Action::Behave(BehaviourSpec::Manual);
    let answer = bench.ask(manual.clone()).await?;
    if bench.clock.is_foreign() {
        return Err(Failure::Skipped("somebody else published the time".into()));
    }
    is(&answer, ResponseStatus::Rejected, Some(Reason::NoClock))?;
    completed(&bench.ask(Action::Stop).await?)?;
    completed(&bench.ask(Action::Identify).await?)?;

    bench.clock.resume(tokio::time::Instant::now());
    bench.synchronised().await?;
    completed(&bench.ask(manual).await?)
}
