//! How far the bodies of twins and their robots are apart: the reality gap, robot by robot.

use std::sync::Arc;
use std::time::Instant;

use axum::Json;
use axum::extract::State;
use serde::Serialize;
use utoipa::ToSchema;

use super::problem::{Code, Problem};
use crawler_system::clock;
use crawler_twins::measures::{self, Coverage, DISPLACEMENT_S, Measure, Measures, Quantiles};
use crawler_twins::{FleetGap, RobotGap, Twins};

/// Median, and what nine in ten are below, in metres.
#[derive(Serialize, ToSchema)]
#[schema(as = GapQuantiles)]
struct QuantilesView {
    median: f64,
    p90: f64,
}

impl QuantilesView {
    const fn new(quantiles: &Quantiles) -> Self {
        Self {
            median: quantiles.median_m,
            p90: quantiles.p90_m,
        }
    }
}

/// Shares within the regions that a twin gives, which should hold 50 and 95 of 100.
#[derive(Serialize, ToSchema)]
#[schema(as = GapCoverage)]
struct CoverageView {
    /// About 0.5 where the twin is as sure as it may be; less where it is too sure.
    within_50: f64,
    /// About 0.95.
    within_95: f64,
}

impl CoverageView {
    const fn new(coverage: &Coverage) -> Self {
        Self {
            within_50: coverage.within_50,
            within_95: coverage.within_95,
        }
    }
}

/// How far predictions were from where the robot was then seen, given what its motors had meanwhile.
#[derive(Serialize, ToSchema)]
#[schema(as = GapErrors)]
struct ErrorsView {
    /// How far ahead they were, in seconds.
    ahead_s: f64,
    /// Of so many, the newest; 256 of a robot at most.
    count: usize,
    /// Driven meanwhile, on average, in metres; this and all below `null` where there are fewer than 20 over 1 s, 10 over 10 s.
    way: Option<f64>,
    /// By the body of the twin.
    own: Option<QuantilesView>,
    /// By the nominal body, from the same places.
    nominal: Option<QuantilesView>,
    /// Median of the twin's own, as a share of that of the nominal body.
    ratio: Option<f64>,
    /// What a perfect copy of the robot would have shown, by the noise that fixes state: what of an error is noise.
    floor: Option<QuantilesView>,
    /// How many were in the regions that the twin gave.
    coverage: Option<CoverageView>,
}

/// Innovations: fixes beside where the twin was by then.
#[derive(Serialize, ToSchema)]
#[schema(as = GapInnovations)]
struct InnovationsView {
    /// Of so many, the newest; 256 of a robot at most.
    count: usize,
    /// `null` where there are fewer than 40.
    coverage: Option<CoverageView>,
}

/// Displacements over some time, and their energy distance (Székely and Rizzo, 2013) to those of bodies.
#[derive(Serialize, ToSchema)]
#[schema(as = GapDisplacements)]
struct DisplacementsView {
    /// Over how long, in seconds.
    over_s: f64,
    /// So many, the newest; 128 of a robot at most.
    count: usize,
    /// From those that were seen to those of the body of the twin, in metres; this and all below `null` where there are fewer
    /// than 20.
    own: Option<f64>,
    /// To those of the nominal body.
    nominal: Option<f64>,
    /// Of what a perfect copy of the robot would have shown.
    floor: Option<f64>,
}

/// How far a robot, or all of them, and the bodies of their twins are apart.
#[derive(Serialize, ToSchema)]
#[schema(as = GapMeasures)]
struct MeasuresView {
    /// Whether there is enough for all of it.
    whole: bool,
    /// 1 s and 10 s ahead.
    errors: Vec<ErrorsView>,
    /// Of single fixes.
    innovations: InnovationsView,
    /// Over two seconds.
    displacements: DisplacementsView,
}

impl MeasuresView {
    fn new(measures: &Measures) -> Self {
        let errors = |(horizon, measure): (usize, &Measure<measures::Errors>)| {
            let value = measure.value.as_ref();
            ErrorsView {
                ahead_s: measures::ahead_s(horizon),
                count: measure.count,
                way: value.map(|errors| errors.way_m),
                own: value.map(|errors| QuantilesView::new(&errors.own)),
                nominal: value.map(|errors| QuantilesView::new(&errors.nominal)),
                ratio: value.and_then(measures::Errors::ratio),
                floor: value.map(|errors| QuantilesView::new(&errors.floor)),
                coverage: value.map(|errors| CoverageView::new(&errors.coverage)),
            }
        };
        let distances = measures.displacements.value.as_ref();
        Self {
            whole: measures.is_whole(),
            errors: measures.errors.iter().enumerate().map(errors).collect(),
            innovations: InnovationsView {
                count: measures.innovations.count,
                coverage: measures.innovations.value.as_ref().map(CoverageView::new),
            },
            displacements: DisplacementsView {
                over_s: DISPLACEMENT_S,
                count: measures.displacements.count,
                own: distances.map(|distances| distances.own_m),
                nominal: distances.map(|distances| distances.nominal_m),
                floor: distances.map(|distances| distances.floor_m),
            },
        }
    }
}

/// The gap of a robot.
#[derive(Serialize, ToSchema)]
#[schema(as = RobotGap)]
struct RobotView {
    /// The robot.
    robot: String,
    /// Id of the certificate whose body its twin has; `null` for the nominal body, beside which it has learned what the wheels
    /// make of their duty.
    certificate: Option<String>,
    /// Unix milliseconds of the oldest prediction that this rests on, by the server's clock; `null` where there is none.
    since: Option<u64>,
    /// How far it is.
    measures: MeasuresView,
}

impl RobotView {
    fn new(gap: &RobotGap) -> Self {
        Self {
            robot: gap.robot.as_str().to_owned(),
            certificate: gap.body.as_ref().map(|body| body.id().to_owned()),
            since: gap.since_ms,
            measures: MeasuresView::new(&gap.measures),
        }
    }
}

/// How far the bodies of twins and their robots are apart.
#[derive(Serialize, ToSchema)]
#[schema(as = FleetGap)]
pub(super) struct GapView {
    /// Unix milliseconds at which it was measured, two seconds ago at most.
    time: u64,
    /// Of all robots together, as many predictions of each at most.
    fleet: MeasuresView,
    /// Of each robot that has a twin, by their names.
    robots: Vec<RobotView>,
}

impl GapView {
    fn new(gap: &FleetGap) -> Self {
        Self {
            time: gap.time_ms,
            fleet: MeasuresView::new(&gap.fleet),
            robots: gap.robots.iter().map(RobotView::new).collect(),
        }
    }
}

/// How far bodies and robots are apart
///
/// The reality gap of each robot that has a twin, and of all together: errors of predictions against those of the nominal
/// body, how often what came was in the regions that should hold it, and the energy distance between displacements that
/// were seen and those of the body; each beside what the tracker's noise alone would show. Of robots while they drive and
/// nothing is wrong with them. A robot begins anew with each certificate.
#[utoipa::path(get, path = "/fleet/gap", tag = "robots", operation_id = "fleet_gap",
    responses(
        (status = 200, description = "How far", body = GapView),
        (status = 404, description = "This server keeps no twins (`no_twin`)")))]
pub(super) async fn of_fleet(State(twins): State<Arc<Twins>>) -> Result<Json<GapView>, Problem> {
    // Of a thousand robots that is a tenth of a second.
    let measure = move || twins.gap(Instant::now(), clock::unix_ms());
    let measured = tokio::task::spawn_blocking(measure).await;
    match measured {
        Ok(Ok(gap)) => Ok(Json(GapView::new(&gap))),
        Ok(Err(reason)) => Err(Problem::new(Code::NoTwin, reason.to_string())),
        Err(error) => {
            tracing::error!(%error, "measuring the gap failed");
            Err(Problem::internal("the gap cannot be measured"))
        }
    }
}
