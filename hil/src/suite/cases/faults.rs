//! Faults put into a robot on purpose, where it takes them.

use std::time::Duration;

use crawler_protocol::{
    Action, Capability, FaultCommand, FaultSpec, MAX_MESSAGE, RobotState, Topic, Wheel,
};

use super::super::case::Verdict;
use super::super::{ANSWER, Bench, Failure, Word, is_standing};
use super::completed;

/// Skips the case on a robot that takes no faults.
fn takes_faults(bench: &Bench) -> Verdict {
    let takes = bench
        .status()
        .is_some_and(|status| status.capabilities.contains(&Capability::Faults.into()));
    if takes {
        Ok(())
    } else {
        Err(Failure::Skipped("the robot takes no faults".into()))
    }
}

fn say(bench: &mut Bench, command: &FaultCommand) -> Verdict {
    let mut buffer = [0; MAX_MESSAGE];
    let len = command
        .to_json(&mut buffer)
        .map_err(|error| Failure::Failed(error.to_string()))?;
    bench.send_on(&Topic::SimulatorCommand, buffer[..len].to_vec())
}

fn inject(bench: &mut Bench, fault: FaultSpec, lasting: Duration) -> Verdict {
    let command = FaultCommand::Inject {
        robot: bench.target().robot.clone(),
        fault,
        lasting_ms: u32::try_from(lasting.as_millis()).ok(),
    };
    say(bench, &command)
}

/// Waits for the record that tells what became of a fault.
async fn told(bench: &mut Bench, text: &str) -> Verdict {
    bench
        .wait(&format!("a record of '{text}'"), ANSWER, |message| {
            let Word::Log(record) = &message.word else {
                return None;
            };
            (record.event == "injected" && record.text.contains(text)).then_some(())
        })
        .await
}

pub(in super::super) async fn dead_ranger(bench: &mut Bench) -> Verdict {
    takes_faults(bench)?;
    inject(bench, FaultSpec::RangerDead, Duration::from_secs(3))?;
    bench
        .until("it is in ERROR", ANSWER, |telemetry| {
            telemetry.state == RobotState::Error && is_standing(telemetry)
        })
        .await?;
    completed(&bench.ask(Action::Stop).await?)?;
    bench
        .until("it is IDLE again", ANSWER, |telemetry| {
            telemetry.state == RobotState::Idle
        })
        .await?;
    Ok(())
}

pub(in super::super) async fn refused(bench: &mut Bench) -> Verdict {
    takes_faults(bench)?;
    let wheel = Wheel::Left;
    inject(
        bench,
        FaultSpec::MotorStuckOn { wheel },
        Duration::from_secs(1),
    )?;
    told(bench, "motor-stuck-on refused: unsupported").await?;
    bench.stays("it stood", 1, is_standing).await?;
    let robot = bench.target().robot.clone();
    say(bench, &FaultCommand::Heal { robot })?;
    told(bench, "healed").await
}
