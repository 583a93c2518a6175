use std::time::{Duration, Instant};

use super::presence::{OFFLINE_AFTER, STALE_AFTER};
use super::*;

fn fleet() -> FleetState {
    FleetState::new(Fleet::default())
}

fn id(text: &str) -> RobotId {
    RobotId::new(text).expect("robot id")
}

fn status(robot: &str, online: bool) -> String {
    format!(
        r#"{{"robot":"{robot}","online":{online},"kind":"simulated","firmware":"0.1.0","board":"sim","capabilities":["drive"],"boot":{{"count":1,"cause":"power-on"}},"protocol":1}}"#
    )
}

fn heartbeat(robot: &str, uptime_ms: u64) -> String {
    format!(r#"{{"robot":"{robot}","seq":1,"timestamp":5,"uptime_ms":{uptime_ms},"state":"IDLE"}}"#)
}

fn telemetry(robot: &str, x: f32) -> String {
    format!(
        r#"{{"robot":"{robot}","seq":1,"timestamp":6,"state":"MOVING","behaviour":"manual","pose":{{"x":{x},"y":0.0,"theta":0.0,"sigma":0.1}},"range_mm":null,"temperature_c":null,"wheels":{{"left":0.0,"right":0.0}},"battery":{{"mv":7400,"percent":50}},"rssi_dbm":null}}"#
    )
}

fn message<'a>(topic: &'a [u8], payload: &'a [u8], retained: bool) -> Incoming<'a> {
    Incoming {
        topic,
        payload,
        retained,
        content_type: None,
        properties: &[],
    }
}

impl FleetState {
    fn hear(&mut self, topic: &str, payload: &str, now: Instant) -> Result<(), ingest::Rejection> {
        self.receive(&message(topic.as_bytes(), payload.as_bytes(), false), now)
            .map(|_| ())
    }

    fn presence(&self, robot: &str) -> Presence {
        self.get(&id(robot)).expect("known").presence
    }
}

#[test]
fn silence_makes_stale_then_offline() {
    let start = Instant::now();
    let mut fleet = fleet();
    fleet
        .hear("swarm/heartbeat/a", &heartbeat("a", 1), start)
        .expect("heartbeat");
    for (after, presence) in [
        (Duration::ZERO, Presence::Online),
        (Duration::from_millis(2_999), Presence::Online),
        (STALE_AFTER, Presence::Stale),
        (Duration::from_millis(14_999), Presence::Stale),
        (OFFLINE_AFTER, Presence::Offline),
    ] {
        fleet.sweep(start + after);
        assert_eq!(fleet.presence("a"), presence, "after {after:?}");
    }
    let later = start + Duration::from_mins(1);
    fleet
        .hear("swarm/telemetry/a", &telemetry("a", 0.0), later)
        .expect("telemetry");
    assert_eq!(fleet.presence("a"), Presence::Online);
}

#[test]
fn a_will_counts_at_once_and_a_later_word_outweighs_it() {
    let now = Instant::now();
    let mut fleet = fleet();
    fleet
        .hear("swarm/status/a", &status("a", true), now)
        .expect("status");
    assert_eq!(fleet.presence("a"), Presence::Online);
    fleet
        .hear("swarm/status/a", &status("a", false), now)
        .expect("will");
    assert_eq!(fleet.presence("a"), Presence::Offline);
    // The will of a session that another took over comes after the other's first words.
    fleet
        .hear("swarm/heartbeat/a", &heartbeat("a", 1), now)
        .expect("heartbeat");
    assert_eq!(fleet.presence("a"), Presence::Online);
}

#[test]
fn a_retained_status_does_not_make_a_robot_online() {
    let now = Instant::now();
    let mut fleet = fleet();
    let status = status("a", true);
    fleet
        .receive(&message(b"swarm/status/a", status.as_bytes(), true), now)
        .expect("status");
    assert_eq!(fleet.presence("a"), Presence::Stale);
    fleet.sweep(now + OFFLINE_AFTER);
    assert_eq!(fleet.presence("a"), Presence::Offline);
}

#[test]
fn hostile_messages_change_nothing() {
    use ingest::Rejection::{Absurd, Malformed, Mismatch, RobotId, TooLarge, Topic};
    let now = Instant::now();
    let mut fleet = fleet();
    fleet
        .hear("swarm/telemetry/a", &telemetry("a", 1.5), now)
        .expect("telemetry");
    let long = "x".repeat(1_025);
    let telemetry_b = telemetry("b", 0.0);
    let far = telemetry("a", 2.0e6);
    let extra = telemetry("a", 0.0).replace(r#""seq":1"#, r#""seq":1,"seq":2"#);
    for (topic, payload, rejection) in [
        ("swarm/telemetry/a", "", Malformed),
        ("swarm/telemetry/a", "{", Malformed),
        ("swarm/telemetry/a", "null", Malformed),
        ("swarm/telemetry/a", "\u{0}", Malformed),
        ("swarm/telemetry/a", &extra, Malformed),
        ("swarm/telemetry/a", &long, TooLarge),
        ("swarm/telemetry/a", &telemetry_b, Mismatch),
        ("swarm/telemetry/a", &far, Absurd),
        ("swarm/telemetry/A", &telemetry_b, RobotId),
        ("swarm/telemetry/../a", "{}", Topic),
        ("swarm/telemetry/", "{}", RobotId),
        ("other/telemetry/a", &telemetry_b, Topic),
        ("swarm/command/swarm", "{}", Topic),
        ("", "", Topic),
    ] {
        assert_eq!(
            fleet.hear(topic, payload, now),
            Err(rejection),
            "{topic} {payload:.40}"
        );
    }
    assert_eq!(
        fleet.receive(&message(b"swarm/telemetry/\xff", b"{}", false), now),
        Err(Topic)
    );
    assert_eq!(fleet.robots().count(), 1);
    let pose = fleet
        .get(&id("a"))
        .and_then(|robot| robot.telemetry.as_ref());
    assert_eq!(pose.expect("telemetry").pose.x, 1.5);
}

#[test]
fn rejections_are_told_once_in_a_while() {
    let now = Instant::now();
    let mut fleet = fleet();
    for _ in 0..1_000 {
        let _ = fleet.hear("swarm/telemetry/a", "{", now);
    }
    assert_eq!(fleet.events.newest(usize::MAX).count(), 1);
    let _ = fleet.hear("swarm/telemetry/a", "{", now + Duration::from_secs(6));
    let texts: Vec<_> = fleet
        .events
        .newest(2)
        .map(|event| event.text.clone())
        .collect();
    assert!(texts[1].contains("1000 messages"), "{texts:?}");
}

#[test]
fn two_robots_with_one_id_are_noticed_and_a_restart_is_not() {
    let start = Instant::now();
    let mut fleet = fleet();
    let mut beat = |second: u64, uptime_ms: u64| {
        fleet
            .hear(
                "swarm/heartbeat/a",
                &heartbeat("a", uptime_ms),
                start + Duration::from_secs(second),
            )
            .expect("heartbeat");
        let errors = fleet.events.newest(usize::MAX);
        errors.filter(|event| event.level == Level::Error).count()
    };
    for second in 0..20 {
        assert_eq!(beat(second, second * 1_000), 0);
    }
    for second in 20..80 {
        assert_eq!(beat(second, (second - 20) * 1_000), 0, "one restart");
    }
    for second in 0..10 {
        beat(100 + second, 900_000 + second);
        beat(100 + second, 5_000 + second);
    }
    assert_eq!(beat(110, 6_000), 1, "told once");
    assert!(fleet.get(&id("a")).expect("known").has_double());
}

/// A bad release: the new program starts, panics, is tried once more, and the robot goes back, twice.
#[test]
fn restarts_into_other_programs_are_none_of_two_robots() {
    let start = Instant::now();
    let mut fleet = fleet();
    let mut boot = |count: u32, build: &str| {
        let told = format!(
            r#"{{"robot":"a","online":true,"kind":"simulated","firmware":"0.1.0","board":"sim","capabilities":["drive"],"boot":{{"count":{count},"cause":"software"}},"protocol":1,"build":"{build}"}}"#
        );
        for at in 0..5 {
            let now = start + Duration::from_secs(u64::from(count) * 5 + at);
            if at == 0 {
                fleet.hear("swarm/status/a", &told, now).expect("status");
            }
            let beat = heartbeat("a", at * 1_000);
            fleet
                .hear("swarm/heartbeat/a", &beat, now)
                .expect("heartbeat");
        }
        fleet.get(&id("a")).expect("known").has_double()
    };
    for (count, build) in (1..).zip(["old", "new", "new", "old", "new", "new", "old"]) {
        assert!(!boot(count, build), "start {count}");
    }
    // One that keeps restarting in one program is told of.
    assert!(boot(8, "old"));
    // Two robots with one id that run different programs are as well: neither starts anew.
    for build in ["new", "old", "new", "old"] {
        boot(9, build);
    }
    assert!(boot(9, "new"));
}

#[test]
fn the_fleet_is_bounded_and_makes_room_only_for_the_absent() {
    let start = Instant::now();
    let mut fleet = fleet();
    for number in 0..MAX_ROBOTS {
        let robot = format!("r-{number}");
        let topic = format!("swarm/heartbeat/{robot}");
        fleet
            .hear(&topic, &heartbeat(&robot, 1), start)
            .expect("room");
    }
    let topic = "swarm/heartbeat/late";
    assert_eq!(
        fleet.hear(topic, &heartbeat("late", 1), start),
        Err(ingest::Rejection::Full)
    );
    fleet
        .hear("swarm/status/r-7", &status("r-7", false), start)
        .expect("goodbye");
    fleet
        .hear(topic, &heartbeat("late", 1), start)
        .expect("room now");
    assert_eq!(fleet.robots().count(), MAX_ROBOTS);
    assert!(fleet.get(&id("r-7")).is_none());
    let changes = fleet.take_roster_changes();
    assert_eq!(changes.removed, [7]);
    assert!(changes.changed.contains(&7), "the index has a new owner");
}

#[test]
fn an_empty_status_takes_a_robot_off_the_books() {
    let now = Instant::now();
    let mut fleet = fleet();
    fleet
        .hear("swarm/status/a", &status("a", false), now)
        .expect("status");
    fleet.hear("swarm/status/a", "", now).expect("empty");
    assert!(fleet.get(&id("a")).is_none());
}

#[test]
fn logs_and_events_are_bounded() {
    let now = Instant::now();
    let mut fleet = fleet();
    for number in 0..2_000 {
        let record = format!(
            r#"{{"robot":"a","seq":{number},"timestamp":1,"level":"warn","event":"e","text":"t"}}"#
        );
        fleet.hear("swarm/logs/a", &record, now).expect("log");
    }
    let robot = fleet.get(&id("a")).expect("known");
    assert_eq!(robot.logs.len(), 200);
    assert_eq!(robot.logs.back().map(|record| record.seq), Some(1_999));
    assert_eq!(fleet.events.newest(usize::MAX).count(), 500);
}

#[test]
fn many_changes_at_once_are_one_event() {
    let start = Instant::now();
    let mut fleet = fleet();
    for number in 0..300 {
        let robot = format!("r-{number}");
        let topic = format!("swarm/heartbeat/{robot}");
        fleet
            .hear(&topic, &heartbeat(&robot, 1), start)
            .expect("heartbeat");
    }
    fleet.sweep(start);
    fleet.sweep(start + STALE_AFTER);
    let texts: Vec<_> = fleet
        .events
        .newest(usize::MAX)
        .map(|event| event.text.clone())
        .collect();
    assert_eq!(texts, ["300 robots are online", "300 robots are stale"]);
}
