//! Questions in `InfluxQL`, over `/query`.
//!
//! `InfluxDB` folds by the hundred thousand rows a second for each of the nineteen numbers of a point,
//! and reads rows as they are by half a million: up to [`SPARSE_ROWS`] are faster folded here. They
//! come as `MessagePack`, which costs it half of what JSON does.

use std::fmt::Write as _;

use crawler_history::{Point, Points, Recorded, Sample, numbered_state};
use crawler_protocol::RobotId;
use serde::Deserialize;
use serde::de::DeserializeOwned;

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
#[serde(bound = "T: DeserializeOwned")]
struct Body<T> {
    #[serde(default = "Vec::new")]
    results: Vec<Outcome<T>>,
}

#[derive(Deserialize)]
#[serde(bound = "T: DeserializeOwned")]
struct Outcome<T> {
    #[serde(default = "Vec::new")]
    series: Vec<Series<T>>,
    error: Option<String>,
}

#[derive(Deserialize)]
#[serde(bound = "T: DeserializeOwned")]
struct Series<T> {
    #[serde(default = "Vec::new")]
    values: Vec<T>,
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
    let body: Wrong = answer.read()?;
    match body.results.into_iter().find_map(|result| result.error) {
        Some(error) => Err(refusal(&error)),
        None => Ok(()),
    }
}

/// A row of so many numbers. The first is a time in milliseconds.
pub(crate) type Row<const N: usize> = [Option<f64>; N];

/// The rows that answer `statement`.
pub(crate) async fn ask<T: DeserializeOwned>(
    client: &Client,
    statement: &str,
) -> Result<Vec<T>, EngineError> {
    let target = format!(
        "/query?db={}&epoch=ms&q={}",
        encoded(&client.address().database),
        encoded(statement)
    );
    rows(client.get_packed(&target).await?.accepted()?.read()?)
}

fn rows<T>(body: Body<T>) -> Result<Vec<T>, EngineError> {
    let Some(outcome) = body.results.into_iter().next() else {
        return Ok(Vec::new());
    };
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

/// Names of the robots of `fleet`.
pub(super) async fn robots(client: &Client, fleet: &str) -> Result<Vec<String>, EngineError> {
    let statement = format!(
        "SHOW TAG VALUES FROM \"{MEASUREMENT}\" WITH KEY = \"robot\" WHERE \"fleet\" = {}",
        literal(fleet)
    );
    let rows: Vec<(String, String)> = ask(client, &statement).await?;
    Ok(rows.into_iter().map(|(_, name)| name).collect())
}

/// Times of the first and of the last sample of `fleet`.
pub(super) async fn recorded(
    client: &Client,
    fleet: &str,
) -> Result<Option<Recorded>, EngineError> {
    let mut ends = Vec::with_capacity(2);
    for function in ["first", "last"] {
        let statement = format!(
            "SELECT {function}(\"x\") FROM \"{MEASUREMENT}\" WHERE \"fleet\" = {}",
            literal(fleet)
        );
        let rows: Vec<Row<2>> = ask(client, &statement).await?;
        ends.extend(rows.first().and_then(|row| row[0]).map(|at| at as i64));
    }
    Ok(match ends.as_slice() {
        &[from, to] => Some(Recorded { from, to }),
        _ => None,
    })
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
fn sample(robot: &RobotId, row: &Row<11>) -> Option<Sample> {
    let [
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
    ] = *row;
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
        let rows: Vec<Row<11>> = ask(client, &statement).await?;
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
    let rows: Vec<Row<20>> = ask(client, &folded(question)).await?;
    Ok(rows.iter().filter_map(read_point).collect())
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
fn read_point(row: &Row<20>) -> Option<Point> {
    let [at, parts @ ..] = row;
    let parts: &Parts = parts;
    point((*at)? as i64, parts)
}

#[cfg(test)]
mod tests {
    use hyper::StatusCode;
    use hyper::header::{CONTENT_TYPE, HeaderMap, HeaderValue};
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
        let read = |text: &str| {
            let answer = Answer {
                status: StatusCode::OK,
                headers: HeaderMap::new(),
                body: text.to_owned().into(),
            };
            rows::<Row<2>>(answer.read()?)
        };
        let error = |text: &str| read(text).expect_err(text);
        assert!(matches!(
            error(r#"{"results":[{"statement_id":0,"error":"database not found: x"}]}"#),
            EngineError::NoDatabase(_)
        ));
        assert!(matches!(
            error(r#"{"results":[{"error":"timeout"}]}"#),
            EngineError::Refused(_)
        ));
        assert!(matches!(error("<html>"), EngineError::Nonsense(_)));
        assert_eq!(read(r#"{"results":[{"statement_id":0}]}"#), Ok(vec![]));
    }

    proptest! {
        #[test]
        fn any_row_is_a_point_or_none(
            row in any::<[Option<f64>; 11]>(),
            parts in any::<[Option<f64>; 20]>(),
        ) {
            let _ = read_point(&parts);
            let _ = sample(&RobotId::new("sim-1").expect("a robot id"), &row);
        }

        #[test]
        fn any_bytes_are_an_answer_or_refused(body in prop::collection::vec(any::<u8>(), 0..60)) {
            let packed = HeaderValue::from_static("application/x-msgpack");
            let answer = Answer {
                status: StatusCode::OK,
                headers: [(CONTENT_TYPE, packed)].into_iter().collect(),
                body: body.into(),
            };
            let _ = answer.read::<Body<Row<11>>>();
            let _ = answer.complaint();
        }
    }
}
