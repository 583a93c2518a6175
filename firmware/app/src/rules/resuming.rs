//! What is taken up again after it was interrupted, and what is not.

use crawler_hal::{Duration, ResetCause};
use crawler_protocol::{Action, BehaviourSpec, ParameterValue, RobotState};
use proptest::test_runner::TestCaseError;

use super::bench::Bench;
use super::happening::{Happening, Number, Sensor};
use crate::goal::Goal;
use crate::perception::{Charge, LinkHealth, SensorHealth, Sight};

type Outcome = Result<(), TestCaseError>;

const WANDER: Action = Action::Behave(BehaviourSpec::Wander { speed: 50 });
const SEES: Happening = Happening::Sensor(Sensor::Sees(Sight::Clear));
const DEAD: Happening = Happening::Sensor(Sensor::Broken(SensorHealth::Dead));
const LOST: Happening = Happening::Link(LinkHealth::Lost);
const UP: Happening = Happening::Link(LinkHealth::Up);

/// A bench whose robot wanders.
fn wandering() -> Result<Bench, TestCaseError> {
    let mut bench = Bench::new(7);
    bench.happen(&UP)?;
    bench.send(&WANDER, 0, Number::Next, 0)?;
    seconds(&mut bench, 1)?;
    assert_eq!(bench.state(), RobotState::Moving);
    Ok(bench)
}

fn seconds(bench: &mut Bench, count: usize) -> Outcome {
    for _ in 0..count {
        bench.happen(&Happening::Run(50))?;
    }
    Ok(())
}

/// Its ranger dies, or its link is lost, for so many seconds.
fn interrupt(bench: &mut Bench, how: &Happening, lasting: usize) -> Outcome {
    bench.happen(how)?;
    seconds(bench, lasting)?;
    bench.happen(&SEES)?;
    bench.happen(&UP)
}

#[test]
fn a_behaviour_goes_on_within_two_seconds() -> Outcome {
    for (how, meanwhile) in [(DEAD, RobotState::Error), (LOST, RobotState::Idle)] {
        let mut bench = wandering()?;
        bench.happen(&how)?;
        seconds(&mut bench, 3)?;
        assert_eq!(bench.state(), meanwhile, "{how:?}");
        bench.happen(&SEES)?;
        bench.happen(&UP)?;
        bench.happen(&Happening::Run(49))?;
        assert_eq!(bench.state(), RobotState::Idle, "not at once: {how:?}");
        seconds(&mut bench, 1)?;
        assert_eq!(bench.state(), RobotState::Moving, "{how:?}");
    }
    Ok(())
}

#[test]
fn what_a_person_says_meanwhile_counts() -> Outcome {
    let otherwise = [
        Action::Stop,
        Action::Estop,
        Action::Behave(BehaviourSpec::Manual),
        Action::Reboot,
    ];
    for action in otherwise {
        let mut bench = wandering()?;
        bench.happen(&DEAD)?;
        seconds(&mut bench, 1)?;
        bench.send(&action, 0, Number::Next, 0)?;
        bench.happen(&Happening::Run(2))?;
        bench.happen(&SEES)?;
        bench.send(&Action::Reset, 0, Number::Next, 0)?;
        seconds(&mut bench, 5)?;
        assert_eq!(bench.state(), RobotState::Idle, "{action:?}");
    }
    // A stop of before the interruption all the more.
    let mut bench = wandering()?;
    bench.send(&Action::Stop, 0, Number::Next, 0)?;
    interrupt(&mut bench, &DEAD, 3)?;
    seconds(&mut bench, 5)?;
    assert_eq!(bench.state(), RobotState::Idle);
    // What only asks something decides nothing.
    let mut bench = wandering()?;
    bench.happen(&LOST)?;
    bench.send(&Action::Identify, 0, Number::Next, 0)?;
    seconds(&mut bench, 1)?;
    bench.happen(&UP)?;
    seconds(&mut bench, 2)?;
    assert_eq!(bench.state(), RobotState::Moving);
    Ok(())
}

/// The robot of a bench after a restart, as the flash tells it what it was at.
fn restarted(cause: ResetCause, panic: Option<&str>) -> Result<Bench, TestCaseError> {
    let mut bench = Bench::new(7);
    bench
        .robot
        .control_handle()
        .set_boot_cause(cause, panic, bench.now());
    let goal = Goal::Wander { speed: 0.5 };
    bench
        .robot
        .store_handle()
        .set_goal_before_restart(Some(goal));
    bench.expect_resumption();
    seconds(&mut bench, 3)?;
    assert_eq!(bench.state(), RobotState::Idle, "nobody could stop it yet");
    Ok(bench)
}

#[test]
fn a_restart_that_was_asked_for_interrupts_it() -> Outcome {
    let mut bench = wandering()?;
    bench.send(&Action::Reboot, 0, Number::Next, 0)?;
    let out = bench.turn(Duration::from_millis(20), None)?;
    assert_eq!(out.unfinished, Some(Goal::Wander { speed: 0.5 }));
    let mut bench = restarted(ResetCause::Software, None)?;
    bench.happen(&UP)?;
    seconds(&mut bench, 2)?;
    assert_eq!(bench.state(), RobotState::Moving);
    Ok(())
}

#[test]
fn no_other_restart_does() -> Outcome {
    for (cause, panic) in [
        (ResetCause::PowerOn, None),
        (ResetCause::BrownOut, None),
        (ResetCause::Watchdog, None),
        (ResetCause::Panic, None),
        (ResetCause::Software, Some("app.rs:1: it broke")),
    ] {
        let mut bench = restarted(cause, panic)?;
        bench.happen(&UP)?;
        seconds(&mut bench, 5)?;
        assert_eq!(bench.state(), RobotState::Idle, "{cause:?} {panic:?}");
    }
    // Nor one before which, or behind which, somebody said otherwise.
    let mut bench = wandering()?;
    bench.send(&Action::Stop, 0, Number::Next, 0)?;
    seconds(&mut bench, 1)?;
    bench.send(&Action::Reboot, 0, Number::Next, 0)?;
    let out = bench.turn(Duration::from_millis(20), None)?;
    assert_eq!((out.reboot, out.unfinished), (true, None));
    let mut bench = restarted(ResetCause::Software, None)?;
    bench.happen(&UP)?;
    bench.send(&Action::Stop, 0, Number::Next, 0)?;
    seconds(&mut bench, 5)?;
    assert_eq!(bench.state(), RobotState::Idle);
    // Nor when nobody comes for longer than that.
    let mut bench = restarted(ResetCause::Software, None)?;
    seconds(&mut bench, 60)?;
    bench.happen(&UP)?;
    seconds(&mut bench, 5)?;
    assert_eq!(bench.state(), RobotState::Idle);
    Ok(())
}

#[test]
fn what_has_an_end_has_ended() -> Outcome {
    for action in [Action::Goto { x: 5.0, y: 0.0 }, Action::Scan] {
        let mut bench = Bench::new(7);
        bench.happen(&UP)?;
        bench.send(&action, 0, Number::Next, 0)?;
        seconds(&mut bench, 1)?;
        interrupt(&mut bench, &DEAD, 3)?;
        seconds(&mut bench, 5)?;
        assert_eq!(bench.state(), RobotState::Idle, "{action:?}");
    }
    Ok(())
}

#[test]
fn what_lasts_stays() -> Outcome {
    for how in [DEAD, LOST] {
        let mut bench = wandering()?;
        interrupt(&mut bench, &how, 61)?;
        seconds(&mut bench, 70)?;
        assert_eq!(bench.state(), RobotState::Idle, "{how:?}");
    }
    for (comes, goes) in [
        (
            Happening::Charge(Charge::Critical),
            Happening::Charge(Charge::Good),
        ),
        (Happening::MotorFault(true), Happening::MotorFault(false)),
    ] {
        let mut bench = wandering()?;
        bench.happen(&DEAD)?;
        seconds(&mut bench, 1)?;
        bench.happen(&comes)?;
        seconds(&mut bench, 1)?;
        bench.happen(&SEES)?;
        bench.happen(&goes)?;
        seconds(&mut bench, 5)?;
        assert_eq!(bench.state(), RobotState::Idle, "{comes:?}");
    }
    Ok(())
}

#[test]
fn a_parameter_says_how_long_and_whether() -> Outcome {
    for (within_ms, goes_on) in [(0.0, false), (2_000.0, false), (4_000.0, true)] {
        let mut bench = wandering()?;
        bench.set("resume_within_ms", ParameterValue::Number(within_ms));
        interrupt(&mut bench, &DEAD, 3)?;
        seconds(&mut bench, 3)?;
        let expected = if goes_on {
            RobotState::Moving
        } else {
            RobotState::Idle
        };
        assert_eq!(bench.state(), expected, "within {within_ms} ms");
    }
    Ok(())
}

/// A loose plug does not make a robot start every other second.
#[test]
fn interrupted_again_it_waits_longer_each_time() -> Outcome {
    let mut bench = wandering()?;
    for wait in [1, 2, 4, 8, 16, 32, 32] {
        interrupt(&mut bench, &DEAD, 1)?;
        seconds(&mut bench, wait - 1)?;
        bench.happen(&Happening::Run(48))?;
        assert_eq!(bench.state(), RobotState::Idle, "{wait} s have not passed");
        bench.happen(&Happening::Run(10))?;
        assert_eq!(bench.state(), RobotState::Moving, "after {wait} s");
    }
    // Well for a minute, it is trusted as at first.
    seconds(&mut bench, 61)?;
    interrupt(&mut bench, &DEAD, 1)?;
    seconds(&mut bench, 2)?;
    assert_eq!(bench.state(), RobotState::Moving);
    Ok(())
}
