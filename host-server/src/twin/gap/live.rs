//! The gap of the robots of a running server.

use std::process::ExitCode;

use crawler_system::cli_error::{CliError, OrSay as _};
use serde::Deserialize;

use super::super::args::GapArgs;
use super::table::{Table, number};
use super::{out, tell};
use crate::config::Settings;

#[derive(Deserialize)]
struct Quantiles {
    median: f64,
    p90: f64,
}

#[derive(Deserialize)]
struct Coverage {
    within_50: f64,
    within_95: f64,
}

#[derive(Deserialize)]
struct Errors {
    ahead_s: f64,
    count: usize,
    own: Option<Quantiles>,
    nominal: Option<Quantiles>,
    ratio: Option<f64>,
    floor: Option<Quantiles>,
    coverage: Option<Coverage>,
}

#[derive(Deserialize)]
struct Displacements {
    count: usize,
    own: Option<f64>,
    nominal: Option<f64>,
    floor: Option<f64>,
}

#[derive(Deserialize)]
struct Measures {
    whole: bool,
    errors: Vec<Errors>,
    displacements: Displacements,
}

#[derive(Deserialize)]
struct Robot {
    #[serde(rename = "robot")]
    name: String,
    certificate: Option<String>,
    measures: Measures,
}

#[derive(Deserialize)]
struct Gap {
    fleet: Measures,
    robots: Vec<Robot>,
}

impl Measures {
    /// How many times the floor the error is, furthest ahead.
    fn above_floor(&self) -> Option<f64> {
        let errors = self.errors.last()?;
        let (own, floor) = (errors.own.as_ref()?, errors.floor.as_ref()?);
        Some(own.median / floor.median.max(1e-4))
    }
}

/// Asks a server: 0 when there is enough of some robot, 1 when of none.
///
/// # Errors
/// One line: what cannot be done, and why.
pub(crate) async fn run(args: &GapArgs, settings: &Settings) -> Result<ExitCode, CliError> {
    let file = out(args.out.as_deref())?;
    let mut client = args.remote.client(settings)?;
    args.remote.log_in(&mut client).await?;
    let answer = client.get("/api/v1/fleet/gap").await;
    client.log_out().await;
    let all = answer?;
    let gap: Gap = serde_json::from_value(all.clone())
        .or_say(|error| format!("what the server says cannot be read: {error}"))?;
    let enough = gap.robots.iter().any(|robot| robot.measures.whole);
    tell("Reality gap", &tables(gap), &all, file)?;
    Ok(if enough {
        ExitCode::SUCCESS
    } else {
        println!("no robot has driven enough yet");
        ExitCode::FAILURE
    })
}

/// The errors over each horizon, and the distances; the worst robots first.
fn tables(mut gap: Gap) -> Vec<Table> {
    let worst = |robot: &Robot| robot.measures.above_floor().unwrap_or(-1.0);
    gap.robots.sort_by(|a, b| worst(b).total_cmp(&worst(a)));
    let rows = || {
        let robots = gap.robots.iter().map(|robot| {
            let body = robot.certificate.as_deref().unwrap_or("nominal");
            (robot.name.as_str(), body, &robot.measures)
        });
        std::iter::once(("all", "", &gap.fleet)).chain(robots)
    };
    let mut tables: Vec<Table> = (0..gap.fleet.errors.len())
        .map(|horizon| {
            let mut table = Table::new(
                format!(
                    "Predictions {:.0} s ahead, off by so many centimetres: median, nine in ten below",
                    gap.fleet.errors[horizon].ahead_s
                ),
                &[
                    "robot", "body", "own", "", "nominal", "", "floor", "", "ratio", "in 50 %",
                    "in 95 %", "pairs",
                ],
            );
            table.rows = rows()
                .filter_map(|(name, body, measures)| {
                    let errors = measures.errors.get(horizon)?;
                    Some(row(name, body, errors))
                })
                .collect();
            table
        })
        .collect();
    if let Some(table) = tables.last_mut() {
        table.notes = vec![
            "floor: what a perfect copy would show, by the noise of the tracker".to_owned(),
            "ratio: own median as a share of that of the nominal body".to_owned(),
            "in 50 %, in 95 %: share within the regions that should hold so many".to_owned(),
            "–: too few to say".to_owned(),
        ];
    }
    let mut table = Table::new(
        "Displacements over two seconds, energy distance to those of bodies in millimetres",
        &["robot", "body", "own", "nominal", "floor", "pairs"],
    );
    let mm = |value: Option<f64>| number(value.map(|metres| metres * 1e3), 2);
    table.rows = rows()
        .map(|(name, body, measures)| {
            let one = &measures.displacements;
            vec![
                name.to_owned(),
                body.to_owned(),
                mm(one.own),
                mm(one.nominal),
                mm(one.floor),
                one.count.to_string(),
            ]
        })
        .collect();
    tables.push(table);
    tables
}

fn row(name: &str, body: &str, errors: &Errors) -> Vec<String> {
    let cm = |value: Option<f64>| number(value.map(|metres| metres * 100.0), 1);
    let percent = |share: Option<f64>| number(share.map(|share| share * 100.0), 0);
    let mut row = vec![name.to_owned(), body.to_owned()];
    for pair in [&errors.own, &errors.nominal, &errors.floor] {
        row.push(cm(pair.as_ref().map(|pair| pair.median)));
        row.push(cm(pair.as_ref().map(|pair| pair.p90)));
    }
    let coverage = errors.coverage.as_ref();
    row.extend([
        number(errors.ratio, 2),
        percent(coverage.map(|coverage| coverage.within_50)),
        percent(coverage.map(|coverage| coverage.within_95)),
        errors.count.to_string(),
    ]);
    row
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};

    fn measures(own: f64) -> Value {
        let errors = |ahead_s: f64| {
            json!({
                "ahead_s": ahead_s, "count": 12, "way": 1.0, "ratio": 0.5,
                "own": {"median": own, "p90": own * 2.0},
                "nominal": {"median": own * 2.0, "p90": 1.0},
                "floor": {"median": 0.01, "p90": 0.02},
                "coverage": {"within_50": 0.4, "within_95": 0.9},
            })
        };
        json!({
            "whole": true, "errors": [errors(1.0), errors(10.0)],
            "innovations": {"count": 50, "coverage": null},
            "displacements": {"over_s": 2.0, "count": 30, "own": 0.0012, "nominal": 0.004, "floor": 0.0001},
        })
    }

    #[test]
    fn the_worst_robot_stands_first_and_who_knows_nothing_last() {
        let mut none = measures(9.0);
        for errors in none["errors"].as_array_mut().expect("errors") {
            for name in ["own", "nominal", "floor", "ratio", "coverage", "way"] {
                errors[name] = Value::Null;
            }
        }
        let gap = json!({
            "time": 5, "fleet": measures(0.03),
            "robots": [
                {"robot": "a", "certificate": null, "since": null, "measures": none},
                {"robot": "b", "certificate": "01ab", "since": 1, "measures": measures(0.02)},
                {"robot": "c", "certificate": null, "since": 1, "measures": measures(0.05)},
            ],
        });
        let tables = tables(serde_json::from_value(gap).expect("a gap"));
        assert_eq!(tables.len(), 3);
        let names = |table: &Table| -> Vec<String> {
            table.rows.iter().map(|row| row[0].clone()).collect()
        };
        for table in &tables {
            assert_eq!(names(table), ["all", "c", "b", "a"]);
            assert!(table.rows.iter().all(|row| row.len() == table.head.len()));
        }
        let row = tables[1].rows[2].join(" ");
        assert_eq!(row, "b 01ab 2.0 4.0 4.0 100.0 1.0 2.0 0.50 40 90 12");
        let row = tables[1].rows[3].join(" ");
        assert_eq!(row, "a nominal – – – – – – – – – 12");
        assert_eq!(tables[2].rows[1].join(" "), "c nominal 1.20 4.00 0.10 30");
    }
}
