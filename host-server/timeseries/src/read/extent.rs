//! What an engine has at all: of which robots, from when to when.

use std::collections::BTreeSet;

use crawler_history::Recorded;
use crawler_protocol::RobotId;
use serde::Deserialize;
use serde::de::DeserializeOwned;

use super::influxql;
use super::metricsql::{ALL, PAST, literal, seconds};
use crate::address::{Dialect, encoded};
use crate::client::Client;
use crate::error::EngineError;
use crate::line::MEASUREMENT;

const DAY: i64 = 86_400_000;
/// Days that `VictoriaMetrics` looks up day by day; for more it does not look at the time.
const WINDOW: i64 = 35;
/// Windows that are looked at, back from today: 420 days.
const WINDOWS: i64 = 12;
/// Robots of the first and of the last day that are asked when it began and ended: each may have half a
/// million samples of that day.
const WITNESSES: usize = 10;

/// The robots of `fleet` that anything is known of.
pub(crate) async fn robots(
    client: &Client,
    dialect: Dialect,
    fleet: &str,
) -> Result<BTreeSet<RobotId>, EngineError> {
    let names = match dialect {
        Dialect::InfluxQl => influxql::robots(client, fleet).await?,
        Dialect::MetricsQl => names(client, fleet, ALL.0, ALL.1).await?,
    };
    let names = names.into_iter();
    // Others may write what they like.
    Ok(names.filter_map(|name| RobotId::new(&name).ok()).collect())
}

/// From when to when there are samples of `fleet`.
pub(crate) async fn recorded(
    client: &Client,
    dialect: Dialect,
    fleet: &str,
    now: i64,
) -> Result<Option<Recorded>, EngineError> {
    match dialect {
        Dialect::InfluxQl => influxql::recorded(client, fleet).await,
        Dialect::MetricsQl => by_days(client, fleet, now).await,
    }
}

#[derive(Deserialize)]
struct Body<T> {
    data: Option<T>,
}

async fn get<T: DeserializeOwned>(client: &Client, target: &str) -> Result<T, EngineError> {
    let answer = client.get(target).await?.accepted()?;
    let body: Body<T> = serde_json::from_slice(&answer.body)
        .map_err(|error| EngineError::Nonsense(error.to_string()))?;
    body.data
        .ok_or_else(|| EngineError::Nonsense("it has no data".into()))
}

fn selector(client: &Client, fleet: &str, more: &str) -> String {
    format!(
        "{MEASUREMENT}_x{{db={},fleet={}{more}}}",
        literal(&client.address().database),
        literal(fleet)
    )
}

/// The robots with samples in the days that `from` and `to` are in.
async fn names(
    client: &Client,
    fleet: &str,
    from: i64,
    to: i64,
) -> Result<Vec<String>, EngineError> {
    let target = format!(
        "/api/v1/label/robot/values?match%5B%5D={}&start={}&end={}",
        encoded(&selector(client, fleet, "")),
        seconds(from),
        seconds(to)
    );
    get(client, &target).await
}

/// Whether there are samples from the day `first` to the day `last`.
async fn any(client: &Client, fleet: &str, first: i64, last: i64) -> Result<bool, EngineError> {
    let names = names(client, fleet, first * DAY, (last + 1) * DAY - 1).await?;
    Ok(!names.is_empty())
}

/// The index of `VictoriaMetrics` knows days: it is asked for the first and the last one, which costs
/// little, and then a few robots of those days are.
async fn by_days(client: &Client, fleet: &str, now: i64) -> Result<Option<Recorded>, EngineError> {
    let today = now.max(0) / DAY;
    let mut ends: Option<((i64, i64), (i64, i64))> = None;
    for n in 0..WINDOWS {
        let last = today - n * WINDOW;
        let window = ((last - WINDOW + 1).max(0), last);
        if window.0 <= window.1 && any(client, fleet, window.0, window.1).await? {
            ends = Some((window, ends.map_or(window, |(_, newest)| newest)));
        } else if ends.is_some() {
            break;
        }
    }
    let Some((oldest, newest)) = ends else {
        return Ok(None);
    };
    let (mut low, mut high) = oldest;
    while low < high {
        let middle = i64::midpoint(low, high);
        if any(client, fleet, oldest.0, middle).await? {
            high = middle;
        } else {
            low = middle + 1;
        }
    }
    let first_day = low;
    (low, high) = newest;
    while low < high {
        let middle = i64::midpoint(low, high) + 1;
        if any(client, fleet, middle, newest.1).await? {
            low = middle;
        } else {
            high = middle - 1;
        }
    }
    let from = edge(client, fleet, first_day, ("min", "tfirst_over_time")).await?;
    let to = edge(client, fleet, low, ("max", "tlast_over_time")).await?;
    Ok(from.zip(to).map(|(from, to)| Recorded { from, to }))
}

/// Time of the first or the last sample of a day, by the word of some robots.
async fn edge(
    client: &Client,
    fleet: &str,
    day: i64,
    (outer, inner): (&str, &str),
) -> Result<Option<i64>, EngineError> {
    #[derive(Deserialize)]
    struct Found {
        result: Vec<One>,
    }
    #[derive(Deserialize)]
    struct One {
        value: (f64, String),
    }
    let end = (day + 1) * DAY - 1;
    let names = names(client, fleet, day * DAY, end).await?;
    let known: Vec<String> = names
        .iter()
        .filter_map(|name| Some(RobotId::new(name).ok()?.to_string()))
        .take(WITNESSES)
        .collect();
    let robots = format!(",robot=~{}", literal(&known.join("|")));
    let question = format!(
        "{outer}({inner}({}[{DAY}ms] offset -{PAST}ms))",
        selector(client, fleet, &robots)
    );
    let target = format!(
        "/api/v1/query?nocache=1&step=1d&time={}&query={}",
        seconds(end - PAST),
        encoded(&question)
    );
    let found: Found = get(client, &target).await?;
    let Some(One { value: (_, value) }) = found.result.into_iter().next() else {
        return Ok(None);
    };
    let seconds: f64 = value
        .parse()
        .map_err(|_| EngineError::Nonsense("a time is no number".into()))?;
    Ok(Some((seconds * 1_000.0).round() as i64))
}
