//! How long requests take, by route.

use std::time::Duration;

use prometheus_client::encoding::EncodeLabelSet;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::registry::{Registry, Unit};

use crate::Metrics;

/// What no route answers: the files of the control room, and whatever strangers try.
const NO_ROUTE: &str = "other";

/// Every value comes from a list of ours, so that nobody outside decides how many series there are.
#[derive(Clone, Debug, Hash, PartialEq, Eq, EncodeLabelSet)]
struct Label {
    method: &'static str,
    /// As the router spells it: `/api/v1/robots/{id}`.
    route: String,
    status: u16,
}

/// Latency of requests.
pub(crate) struct Latency(Family<Label, Histogram>);

impl Latency {
    pub(crate) fn new(registry: &mut Registry) -> Self {
        let family = Family::<Label, Histogram>::new_with_constructor(|| {
            Histogram::new([
                0.001, 0.002_5, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 10.0,
            ])
        });
        registry.register_with_unit(
            "http_request_duration",
            "From the head of a request to the head of its answer, by route and status",
            Unit::Seconds,
            family.clone(),
        );
        Self(family)
    }
}

impl Metrics {
    /// Notes one request: `route` as the router spells it, `None` when no route answered.
    pub fn observe_http(&self, method: &str, route: Option<&str>, status: u16, took: Duration) {
        let label = Label {
            method: name(method),
            route: route.unwrap_or(NO_ROUTE).to_owned(),
            status,
        };
        self.http_latency
            .0
            .get_or_create(&label)
            .observe(took.as_secs_f64());
    }
}

/// Anybody can invent a method.
fn name(method: &str) -> &'static str {
    const KNOWN: [&str; 7] = ["GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"];
    let known = KNOWN.into_iter().find(|known| *known == method);
    known.unwrap_or(NO_ROUTE)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strangers_make_no_series() {
        let metrics = Metrics::new();
        for number in 0..1_000 {
            metrics.observe_http(&format!("M{number}"), None, 404, Duration::from_millis(3));
        }
        let text = metrics.exposition().finish();
        let series = text
            .lines()
            .filter(|line| line.starts_with("terracrawler_http_request_duration_seconds_count"))
            .collect::<Vec<_>>();
        assert_eq!(
            series,
            [
                r#"terracrawler_http_request_duration_seconds_count{method="other",route="other",status="404"} 1000"#
            ]
        );
    }
}
