//! A robot on a bench obeys; every other robot does not.

use crawler_drivers::us100::{LinkError, RangeError};
use crawler_hal::{Duration, Instant, Millimeters};
use crawler_protocol::{LinkCut, MAX_MESSAGE};
use proptest::prelude::*;
use std::format;
use std::string::{String, ToString};
use std::vec::Vec;

use crate::testing::{TestRobot, robot, robot_with};

fn bench() -> TestRobot {
    robot_with("rover", |config| config.faults = true)
}

fn at(ms: u64) -> Instant {
    Instant::from_millis(ms)
}

fn inject(robot: &TestRobot, fault: &str, lasting_ms: Option<u32>, now: Instant) {
    let lasting = lasting_ms.map_or(String::new(), |ms| format!(r#","lasting_ms":{ms}"#));
    let text = format!(r#"{{"command":"inject","robot":"rover","fault":{{{fault}}}{lasting}}}"#);
    robot.obey_simulator(text.as_bytes(), now);
}

fn heal(robot: &TestRobot, now: Instant) {
    robot.obey_simulator(br#"{"command":"heal","robot":"rover"}"#, now);
}

/// Texts of the records since the last call.
fn told(robot: &TestRobot) -> Vec<String> {
    core::iter::from_fn(|| {
        let entry = robot.outbox.next_log(0, Instant::BOOT)?;
        assert_eq!(entry.event, "injected");
        Some(entry.text.to_string())
    })
    .collect()
}

const SOUND: Result<Millimeters, RangeError> = Ok(Millimeters(800));

#[test]
fn a_ranger_dies_or_sticks_for_a_time() {
    let robot = bench();
    inject(&robot, r#""fault":"ranger-dead""#, Some(500), at(1_000));
    let dead = Err(RangeError::Link(LinkError::Timeout));
    assert_eq!(robot.injected.range(SOUND, at(1_499)), dead);
    assert_eq!(robot.injected.range(SOUND, at(1_500)), SOUND);
    for (mm, expected) in [
        (300, Ok(Millimeters(300))),
        (5, Err(RangeError::TooNear(Millimeters(5)))),
        (9_999, Err(RangeError::NoEcho(Millimeters(9_999)))),
    ] {
        let fault = format!(r#""fault":"ranger-stuck","mm":{mm}"#);
        inject(&robot, &fault, None, at(2_000));
        assert_eq!(robot.injected.range(SOUND, at(9_000_000)), expected);
    }
    heal(&robot, at(9_000_000));
    assert_eq!(robot.injected.range(SOUND, at(9_000_000)), SOUND);
    assert_eq!(
        told(&robot),
        [
            "ranger-dead for 500 ms",
            "ranger-stuck",
            "ranger-stuck",
            "ranger-stuck",
            "healed"
        ]
    );
}

#[test]
fn a_motor_gets_its_strength_back_when_it_stands() {
    let robot = bench();
    let weak = r#""fault":"motor-weak","wheel":"left","strength":0.5"#;
    inject(&robot, weak, Some(100), at(0));
    assert_eq!(robot.injected.weaken([0.8, 0.8], at(50)), [0.4, 0.8]);
    // Its time is over, but the wheel turns: it would jump.
    assert_eq!(robot.injected.weaken([0.8, 0.8], at(150)), [0.4, 0.8]);
    assert_eq!(robot.injected.weaken([0.0, 0.8], at(170)), [0.0, 0.8]);
    assert_eq!(robot.injected.weaken([0.1, 0.8], at(190)), [0.1, 0.8]);
    let dead = r#""fault":"motor-dead","wheel":"right""#;
    inject(&robot, dead, None, at(200));
    assert_eq!(robot.injected.weaken([0.5, -1.0], at(9_000)), [0.5, 0.0]);
    heal(&robot, at(9_000));
    assert_eq!(robot.injected.weaken([0.5, -1.0], at(9_020)), [0.5, 0.0]);
    assert_eq!(robot.injected.weaken([0.5, 0.0], at(9_040)), [0.5, 0.0]);
    assert_eq!(robot.injected.weaken([0.5, -0.1], at(9_060)), [0.5, -0.1]);
}

#[test]
fn a_link_is_lost_for_a_time_and_never_for_good() {
    let robot = bench();
    let loss = r#""fault":"link-loss","how":"password""#;
    inject(&robot, loss, None, at(0));
    assert_eq!(robot.injected.link(at(1)), None);
    inject(&robot, loss, Some(4_000), at(0));
    assert_eq!(robot.injected.link(at(3_999)), Some(LinkCut::Password));
    assert_eq!(robot.injected.link(at(4_000)), None);
    assert_eq!(
        told(&robot),
        ["link-loss refused: missing_field", "link-loss for 4000 ms"]
    );
}

#[test]
fn a_clock_jumps_and_a_supply_dips() {
    let robot = bench();
    robot.observe_time(1_767_225_600_000, at(0));
    inject(
        &robot,
        r#""fault":"clock-step","ms":-3600000"#,
        None,
        at(1_000),
    );
    assert_eq!(
        robot.unix_ms(at(1_000)),
        Some(1_767_225_601_000 - 3_600_000)
    );
    assert!(!robot.injected.restart_is_due(at(2_000)));
    inject(&robot, r#""fault":"brown-out""#, None, at(2_000));
    assert!(!robot.injected.restart_is_due(at(2_000)));
    assert!(
        robot
            .injected
            .restart_is_due(at(2_000) + Duration::from_millis(300))
    );
}

#[test]
fn what_a_program_cannot_break_is_refused_and_told() {
    let robot = bench();
    for fault in [
        r#""fault":"motor-stuck-on","wheel":"left""#,
        r#""fault":"flash-power-cut","after_bytes":1"#,
        r#""fault":"battery-at","charge":0"#,
        r#""fault":"hostile-packets","per_s":5"#,
        r#""fault":"camera-absent""#,
    ] {
        inject(&robot, fault, Some(1_000), at(0));
    }
    let told = told(&robot);
    assert_eq!(told.len(), 5);
    assert!(
        told.iter()
            .all(|text| text.ends_with("refused: unsupported"))
    );
}

#[test]
fn words_to_others_and_nonsense_change_nothing() {
    let robot = bench();
    for text in [
        r#"{"command":"inject","robot":"other","fault":{"fault":"ranger-dead"}}"#,
        r#"{"command":"pause"}"#,
        r#"{"command":"heal","robot":"other"}"#,
    ] {
        robot.obey_simulator(text.as_bytes(), at(0));
    }
    assert_eq!(told(&robot), [""; 0]);
    robot.obey_simulator(b"{}", at(0));
    assert_eq!(
        told(&robot),
        ["not a command to a simulator: missing_field"]
    );
    assert_eq!(robot.injected.range(SOUND, at(0)), SOUND);
}

/// What a robot on a bench says to each command of a simulator, sound and not.
#[test]
fn of_fifteen_commands_a_robot_obeys_two() {
    // What only simulators are told is theirs to judge.
    for text in [
        r#"{"command":"pause"}"#,
        r#"{"command":"pause","steps":1}"#,
        r#"{"command":"resume"}"#,
        r#"{"command":"step","steps":5}"#,
        r#"{"command":"step","steps":0}"#,
        r#"{"command":"speed","factor":2}"#,
        r#"{"command":"speed","factor":"2"}"#,
        r#"{"command":"reset","seed":7}"#,
        r#"{"command":"reset","seed":null}"#,
        r#"{"command":"add"}"#,
        r#"{"command":"add","pose":{"x":1}}"#,
        r#"{"command":"remove","robot":"rover"}"#,
        r#"{"command":"remove"}"#,
        r#"{"command":"snapshot","name":"a"}"#,
        r#"{"command":"snapshot","name":"../up"}"#,
        r#"{"command":"restore","name":"a"}"#,
        r#"{"command":"restore","name":5}"#,
        r#"{"command":"load","scenario":"a"}"#,
        r#"{"command":"load","scenario":"a","robots":0}"#,
        r#"{"command":"drop","obstacle":{"shape":"circle","x":1,"y":2,"r":0.5}}"#,
        r#"{"command":"drop","obstacle":{"shape":"circle","x":1,"y":2,"r":-1}}"#,
        r#"{"command":"take","item":3}"#,
        r#"{"command":"take","item":3,"item":3}"#,
        r#"{"command":"forget","name":"a"}"#,
        r#"{"command":"forget","name":""}"#,
        r#"{"command":"dance"}"#,
    ] {
        let robot = bench();
        robot.obey_simulator(text.as_bytes(), at(0));
        assert_eq!(told(&robot), [""; 0], "{text}");
        assert_eq!(robot.injected.range(SOUND, at(1)), SOUND, "{text}");
    }
    let fault = r#""fault":{"fault":"ranger-dead"}"#;
    for (fields, record) in [
        // The two, whole.
        (
            format!(r#""command":"inject","robot":"rover",{fault}"#),
            "ranger-dead",
        ),
        (
            format!(r#""lasting_ms":86400000,{fault},"robot":"rover","command":"inject""#),
            "ranger-dead for 86400000 ms",
        ),
        (r#""command":"heal","robot":"rover""#.to_string(), "healed"),
        // And not.
        (r#""command":"heal""#.to_string(), "missing_field"),
        (
            r#""command":"heal","robot":"No""#.to_string(),
            "out_of_range",
        ),
        (r#""command":"heal","robot":5"#.to_string(), "wrong_type"),
        (r#""command":"heal","robot":null"#.to_string(), "wrong_type"),
        (
            r#""command":"heal","robot":"rover","robot":"rover""#.to_string(),
            "duplicate_field",
        ),
        (
            r#""command":"heal","robot":"rover","steps":1"#.to_string(),
            "unknown_field",
        ),
        (
            r#""command":"heal","robot":"rover","colour":1"#.to_string(),
            "unknown_field",
        ),
        (
            r#""command":"heal","robot":"rover","lasting_ms":1"#.to_string(),
            "unknown_field",
        ),
        (
            format!(r#""command":"heal","robot":"rover",{fault}"#),
            "unknown_field",
        ),
        (
            r#""command":"pause","command":"heal","robot":"rover""#.to_string(),
            "duplicate_field",
        ),
        (format!(r#""command":"inject",{fault}"#), "missing_field"),
        (
            r#""command":"inject","robot":"rover""#.to_string(),
            "missing_field",
        ),
        (
            format!(r#""command":"inject","robot":"rover",{fault},"seed":1"#),
            "unknown_field",
        ),
        (
            format!(r#""command":"inject","robot":"rover",{fault},"lasting_ms":0"#),
            "out_of_range",
        ),
        (
            format!(r#""command":"inject","robot":"rover",{fault},"lasting_ms":86400001"#),
            "out_of_range",
        ),
        (
            r#""command":"inject","robot":"rover","fault":{"fault":"rust"}"#.to_string(),
            "out_of_range",
        ),
        (
            r#""command":"inject","robot":"rover","fault":{"fault":"ranger-dead","mm":1}"#
                .to_string(),
            "unknown_field",
        ),
        (
            r#""command":"inject","robot":"rover","fault":"ranger-dead""#.to_string(),
            "wrong_type",
        ),
        // Whose command it is does not matter where it cannot be read.
        (
            r#""command":"heal","robot":"other","colour":1"#.to_string(),
            "unknown_field",
        ),
        (r#""robot":"rover""#.to_string(), "missing_field"),
        (r#""command":5"#.to_string(), "wrong_type"),
        (r#""command":null"#.to_string(), "wrong_type"),
        (
            r#""command":"heal","robot":"rover""}"#.to_string(),
            "malformed",
        ),
    ] {
        let robot = bench();
        let text = format!("{{{fields}}}");
        robot.obey_simulator(text.as_bytes(), at(0));
        let refused = format!("not a command to a simulator: {record}");
        let told = told(&robot);
        let [told] = told.as_slice() else {
            panic!("{text}: {told:?}");
        };
        assert!(told == record || *told == refused, "{text}: {told}");
    }
    for (text, reason) in [
        ("", "malformed"),
        ("[]", "wrong_type"),
        (r#""heal""#, "wrong_type"),
        ("{}", "missing_field"),
        (&" ".repeat(MAX_MESSAGE + 1), "too_large"),
    ] {
        let robot = bench();
        robot.obey_simulator(text.as_bytes(), at(0));
        let refused = format!("not a command to a simulator: {reason}");
        assert_eq!(told(&robot), [refused], "{text}");
    }
}

#[test]
fn a_robot_at_work_takes_no_faults() {
    let robot = robot("rover");
    inject(&robot, r#""fault":"ranger-dead""#, None, at(0));
    inject(&robot, r#""fault":"brown-out""#, None, at(0));
    assert_eq!(robot.injected.range(SOUND, at(1)), SOUND);
    assert!(!robot.injected.restart_is_due(at(10_000)));
    assert_eq!(told(&robot), [""; 0]);
}

proptest! {
    /// Whatever is broken when: a duty is only made smaller, and grows no faster than it is asked
    /// to grow.
    #[test]
    fn no_fault_makes_a_wheel_faster(
        steps in proptest::collection::vec(
            (0..4_u8, 0..3_u8, -1.0..=1.0_f32, 0.0..=1.0_f32, 1..400_u32),
            1..120,
        )
    ) {
        let robot = bench();
        let (mut asked, mut had) = (0.0_f32, 0.0_f32);
        for (step, (what, wheel, goal, strength, ms)) in steps.into_iter().enumerate() {
            let now = at(step as u64 * 20);
            let wheel = if wheel == 0 { "left" } else { "right" };
            match what {
                0 => {
                    let fault = format!(
                        r#""fault":"motor-weak","wheel":"{wheel}","strength":{strength}"#
                    );
                    inject(&robot, &fault, Some(ms), now);
                }
                1 => heal(&robot, now),
                _ => {}
            }
            let next = asked + (goal - asked).clamp(-0.05, 0.05);
            let [_, left] = robot.injected.weaken([next, next], now);
            prop_assert!(left.abs() <= next.abs());
            prop_assert!(left == 0.0 || (left > 0.0) == (next > 0.0));
            prop_assert!(left.abs() - had.abs() <= 0.0501, "from {had} to {left}");
            had = left;
            asked = next;
        }
    }

    #[test]
    fn no_payload_makes_it_panic(payload in proptest::collection::vec(any::<u8>(), 0..=MAX_MESSAGE + 8)) {
        bench().obey_simulator(&payload, at(0));
    }
}
