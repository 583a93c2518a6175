//! Questions in `MetricsQL`, over `/api/v1/query_range`.
//!
//! A value there looks back from its time over a window that has its end and not its beginning. The
//! last millisecond of a stretch, with a window of its length, thus has just that stretch. The first
//! and the last stretch may be cut by the question, so each has a window of its own.

use std::collections::BTreeMap;

use crawler_history::Point;
use serde::Deserialize;

use super::{Fold, PARTS, Parts, Question, point};
use crate::address::encoded;
use crate::client::Client;
use crate::error::EngineError;
use crate::line::MEASUREMENT;

/// Questions are asked of the past, and so many milliseconds are added again: within half a minute of
/// now, the engine would repeat older values in place of those that may still change.
pub(super) const PAST: i64 = 86_400_000;

/// Longest step that the engine takes, in milliseconds: 100 years.
const LONGEST: i64 = 3_153_600_000_000;
/// History begins in 2000 and ends in 2065 here, in Unix milliseconds: the engine answers nothing when
/// window and step reach back before 1970.
pub(super) const ALL: (i64, i64) = (946_684_800_000, 3_000_000_000_000);
/// Step of a question about one stretch, where it says nothing.
const ONE: i64 = 60_000;

#[derive(Deserialize)]
struct Body<'a> {
    #[serde(borrow)]
    data: Option<Data<'a>>,
}

#[derive(Deserialize)]
struct Data<'a> {
    #[serde(borrow)]
    result: Vec<Series<'a>>,
}

#[derive(Deserialize)]
struct Series<'a> {
    #[serde(borrow)]
    metric: Metric<'a>,
    #[serde(borrow)]
    values: Vec<(f64, &'a str)>,
}

#[derive(Deserialize)]
struct Metric<'a> {
    #[serde(rename = "__name__")]
    name: &'a str,
    rollup: &'a str,
}

/// Stretches of one length: the last millisecond of the first and of the last one.
#[derive(Debug, PartialEq, Eq)]
struct Stretches {
    first: i64,
    last: i64,
    length: i64,
    /// From the last millisecond of a stretch to when its point begins.
    back: i64,
}

/// The stretches of a question: those that are whole, and the cut ones at both ends.
fn stretches(from: i64, to: i64, step: i64) -> Vec<Stretches> {
    let begin = from - from.rem_euclid(step);
    let whole_begin = if begin == from { from } else { begin + step };
    let whole_end = to - to.rem_euclid(step);
    let mut out = Vec::new();
    let mut one = |begin: i64, from: i64, to: i64| {
        out.push(Stretches {
            first: to - 1,
            last: to - 1,
            length: to - from,
            back: to - 1 - begin,
        });
    };
    if whole_begin > whole_end {
        // All within one.
        one(begin, from, to);
        return out;
    }
    if from < whole_begin {
        one(begin, from, whole_begin);
    }
    if whole_end < to {
        one(whole_end, whole_end, to);
    }
    if whole_begin < whole_end {
        out.push(Stretches {
            first: whole_begin + step - 1,
            last: whole_end - 1,
            length: step,
            back: step - 1,
        });
    }
    out
}

pub(super) fn literal(text: &str) -> String {
    format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\""))
}

const fn function(fold: Fold) -> &'static str {
    match fold {
        Fold::Count => "count_over_time",
        Fold::Mean => "avg_over_time",
        Fold::Min => "min_over_time",
        Fold::Max => "max_over_time",
        Fold::Last => "last_over_time",
    }
}

/// One expression for all [`PARTS`]. Fields with the same functions are asked for together.
fn expression(database: &str, question: &Question<'_>, length: i64) -> String {
    let labels = format!(
        "db={},fleet={},robot={}",
        literal(database),
        literal(question.fleet),
        literal(question.robot.as_str())
    );
    let mut fields: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for (fold, field) in PARTS {
        fields.entry(field).or_default().push(function(fold));
    }
    let mut groups: BTreeMap<Vec<&str>, Vec<&str>> = BTreeMap::new();
    for (field, functions) in fields {
        groups.entry(functions).or_default().push(field);
    }
    let groups = groups.iter().map(|(functions, fields)| {
        let functions: Vec<String> = functions.iter().map(|name| literal(name)).collect();
        format!(
            "aggr_over_time(({}), {{__name__=~\"{MEASUREMENT}_({})\",{labels}}}[{length}ms] offset -{PAST}ms) keep_metric_names",
            functions.join(","),
            fields.join("|")
        )
    });
    format!("union({})", groups.collect::<Vec<_>>().join(","))
}

/// Seconds, as the engine wants them.
pub(super) fn seconds(ms: i64) -> String {
    let sign = if ms < 0 { "-" } else { "" };
    let ms = ms.unsigned_abs();
    format!("{sign}{}.{:03}", ms / 1_000, ms % 1_000)
}

async fn ask(
    client: &Client,
    question: &Question<'_>,
    stretches: Stretches,
) -> Result<Vec<Point>, EngineError> {
    let expression = expression(&client.address().database, question, stretches.length);
    let step = if stretches.first == stretches.last {
        ONE
    } else {
        question.step
    };
    let target = format!(
        "/api/v1/query_range?nocache=1&start={}&end={}&step={}ms&query={}",
        seconds(stretches.first - PAST),
        seconds(stretches.last - PAST),
        step,
        encoded(&expression)
    );
    let answer = client.get(&target).await?.accepted()?;
    read(&answer.body, PAST - stretches.back)
}

/// The points in an answer, whose times are `ahead` milliseconds after those that it says.
fn read(body: &[u8], ahead: i64) -> Result<Vec<Point>, EngineError> {
    let nonsense = |text: &str| EngineError::Nonsense(text.to_owned());
    let body: Body<'_> =
        serde_json::from_slice(body).map_err(|error| EngineError::Nonsense(error.to_string()))?;
    let data = body.data.ok_or_else(|| nonsense("it has no data"))?;
    let mut found: BTreeMap<i64, Parts> = BTreeMap::new();
    for series in data.result {
        let field = series
            .metric
            .name
            .strip_prefix(MEASUREMENT)
            .and_then(|rest| rest.strip_prefix('_'));
        let place = PARTS.iter().position(|(fold, known)| {
            Some(*known) == field && function(*fold) == series.metric.rollup
        });
        let Some(place) = place else { continue };
        for (at, value) in series.values {
            let at = ((at * 1_000.0).round() as i64).saturating_add(ahead);
            let value = value
                .parse()
                .map_err(|_| nonsense("a value is no number"))?;
            found.entry(at).or_default()[place] = Some(value);
        }
    }
    let points = found.iter().filter_map(|(&at, parts)| point(at, parts));
    Ok(points.collect())
}

/// All points, as the engine folds them.
pub(super) async fn points(
    client: &Client,
    question: &Question<'_>,
) -> Result<Vec<Point>, EngineError> {
    let question = &Question {
        from: question.from.max(ALL.0),
        to: question.to.min(ALL.1),
        step: question.step.min(LONGEST),
        ..question.clone()
    };
    if question.from >= question.to {
        return Ok(Vec::new());
    }
    let mut out = Vec::new();
    for stretches in stretches(question.from, question.to, question.step) {
        out.extend(ask(client, question, stretches).await?);
    }
    out.sort_by_key(|point| point.at);
    Ok(out)
}

#[cfg(test)]
mod tests {
    use crawler_protocol::RobotId;
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_question_is_one_expression() {
        let robot = RobotId::new("sim-1").expect("a robot id");
        let question = Question {
            fleet: "a\"b\\",
            robot: &robot,
            from: 0,
            to: 1,
            step: 1,
        };
        let text = expression("fleet", &question, 500);
        let has = "aggr_over_time((\"avg_over_time\"), {__name__=~\"telemetry_(left|right|y)\",\
                   db=\"fleet\",fleet=\"a\\\"b\\\\\",robot=\"sim-1\"}[500ms] offset -86400000ms) keep_metric_names";
        assert!(text.contains(has), "{text}");
    }

    #[test]
    fn what_is_no_answer_is_refused() {
        for body in [
            "",
            "{}",
            r#"{"data":{"result":[{"metric":{},"values":[]}]}}"#,
        ] {
            assert!(read(body.as_bytes(), 0).is_err(), "{body}");
        }
        let body = r#"{"data":{"result":[{"metric":{"__name__":"other","rollup":"x"},"values":[[1,"2"]]}]}}"#;
        assert_eq!(read(body.as_bytes(), 0), Ok(vec![]));
    }

    proptest! {
        #[test]
        fn every_moment_is_in_the_stretch_of_its_point(
            from in 0..5_000_i64,
            length in 1..5_000_i64,
            step in 1..700_i64,
        ) {
            let to = from + length;
            let mut covered = BTreeMap::new();
            for part in stretches(from, to, step) {
                prop_assert!(part.first <= part.last);
                let mut end = part.first;
                while end <= part.last {
                    for at in end - part.length + 1..=end {
                        prop_assert_eq!(covered.insert(at, end - part.back), None);
                    }
                    end += step;
                }
            }
            let wanted: BTreeMap<i64, i64> = (from..to).map(|at| (at, at - at % step)).collect();
            prop_assert_eq!(covered, wanted);
        }
    }
}
