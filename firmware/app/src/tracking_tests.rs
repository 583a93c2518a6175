//! Which fixes are taken, and what becomes of the others.

use crawler_hal::{Duration, Instant};
use crawler_protocol::{Action, Command, Pose, PoseFix, RobotId, Source};
use proptest::prelude::*;
use std::vec::Vec;

use super::{AHEAD, FRESH_FOR, Fix, Refusal, TOLD_EVERY};
use crate::control::ControlLoop;
use crate::testing::{TestRng, TestRobot, robot};

const BOOTED_MS: u64 = 1_700_000_000_000;
const NOW: Instant = Instant::from_millis(10_000);
const NOW_MS: u64 = BOOTED_MS + 10_000;

const POSE: Pose = Pose {
    x: 1.0,
    y: -2.0,
    theta: 0.5,
    sigma: 0.01,
};

fn json(id: &str, timestamp: u64, pose: Pose) -> Vec<u8> {
    let mut buffer = [0; 256];
    let robot = RobotId::new(id).expect("legal");
    let fix = PoseFix {
        robot,
        timestamp,
        pose,
    };
    let len = fix.to_json(&mut buffer).expect("fits");
    buffer[..len].to_vec()
}

fn synchronised() -> TestRobot {
    let robot = robot("seen");
    robot.time.observe(BOOTED_MS, Instant::BOOT);
    robot
}

#[test]
fn a_fix_of_now_is_handed_over_once_and_the_newest_only() {
    let robot = synchronised();
    for age in [300, 200, 100] {
        let payload = json("seen", NOW_MS - age, POSE);
        assert_eq!(robot.observe_fix(&payload, NOW), Ok(()));
    }
    let seen = Instant::from_millis(9_900);
    assert_eq!(
        robot.control_handle().take_fix(),
        Some(Fix { pose: POSE, seen })
    );
    assert_eq!(robot.control_handle().take_fix(), None);
    assert_eq!(robot.refused_fixes(), 0);
}

#[test]
fn fixes_of_another_time_are_refused_while_the_clock_is_known() {
    let robot = synchronised();
    let (late, early) = (FRESH_FOR.as_millis(), AHEAD.as_millis());
    let judge = |timestamp| robot.observe_fix(&json("seen", timestamp, POSE), NOW);
    assert_eq!(judge(NOW_MS - late - 1), Err(Refusal::Stale));
    assert_eq!(judge(0), Err(Refusal::Stale));
    assert_eq!(judge(NOW_MS + early + 1), Err(Refusal::Future));
    assert_eq!(judge(u64::MAX), Err(Refusal::Future));
    assert_eq!(robot.control_handle().take_fix(), None);
    assert_eq!(judge(NOW_MS - late), Ok(()));
    assert_eq!(judge(NOW_MS - late), Err(Refusal::Repeated));
    assert_eq!(judge(NOW_MS + early), Ok(()));
    assert_eq!(robot.refused_fixes(), 5);
    let fix = robot.control_handle().take_fix().expect("the last one");
    assert_eq!(fix.seen, NOW, "not in the future");
}

#[test]
fn without_a_clock_a_fix_was_seen_when_it_came() {
    let robot = robot("seen");
    assert_eq!(robot.observe_fix(&json("seen", 17, POSE), NOW), Ok(()));
    assert_eq!(
        robot.control_handle().take_fix().map(|fix| fix.seen),
        Some(NOW)
    );
}

#[test]
fn nonsense_is_refused_counted_and_told_now_and_then() {
    let robot = synchronised();
    let judge = |payload: &[u8]| robot.observe_fix(payload, NOW);
    assert_eq!(
        judge(&json("other", NOW_MS, POSE)),
        Err(Refusal::OtherRobot)
    );
    let far = |x, y, theta, sigma| Pose { x, y, theta, sigma };
    for pose in [
        far(1_001.0, 0.0, 0.0, 0.1),
        far(0.0, -1e30, 0.0, 0.1),
        far(0.0, 0.0, 7.0, 0.1),
        far(0.0, 0.0, 0.0, -0.1),
        far(0.0, 0.0, 0.0, 11.0),
    ] {
        assert_eq!(
            judge(&json("seen", NOW_MS, pose)),
            Err(Refusal::OutOfRange),
            "{pose:?}"
        );
    }
    let huge = br#"{"robot":"seen","timestamp":1,"pose":{"x":1e99,"y":0,"theta":0,"sigma":0}}"#;
    for text in [&b""[..], b"{}", b"null", b"\xff\xfe", huge] {
        assert_eq!(judge(text), Err(Refusal::Malformed));
    }
    assert_eq!(robot.refused_fixes(), 11);
    let logs = |now| {
        let mut count = 0;
        while robot.outbox.next_log(0, now).is_some() {
            count += 1;
        }
        count
    };
    assert_eq!(logs(NOW), 1, "the first one, and no other");
    let later = NOW + TOLD_EVERY + Duration::from_millis(1);
    let _ = robot.observe_fix(b"", later);
    assert_eq!(logs(later), 1);
}

#[test]
fn orders_at_every_step_do_not_keep_a_reference_from_control() {
    let robot = synchronised();
    robot.store_handle().set_loaded();
    let mut control = ControlLoop::new(&robot);
    let mut rng = TestRng(1);
    let payload = json("seen", NOW_MS, POSE);
    assert_eq!(robot.observe_fix(&payload, NOW), Ok(()));
    let mut step = |number: u64| {
        let now = NOW + Duration::from_millis(20 * number);
        let command = Command {
            action: Action::Identify,
            timestamp: 0,
            seq: number + 1,
            source: Source::new("flood").expect("legal"),
        };
        assert!(robot.route(&command, now, |_| ()).is_ok());
        let outputs = control.turn(&robot, None, false, &mut rng, now);
        assert!(outputs.identify, "the order was not taken");
        control.controller().pose()
    };
    assert_eq!(step(0), Pose::default(), "an order and a reference at once");
    assert_eq!(step(1), POSE);
}

proptest! {
    #[test]
    fn no_bytes_do_harm(payload in prop::collection::vec(any::<u8>(), 0..300)) {
        let robot = synchronised();
        let _ = robot.observe_fix(&payload, NOW);
        prop_assert_eq!(robot.control_handle().take_fix(), None);
    }
}
