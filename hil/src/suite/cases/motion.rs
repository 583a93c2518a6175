//! Cases that set wheels in motion. Put a real robot on blocks, or give it room.

use std::time::Duration;

use crawler_protocol::open::{Response, Telemetry};
use crawler_protocol::{
    Action, BehaviourName, BehaviourSpec, Direction, PolicyName, Reason, ResponseStatus, RobotState,
};
use serde_json::json;
use tokio::time::Instant;

use super::super::case::Verdict;
use super::super::{ANSWER, Bench, Failure, REST, is_standing};
use super::{check, completed, is};

/// For wheels to turn after a command: ramp and a telemetry period, many times over.
const STARTS: Duration = Duration::from_secs(5);
/// For a robot to stand after it had a reason to. The failsafe alone takes half a second.
const STOPS: Duration = Duration::from_secs(3);
/// Between two words of a controller that drives.
const WORDS: Duration = Duration::from_millis(100);
/// Room ahead to drive forward in, in millimetres.
const ROOM_MM: u16 = 900;
/// Long enough to be ended by something else.
const LONG_MS: u32 = 8_000;

fn turn_for(direction: Direction, duration_ms: u32) -> Action {
    Action::Move {
        direction,
        speed: 40,
        duration_ms,
    }
}

/// Turning in place is free whatever stands in front.
fn a_turn(duration_ms: u32) -> Action {
    turn_for(Direction::Left, duration_ms)
}

fn is_moving(telemetry: &Telemetry) -> bool {
    !is_standing(telemetry)
}

/// Positive for counter-clockwise.
fn turning(telemetry: &Telemetry) -> f32 {
    telemetry.wheels.right - telemetry.wheels.left
}

impl Bench {
    /// Begins a long turn and waits until the wheels turn. Gives the number of its command.
    async fn long_turn(&mut self) -> Result<u64, Failure> {
        self.synchronised().await?;
        let seq = self.send(a_turn(LONG_MS))?;
        let answer = self.answer(seq, ANSWER).await?;
        is(&answer, ResponseStatus::Accepted, None)?;
        self.until("the wheels turn", STARTS, is_moving).await?;
        Ok(seq)
    }

    /// Sends a bounded move and checks its way from `accepted` over turning wheels to rest.
    /// Gives the final answer and the telemetry of the fastest moment.
    async fn whole_move(&mut self, action: Action) -> Result<(Response, Telemetry), Failure> {
        let seq = self.send(action)?;
        let answer = self.answer(seq, ANSWER).await?;
        if answer.status.is_final() {
            return Err(Failure::Failed(format!(
                "answered {answer:?} instead of accepted"
            )));
        }
        let telemetry = self
            .until("the wheels turn", STARTS, |telemetry| {
                is_moving(telemetry) && telemetry.state != RobotState::Idle
            })
            .await?;
        let outcome = self
            .outcome(seq, ANSWER + Duration::from_millis(LONG_MS.into()))
            .await?;
        self.rests(STOPS + ANSWER).await?;
        Ok((outcome, telemetry))
    }

    /// Turns until there is room ahead.
    async fn find_room(&mut self) -> Verdict {
        self.synchronised().await?;
        for _ in 0..16 {
            let ahead = self.telemetry(ANSWER).await?.range_mm;
            if ahead.is_some_and(|mm| mm >= ROOM_MM) {
                return Ok(());
            }
            completed(&self.whole_move(a_turn(450)).await?.0)?;
        }
        Err(Failure::Skipped(format!(
            "no {ROOM_MM} mm of room in any direction"
        )))
    }

    /// Repeats `action` as a controller does who drives, until `span` has passed. Whether the
    /// wheels turned meanwhile.
    async fn drive_on(&mut self, action: &Action, span: Duration) -> Result<bool, Failure> {
        let until = Instant::now() + span;
        let mut moved = false;
        while Instant::now() < until {
            let seq = self.send(action.clone())?;
            completed(&self.outcome(seq, ANSWER).await?)?;
            let soon = Instant::now() + WORDS;
            while self.next(soon).await?.is_some() {}
            // Whatever was waited for, telemetry was heard meanwhile.
            moved |= self.book.telemetry.as_ref().is_some_and(is_moving);
        }
        Ok(moved)
    }
}

pub(in super::super) async fn turn(bench: &mut Bench) -> Verdict {
    bench.synchronised().await?;
    for (direction, sign) in [(Direction::Left, 1.0), (Direction::Right, -1.0)] {
        let (outcome, fastest) = bench.whole_move(turn_for(direction, 1_200)).await?;
        completed(&outcome)?;
        check(turning(&fastest) * sign > 0.0, || {
            format!(
                "{direction:?} turned the wheels {:.2} and {:.2}",
                fastest.wheels.left, fastest.wheels.right
            )
        })?;
        check(fastest.wheels.left * fastest.wheels.right <= 0.0, || {
            format!("{direction:?} did not turn in place")
        })?;
    }
    Ok(())
}

pub(in super::super) async fn forward_and_back(bench: &mut Bench) -> Verdict {
    // In company the way may be blocked by somebody else; thrice in a row it is no accident.
    for attempt in 1..=3 {
        bench.find_room().await?;
        let there = Action::Move {
            direction: Direction::Forward,
            speed: 50,
            duration_ms: 1_000,
        };
        let (outcome, fastest) = bench.whole_move(there).await?;
        if outcome.reason == Some(Reason::Blocked.into()) && attempt < 3 {
            continue;
        }
        completed(&outcome)?;
        check(
            fastest.wheels.left > 0.0 && fastest.wheels.right > 0.0,
            || "forward turned a wheel backward".into(),
        )?;
        break;
    }
    let back = Action::Move {
        direction: Direction::Backward,
        speed: 50,
        duration_ms: 1_000,
    };
    let (outcome, fastest) = bench.whole_move(back).await?;
    completed(&outcome)?;
    check(
        fastest.wheels.left < 0.0 && fastest.wheels.right < 0.0,
        || "backward turned a wheel forward".into(),
    )
}

pub(in super::super) async fn stop(bench: &mut Bench) -> Verdict {
    let turn = bench.long_turn().await?;
    completed(&bench.ask(Action::Stop).await?)?;
    let answer = bench.outcome(turn, ANSWER).await?;
    is(&answer, ResponseStatus::Failed, Some(Reason::Interrupted))?;
    bench.rests(STOPS).await
}

pub(in super::super) async fn late_stop(bench: &mut Bench) -> Verdict {
    bench.long_turn().await?;
    let (seq, mut command) = bench.envelope(json!({"command": "stop"}));
    command["timestamp"] = 1.into();
    bench.send_bytes(command.to_string().into())?;
    completed(&bench.outcome(seq, ANSWER).await?)?;
    bench.rests(STOPS).await
}

pub(in super::super) async fn estop(bench: &mut Bench) -> Verdict {
    let turn = bench.long_turn().await?;
    completed(&bench.ask(Action::Estop).await?)?;
    let answer = bench.outcome(turn, ANSWER).await?;
    is(&answer, ResponseStatus::Failed, Some(Reason::Interrupted))?;
    bench
        .until("the robot stands in ERROR", STOPS, |telemetry| {
            is_standing(telemetry) && telemetry.state == RobotState::Error
        })
        .await?;
    // Neither another move nor a stop releases it.
    let answer = bench.ask(a_turn(500)).await?;
    is(&answer, ResponseStatus::Rejected, Some(Reason::Estopped))?;
    completed(&bench.ask(Action::Stop).await?)?;
    let latched =
        |telemetry: &Telemetry| is_standing(telemetry) && telemetry.state == RobotState::Error;
    bench
        .stays("the emergency stop was latched", 3, latched)
        .await?;
    completed(&bench.ask(Action::Reset).await?)?;
    bench.rests(REST).await?;
    completed(&bench.whole_move(a_turn(600)).await?.0)
}

async fn failsafe(bench: &mut Bench, action: Action) -> Verdict {
    bench.synchronised().await?;
    let moved = bench.drive_on(&action, Duration::from_secs(2)).await?;
    check(moved, || "the wheels never turned".into())?;
    // From here on silence.
    bench.rests(STOPS).await
}

pub(in super::super) async fn drive_failsafe(bench: &mut Bench) -> Verdict {
    failsafe(bench, Action::Drive { v: 0.0, w: 1.5 }).await
}

pub(in super::super) async fn move_failsafe(bench: &mut Bench) -> Verdict {
    failsafe(bench, a_turn(0)).await
}

pub(in super::super) async fn overtaken(bench: &mut Bench) -> Verdict {
    let first = bench.long_turn().await?;
    let second = bench.send(turn_for(Direction::Right, 1_000))?;
    let answer = bench.outcome(first, ANSWER).await?;
    is(&answer, ResponseStatus::Failed, Some(Reason::Interrupted))?;
    completed(&bench.outcome(second, ANSWER).await?)?;
    bench.rests(STOPS).await
}

pub(in super::super) async fn not_again(bench: &mut Bench) -> Verdict {
    bench.synchronised().await?;
    let (seq, command) = bench.envelope(json!({"command": "move",
        "parameters": {"direction": "left", "speed": 40, "duration": 600}}));
    let bytes = command.to_string().into_bytes();
    bench.send_bytes(bytes.clone())?;
    bench.until("the wheels turn", STARTS, is_moving).await?;
    completed(&bench.outcome(seq, ANSWER).await?)?;
    bench.rests(STOPS).await?;
    bench.send_bytes(bytes)?;
    completed(&bench.answer(seq, ANSWER).await?)?;
    bench
        .stays("it stood before the repetition", 4, is_standing)
        .await
}

pub(in super::super) async fn late_move(bench: &mut Bench) -> Verdict {
    bench.synchronised().await?;
    let body = json!({"command": "move",
        "parameters": {"direction": "left", "speed": 40, "duration": 600}});
    let (seq, mut command) = bench.envelope(body.clone());
    command["timestamp"] = bench.clock.now_ms().saturating_sub(60_000).into();
    bench.send_bytes(command.to_string().into())?;
    is(
        &bench.answer(seq, ANSWER).await?,
        ResponseStatus::Expired,
        None,
    )?;

    let (_, mut command) = bench.envelope(body);
    command["seq"] = (seq - 1).into();
    bench.send_bytes(command.to_string().into())?;
    let answer = bench.answer(seq - 1, ANSWER).await?;
    is(&answer, ResponseStatus::Stale, None)?;
    bench
        .stays(
            "it stood before commands that came too late",
            3,
            is_standing,
        )
        .await
}

pub(in super::super) async fn bad_while_moving(bench: &mut Bench) -> Verdict {
    let turn = bench.long_turn().await?;
    let begun = Instant::now();
    for (body, reason) in [
        (json!({"command": "fly"}), Reason::UnknownCommand),
        (
            json!({"command": "move", "parameters": {"direction": "left", "speed": 101, "duration": 1}}),
            Reason::OutOfRange,
        ),
        (
            json!({"command": "move", "parameters": {"direction": "up", "speed": 1, "duration": 1}}),
            Reason::OutOfRange,
        ),
        (
            json!({"command": "drive", "parameters": {"v": "fast", "w": 0}}),
            Reason::WrongType,
        ),
        (
            json!({"command": "drive", "parameters": {"v": 0, "w": 1e9}}),
            Reason::OutOfRange,
        ),
        (
            json!({"command": "goto", "parameters": {"x": 1}}),
            Reason::MissingField,
        ),
        (
            json!({"command": "stop", "parameters": {"now": true}}),
            Reason::UnknownField,
        ),
    ] {
        let (seq, command) = bench.envelope(body);
        bench.send_bytes(command.to_string().into())?;
        let answer = bench.answer(seq, ANSWER).await?;
        is(&answer, ResponseStatus::Rejected, Some(reason))?;
    }
    if begun.elapsed() < Duration::from_millis(u64::from(LONG_MS) / 2) {
        bench.stays("it was turning", 2, is_moving).await?;
    }
    // Nothing but its own time ended it.
    completed(&bench.outcome(turn, ANSWER * 2).await?)
}

pub(in super::super) async fn swarm_stop(bench: &mut Bench) -> Verdict {
    let own = bench.target().robot.as_str();
    let others = bench
        .book
        .fleet
        .iter()
        .filter(|(id, online)| **online && *id != own)
        .count();
    if others > 0 {
        return Err(Failure::Skipped(format!(
            "{others} other robots of the fleet would stop too"
        )));
    }
    let turn = bench.long_turn().await?;
    let seq = bench.send_swarm(Action::Stop)?;
    completed(&bench.outcome(seq, ANSWER).await?)?;
    let answer = bench.outcome(turn, ANSWER).await?;
    is(&answer, ResponseStatus::Failed, Some(Reason::Interrupted))?;
    bench.rests(STOPS).await
}

pub(in super::super) async fn scan(bench: &mut Bench) -> Verdict {
    bench.synchronised().await?;
    let seq = bench.send(Action::Scan)?;
    let answer = bench.answer(seq, ANSWER).await?;
    is(&answer, ResponseStatus::Accepted, None)?;
    bench
        .until("the robot turns, SCANNING", STARTS, |telemetry| {
            telemetry.state == RobotState::Scanning && is_moving(telemetry)
        })
        .await?;
    completed(&bench.outcome(seq, Duration::from_secs(35)).await?)?;
    bench.rests(STOPS).await
}

pub(in super::super) async fn goto(bench: &mut Bench) -> Verdict {
    bench.find_room().await?;
    let here = bench.telemetry(ANSWER).await?.pose;
    let (x, y) = (
        here.x + 0.4 * here.theta.cos(),
        here.y + 0.4 * here.theta.sin(),
    );
    let seq = bench.send(Action::Goto { x, y })?;
    let answer = bench.answer(seq, ANSWER).await?;
    is(&answer, ResponseStatus::Accepted, None)?;
    bench
        .until("the robot is under way to its goal", STARTS, |telemetry| {
            telemetry.behaviour == BehaviourName::Goto && is_moving(telemetry)
        })
        .await?;
    completed(&bench.outcome(seq, Duration::from_secs(40)).await?)?;
    bench.rests(STOPS).await?;
    let there = bench.telemetry(ANSWER).await?.pose;
    let missed = (there.x - x).hypot(there.y - y);
    let tolerance = bench.number("arrive_tolerance")?;
    // It rolls out, and an outside reference may move the estimate once more.
    check(missed <= tolerance + 0.15, || {
        format!("it missed its goal by {missed:.2} m")
    })
}

pub(in super::super) async fn wander(bench: &mut Bench) -> Verdict {
    bench.synchronised().await?;
    let wander = Action::Behave(BehaviourSpec::Wander { speed: 50 });
    completed(&bench.ask(wander.clone()).await?)?;
    bench
        .until("the robot wanders", ANSWER, |telemetry| {
            telemetry.behaviour == BehaviourName::Wander && is_moving(telemetry)
        })
        .await?;
    completed(&bench.ask(Action::Stop).await?)?;
    bench.rests(STOPS).await?;
    let manual = |telemetry: &Telemetry| {
        is_standing(telemetry) && telemetry.behaviour == BehaviourName::Manual
    };
    bench.stays("it stood, manual", 2, manual).await?;
    // So does `behave manual`.
    completed(&bench.ask(wander).await?)?;
    bench.until("the robot wanders", ANSWER, is_moving).await?;
    let end = Action::Behave(BehaviourSpec::Manual);
    completed(&bench.ask(end).await?)?;
    bench.rests(STOPS).await
}

pub(in super::super) async fn policy(bench: &mut Bench) -> Verdict {
    bench.synchronised().await?;
    let policy = PolicyName::new("spread").map_err(|error| Failure::Failed(error.to_string()))?;
    let drive = Action::Behave(BehaviourSpec::Policy { policy });
    completed(&bench.ask(drive).await?)?;
    bench
        .until("the robot drives by its policy", ANSWER, |telemetry| {
            telemetry.behaviour == BehaviourName::Policy && is_moving(telemetry)
        })
        .await?;
    completed(&bench.ask(Action::Stop).await?)?;
    bench.rests(STOPS).await?;
    let manual = |telemetry: &Telemetry| {
        is_standing(telemetry) && telemetry.behaviour == BehaviourName::Manual
    };
    bench.stays("it stood, manual", 2, manual).await
}
