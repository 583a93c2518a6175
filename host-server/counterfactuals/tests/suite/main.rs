//! What is asked of the records of realities with bodies that nobody can look into.

mod recorded;

use std::sync::Arc;

use crawler_counterfactuals::answer::{Answer, Path, RobotAnswer};
use crawler_counterfactuals::{Certificates, Known, NotAsked, Question, State, Unreadable};
use serde_json::{Value, json};

use recorded::{Recorded, eventually, id};

const HALL: &str = r#"
name = "hall"
robots = 6
arena = { width = 5.0, height = 5.0, obstacles = [{ shape = "box", x = 0.0, y = 0.0, w = 0.5, h = 0.5 }], scatter = { per_square_metre = 0.0 } }
tracker = { rate_hz = 10.0 }
[spawn]
poses = [
    { x = -2.0, y = -2.0 }, { x = -2.0, y = -1.2 }, { x = -2.0, y = 1.2 },
    { x = 1.5, y = 1.5 }, { x = 1.5, y = -1.5 }, { x = 0.0, y = 2.0 },
]
"#;

/// Nobody was calibrated.
fn nominal() -> Arc<Certificates> {
    Arc::new(|_| None)
}

fn of<'a>(answer: &'a Answer, name: &str) -> &'a RobotAnswer {
    let found = answer
        .robots
        .iter()
        .find(|robot| robot.robot.as_str() == name);
    found.expect("it is in it")
}

fn goto(x: f32, y: f32) -> Value {
    json!({ "command": "goto", "parameters": { "x": x, "y": y } })
}

fn wander() -> Value {
    json!({ "command": "behave", "parameters": { "behaviour": "wander" } })
}

fn stop() -> Value {
    json!({ "command": "stop" })
}

/// How far a path leads from its beginning, metres.
fn far(path: &Path) -> f32 {
    let (first, last) = (path.places[0], path.places[path.places.len() - 1]);
    (first.x - last.x).hypot(first.y - last.y)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_that_is_stopped_stays_and_the_others_go_where_they_went() {
    let orders = [
        (8_000, "sim-0001", goto(2.0, -2.0)),
        (8_000, "sim-0002", wander()),
        (8_000, "sim-0003", goto(1.0, 1.2)),
        (12_000, "sim-0004", goto(1.5, 0.0)),
    ];
    let past = Recorded::of(HALL, 77, 20, &orders, nominal()).await;
    let question = past.question(11_000, Some(&["sim-0001"]), &stop());
    let answer = past.answer(question.clone()).await;
    assert_eq!(answer.robots.len(), 6);
    for robot in &answer.robots {
        for path in [&robot.was, &robot.would] {
            let lengths = [path.places.len(), path.states.len(), path.within.len()];
            assert_eq!(lengths, [33; 3], "{robot:?}");
        }
        assert_eq!(robot.recorded.len(), 33);
        assert!(robot.recorded.iter().all(Option::is_some), "{robot:?}");
        let known = (&robot.known, robot.supposed);
        assert_eq!(known, (&Known::Make, false), "none has driven so far");
    }
    let stopped = of(&answer, "sim-0001");
    assert!(far(&stopped.would) < 0.25, "{stopped:?}");
    assert!(far(&stopped.was) > 0.7, "{stopped:?}");
    assert!(stopped.parted_s.is_some_and(|at| at < 2.0), "{stopped:?}");
    assert!(stopped.apart_m > 0.7, "{stopped:?}");
    assert_eq!(stopped.doing.as_deref(), Some("goto 2.00, -2.00"));
    assert_eq!(of(&answer, "sim-0002").doing.as_deref(), Some("wander"));
    // It is told only after the moment, and goes in both worlds.
    let later = of(&answer, "sim-0004");
    assert_eq!(later.doing, None);
    assert!(
        far(&later.was) > 0.4 && far(&later.would) > 0.4,
        "{later:?}"
    );
    let idle = of(&answer, "sim-0006");
    assert!(far(&idle.was) < 0.05 && far(&idle.would) < 0.05, "{idle:?}");
    // Whoever is told a place goes there as it did.
    assert_eq!(answer.tested, 6);
    for name in ["sim-0001", "sim-0003", "sim-0004", "sim-0005", "sim-0006"] {
        assert_eq!(
            of(&answer, name).inside,
            Some(true),
            "{name}: {:?}",
            of(&answer, name)
        );
    }
    let way = answer
        .measures
        .iter()
        .find(|measure| measure.name == "way_m");
    let way = way.expect("it is measured").difference;
    assert!(way.high < -0.05, "{way:?}");
    // The same question has the same answer.
    assert_eq!(past.answer(question).await, answer);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_moves_and_was_told_nothing_is_supposed_to_wander() {
    let start = format!(
        "{HALL}\n[command]\ncommand = \"behave\"\nparameters = {{ behaviour = \"wander\" }}\n"
    );
    let past = Recorded::of(&start, 5, 20, &[(6_000, "sim-0005", stop())], nominal()).await;
    let question = past.question(11_000, None, &stop());
    let answer = past.answer(question).await;
    let wandering = of(&answer, "sim-0002");
    assert!(wandering.supposed, "{wandering:?}");
    assert_eq!(wandering.doing.as_deref(), Some("wander"));
    let stopped = of(&answer, "sim-0005");
    assert!(!stopped.supposed && far(&stopped.was) < 0.05, "{stopped:?}");
    assert_eq!(stopped.doing.as_deref(), Some("stop"));
    for robot in &answer.robots {
        assert!(far(&robot.would) < 0.25, "{robot:?}");
    }
}

/// Two robots in lanes, whose bodies are as wild as any.
const LANES: &str = r#"
name = "lanes"
robots = 2
randomisation = "wild"
link = {}
bodies = [{ charge = 0.7 }]
arena = { width = 6.0, height = 4.0, scatter = { per_square_metre = 0.0 } }
tracker = { rate_hz = 10.0 }
[spawn]
poses = [{ x = -2.4, y = -1.0 }, { x = -2.4, y = 1.0 }]
"#;

#[tokio::test(flavor = "multi_thread")]
async fn bodies_are_found_in_what_robots_did_before() {
    let mut orders = Vec::new();
    for (at, x) in [(8_000, 2.4), (30_000, -2.4), (54_000, 2.4)] {
        orders.push((at, "sim-0001", goto(x, -1.0)));
        orders.push((at, "sim-0002", goto(x, 1.0)));
    }
    let past = Recorded::of(LANES, 2, 70, &orders, nominal()).await;
    let question = Question {
        draws: 20,
        ..past.question(57_000, Some(&["sim-0001"]), &stop())
    };
    let answer = past.answer(question).await;
    for robot in &answer.robots {
        let known = (&robot.known, robot.inside);
        assert_eq!(known, (&Known::Record, Some(true)));
        let last = robot.recorded.last().copied().flatten().expect("recorded");
        let (end, within) = (robot.was.places[32], robot.was.within[32]);
        let off = (end.x - last.x).hypot(end.y - last.y);
        // Of some two metres.
        let told = (far(&robot.was), off, within);
        assert!(told.0 > 1.0 && off < 0.1 && within < 0.2, "{told:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn questions_come_one_at_a_time_and_can_be_ended() {
    let past = Recorded::of(HALL, 3, 12, &[], nominal()).await;
    let long = Question {
        draws: 200,
        ..past.question(8_000, None, &wander())
    };
    let first = past.ask(long.clone()).await;
    let second = past.counterfactuals.ask("b", long.clone(), 1).await;
    assert!(matches!(second, Err(NotAsked::Busy)), "{second:?}");
    assert_eq!(past.counterfactuals.list().len(), 1);
    assert!(past.counterfactuals.remove(first.id));
    assert!(!past.counterfactuals.remove(first.id));
    assert_eq!(past.counterfactuals.get(first.id), None);
    // It comes to its end within a step; then there is room for another one, which the end of the server ends.
    let third = eventually("there is room", || async {
        match past.counterfactuals.ask("c", long.clone(), 1).await {
            Err(NotAsked::Busy) => None,
            asked => Some(asked.expect("it is asked")),
        }
    })
    .await;
    past.counterfactuals.end();
    let ended = past.wait(&third).await;
    assert_eq!(ended.state, State::Failed("it was ended".to_owned()));
    // The last sixteen are kept.
    for _ in 0..20 {
        let quick = Question {
            seconds: 1,
            draws: 2,
            ..past.question(8_000, Some(&["sim-0001"]), &stop())
        };
        let asked = past.ask(quick).await;
        // Whoever sees the answer may ask again at once.
        past.wait(&asked).await;
    }
    let list = past.counterfactuals.list();
    assert_eq!(list.len(), 16);
    assert!(list.is_sorted_by(|newer, older| newer.id > older.id));
}

#[tokio::test(flavor = "multi_thread")]
async fn what_was_not_recorded_is_not_asked_of() {
    let past = Recorded::of(HALL, 3, 8, &[], nominal()).await;
    for (at_ms, robots) in [
        (-100_000, None),
        (100_000, None),
        (6_000, Some(&["sim-0001", "sim-0099"][..])),
    ] {
        let question = past.question(at_ms, robots, &stop());
        let asked = past.counterfactuals.ask("somebody", question, 1).await;
        let missing = robots.map(|_| id("sim-0099"));
        assert!(
            matches!(&asked, Err(NotAsked::Past(Unreadable::Nothing { robot })) if *robot == missing),
            "{asked:?}"
        );
    }
    let long = Question {
        seconds: 60,
        draws: 200,
        ..past.question(6_000, None, &stop())
    };
    // Six robots are few enough for it.
    let asked = past.ask(long).await;
    assert!(past.counterfactuals.remove(asked.id));
}
