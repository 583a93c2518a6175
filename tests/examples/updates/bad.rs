//! A release that fails at some robots, and is stopped by that.

use std::time::Duration;

use serde_json::json;

use super::Size;
use super::fleet::{BUILD, Fleet, Meeting};

/// What is wrong with it.
const DEFECTS: [&str; 2] = ["panic=5000@10%", "never-link@10%"];
/// For robots that went back to be there again: one that cannot be reached gives up its trial after five minutes.
const BACK: Duration = Duration::from_mins(15);
/// Share of the robots that are first, percent.
const FIRST: usize = 10;

pub(crate) fn run(size: &Size) -> Vec<String> {
    let robots = size.bad;
    let fleet = Fleet::start(Meeting::Embedded);
    let _simulated = fleet.robots(fleet.port, robots);
    let release = fleet.release(&DEFECTS);
    let phases = json!([
        { "select": { "share": FIRST }, "soak_s": 1 },
        { "select": { "share": 100 }, "soak_s": 1 }
    ]);
    let rollout = fleet.begin(&release, &phases, size.parallel);
    let mut failures = 0;
    let took = fleet.wait("it stops", &rollout, |seen| {
        failures = seen.failures();
        seen.state() != "running"
    });
    let mut ended = (String::new(), 0, 0, 0);
    let more = fleet.wait("nobody is at work", &rollout, |seen| {
        ended = (
            seen.state().to_owned(),
            seen.count("confirmed"),
            seen.count("rolled_back") + seen.count("failed"),
            seen.count("waiting"),
        );
        seen.at_work() == 0
    });
    let (state, confirmed, failed, waiting) = ended;
    // What robots have said of themselves by now: one that went back says so when it has connected.
    fleet.server.wait_online(robots, BACK);
    let proven = fleet.running(BUILD);
    println!(
        "\n{robots} robots, {FIRST} % of them first, {}:\n\n\
         | stopped after, s | failures by then | and in the end, s later | robots that it failed at | robots that \
         proved it | never offered | run it | run what they ran before |\n|---:|---:|---:|---:|---:|---:|---:|---:|",
        DEFECTS.join(" and ")
    );
    println!(
        "| {:.0} | {failures} | {:.0} | {failed} | {confirmed} | {waiting} | {proven} | {} |",
        took.as_secs_f64(),
        more.as_secs_f64(),
        robots - proven
    );
    let mut wrong = Vec::new();
    if state != "paused" || failures > 2 {
        wrong.push(format!(
            "the bad release is {state} after {failures} failures"
        ));
    }
    if proven != confirmed {
        wrong.push(format!(
            "{proven} robots run a release that {confirmed} have proven"
        ));
    }
    wrong
}
