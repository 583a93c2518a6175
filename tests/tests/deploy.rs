//! What `deploy/` and `docs/monitor.md` promise about the metrics is what a server serves, and the
//! files that other programs read can be read by them.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use crawler_tests::engines::influx::Influx;
use crawler_tests::engines::postgres::Postgres;
use crawler_tests::{Terracrawler, root, wait_for};
use serde_json::{Value, json};

fn deploy(name: &str) -> PathBuf {
    root().join("deploy").join(name)
}

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// The names of our metrics in a text: words that begin as ours do.
fn names(text: &str) -> BTreeSet<String> {
    text.split(|c: char| !(c.is_ascii_alphanumeric() || c == '_'))
        .filter(|word| {
            ["terracrawler_", "process_"]
                .iter()
                .any(|beginning| word.starts_with(beginning) && word.len() > beginning.len())
        })
        .map(str::to_owned)
        .collect()
}

/// The expressions of the alerts. Their texts name other things, too.
fn alert_expressions(yaml: &str) -> String {
    let mut expressions = String::new();
    let mut inside = false;
    for line in yaml.lines() {
        let text = line.trim_start();
        if let Some(expression) = text.strip_prefix("expr:") {
            inside = true;
            expressions += expression;
        } else if inside {
            // Keys of a rule end its expression.
            inside = !["for:", "labels:", "annotations:"]
                .iter()
                .any(|key| text.starts_with(key));
            if inside {
                expressions += text;
            }
        }
        expressions.push('\n');
    }
    expressions
}

/// The expressions of every panel.
fn panel_expressions(dashboard: &Value, expressions: &mut Vec<String>) {
    match dashboard {
        Value::Object(map) => {
            if let Some(Value::String(expression)) = map.get("expr") {
                expressions.push(expression.clone());
            }
            map.values()
                .for_each(|value| panel_expressions(value, expressions));
        }
        Value::Array(list) => list
            .iter()
            .for_each(|value| panel_expressions(value, expressions)),
        _ => {}
    }
}

/// The metrics of a server that has seen a bit of everything.
fn served() -> BTreeSet<String> {
    let (database, history) = (Postgres::shared(), Influx::start());
    let server = Terracrawler::start(&[
        "up",
        "--robots=2",
        "--scenario=empty",
        &format!("--database={}", database.database()),
    ]);
    let other =
        Terracrawler::start(&["serve", &format!("--timeseries={}", history.url("metrics"))]);
    server.wait_online(2, Duration::from_mins(1));
    let (status, _) = server.post("/api/v1/swarm/commands", &json!({ "command": "stop" }));
    assert_eq!(status, 202);
    // Something that is not what it should be.
    let port = server.mqtt();
    crawler_tests::publish(port, "swarm/heartbeat/stranger", "nonsense");
    // Something that only a newer robot says.
    let newer =
        r#"{"robot":"newer","seq":1,"timestamp":1,"uptime_ms":1,"state":"FLYING","mood":"fine"}"#;
    crawler_tests::publish(port, "swarm/heartbeat/newer", newer);
    wait_for("every kind of metric", Duration::from_mins(2), || {
        let text = server.get("/metrics").1;
        let text = text.as_str()?;
        let there = [
            "terracrawler_command_latency_seconds_bucket{",
            "terracrawler_mqtt_messages_rejected_total{",
            "terracrawler_mqtt_unknown_fields_total{",
            "terracrawler_mqtt_unknown_words_total{",
        ]
        .iter()
        .all(|name| text.contains(name));
        let (_, more) = other.get("/metrics");
        there.then(|| {
            text.lines()
                .chain(more.as_str().unwrap_or_default().lines())
                .filter(|line| !line.starts_with('#'))
                .filter_map(|line| line.split(['{', ' ']).next())
                .map(str::to_owned)
                .collect()
        })
    })
}

#[test]
fn every_metric_that_is_spoken_of_is_served() {
    let served = served();
    let mut expressions = Vec::new();
    let dashboard = serde_json::from_str(&read(&deploy("grafana/terracrawler.json")));
    panel_expressions(&dashboard.expect("JSON"), &mut expressions);
    assert!(expressions.len() > 20, "{expressions:?}");
    let alerts = alert_expressions(&read(&deploy("prometheus/alerts.yml")));
    assert!(names(&alerts).len() > 10, "{alerts}");
    for (whose, text) in [
        ("the dashboard", &expressions.join("\n")),
        ("the alerts", &alerts),
    ] {
        let unknown: Vec<_> = names(text).difference(&served).cloned().collect();
        assert!(
            unknown.is_empty(),
            "{whose}: nobody serves {unknown:?} among {served:?}"
        );
    }
    // Histograms have one name on the page and three in the text.
    let bare = |name: &String| {
        ["_bucket", "_count", "_sum"]
            .iter()
            .find_map(|ending| name.strip_suffix(ending))
            .unwrap_or(name)
            .to_owned()
    };
    let served: BTreeSet<String> = served.iter().map(bare).collect();
    let page = names(&read(&root().join("docs/monitor.md")));
    let gone: Vec<_> = page.difference(&served).collect();
    assert!(
        gone.is_empty(),
        "docs/monitor.md explains {gone:?}, which nobody serves"
    );
    let unexplained: Vec<_> = served
        .difference(&page)
        .filter(|name| name.starts_with("terracrawler_") || name.starts_with("process_"))
        .collect();
    assert!(
        unexplained.is_empty(),
        "docs/monitor.md lacks {unexplained:?}"
    );
}

/// Runs a checker where it is installed.
fn check(program: &str, arguments: &[&str]) {
    let output = match Command::new(program)
        .args(arguments)
        .current_dir(root())
        .output()
    {
        Ok(output) => output,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            println!("skipped: {program} is not installed");
            return;
        }
        Err(error) => panic!("{program}: {error}"),
    };
    assert!(
        output.status.success(),
        "{program} {arguments:?}:\n{}{}",
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    );
}

#[test]
fn prometheus_takes_its_files() {
    check(
        "promtool",
        &["check", "config", "deploy/prometheus/prometheus.yml"],
    );
}

#[test]
fn the_unit_gives_the_service_little() {
    check(
        "systemd-analyze",
        &[
            "security",
            "--offline=true",
            // In tenths: 1.4 of 10 when this was written.
            "--threshold=20",
            "deploy/systemd/terracrawler.service",
        ],
    );
}
