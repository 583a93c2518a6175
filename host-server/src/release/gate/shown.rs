//! What is said of a report: to people as a table, to programs as JSON.

use std::fmt::Write as _;
use std::path::Path;

use crawler_release::KeyId;
use crawler_updates::gate::{Bound, Finding, GateFault, GateReport, Parted, Threshold};
use serde_json::{Value, json};

use crate::release::args::shown;

/// The table of a report, or of why it is not believed.
pub(crate) fn text(path: &Path, key: KeyId, gate: &Result<GateReport, GateFault>) -> String {
    let mut out = String::new();
    let mut row = |name: &str, value: &str| {
        let _ = writeln!(out, "{name:<12}{value}");
    };
    row("gate", &path.display().to_string());
    let report = match gate {
        Ok(report) => report,
        Err(fault) => {
            row("NO GATE", &format!("{}: {fault}", fault.code()));
            return out;
        }
    };
    row(
        "about",
        &format!("{} (build {})", report.release, report.build),
    );
    row("signature", &format!("by key {key}"));
    row("made", &shown(report.made));
    let evaluator = &report.evaluator;
    row(
        "evaluator",
        &format!("{}, protocol {}", evaluator.version, evaluator.protocol),
    );
    row("program", &evaluator.program.to_string());
    row("plan", &report.plan.to_string());
    for one in &report.evaluations {
        let last = one.seed.saturating_add(u64::from(one.seeds) - 1);
        row(
            "evaluated",
            &format!(
                "{}: {} of {} runs succeed; {} robots, seeds {} to {last}",
                one.scenario, one.successes, one.seeds, one.robots, one.seed
            ),
        );
        for threshold in &one.thresholds {
            row("threshold", &threshold_text(threshold));
        }
    }
    for one in &report.replays {
        row(
            "replayed",
            &format!(
                "{}: {} of {} robots do the same",
                one.recording, one.same, one.robots
            ),
        );
        for parted in &one.differences {
            row("difference", &parted_text(parted));
        }
        if one.more > 0 {
            row("difference", &format!("and {} more robots", one.more));
        }
    }
    row(
        "outcome",
        if report.passed {
            "passed"
        } else {
            "NOT PASSED"
        },
    );
    out
}

fn threshold_text(threshold: &Threshold) -> String {
    let (sign, bound) = match threshold.bound {
        Bound::AtLeast(bound) => (">=", bound),
        Bound::AtMost(bound) => ("<=", bound),
    };
    let word = if threshold.is_met() { "met" } else { "NOT MET" };
    let measured = threshold.measured.map_or_else(
        || "nothing was measured".to_owned(),
        |one| {
            format!(
                "{:.4}, 95 % interval {:.4} to {:.4}",
                one.mean, one.low, one.high
            )
        },
    );
    format!("{} {sign} {bound}: {word} ({measured})", threshold.metric)
}

fn parted_text(parted: &Parted) -> String {
    let at_s = parted.at_us as f64 * 1e-6;
    let what = format!("{} {} at {at_s:.6} s", parted.robot, parted.output);
    let why = parted.why.as_deref().unwrap_or_default();
    match parted.finding {
        Finding::Expected => format!("{what}: expected ({why})"),
        Finding::Unexpected => format!("{what}: NOT EXPECTED"),
        Finding::Missing => format!("{what}: NOT FOUND, although expected ({why})"),
    }
}

/// The same for programs.
pub(crate) fn json(path: &Path, gate: &Result<GateReport, GateFault>) -> Value {
    json!({
        "file": path.to_string_lossy(),
        "report": gate.as_ref().ok(),
    })
}
