use std::time::{Duration, Instant};

use serde_json::json;

use super::*;
use crawler_commands::Totals;

const NUMBERS: Numbers = Numbers {
    messages_in: 0,
    commands: Totals {
        sent: 3,
        answered: 2,
        open: 1,
    },
    real_time_factor: Some(1.0),
};

fn status(robot: &str) -> String {
    format!(
        r#"{{"robot":"{robot}","online":true,"kind":"physical","firmware":"0.1.0","board":"c3","capabilities":["drive"],"boot":{{"count":1,"cause":"power-on"}},"protocol":1}}"#
    )
}

fn telemetry(robot: &str, x: f32, theta: f32) -> String {
    format!(
        r#"{{"robot":"{robot}","seq":1,"timestamp":6,"state":"AVOIDING","behaviour":"wander","pose":{{"x":{x},"y":-2.5,"theta":{theta},"sigma":0.1}},"range_mm":812,"temperature_c":null,"wheels":{{"left":0.0,"right":0.0}},"battery":{{"mv":6400,"percent":12}},"rssi_dbm":null}}"#
    )
}

fn hear(fleet: &SharedFleet, topic: &str, payload: &str, now: Instant) {
    fleet
        .lock()
        .receive(
            &crate::Incoming {
                topic: topic.as_bytes(),
                payload: payload.as_bytes(),
                retained: false,
                content_type: None,
                properties: &[],
            },
            now,
        )
        .expect("accepted");
}

fn text(frame: &Bytes) -> Value {
    serde_json::from_slice(&frame[1..]).expect("JSON")
}

/// Index, x, y in metres, heading in turns, state, flags (presence, 4 has range, 8 battery low),
/// range: as the contract lays them out.
fn poses(frame: &Bytes) -> Vec<(u16, f32, f32, f32, u8, u8, u16)> {
    let u16_at = |at: usize| u16::from_le_bytes([frame[at], frame[at + 1]]);
    let f32_at =
        |at: usize| f32::from_le_bytes([frame[at], frame[at + 1], frame[at + 2], frame[at + 3]]);
    assert_eq!(frame[0], 2);
    let count = usize::from(u16_at(2));
    let (indices, body): (Vec<u16>, usize) = if frame[1] & 2 == 0 {
        (
            (0..count).map(|row| u16_at(20 + 2 * row)).collect(),
            20 + 2 * count,
        )
    } else {
        let (first, length) = (u16_at(20), usize::from(u16_at(22)));
        let set = |bit: &u16| frame[24 + usize::from(bit / 8)] >> (bit % 8) & 1 == 1;
        let bits = (0..8 * length as u16).filter(set);
        (bits.map(|bit| first + bit).collect(), 24 + length)
    };
    assert_eq!(indices.len(), count);
    assert_eq!(frame.len(), body + 8 * count);
    let (x0, y0, unit) = (f32_at(8), f32_at(12), f32_at(16));
    indices
        .into_iter()
        .enumerate()
        .map(|(row, index)| {
            let at = body + 8 * row;
            let (course, reach) = (u16_at(at + 4), u16_at(at + 6));
            let range = reach & 0x3fff;
            let known = u16::from(range != 0x3fff);
            (
                index,
                x0 + f32::from(u16_at(at)) * unit,
                y0 + f32::from(u16_at(at + 2)) * unit,
                f32::from(course & 0xfff) / 4_096.0,
                (course >> 12 & 7) as u8,
                (reach >> 14 | known << 2 | course >> 15 << 3) as u8,
                range,
            )
        })
        .collect()
}

fn close(a: f32, b: f32, tolerance: f32) {
    assert!((a - b).abs() <= tolerance, "{a} and {b}");
}

#[test]
fn a_new_reader_gets_everything_there_is() {
    let now = Instant::now();
    let fleet = SharedFleet::new(Fleet::default());
    let feed = Feed::new(Fleet::default());
    feed.set_arena(json!({"width": 4.0, "height": 3.0, "obstacles": []}));
    hear(&fleet, "swarm/status/a", &status("a"), now);
    hear(
        &fleet,
        "swarm/telemetry/a",
        &telemetry("a", 1.25, -std::f32::consts::FRAC_PI_2),
        now,
    );
    // A robot without a status is no line and no pose: its kind is not known.
    hear(&fleet, "swarm/telemetry/b", &telemetry("b", 0.0, 0.0), now);

    let (frames, _) = feed.connect(&fleet);
    let hello = text(&frames[0]);
    assert_eq!(frames[0][0], 0);
    assert_eq!(hello["protocol"], 2);
    assert_eq!(hello["fleet"], "swarm");
    assert_eq!(hello["arena"]["width"], 4.0);
    let roster = text(&frames[1]);
    assert_eq!(frames[1][0], 1);
    assert_eq!(
        roster,
        json!({"robots": [{"index": 0, "id": "a", "kind": "physical", "online": "online",
            "firmware": "0.1.0", "board": "c3"}], "removed": []})
    );
    assert_eq!(frames[2][1], 1, "full");
    let rows = poses(&frames[2]);
    assert_eq!(rows.len(), 1);
    let (index, x, y, turns, state, flags, range) = rows[0];
    assert_eq!((index, state, range), (0, 5, 812));
    close(x, 1.25, 0.001);
    close(y, -2.5, 0.001);
    close(turns, 0.75, 0.001);
    assert_eq!(flags, 0b1100, "online, with a range, battery low");
}

#[test]
fn positions_survive_any_distance() {
    let now = Instant::now();
    let fleet = SharedFleet::new(Fleet::default());
    for (robot, x) in [("a", -900_000.0), ("b", 0.0), ("c", 900_000.0)] {
        hear(
            &fleet,
            &format!("swarm/status/{robot}"),
            &status(robot),
            now,
        );
        hear(
            &fleet,
            &format!("swarm/telemetry/{robot}"),
            &telemetry(robot, x, 0.0),
            now,
        );
    }
    let (frames, _) = Feed::new(Fleet::default()).connect(&fleet);
    let rows = poses(&frames[2]);
    for (row, expected) in rows.iter().zip([-900_000.0, 0.0, 900_000.0]) {
        // 1,800 km in 65,535 steps.
        close(row.1, expected, 28.0);
    }
}

#[test]
fn a_robot_takes_less_than_ten_bytes() {
    let now = Instant::now();
    let fleet = SharedFleet::new(Fleet::default());
    for number in 0..300 {
        let robot = format!("r{number}");
        hear(
            &fleet,
            &format!("swarm/status/{robot}"),
            &status(&robot),
            now,
        );
        // Some have told nothing of themselves yet, so that indices have gaps.
        if number % 7 != 3 {
            let told = telemetry(&robot, number as f32 / 100.0, number as f32 / 50.0);
            hear(&fleet, &format!("swarm/telemetry/{robot}"), &told, now);
        }
    }
    let (frames, _) = Feed::new(Fleet::default()).connect(&fleet);
    let rows = poses(&frames[2]);
    assert_eq!(rows.len(), 257);
    assert!(
        frames[2].len() < 10 * rows.len(),
        "{} bytes",
        frames[2].len()
    );
    for (index, x, _, turns, _, _, range) in rows {
        assert_ne!(index % 7, 3);
        close(x, f32::from(index) / 100.0, 0.001);
        let expected = (f32::from(index) / 50.0 / std::f32::consts::TAU).fract();
        close(turns, expected, 1.0 / 8_192.0);
        assert_eq!(range, 812);
    }
}

#[test]
fn only_changes_follow() {
    let start = Instant::now();
    let fleet = SharedFleet::new(Fleet::default());
    let feed = Feed::new(Fleet::default());
    for robot in ["a", "b"] {
        hear(
            &fleet,
            &format!("swarm/status/{robot}"),
            &status(robot),
            start,
        );
        hear(
            &fleet,
            &format!("swarm/telemetry/{robot}"),
            &telemetry(robot, 0.0, 0.0),
            start,
        );
    }
    let (_, mut receiver) = feed.connect(&fleet);
    let mut tick = |now| {
        feed.tick(&fleet, now, || NUMBERS);
        let mut frames = Vec::new();
        while let Ok(frame) = receiver.try_recv() {
            frames.push(frame);
        }
        frames
    };
    let of_kind = |frames: &[Bytes], kind: u8| {
        let frames = frames.iter().filter(|frame| frame[0] == kind);
        frames.cloned().collect::<Vec<_>>()
    };
    tick(start);
    assert!(of_kind(&tick(start), 2).is_empty(), "nothing changed");

    hear(
        &fleet,
        "swarm/telemetry/b",
        &telemetry("b", 0.5, 0.0),
        start,
    );
    let frames = of_kind(&tick(start), 2);
    assert_eq!(frames.len(), 1);
    assert_eq!(frames[0][1], 0, "not full");
    assert_eq!(poses(&frames[0]).len(), 1);
    assert_eq!(poses(&frames[0])[0].0, 1);

    // Silence shows in roster, pose flags and as one event each.
    let frames = tick(start + Duration::from_secs(3));
    let roster = text(&of_kind(&frames, 1)[0]);
    assert_eq!(roster["robots"].as_array().map(Vec::len), Some(2));
    assert_eq!(roster["robots"][0]["online"], "stale");
    assert_eq!(poses(&of_kind(&frames, 2)[0])[0].5 & 3, 1);
    assert_eq!(of_kind(&frames, 3).len(), 2);

    hear(&fleet, "swarm/status/a", "", start);
    let frames = tick(start + Duration::from_secs(3));
    assert_eq!(
        text(&of_kind(&frames, 1)[0]),
        json!({"robots": [], "removed": [0]})
    );
}

#[test]
fn metrics_come_once_a_second() {
    let start = Instant::now();
    let fleet = SharedFleet::new(Fleet::default());
    let feed = Feed::new(Fleet::default());
    hear(
        &fleet,
        "swarm/telemetry/a",
        &telemetry("a", 0.0, 0.0),
        start,
    );
    let (_, mut receiver) = feed.connect(&fleet);
    let mut metrics = Vec::new();
    for tick in 0..25_u64 {
        let now = start + Duration::from_millis(100 * tick);
        feed.tick(&fleet, now, || Numbers {
            messages_in: tick * 10,
            ..NUMBERS
        });
        while let Ok(frame) = receiver.try_recv() {
            if frame[0] == 4 {
                metrics.push(text(&frame));
            }
        }
    }
    assert_eq!(metrics.len(), 3);
    assert_eq!(
        metrics[1],
        json!({
            "robots": {"online": 1, "stale": 0, "offline": 0},
            "states": {"AVOIDING": 1},
            "messages_per_s": 100.0,
            "commands": {"sent": 3, "answered": 2},
            "real_time_factor": 1.0,
        })
    );
}

#[test]
fn a_burst_of_events_is_cut_short() {
    let start = Instant::now();
    let fleet = SharedFleet::new(Fleet::default());
    let feed = Feed::new(Fleet::default());
    let (_, mut receiver) = feed.connect(&fleet);
    for number in 0..2_000 {
        let record = format!(
            r#"{{"robot":"a","seq":{number},"timestamp":1,"level":"error","event":"e","text":"t"}}"#
        );
        hear(&fleet, "swarm/logs/a", &record, start);
    }
    feed.tick(&fleet, start, || NUMBERS);
    let mut events = Vec::new();
    while let Ok(frame) = receiver.try_recv() {
        if frame[0] == 3 {
            events.push(text(&frame)["text"].as_str().expect("text").to_owned());
        }
    }
    assert_eq!(events.len(), EVENTS_PER_TICK + 1);
    assert_eq!(events[0], "1980 more events at the same time");
}

#[test]
fn readers_are_told_of_another_arena_and_nothing_is_told_twice() {
    let fleet = SharedFleet::new(Fleet::default());
    let feed = Feed::new(Fleet::default());
    assert_eq!(feed.set_arena(json!({"width": 4.0})), 0, "nobody is here");
    let (frames, mut receiver) = feed.connect(&fleet);
    assert_eq!(text(&frames[0])["arena"]["width"], 4.0);
    assert!(receiver.try_recv().is_err());
    let bytes = feed.set_arena(json!({"width": 5.0}));
    let hello = receiver.try_recv().expect("another hello");
    assert_eq!((hello[0], hello.len()), (0, bytes));
    assert_eq!(text(&hello)["arena"]["width"], 5.0);
    assert_eq!(text(&hello)["fleet"], "swarm");
    assert!(receiver.try_recv().is_err());
    let (frames, _) = feed.connect(&fleet);
    assert_eq!(text(&frames[0])["arena"]["width"], 5.0);
}
