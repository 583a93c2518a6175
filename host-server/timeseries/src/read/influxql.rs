//! Questions in `InfluxQL`, over `/query`.
//!
//! `InfluxDB` folds by the hundred thousand rows a second for each of the nineteen numbers of a point,
//! and reads rows as they are by half a million: up to [`SPARSE_ROWS`] are faster folded here.

use std::fmt::Write as _;

use crawler_protocol::RobotId;
use crawler_records::history::{Point, Points, Sample, numbered_state};
use serde::Deserialize;

use super::{FIELDS, Fold, PARTS, Parts, Question, point};
use crate::address::encoded;
use crate::client::{Answer, Client, one_line};
use crate::error::EngineError;
use crate::line::MEASUREMENT;

/// Most rows that are fetched as they are: an hour at 5 Hz, and some.
pub const SPARSE_ROWS: usize = 20_000;
/// Shortest time between two samples that is reckoned with, in milliseconds. Who sends more often is
/// noticed by the number of rows.
const EVERY: i64 = 200;

#[derive(Deserialize)]
struct Body {
    #[serde(default)]
    results: Vec<Outcome>,
}

#[derive(Deserialize, Default)]
struct Outcome {
    #[serde(default)]
    series: Vec<Series>,
    error: Option<String>,
}

#[derive(Deserialize)]
struct Series {
    #[serde(default)]
    values: Vec<Vec<Option<f64>>>,
}

/// What is wrong, as the body of an answer says it.
#[derive(Deserialize)]
struct Wrong {
    #[serde(default)]
    results: Vec<WrongOutcome>,
}

#[derive(Deserialize)]
struct WrongOutcome {
    error: Option<String>,
}

/// A name of a database or a field in a statement.
pub(crate) fn name(text: &str) -> String {
    format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\""))
}

/// A text in a statement.
fn literal(text: &str) -> String {
    format!("'{}'", text.replace('\\', "\\\\").replace('\'', "\\'"))
}

/// An error of a statement, which comes with status 200.
fn refusal(error: &str) -> EngineError {
    let text = one_line(error, "an error without a word");
    if text.contains("database not found") || text.contains("bucket") {
        EngineError::NoDatabase(text)
    } else if text.contains("authoriz") {
        EngineError::Denied(text)
    } else {
        EngineError::Refused(text)
    }
}

/// The answer to a statement without rows.
pub(crate) fn checked(answer: Answer) -> Result<(), EngineError> {
    let answer = answer.accepted()?;
    let body: Wrong = parsed(&answer.body)?;
    match body.results.into_iter().find_map(|result| result.error) {
        Some(error) => Err(refusal(&error)),
        None => Ok(()),
    }
}

fn parsed<'a, T: Deserialize<'a>>(body: &'a [u8]) -> Result<T, EngineError> {
    serde_json::from_slice(body).map_err(|error| EngineError::Nonsense(error.to_string()))
}

/// The rows that answer `statement`: times in milliseconds, and numbers.
pub(crate) async fn ask(
    client: &Client,
    statement: &str,
) -> Result<Vec<Vec<Option<f64>>>, EngineError> {
    let target = format!(
        "/query?db={}&epoch=ms&q={}",
        encoded(&client.address().database),
        encoded(statement)
    );
    let answer = client.get(&target).await?.accepted()?;
    rows(&answer.body)
}

fn rows(body: &[u8]) -> Result<Vec<Vec<Option<f64>>>, EngineError> {
    let body: Body = parsed(body)?;
    let outcome = body.results.into_iter().next().unwrap_or_default();
    match outcome.error {
        Some(error) => Err(refusal(&error)),
        // One robot is one series.
        None => Ok(outcome
            .series
            .into_iter()
            .next()
            .map_or_else(Vec::new, |series| series.values)),
    }
}

fn condition(question: &Question<'_>) -> String {
    format!(
        "FROM \"{MEASUREMENT}\" WHERE \"fleet\" = {} AND \"robot\" = {} AND time >= {}ms AND time < {}ms",
        literal(question.fleet),
        literal(question.robot.as_str()),
        question.from,
        question.to
    )
}

/// A row of [`FIELDS`], behind its time, as a sample.
fn sample(robot: &RobotId, row: &[Option<f64>]) -> Option<Sample> {
    let &[
        at,
        x,
        y,
        theta,
        left,
        right,
        mv,
        percent,
        range,
        rssi,
        state,
    ] = row
    else {
        return None;
    };
    Some(Sample {
        robot: robot.clone(),
        at: at? as i64,
        x: x? as f32,
        y: y? as f32,
        theta: theta? as f32,
        range_mm: range.map(|range| range as u16),
        battery_mv: mv? as u16,
        battery_percent: percent? as u8,
        rssi: rssi.map(|rssi| rssi as i8),
        left: left? as f32,
        right: right? as f32,
        state: numbered_state(state? as i64),
    })
}

/// All points: of rows as they are where they are few, else as the engine folds them.
pub(super) async fn points(
    client: &Client,
    question: &Question<'_>,
    mut points: Points,
) -> Result<Vec<Point>, EngineError> {
    if (question.to - question.from) / EVERY <= SPARSE_ROWS as i64 {
        let fields: Vec<String> = FIELDS.iter().map(|field| name(field)).collect();
        let statement = format!(
            "SELECT {} {} LIMIT {}",
            fields.join(", "),
            condition(question),
            SPARSE_ROWS + 1
        );
        let rows = ask(client, &statement).await?;
        if rows.len() <= SPARSE_ROWS {
            for row in &rows {
                // Half a row is somebody else's.
                if let Some(sample) = sample(question.robot, row) {
                    points.add(&sample);
                }
            }
            return Ok(points.finish());
        }
    }
    let rows = ask(client, &folded(question)).await?;
    Ok(rows.iter().filter_map(|row| read_point(row)).collect())
}

fn folded(question: &Question<'_>) -> String {
    let mut statement = "SELECT ".to_owned();
    for (place, (fold, field)) in PARTS.iter().enumerate() {
        let function = match fold {
            Fold::Count => "count",
            Fold::Mean => "mean",
            Fold::Min => "min",
            Fold::Max => "max",
            Fold::Last => "last",
        };
        let comma = if place == 0 { "" } else { ", " };
        // Writing to a String does not fail.
        let _ = write!(statement, "{comma}{function}({})", name(field));
    }
    let _ = write!(
        statement,
        " {} GROUP BY time({}ms) fill(none)",
        condition(question),
        question.step
    );
    statement
}

/// A row of [`PARTS`], behind its time.
fn read_point(row: &[Option<f64>]) -> Option<Point> {
    let (at, parts) = row.split_first()?;
    let parts: &Parts = parts.try_into().ok()?;
    point((*at)? as i64, parts)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_question_is_one_statement() {
        let robot = RobotId::new("sim-1").expect("a robot id");
        let question = Question {
            fleet: "it's \\ a \"swarm\"",
            robot: &robot,
            from: 5,
            to: 6,
            step: 1,
        };
        let text = folded(&question);
        let begins = "SELECT count(\"x\"), mean(\"x\"), mean(\"y\")";
        assert!(text.starts_with(begins), "{text}");
        let ends = "FROM \"telemetry\" WHERE \"fleet\" = 'it\\'s \\\\ a \"swarm\"' AND \"robot\" = 'sim-1' \
                    AND time >= 5ms AND time < 6ms GROUP BY time(1ms) fill(none)";
        assert!(text.ends_with(ends), "{text}");
        assert_eq!(name("a\"b\\"), "\"a\\\"b\\\\\"");
    }

    #[test]
    fn errors_within_an_answer_are_told_apart() {
        let error = |text: &str| rows(text.as_bytes()).expect_err(text);
        assert!(matches!(
            error(r#"{"results":[{"statement_id":0,"error":"database not found: x"}]}"#),
            EngineError::NoDatabase(_)
        ));
        assert!(matches!(
            error(r#"{"results":[{"error":"timeout"}]}"#),
            EngineError::Refused(_)
        ));
        assert!(matches!(error("<html>"), EngineError::Nonsense(_)));
        assert_eq!(rows(br#"{"results":[{"statement_id":0}]}"#), Ok(vec![]));
    }

    proptest! {
        #[test]
        fn any_row_is_a_point_or_none(row in prop::collection::vec(any::<Option<f64>>(), 0..25)) {
            let _ = read_point(&row);
            let _ = sample(&RobotId::new("sim-1").expect("a robot id"), &row);
        }
    }
}
