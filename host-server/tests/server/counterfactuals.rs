//! What if: asked over HTTP, of a simulated fleet and of robots that nobody simulates.

use crate::support::{Answer, Fixture, eventually, telemetry};
use hyper::Method;
use serde_json::{Value, json};

const PATH: &str = "/api/v1/counterfactuals";

/// The last moment that is recorded, once so much is.
async fn recorded(fixture: &Fixture, least_ms: u64) -> u64 {
    let mut begin = None;
    let mut newest = 0;
    eventually("it is recorded", async || {
        let span = fixture.get("/api/v1/history").await.json();
        let Some(to) = span["to"].as_u64() else {
            return false;
        };
        newest = to;
        to - *begin.get_or_insert(to) >= least_ms
    })
    .await;
    newest
}

async fn ask(fixture: &Fixture, body: &Value) -> Answer {
    fixture.post(PATH, &body.to_string()).await
}

/// What a question comes to.
async fn answered(fixture: &Fixture, id: &str) -> Value {
    let path = format!("{PATH}/{id}");
    let mut told = Value::Null;
    eventually("it is worked out", async || {
        told = fixture.get(&path).await.json();
        told["state"] != "running"
    })
    .await;
    assert_eq!(told["state"], "done", "{told}");
    told
}

fn stop() -> Value {
    json!({ "command": "stop" })
}

#[tokio::test(flavor = "multi_thread")]
async fn a_simulated_fleet_goes_on_from_a_recorded_moment() {
    let fixture = Fixture::up("arena", |layer| layer.robots = Some(3)).await;
    for robot in ["sim-0001", "sim-0002", "sim-0003"] {
        fixture.wait_told(robot).await;
        let path = format!("/api/v1/robots/{robot}");
        eventually("it wanders", async || {
            let told = fixture.get(&path).await.json();
            let state = &told["state"];
            ["MOVING", "CAUTION", "AVOIDING"]
                .iter()
                .any(|moving| state == moving)
        })
        .await;
    }
    let newest = recorded(&fixture, 7_000).await;
    let body = json!({
        "at": newest - 2_500, "seconds": 2, "draws": 4, "robots": ["sim-0002"], "command": stop(),
    });
    let begun = ask(&fixture, &body).await;
    assert_eq!(begun.status, 202, "{}", begun.text());
    let question = begun.json();
    let id = question["id"].as_str().expect("an id").to_owned();
    assert_eq!(begun.header("location"), format!("{PATH}/{id}"));
    for (name, value) in [
        ("draws", json!(4)),
        ("robots", json!(["sim-0002"])),
        ("command", stop()),
    ] {
        assert_eq!(question[name], value, "{question}");
    }
    let told = answered(&fixture, &id).await;
    assert_eq!(told["done"], 4);
    let answer = &told["answer"];
    assert_eq!(answer["step"], 250, "{answer}");
    assert!(answer["arena"].is_object(), "{answer}");
    let robots = answer["robots"].as_array().expect("robots");
    let names: Vec<&Value> = robots.iter().map(|robot| &robot["robot"]).collect();
    assert_eq!(names, ["sim-0001", "sim-0002", "sim-0003"]);
    let mut wandering = 0;
    for robot in robots {
        assert_eq!(robot["kind"], "simulated");
        for (path, columns) in [
            ("recorded", &["x", "y", "theta"][..]),
            ("was", &["x", "y", "theta", "state", "within"]),
            ("would", &["x", "y", "theta", "state", "within"]),
        ] {
            for column in columns {
                let length = robot[path][column].as_array().map(Vec::len);
                assert_eq!(length, Some(9), "{path} {column}: {robot}");
            }
        }
        // Nobody but the scenario has told them to wander; whoever stood at that moment may not have.
        let wanders = robot["command"] == "wander";
        assert_eq!(robot["supposed"], wanders, "{robot}");
        wandering += usize::from(wanders);
        assert_eq!(robot["was"]["x"][0], robot["would"]["x"][0]);
    }
    assert!(wandering > 0, "{answer}");
    let measures = answer["measures"].as_array().expect("measures");
    let way = measures.iter().find(|measure| measure["name"] == "way_m");
    let way = way.expect("it is measured");
    assert!(way["would"].as_f64() <= way["was"].as_f64(), "{way}");

    let list = fixture.get(PATH).await.json();
    let all = list["counterfactuals"].as_array().expect("a list");
    assert_eq!(all.len(), 1);
    assert_eq!(
        (&all[0]["id"], &all[0]["answer"]),
        (&json!(id), &Value::Null)
    );
    let path = format!("{PATH}/{id}");
    let gone = fixture
        .call(Method::DELETE, &path, &[], String::new())
        .await;
    assert_eq!(gone.status, 204);
    for method in [Method::GET, Method::DELETE] {
        let answer = fixture.call(method, &path, &[], String::new()).await;
        answer.is_problem(404, "unknown_counterfactual");
    }
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_that_nobody_simulates_is_asked_about_as_well() {
    let fixture = Fixture::start().await;
    let robot = fixture.robot("rover-1").await;
    robot.introduce().await;
    let mut seq = 0;
    let mut newest = 0;
    eventually("it is recorded", async || {
        seq += 1;
        let topic = "swarm/telemetry/rover-1";
        robot.publish(topic, telemetry("rover-1", seq)).await;
        let span = fixture.get("/api/v1/history").await.json();
        newest = span["to"].as_u64().unwrap_or_default();
        span["from"].as_u64().is_some_and(|from| newest >= from) && seq > 20
    })
    .await;
    let body = json!({
        "at": newest, "seconds": 1, "draws": 2,
        "command": { "command": "drive", "parameters": { "v": 0.2, "w": 0.0 } },
    });
    let begun = ask(&fixture, &body).await;
    assert_eq!(begun.status, 202, "{}", begun.text());
    let id = begun.json()["id"].as_str().expect("an id").to_owned();
    let told = answered(&fixture, &id).await;
    assert_eq!(told["robots"], Value::Null);
    let answer = &told["answer"];
    assert!(answer["arena"].is_null(), "{answer}");
    assert_eq!(answer["robots"][0]["robot"], "rover-1");
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_asked_is_said() {
    let fixture = Fixture::start().await;
    let right = json!({ "at": 1_000, "seconds": 5, "draws": 5, "command": stop() });
    for at in [0, 1_000, i64::MAX] {
        let mut body = right.clone();
        body["at"] = json!(at);
        ask(&fixture, &body).await.is_problem(404, "not_recorded");
    }
    for (field, value, pointer) in [
        ("seconds", json!(0), "/seconds"),
        ("seconds", json!(61), "/seconds"),
        ("draws", json!(1), "/draws"),
        ("draws", json!(201), "/draws"),
        ("at", json!(-1), "/at"),
        ("robots", json!([]), "/robots"),
        ("robots", json!(["rover-1", "No Robot"]), "/robots/1"),
        (
            "command",
            json!({ "command": "identify" }),
            "/command/command",
        ),
        ("command", json!({ "command": "fly" }), "/command/command"),
        (
            "command",
            json!({ "command": "goto", "parameters": { "x": 1 } }),
            "/command",
        ),
    ] {
        let mut body = right.clone();
        body[field] = value;
        let answer = ask(&fixture, &body).await;
        answer.is_problem(422, "invalid_counterfactual");
        let problem = answer.json();
        let at = problem["errors"][0]["pointer"].as_str().expect("a pointer");
        assert!(at.starts_with(pointer), "{body}: {problem}");
    }
    for id in ["x", "99999999999999999999999", "17"] {
        let path = format!("{PATH}/{id}");
        fixture
            .get(&path)
            .await
            .is_problem(404, "unknown_counterfactual");
    }
    fixture.stop().await;
}
