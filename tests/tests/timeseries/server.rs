//! Servers whose history is in an engine.

use std::process::Command;

use crawler_tests::engines::influx::Influx;
use crawler_tests::engines::victoria::Victoria;
use crawler_tests::measure::{metrics, sum};
use crawler_tests::{ReservedPort, Terracrawler, binary, wait_for, wait_for_with};

use super::{PATIENCE, now};

fn points(answer: &serde_json::Value) -> u64 {
    let points = answer["points"].as_array();
    let counts = points.iter().flat_map(|points| points.iter());
    counts.filter_map(|point| point["count"].as_u64()).sum()
}

/// A server with robots keeps its history in the engine at `url`; another server reads the same.
fn end_to_end(url: &str) -> Terracrawler {
    let arguments = ["up", "--robots", "3", "--timeseries", url];
    let server = Terracrawler::start(&arguments);
    server.wait_online(3, PATIENCE);
    let path = "/api/v1/robots/sim-0002/telemetry";
    wait_for("history", PATIENCE, || {
        let (status, answer) = server.get(path);
        (status == 200 && points(&answer) >= 10).then_some(())
    });
    assert_eq!(server.get("/readyz").1["history"], true);
    let other = Terracrawler::start(&["serve", "--timeseries", url]);
    wait_for("history of another server", PATIENCE, || {
        (points(&other.get(path).1) >= 10).then_some(())
    });
    wait_for("frames of another server", PATIENCE, || {
        let (status, answer) = other.get("/api/v1/history/frames");
        let robots = answer["robots"].as_array()?;
        let whole =
            |track: &serde_json::Value| track["at"].as_array().is_some_and(|at| !at.is_empty());
        (status == 200 && robots.len() == 3 && robots.iter().all(whole)).then_some(())
    });
    wait_for("what is recorded at all", PATIENCE, || {
        let (status, span) = other.get("/api/v1/history");
        let known = span["robots"] == 3 && span["from"].as_i64() < span["to"].as_i64();
        (status == 200 && known).then_some(())
    });
    let local = server.data().join("history.sqlite");
    assert!(!local.exists(), "a local history");
    let metrics = server
        .get("/metrics")
        .1
        .as_str()
        .unwrap_or_default()
        .to_owned();
    assert!(
        metrics.contains("terracrawler_history_engine_up 1"),
        "{metrics}"
    );
    assert!(
        metrics.contains("terracrawler_history_dropped_total 0"),
        "{metrics}"
    );
    server
}

#[test]
fn a_server_keeps_its_history_in_victoria_metrics() {
    let victoria = Victoria::start();
    let (status, log) = end_to_end(&victoria.url("fleet")).interrupt();
    assert!(status.success(), "{log}");
}

/// What the doctor says of the history at `url`.
fn doctor(server: &Terracrawler, url: &str) -> String {
    let asked = Command::new(binary())
        .args(["doctor", "--open", "--timeseries", url, "--data"])
        .arg(server.data())
        .output()
        .expect("the doctor");
    let text = String::from_utf8_lossy(&asked.stdout).into_owned();
    let lines: Vec<&str> = text
        .lines()
        .skip_while(|line| !line.contains("  history  "))
        .take(2)
        .collect();
    assert!(!lines.is_empty(), "{text}");
    lines.join("\n")
}

#[test]
fn a_server_outlives_the_engine_of_its_history() {
    let mut influx = Influx::start();
    let url = influx.url("fleet");
    let server = end_to_end(&url);
    let said = doctor(&server, &url);
    assert!(
        said.starts_with("ok ") && said.contains("InfluxDB 1."),
        "{said}"
    );
    let said = doctor(&server, &influx.url("other"));
    assert!(
        said.starts_with("warn") && said.contains("CREATE DATABASE"),
        "{said}"
    );
    let begin = now();

    influx.kill();
    wait_for("it is told of", PATIENCE, || {
        (server.get("/readyz").1["history"] == false).then_some(())
    });
    // Robots can be steered all the same.
    assert_eq!(server.get("/readyz").0, 200);
    let (status, problem) = server.get("/api/v1/robots/sim-0001/telemetry");
    assert_eq!(
        (status, &problem["code"]),
        (503, &"history_unavailable".into())
    );
    let (status, problem) = server.get("/api/v1/history");
    assert_eq!(
        (status, &problem["code"]),
        (503, &"history_unavailable".into())
    );
    let said = doctor(&server, &url);
    assert!(
        said.starts_with("fail") && said.contains("does not answer"),
        "{said}"
    );
    // Samples of three robots, five a second at most: of several seconds.
    let mut queued = 0.0;
    wait_for_with("samples wait", PATIENCE, &mut queued, |queued| {
        *queued = sum(&metrics(&server), "terracrawler_history_queued");
        (*queued >= 60.0).then_some(())
    });

    let end = now();
    influx.resume();
    let path = format!("/api/v1/robots/sim-0001/telemetry?from={begin}&to={end}&step=1000");
    // What was told while it was away has waited.
    let mut last = (0, serde_json::Value::Null);
    wait_for_with("history of the outage", PATIENCE, &mut last, |last| {
        *last = server.get(&path);
        let whole = last.1["points"]
            .as_array()
            .is_some_and(|points| points.len() >= 2);
        (last.0 == 200 && whole).then_some(())
    });
    let (status, log) = server.interrupt();
    assert!(status.success(), "{log}");
    assert!(log.contains("cannot be used, samples wait for it"), "{log}");
}

#[test]
fn a_server_starts_without_the_engine_of_its_history() {
    let nobody = ReservedPort::new();
    let port = nobody.number();
    let url = format!("influx://ada:secret@127.0.0.1:{port}/fleet");
    let server = Terracrawler::start(&["serve", "--timeseries", &url]);
    wait_for("it says so", PATIENCE, || {
        server
            .log()
            .contains("cannot be used, samples wait for it")
            .then_some(())
    });
    assert!(!server.log().contains("secret"), "{}", server.log());
    let (status, log) = server.interrupt();
    assert!(status.success(), "{log}");

    let folder = tempfile::tempdir().expect("a folder");
    let data = folder.path().join("data");
    let refused = Command::new(binary())
        .args([
            "serve",
            "--open",
            "--http",
            "127.0.0.1:0",
            "--mqtt",
            "127.0.0.1:0",
        ])
        .args(["--timeseries", "influx://127.0.0.1", "--data"])
        .arg(&data)
        .output()
        .expect("it runs");
    let said = String::from_utf8_lossy(&refused.stderr);
    assert!(
        !refused.status.success() && said.contains("must name a database"),
        "{said}"
    );
    // Before anything is opened.
    assert!(!data.join("records.sqlite").exists());
}
