//! The activities themselves, on a clock of the test, with ports whose other side it holds.

use std::format;

use crawler_drivers::battery::Config as Gauge;
use crawler_hal::{Clock as _, Duration, Instant, Millivolts, RangerPort};
use crawler_protocol::{Action, BehaviourSpec, Command, Reason, ResponseStatus, RobotState};

use crate::perception::SensorHealth;
use crate::testing::flash::TestFlash;
use crate::testing::ports::{BatteryPin, Chip, Line, Motor, NotWired, Ranger};
use crate::testing::{Executor, TestRng, TestRobot, robot, source};
use crate::{control, lamp, power, sense, store};

const BOOTED_MS: u64 = 1_700_000_000_000;

struct Body {
    left: Motor,
    right: Motor,
    ranger: Ranger,
    chip: Chip,
    battery: BatteryPin,
    seq: u64,
}

/// Order in which the activities are spawned.
const CONTROL: usize = 0;
const SENSE: usize = 1;
const POWER: usize = 2;

impl Body {
    fn start<'a>(robot: &'a TestRobot, executor: &mut Executor<'a>) -> Self {
        let clock = executor.clock.clone();
        let body = Self {
            left: Motor::default(),
            right: Motor::default(),
            ranger: Ranger::new(clock.clone(), 2_000),
            chip: Chip::default(),
            battery: BatteryPin::default(),
            seq: 0,
        };
        let full = Gauge::STANDARD.divider.pin(Millivolts(8_000));
        body.battery.0.set(Some(full));
        robot.time.observe(BOOTED_MS, Instant::BOOT);
        executor.spawn(control(
            robot,
            body.left.port(),
            body.right.port(),
            body.chip.clone(),
            TestRng(9),
            clock.clone(),
        ));
        let port: RangerPort<Ranger, Line, NotWired> = RangerPort::Uart(body.ranger.clone());
        executor.spawn(sense(robot, port, clock.clone()));
        executor.spawn(power(robot, body.battery.clone(), clock.clone()));
        executor.spawn(lamp(robot, Line::default(), clock.clone()));
        executor.spawn(store(robot, TestFlash::new(2), clock));
        executor.run_for(Duration::from_secs(1));
        body
    }

    fn send(&mut self, robot: &TestRobot, executor: &Executor<'_>, action: Action) {
        self.seq += 1;
        let command = Command {
            action,
            timestamp: BOOTED_MS + executor.clock.now().as_millis(),
            seq: self.seq,
            source: source("operator:ada"),
        };
        let mut buffer = [0; 1024];
        let len = command.to_json(&mut buffer).expect("fits");
        robot.submit(&buffer[..len], executor.clock.now());
    }

    fn duties(&self) -> [f32; 2] {
        [self.left.duty(), self.right.duty()]
    }
}

fn answer(robot: &TestRobot) -> Option<(ResponseStatus, Option<Reason>)> {
    let (ticket, answer) = robot.outbox.next_answer()?;
    robot.outbox.sent(ticket);
    robot.outbox.delivered(ticket);
    Some((answer.status, answer.reason))
}

#[test]
fn it_starts_drives_and_stops() {
    let robot = robot("whole");
    let mut executor = Executor::default();
    let mut body = Body::start(&robot, &mut executor);
    assert_eq!(robot.snapshot().state, RobotState::Idle);
    let range = robot.snapshot().reading.range_mm(executor.clock.now());
    assert!(matches!(range, Some(2_000..=2_001)), "{range:?}");
    assert_eq!(robot.snapshot().reading.temperature.map(|t| t.0), Some(21));
    assert_eq!(robot.boot().count, 1);

    let wander = Action::Behave(BehaviourSpec::Wander { speed: 80 });
    body.send(&robot, &executor, wander);
    executor.run_for(Duration::from_millis(600));
    assert_eq!(answer(&robot), Some((ResponseStatus::Completed, None)));
    assert_eq!(robot.snapshot().state, RobotState::Moving);
    assert!(
        body.duties().iter().all(|duty| *duty > 0.3),
        "{:?}",
        body.duties()
    );
    assert!(robot.snapshot().pose.x > 0.05);

    // A halt does not wait for the next period: no time passes at all.
    body.send(&robot, &executor, Action::Stop);
    executor.run_woken();
    assert_eq!(body.duties(), [0.0, 0.0]);
    assert_eq!(answer(&robot), Some((ResponseStatus::Completed, None)));
    executor.run_for(Duration::from_secs(5));
    assert_eq!(body.duties(), [0.0, 0.0]);
}

#[test]
fn an_obstacle_slows_it_down_and_a_cut_wire_stops_it() {
    let robot = robot("whole");
    let mut executor = Executor::default();
    let mut body = Body::start(&robot, &mut executor);
    let wander = Action::Behave(BehaviourSpec::Wander { speed: 80 });
    body.send(&robot, &executor, wander);
    executor.run_for(Duration::from_millis(600));
    body.ranger.range_mm.set(400);
    executor.run_for(Duration::from_millis(500));
    assert_eq!(robot.snapshot().state, RobotState::Caution);
    body.ranger.range_mm.set(100);
    executor.run_for(Duration::from_millis(400));
    assert_eq!(robot.snapshot().state, RobotState::Avoiding);
    body.ranger.silent.set(true);
    executor.run_for(Duration::from_millis(500));
    assert_eq!(body.duties(), [0.0, 0.0]);
    executor.run_for(Duration::from_secs(1));
    assert_eq!(robot.snapshot().reading.health, SensorHealth::Dead);
    assert_eq!(robot.snapshot().state, RobotState::Error);
    body.ranger.silent.set(false);
    body.ranger.range_mm.set(2_000);
    executor.run_for(Duration::from_secs(1));
    assert_eq!(robot.snapshot().state, RobotState::Idle, "nothing resumes");
    assert_eq!(body.duties(), [0.0, 0.0]);
}

#[test]
fn an_empty_battery_stops_it_and_is_reported() {
    let robot = robot("whole");
    let mut executor = Executor::default();
    let mut body = Body::start(&robot, &mut executor);
    let empty = Gauge::STANDARD.divider.pin(Millivolts(6_200));
    body.battery.0.set(Some(empty));
    executor.run_for(Duration::from_secs(60));
    assert_eq!(robot.snapshot().state, RobotState::Error);
    body.send(&robot, &executor, Action::Scan);
    executor.run_for(Duration::from_millis(40));
    assert_eq!(
        answer(&robot),
        Some((ResponseStatus::Rejected, Some(Reason::LowBattery)))
    );
}

#[test]
fn a_scan_turns_once_around_and_tells_what_it_saw() {
    let robot = robot("whole");
    let mut executor = Executor::default();
    let mut body = Body::start(&robot, &mut executor);
    body.send(&robot, &executor, Action::Scan);
    executor.run_for(Duration::from_millis(200));
    assert_eq!(answer(&robot), Some((ResponseStatus::Accepted, None)));
    assert_eq!(robot.snapshot().state, RobotState::Scanning);
    executor.run_for(Duration::from_secs(7));
    assert_eq!(answer(&robot), Some((ResponseStatus::Completed, None)));
    assert_eq!(robot.snapshot().state, RobotState::Idle);
    let scans = core::iter::from_fn(|| robot.outbox.next_log(0, executor.clock.now()))
        .filter(|log| log.event == "scan")
        .map(|log| format!("{}", log.text))
        .collect::<std::vec::Vec<_>>();
    assert_eq!(scans.len(), 2);
    assert_eq!(
        scans[0],
        "cm per 15 deg from 0 deg: 200 200 200 200 200 200 200 200 200 200 200 200"
    );
}

#[test]
fn nothing_is_polled_but_what_is_due() {
    let robot = robot("whole");
    let mut executor = Executor::default();
    let _body = Body::start(&robot, &mut executor);
    let before = [CONTROL, SENSE, POWER].map(|task| executor.polls(task));
    executor.run_for(Duration::from_secs(10));
    let after = [CONTROL, SENSE, POWER].map(|task| executor.polls(task));
    let polls = [0, 1, 2].map(|task| after[task] - before[task]);
    assert!(
        (499..=501).contains(&polls[CONTROL]),
        "50 a second: {}",
        polls[CONTROL]
    );
    // A measurement: the reply, the silence behind it, the next tick.
    assert!(polls[SENSE] <= 125 * 5, "{}", polls[SENSE]);
    assert!((9..=11).contains(&polls[POWER]), "{}", polls[POWER]);
}

#[test]
fn the_watchdog_is_fed_by_a_healthy_loop_alone() {
    let robot = robot("whole");
    let mut executor = Executor::default();
    let mut body = Body::start(&robot, &mut executor);
    let feeds = |body: &Body| body.chip.feeds.get();
    let before = feeds(&body);
    executor.run_for(Duration::from_secs(1));
    assert!((49..=51).contains(&(feeds(&body) - before)));

    // A step that comes too late is no sign of health; the next one is.
    let before = feeds(&body);
    executor.starve(Duration::from_millis(150));
    assert_eq!(feeds(&body), before);
    executor.run_for(Duration::from_millis(20));
    assert_eq!(feeds(&body), before + 1);

    // An enable output that refuses: the wheel is stopped by its direction inputs.
    let wander = Action::Behave(BehaviourSpec::Wander { speed: 80 });
    body.send(&robot, &executor, wander);
    executor.run_for(Duration::from_millis(300));
    body.left.enable.refuses.set(true);
    executor.run_for(Duration::from_millis(60));
    let before = feeds(&body);
    executor.run_for(Duration::from_secs(1));
    assert_eq!(feeds(&body), before, "not fed");
    assert_eq!(robot.snapshot().state, RobotState::Error);
    assert_eq!(body.duties(), [0.0, 0.0]);
    body.left.enable.refuses.set(false);
    executor.run_for(Duration::from_millis(100));
    assert!(feeds(&body) > before);
    assert_eq!(robot.snapshot().state, RobotState::Idle);
    assert_eq!(body.chip.resets.get(), 0);
}

#[test]
fn a_wheel_that_cannot_be_stopped_resets_the_pins() {
    let robot = robot("whole");
    let mut executor = Executor::default();
    let mut body = Body::start(&robot, &mut executor);
    let wander = Action::Behave(BehaviourSpec::Wander { speed: 80 });
    body.send(&robot, &executor, wander);
    executor.run_for(Duration::from_millis(300));
    for line in [&body.left.enable, &body.left.in1, &body.left.in2] {
        line.refuses.set(true);
    }
    let before = body.chip.feeds.get();
    executor.run_for(Duration::from_millis(200));
    assert!(body.chip.feeds.get() <= before + 1, "not fed");
    assert_eq!(body.chip.resets.get(), 1);
}

#[test]
fn reboot_answers_comes_to_rest_and_resets() {
    let robot = robot("whole");
    let mut executor = Executor::default();
    let mut body = Body::start(&robot, &mut executor);
    let wander = Action::Behave(BehaviourSpec::Wander { speed: 80 });
    body.send(&robot, &executor, wander);
    executor.run_for(Duration::from_millis(600));
    assert!(answer(&robot).is_some());
    body.send(&robot, &executor, Action::Reboot);
    executor.run_for(Duration::from_millis(400));
    assert_eq!(body.chip.resets.get(), 0);
    assert_eq!(answer(&robot), Some((ResponseStatus::Completed, None)));
    executor.run_for(Duration::from_millis(200));
    assert_eq!(body.chip.resets.get(), 1);
    assert_eq!(body.duties(), [0.0, 0.0]);
}
