//! What is wrong with a robot leads to a stated state and a pattern of the lamp, and is told when
//! there is someone to tell. `docs/faults.md` is the list.

use std::collections::HashMap;

use crate::common::{duty, forward, lockstep, settle};
use crawler_app::parameters::Parameter;
use crawler_app::trouble::LinkTrouble;
use crawler_drivers::lamp::Pattern;
use crawler_hal::{Duration, ResetCause};
use crawler_protocol::{
    Action, BootCause, Direction, Level, LogRecord, ParameterValue, ParameterValues, Reason,
    Response, ResponseStatus, RobotState, StatusMessage, Topic,
};
use crawler_sim::faults::Fault;
use crawler_sim::net::lockstep::{Cut, PeerFault};
use crawler_sim::run::{EPOCH_MS, Simulation};

const SECOND: Duration = Duration::from_secs(1);

/// What robots published since the last call.
#[derive(Debug, Default)]
struct Told {
    logs: Vec<LogRecord>,
    responses: Vec<Response>,
    statuses: Vec<StatusMessage>,
}

impl Told {
    fn since(simulation: &Simulation) -> Self {
        let mut told = Self::default();
        for published in simulation.network().unwrap().take_record() {
            let payload = &published.payload;
            match Topic::parse(simulation.fleet(), &published.topic).unwrap() {
                Topic::Logs(_) => told.logs.push(LogRecord::from_json(payload).unwrap()),
                Topic::Response(_) => told.responses.push(Response::from_json(payload).unwrap()),
                Topic::Status(_) => told
                    .statuses
                    .push(StatusMessage::from_json(payload).unwrap()),
                _ => {}
            }
        }
        told
    }

    /// Whether there is a record of `event` with `words` in its text.
    fn says(&self, event: &str, words: &str) -> bool {
        let mut logs = self.logs.iter();
        logs.any(|record| record.event == event && record.text.contains(words))
    }
}

/// The pattern that the lamp pin of robot 0 follows from now on.
fn shown(simulation: &mut Simulation) -> Pattern {
    const STEP_MS: u64 = 10;
    let mut runs: Vec<(bool, u64)> = Vec::new();
    for _ in 0..1_000 {
        simulation.run_for(Duration::from_millis(STEP_MS));
        let lit = simulation.observe(0).unwrap().lamp;
        match runs.last_mut() {
            Some((last, ms)) if *last == lit => *ms += STEP_MS,
            _ => runs.push((lit, STEP_MS)),
        }
    }
    // The first and the last are cut off.
    let whole = &runs[1..runs.len() - 1];
    let fits = |pattern: &&Pattern| {
        let table = pattern.table_ms();
        (0..table.len()).step_by(2).any(|start| {
            let start = start + usize::from(!whole[0].0);
            whole.iter().enumerate().all(|(index, &(_, ms))| {
                let wanted = u64::from(table[(start + index) % table.len()]);
                // Edges fall between two looks.
                ms.abs_diff(wanted) <= STEP_MS
            })
        })
    };
    let matching: Vec<_> = Pattern::ALL.iter().filter(fits).collect();
    assert_eq!(matching.len(), 1, "{matching:?} for {whole:?}");
    *matching[0]
}

fn state(simulation: &Simulation) -> RobotState {
    simulation.robot(0).unwrap().snapshot().state
}

fn inject(simulation: &mut Simulation, fault: Fault) {
    simulation.inject(0, fault, None).unwrap();
}

fn heal(simulation: &mut Simulation) {
    simulation.heal(0);
}

#[test]
fn a_sound_robot_shows_its_state() {
    let mut simulation = lockstep("empty", 1, 1);
    settle(&mut simulation);
    assert_eq!(shown(&mut simulation), Pattern::Idle);
}

#[test]
fn an_absent_or_stuck_ranger_is_a_state() {
    for (fault, words) in [(Fault::RangerDead, "dead"), (Fault::LineStuck, "dead")] {
        let mut simulation = lockstep("empty", 1, 2);
        inject(&mut simulation, fault);
        settle(&mut simulation);
        assert_eq!(state(&simulation), RobotState::Error, "{fault:?}");
        assert_eq!(shown(&mut simulation), Pattern::RangerFault, "{fault:?}");
        simulation.submit(0, forward(50, 1_000));
        simulation.run_for(SECOND);
        assert_eq!(duty(&simulation, 0), [0, 0]);
        let told = Told::since(&simulation);
        assert!(told.says("ranger", words), "{fault:?}: {told:?}");
        assert!(told.says("fault", "ranger"), "{fault:?}: {told:?}");
        // Nothing else stops: it answers, and comes back by itself.
        assert!(!told.responses.is_empty());
        heal(&mut simulation);
        simulation.run_for(SECOND * 3);
        assert_eq!(state(&simulation), RobotState::Idle, "{fault:?}");
        assert!(Told::since(&simulation).says("fault", "ranger is over"));
    }
}

/// Cuts robot 0 off in a way it can name, while it loses its ranger as well; returns what it
/// tells afterwards.
fn cut_off(cut: Cut, pattern: Pattern, trouble: LinkTrouble) -> Told {
    let mut simulation = lockstep("empty", 1, 3);
    settle(&mut simulation);
    simulation.cut(0, cut);
    simulation.run_for(SECOND * 40);
    assert_eq!(
        simulation.robot(0).unwrap().link_trouble(),
        Some(trouble),
        "{cut:?}"
    );
    assert_eq!(state(&simulation), RobotState::Idle);
    assert_eq!(shown(&mut simulation), pattern, "{cut:?}");
    inject(&mut simulation, Fault::RangerDead);
    simulation.run_for(SECOND * 3);
    heal(&mut simulation);
    simulation.run_for(SECOND * 200);
    drop(Told::since(&simulation));
    simulation.cut(0, Cut::None);
    simulation.run_for(SECOND * 45);
    assert_eq!(simulation.robot(0).unwrap().link_trouble(), None);
    assert_eq!(shown(&mut simulation), Pattern::Idle);
    let told = Told::since(&simulation);
    assert!(told.says("ranger", "good"), "{cut:?}: {told:?}");
    assert!(told.says("link-lost", ""), "{cut:?}: {told:?}");
    told
}

#[test]
fn a_wrong_network_password_is_shown_and_told_afterwards() {
    let trouble = LinkTrouble::Password;
    let told = cut_off(Cut::Password, Pattern::NetworkPassword, trouble);
    assert!(told.says("network-password", "refuses"), "{told:?}");
}

#[test]
fn a_network_without_addresses_is_shown_and_told_afterwards() {
    let told = cut_off(Cut::NoAddress, Pattern::NoAddress, LinkTrouble::NoAddress);
    assert!(told.says("no-address", "no address"), "{told:?}");
}

#[test]
fn no_network_is_shown_and_told_afterwards() {
    let told = cut_off(Cut::Radio, Pattern::NoNetwork, LinkTrouble::NoNetwork);
    assert!(told.says("no-network", "network"), "{told:?}");
}

#[test]
fn a_silent_broker_is_shown_and_told_afterwards() {
    let told = cut_off(Cut::Silent, Pattern::NoLink, LinkTrouble::NoBroker);
    assert!(told.says("link-failed", "does not answer"), "{told:?}");
}

#[test]
fn a_broker_that_refuses_credentials_is_shown_and_told_afterwards() {
    let mut simulation = lockstep("empty", 1, 4);
    settle(&mut simulation);
    let network = simulation.network().unwrap().clone();
    simulation.require_credentials(Some(("rover", "open sesame")));
    simulation.cut(0, Cut::Radio);
    simulation.run_for(SECOND);
    simulation.cut(0, Cut::None);
    simulation.run_for(SECOND * 60);
    let trouble = simulation.robot(0).unwrap().link_trouble();
    assert_eq!(trouble, Some(LinkTrouble::Credentials));
    assert_eq!(state(&simulation), RobotState::Idle);
    assert_eq!(shown(&mut simulation), Pattern::BrokerRefuses);
    let refusals = network.take_faults();
    let refused = |fault: &PeerFault| *fault == PeerFault::NotAuthorized;
    assert!(refusals.iter().any(|(_, fault)| refused(fault)));
    assert!(refusals.len() < 10, "no hammering: {}", refusals.len());
    drop(Told::since(&simulation));
    simulation.require_credentials(None);
    simulation.run_for(SECOND * 35);
    assert_eq!(shown(&mut simulation), Pattern::Idle);
    let told = Told::since(&simulation);
    assert!(told.says("broker-credentials", "(0x87)"), "{told:?}");
}

#[test]
fn robots_with_the_right_credentials_are_let_in() {
    let mut simulation = lockstep("empty", 2, 4);
    let network = simulation.network().unwrap().clone();
    simulation.require_credentials(Some(("rover", "open sesame")));
    simulation.set_credentials("rover", "open sesame").unwrap();
    settle(&mut simulation);
    assert_eq!(network.connected(), 0, "the old program does not know");
    for robot in 0..2 {
        simulation.crash(robot, "src/x.rs:1: restart");
    }
    simulation.run_for(SECOND * 10);
    assert_eq!(network.connected(), 2);
    let long = "x".repeat(65);
    assert!(simulation.set_credentials("rover", &long).is_err());
}

/// A time message of the server, in milliseconds from what is true.
fn tell_time(simulation: &mut Simulation, off_ms: i64) {
    let topic = Topic::Time.render(simulation.fleet());
    let time = simulation.unix_ms().saturating_add_signed(off_ms);
    let body = format!(r#"{{"timestamp":{time}}}"#);
    simulation.publish(&topic, body.as_bytes(), false, false);
}

/// Unix time by robot 0, in milliseconds from what is true.
fn clock_off(simulation: &Simulation) -> i64 {
    let robot = simulation.robot(0).unwrap();
    // One boot, at the beginning of the world.
    let time = robot.unix_ms(simulation.now()).expect("synchronised");
    time as i64 - simulation.unix_ms() as i64
}

#[test]
fn a_single_wrong_time_moves_no_clock_and_no_robot() {
    const HOUR: i64 = 3_600_000;
    for off_ms in [-HOUR, HOUR, -50 * 365 * 24 * HOUR, 200 * 365 * 24 * HOUR] {
        let mut simulation = lockstep("empty", 1, 5);
        settle(&mut simulation);
        simulation.run_for(SECOND * 20);
        drop(Told::since(&simulation));
        for _ in 0..20 {
            tell_time(&mut simulation, off_ms);
            simulation.run_for(Duration::from_millis(50));
        }
        assert!(clock_off(&simulation).abs() < 100, "{off_ms}");
        assert_eq!(state(&simulation), RobotState::Idle);
        assert_eq!(duty(&simulation, 0), [0, 0]);
        // Turning in place needs no room.
        simulation.submit(
            0,
            Action::Move {
                direction: Direction::Left,
                speed: 40,
                duration_ms: 200,
            },
        );
        simulation.run_for(SECOND * 2);
        let told = Told::since(&simulation);
        let last = told.responses.last().unwrap();
        assert_eq!(last.status, ResponseStatus::Completed, "{off_ms}: {told:?}");
        let warned = told.logs.iter().filter(|record| record.event == "time");
        assert_eq!(warned.count(), 1, "{off_ms}: told once");
        assert!(told.says("time", "not believed yet"));
        assert_eq!(shown(&mut simulation), Pattern::Idle);
    }
}

#[test]
fn a_server_whose_clock_was_set_is_believed_after_a_while_and_it_is_told() {
    const HOUR_MS: u64 = 3_600_000;
    for (epoch, by) in [(EPOCH_MS - HOUR_MS, "-3"), (EPOCH_MS + HOUR_MS, "3")] {
        let mut simulation = lockstep("empty", 1, 6);
        settle(&mut simulation);
        simulation.run_for(SECOND * 20);
        simulation.serve_time(epoch, SECOND * 5);
        // Meanwhile a motion command by the new clock is refused: it could be an old one.
        simulation.run_for(SECOND * 6);
        drop(Told::since(&simulation));
        let now = epoch + simulation.now().as_millis();
        let body = format!(
            r#"{{"command":"move","parameters":{{"direction":"forward","speed":30,"duration":200}},"timestamp":{now},"seq":1,"source":"operator:ada"}}"#
        );
        simulation.submit_raw(0, body.as_bytes());
        simulation.run_for(SECOND);
        let told = Told::since(&simulation);
        let refused = told.responses.last().unwrap();
        let expected = if epoch < EPOCH_MS {
            (ResponseStatus::Expired, None)
        } else {
            (ResponseStatus::Rejected, Some(Reason::OutOfRange))
        };
        assert_eq!((refused.status, refused.reason), expected);
        assert_eq!(duty(&simulation, 0), [0, 0]);
        // A halt needs no clock.
        simulation.submit(0, Action::Stop);
        simulation.run_for(SECOND * 15);
        let told = Told::since(&simulation);
        assert!(told.says("time", &format!("moved by {by}")), "{told:?}");
        let completed = |r: &Response| r.status == ResponseStatus::Completed;
        assert!(told.responses.iter().any(completed), "{told:?}");
        let robot = simulation.robot(0).unwrap();
        let time = robot.unix_ms(simulation.now()).unwrap();
        assert!(time.abs_diff(epoch + simulation.now().as_millis()) < 100);
        assert_eq!(shown(&mut simulation), Pattern::Idle);
    }
}

#[test]
fn a_flash_full_of_noise_costs_the_parameters_and_nothing_else() {
    const ROBOTS: usize = 60;
    let mut simulation = lockstep("empty", ROBOTS as u32, 7);
    settle(&mut simulation);
    for robot in 0..ROBOTS {
        let seed = robot as u32;
        let noise = Fault::FlashNoise { seed };
        simulation.inject(robot, noise, None).unwrap();
    }
    simulation.submit_all(Action::Reboot);
    simulation.run_for(SECOND * 10);
    let mut values = ParameterValues::new();
    let name = heapless::String::try_from("safe_distance_mm").unwrap();
    values.push((name, ParameterValue::Number(725.0))).unwrap();
    for robot in 0..ROBOTS {
        assert_eq!(simulation.boots(robot), 2);
        let context = simulation.robot(robot).unwrap();
        assert_eq!(context.snapshot().state, RobotState::Idle, "robot {robot}");
        assert_eq!(context.boot().count, 1, "robot {robot} counts anew");
        let safe = context.with_parameters(|p| p.number(Parameter::SafeDistance));
        let sound = simulation.robot(0).unwrap();
        assert_eq!(
            safe,
            sound.with_parameters(|p| p.number(Parameter::SafeDistance))
        );
    }
    let told = Told::since(&simulation);
    let mut robots: HashMap<String, Level> = HashMap::new();
    for record in told.logs.iter().filter(|record| record.event == "flash") {
        robots.insert(record.robot.as_str().to_owned(), record.level);
    }
    assert_eq!(robots.len(), ROBOTS, "every one of them tells");
    assert_eq!(shown(&mut simulation), Pattern::Idle);
    // What is stored from now on is kept.
    simulation.submit_all(Action::Set(values));
    simulation.run_for(SECOND * 3);
    simulation.submit_all(Action::Reboot);
    simulation.run_for(SECOND * 10);
    for robot in 0..ROBOTS {
        let context = simulation.robot(robot).unwrap();
        assert_eq!(context.boot().count, 2, "robot {robot}");
        let safe = context.with_parameters(|p| p.number(Parameter::SafeDistance));
        assert_eq!(safe, 725.0, "robot {robot}");
        assert_eq!(simulation.observe(robot).unwrap().flash_violations, 0);
    }
}

#[test]
fn a_panic_is_told_in_the_status_and_in_a_record() {
    let mut simulation = lockstep("empty", 1, 8);
    settle(&mut simulation);
    drop(Told::since(&simulation));
    let text = "src/wheel.rs:12: a wheel fell off";
    simulation.crash(0, text);
    simulation.run_for(SECOND * 8);
    let told = Told::since(&simulation);
    let status = told.statuses.iter().rfind(|status| status.online).unwrap();
    assert_eq!(status.boot.cause, BootCause::Panic);
    assert_eq!(status.boot.panic.as_deref(), Some(text));
    assert!(told.says("panic", text), "{told:?}");
    assert_eq!(state(&simulation), RobotState::Idle);
    // Only once: the boot after that is an ordinary one.
    simulation.submit(0, Action::Reboot);
    simulation.run_for(SECOND * 8);
    let told = Told::since(&simulation);
    let status = told.statuses.iter().rfind(|status| status.online).unwrap();
    assert_eq!(status.boot.cause, BootCause::Software);
    assert_eq!(status.boot.panic, None);
    assert!(!told.says("panic", ""));
    let context = simulation.robot(0).unwrap();
    assert_eq!(context.boot().cause, ResetCause::Software);
}
