//! `terracrawler twin gap`: of a server, and of scenarios.

use std::process::Output;

use serde_json::Value;

use crate::console::Place;
use crate::folder::Folder;
use crate::twin_live::Server;

fn said(output: &Output) -> String {
    let errors = String::from_utf8_lossy(&output.stderr);
    String::from_utf8_lossy(&output.stdout).into_owned() + &errors
}

#[test]
fn a_server_whose_robots_stand_says_so_and_the_report_is_a_file() {
    let place = Place::new();
    let server = Server::start(&place);
    for name in ["gap.json", "gap.md", "gap.html"] {
        let file = place.path().join(name);
        let output = place.run(&["twin", "gap", "--out", file.to_str().expect("a path")]);
        let words = said(&output);
        assert_eq!(output.status.code(), Some(1), "{words}");
        assert!(
            words.contains("Predictions 10 s ahead")
                && words.contains("no robot has driven enough yet"),
            "{words}"
        );
        let text = std::fs::read_to_string(file).expect("written");
        match name {
            "gap.json" => {
                let all: Value = serde_json::from_str(&text).expect("JSON");
                assert_eq!(all["fleet"]["whole"], false, "{all}");
            }
            "gap.md" => assert!(
                text.starts_with("# Reality gap\n\n## Predictions 1 s"),
                "{text}"
            ),
            _ => assert!(text.starts_with("<!doctype html>") && text.contains("<td>all</td>")),
        }
    }
    drop(server);
    let nobody = place.run(&["twin", "gap"]);
    assert_eq!(nobody.status.code(), Some(1), "{}", said(&nobody));
}

#[test]
fn scenarios_are_run_in_both_worlds_and_ranked() {
    let (place, folder) = (Place::new(), Folder::new());
    let file = folder.file("gap.json");
    let settings = [
        "--scenario",
        "simple-navigation",
        "--scenario",
        "multi-robot-coordination",
        "--scenario",
        "corridor",
        "--seeds",
        "2",
        "--set",
        "duration_s=25",
        "--out",
        &file,
    ];
    let run = |more: &[&str]| {
        let output = place.run(&[&["twin", "gap"][..], &settings, more].concat());
        assert_eq!(output.status.code(), Some(0), "{}", said(&output));
        let text = std::fs::read_to_string(&file).expect("written");
        let all: Value = serde_json::from_str(&text).expect("JSON");
        (said(&output), all)
    };
    let line = |all: &Value, metric: &str| -> Value {
        let lines = all["across"].as_array().expect("lines");
        let line = lines.iter().find(|line| line["metric"] == metric);
        line.expect("a line").clone()
    };
    // A reference that differs in nothing is like the simulator in all.
    let (words, all) = run(&["--reference", "randomisation=none"]);
    let way = line(&all, "distance_m");
    assert!(
        way["settings"] == 3 && way["rank_correlation"] == 1.0,
        "{way}"
    );
    for setting in all["settings"].as_array().expect("settings") {
        for metric in setting["metrics"].as_array().expect("metrics") {
            assert_eq!(metric["simulator"], metric["reference"], "{metric}");
        }
    }
    assert!(
        words.contains("multi-robot-coordination: means in both worlds")
            && words.contains("Rank correlation of the means of 3 settings"),
        "{words}"
    );
    // One whose robots are others is not.
    let (_, all) = run(&["--threads", "1"]);
    let way = &line(&all, "distance_m")["rank_correlation"];
    let way = way.as_f64().expect("a number");
    assert!((-1.0..=1.0).contains(&way), "{way}");
    let differs = |setting: &Value| {
        let metrics = setting["metrics"].as_array().expect("metrics");
        metrics
            .iter()
            .any(|metric| metric["simulator"] != metric["reference"])
    };
    assert!(
        all["settings"]
            .as_array()
            .expect("settings")
            .iter()
            .all(differs)
    );
}

#[test]
fn what_cannot_be_measured_is_named() {
    for (words, named) in [
        (
            &["--out", "gap.txt"][..],
            "gap.txt: the name ends with .json, .md or .html",
        ),
        (&["--scenario", "nowhere"], "`nowhere` is neither"),
        (
            &["--scenario", "arena", "--server", "http://127.0.0.1:1"],
            "cannot be used with '--server",
        ),
        (&["--seeds", "3"], "--scenario <SCENARIO>"),
        (
            &["--scenario", "arena", "--reference", "nothing=7"],
            "unknown field `nothing`",
        ),
        (
            &["--scenario", "arena", "--out", "gap"],
            "gap: the name ends with .json, .md or .html",
        ),
    ] {
        let output = Place::new().run(&[&["twin", "gap"][..], words].concat());
        let (code, told) = (output.status.code(), said(&output));
        assert!(matches!(code, Some(1 | 2)), "{words:?}: {told}");
        assert!(told.contains(named), "{words:?}: {told}");
    }
}
