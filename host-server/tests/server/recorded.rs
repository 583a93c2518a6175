//! What was: where robots were, in which arena, and what happened, as far back as it is recorded.

use std::collections::BTreeSet;
use std::time::{SystemTime, UNIX_EPOCH};

use crate::support::closed::VIEWER;
use crate::support::{Answer, FakeRobot, Fixture, eventually, telemetry};
use crawler_server::config::Role;
use hyper::Method;
use serde_json::Value;

fn now() -> u64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH);
    now.expect("after 1970").as_millis() as u64
}

fn list(value: &Value) -> &[Value] {
    value.as_array().map_or(&[], Vec::as_slice)
}

fn number(value: &Value) -> f64 {
    value
        .as_f64()
        .unwrap_or_else(|| panic!("no number: {value}"))
}

/// Whether the frames of a robot are what its telemetry says of the same stretch.
fn agrees(track: &Value, states: &[Value], points: &[Value]) -> Result<(), String> {
    let columns = [
        "at",
        "x",
        "y",
        "theta",
        "state",
        "range_mm",
        "battery_percent",
    ];
    for column in columns {
        let length = list(&track[column]).len();
        if length != points.len() {
            return Err(format!("{column}: {length} and {}", points.len()));
        }
    }
    for (place, point) in points.iter().enumerate() {
        if track["at"][place] != point["at"] {
            return Err(format!("{} and {}", track["at"][place], point["at"]));
        }
        let state = track["state"][place].as_u64().expect("a place") as usize;
        if states.get(state) != Some(&point["state"]) {
            return Err(format!("{state} and {}", point["state"]));
        }
        let off = |column: &str, by: f64| {
            let (one, other) = (&track[column][place], &point[column]);
            match (one.as_f64(), other.as_f64()) {
                (Some(one), Some(other)) => (one - other).abs() > by,
                _ => one != other,
            }
        };
        for (column, by) in [
            ("x", 0.002),
            ("y", 0.002),
            ("theta", 0.001),
            ("range_mm", 1.0),
            ("battery_percent", 1.0),
        ] {
            if off(column, by) {
                return Err(format!("{column} of {point} and {}", track[column][place]));
            }
        }
    }
    Ok(())
}

/// Whether the frames of the last minute are those of each robot's telemetry.
async fn frames_agree(fixture: &Fixture, robots: &[&str]) -> Result<(), String> {
    let to = now() / 1_000 * 1_000;
    let stretch = format!("from={}&to={to}&step=1000", to - 60_000);
    let answer = fixture
        .get(&format!("/api/v1/history/frames?{stretch}"))
        .await;
    let frames = answer.json();
    let names: Vec<&str> = list(&frames["robots"])
        .iter()
        .filter_map(|track| track["robot"].as_str())
        .collect();
    if names != robots {
        return Err(format!("{names:?}"));
    }
    for track in list(&frames["robots"]) {
        let robot = track["robot"].as_str().expect("a name");
        let path = format!("/api/v1/robots/{robot}/telemetry?{stretch}");
        let told = fixture.get(&path).await.json();
        agrees(track, list(&frames["states"]), list(&told["points"]))?;
        if list(&track["at"]).len() < 2 {
            return Err(format!("{robot} has told little"));
        }
        assert_eq!(track["kind"], "simulated", "{track}");
    }
    Ok(())
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_are_what_each_robot_has_told() {
    let begin = now();
    let fixture = Fixture::up("empty", |layer| layer.robots = Some(3)).await;
    let robots = ["sim-0001", "sim-0002", "sim-0003"];
    for robot in robots {
        fixture.wait_told(robot).await;
    }
    // While samples come in, two questions may have different answers.
    eventually("frames agree with telemetry", async || {
        frames_agree(&fixture, &robots).await.is_ok()
    })
    .await;

    let span = fixture.get("/api/v1/history").await.json();
    assert_eq!(span["robots"], 3, "{span}");
    let (from, to) = (number(&span["from"]) as u64, number(&span["to"]) as u64);
    // A minute counts as a whole.
    assert!(
        from + 60_000 >= begin && from <= to && to <= now(),
        "{span}"
    );

    let path = format!(
        "/api/v1/history/frames?from={}&to={}&step=100&robots=sim-0003,sim-0001,nobody",
        to - 5_000,
        to + 1
    );
    let some = fixture.get(&path).await.json();
    let names: Vec<&Value> = list(&some["robots"])
        .iter()
        .map(|track| &track["robot"])
        .collect();
    assert_eq!(names, ["sim-0001", "sim-0003"], "{some}");
    // The arena came into being when the world did.
    assert!(
        some["arena"].is_object() || !list(&some["arenas"]).is_empty(),
        "{some}"
    );
    let before = format!(
        "/api/v1/history/frames?from={}&to={}",
        begin - 60_000,
        now()
    );
    eventually("the arena is recorded", async || {
        let told = fixture.get(&before).await.json();
        let changes = list(&told["arenas"]);
        told["arena"].is_null()
            && changes.len() == 1
            && changes[0]["arena"].is_object()
            && number(&changes[0]["at"]) as u64 >= begin
    })
    .await;
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn limits_are_named() {
    let fixture = Fixture::start().await;
    let span = fixture.get("/api/v1/history").await.json();
    assert_eq!(
        (&span["from"], &span["to"], &span["robots"]),
        (&Value::Null, &Value::Null, &0.into())
    );
    let nothing = fixture.get("/api/v1/history/frames").await.json();
    assert_eq!(nothing["robots"], serde_json::json!([]));
    assert_eq!(nothing["arena"], Value::Null);
    assert_eq!(list(&nothing["states"]).len(), 8);
    assert_eq!(nothing["step"], 12_000);

    let many: Vec<String> = (0..1_001).map(|n| format!("sim-{n:04}")).collect();
    let many = format!("from=0&to=60000&step=100&robots={}", many.join(","));
    for (query, code, says) in [
        ("from=5&to=4", "bad_query", "before"),
        ("from=-1&to=4", "bad_query", "before"),
        ("from=x", "bad_query", ""),
        ("step=99", "bad_query", "100 ms"),
        ("step=-9223372036854775808", "bad_query", "100 ms"),
        ("robots=", "bad_query", "robots"),
        ("robots=a,%20b", "bad_query", "robots"),
        ("since=5", "bad_query", ""),
        ("from=0&to=60100&step=100", "too_much", "600"),
        ("from=0&to=9223372036854775807&step=100", "too_much", "600"),
        (many.as_str(), "too_much", "600000"),
    ] {
        let answer = fixture
            .get(&format!("/api/v1/history/frames?{query}"))
            .await;
        answer.is_problem(400, code);
        assert!(answer.text().contains(says), "{}", answer.text());
    }
    for (query, says) in [
        ("limit=0", "1000"),
        ("limit=1001", "1000"),
        ("level=debug", ""),
        ("robot=NO", "robot"),
        ("before=5", "next"),
        ("before=-", "next"),
        ("from=7&to=7", "before"),
        ("until=7", ""),
    ] {
        let answer = fixture.get(&format!("/api/v1/events?{query}")).await;
        answer.is_problem(400, "bad_query");
        assert!(answer.text().contains(says), "{}", answer.text());
    }
    fixture.stop().await;
}

/// Has a robot complain, which makes an event of each.
async fn complain(robot: &FakeRobot, numbers: std::ops::Range<u32>) {
    for n in numbers {
        let id = &robot.id;
        let level = if n.is_multiple_of(2) { "warn" } else { "error" };
        let record = format!(
            r#"{{"robot":"{id}","seq":{n},"timestamp":5,"level":"{level}","event":"odd","text":"number {n}"}}"#
        );
        robot.publish(&format!("swarm/logs/{id}"), record).await;
    }
}

/// The numbers of the complaints among events, and where the next page begins.
fn complaints(answer: &Answer) -> (Vec<u32>, Option<String>) {
    assert_eq!(answer.status, 200, "{}", answer.text());
    let page = answer.json();
    let numbers = list(&page["events"]).iter().filter_map(|event| {
        let number = event["text"].as_str()?.strip_prefix("odd: number ")?;
        number.parse().ok()
    });
    (numbers.collect(), page["next"].as_str().map(str::to_owned))
}

#[tokio::test(flavor = "multi_thread")]
async fn events_come_in_pages_and_survive_a_restart() {
    let begin = now();
    let fixture = Fixture::closed_with(Role::Serve, |layer| layer.open = Some(true)).await;
    let robot = fixture.robot("a").await;
    robot.introduce().await;
    fixture.wait_told("a").await;
    complain(&robot, 0..60).await;
    let all = format!("/api/v1/events?robot=a&from={begin}&limit=1000");
    let recorded = async |wanted: usize| {
        let (numbers, _) = complaints(&fixture.get(&all).await);
        numbers.len() == wanted
    };
    eventually("recorded", async || recorded(60).await).await;

    // Page by page, while new ones come.
    let (mut seen, mut next) = (Vec::new(), None::<String>);
    let mut ids = BTreeSet::new();
    let mut later = 60..63;
    loop {
        let before = next.map_or_else(String::new, |next| format!("&before={next}"));
        let path = format!("/api/v1/events?robot=a&level=warn&limit=7{before}");
        let answer = fixture.get(&path).await;
        for event in list(&answer.json()["events"]) {
            let id = event["id"].as_str().expect("an id").to_owned();
            assert!(ids.insert(id), "twice: {event}");
            assert_eq!(event["robot"], "a");
            assert!(number(&event["time"]) as u64 >= begin, "{event}");
            assert!(matches!(event["level"].as_str(), Some("warn" | "error")));
        }
        let (numbers, following) = complaints(&answer);
        seen.extend(numbers);
        complain(&robot, later.clone()).await;
        eventually("the new ones are there", async || {
            recorded(later.end as usize).await
        })
        .await;
        later = later.end..later.end + 3;
        next = following;
        if next.is_none() {
            break;
        }
    }
    assert_eq!(seen, (0..60).rev().collect::<Vec<_>>());

    let errors = format!("/api/v1/events?level=error&to={}&limit=500", now() + 1);
    let (numbers, _) = complaints(&fixture.get(&errors).await);
    assert!(numbers.len() >= 30 && numbers.iter().all(|n| n % 2 == 1));
    let other = fixture.get("/api/v1/events?robot=b").await.json();
    assert_eq!(other["events"], serde_json::json!([]));
    assert_eq!(other["next"], Value::Null);
    let metrics = fixture.get("/metrics").await;
    for line in [
        "terracrawler_events_dropped_total 0",
        "terracrawler_events_failures_total 0",
    ] {
        assert!(metrics.text().contains(line), "{line}: {}", metrics.text());
    }

    // A moment before the end, so that it is written by the end alone.
    robot.publish("swarm/telemetry/a", telemetry("a", 9)).await;
    complain(&robot, 900..901).await;
    eventually("it is known", async || {
        let logs = fixture.get("/api/v1/robots/a/logs").await;
        logs.text().contains("number 900")
    })
    .await;
    let (kept, _) = complaints(&fixture.get(&all).await);
    let scratch = fixture.leave().await;
    let again = Fixture::closed_at(scratch, Role::Serve, |_| {}).await;
    again.get(&all).await.is_problem(401, "unauthenticated");
    let viewer = again.login(VIEWER).await.token;
    let (after, _) = complaints(&again.get_as(&viewer, &all).await);
    assert_eq!(after.first(), Some(&900));
    let kept: Vec<u32> = kept.into_iter().filter(|n| *n != 900).collect();
    assert_eq!(after[1..], kept);
    let span = again.get_as(&viewer, "/api/v1/history").await.json();
    assert_eq!(span["robots"], 1, "{span}");
    let from = number(&span["from"]) as u64 / 60_000 * 60_000;
    let path = format!("/api/v1/history/frames?from={from}&to={}", now() + 60_000);
    let frames = again.call_as(&viewer, Method::GET, &path, "").await.json();
    let track = &frames["robots"][0];
    assert_eq!(track["robot"], "a", "{frames}");
    assert!(!list(&track["at"]).is_empty(), "{frames}");
    again.stop().await;
}
