//! Twins of robots: where they are by what they did, where they will be, and whose body that is.

use std::sync::Arc;
use std::time::Instant;

use axum::Json;
use axum::extract::{Path, State};
use crawler_protocol::RobotId;
use serde::Serialize;
use utoipa::ToSchema;

use super::problem::{Code, Problem};
use crawler_fleet::SharedFleet;
use crawler_system::clock;
use crawler_twins::folder::Refusal;
use crawler_twins::{
    Ahead, Certificate, Estimate, Fault, Found, NoTwin, Residual, State as TwinState, Twins, Value,
};

/// A place, and how sure it is.
#[derive(Serialize, ToSchema)]
#[schema(as = TwinPose)]
pub(super) struct PoseView {
    /// Metres.
    x: f64,
    /// Metres.
    y: f64,
    /// Heading in radians, anticlockwise from the x axis.
    theta: f64,
    /// One standard deviation of the position along its longer axis, in metres.
    sigma: f64,
    /// Of the heading, in radians.
    sigma_theta: f64,
}

impl PoseView {
    fn new(at: &Estimate) -> Self {
        Self {
            x: at.pose.x,
            y: at.pose.y,
            theta: at.pose.theta,
            sigma: at.sigma_m,
            sigma_theta: at.sigma_rad,
        }
    }
}

/// A number for each wheel.
#[derive(Serialize, ToSchema)]
#[schema(as = TwinWheels)]
pub(super) struct WheelsView {
    left: f64,
    right: f64,
}

impl WheelsView {
    const fn new([left, right]: [f64; 2]) -> Self {
        Self { left, right }
    }
}

/// What a twin finds wrong with its robot.
#[derive(Serialize, ToSchema)]
#[schema(as = TwinFault)]
pub(super) struct FaultView {
    /// `left_weak`, `right_weak`, `both_weak`, `slipping`, `stuck`, `tracker_wrong` or `late`.
    fault: &'static str,
    /// What it means, for people.
    meaning: &'static str,
    /// Unix milliseconds.
    since: u64,
    /// How much: the share that is missing; of `late` seconds, of `tracker_wrong` jumps.
    amount: f64,
}

impl FaultView {
    const fn new(&(fault, since): &(Fault, u64)) -> Self {
        Self {
            fault: fault.fault.name(),
            meaning: fault.fault.meaning(),
            since,
            amount: fault.amount,
        }
    }
}

/// How far the wheels are from the body of the certificate.
#[derive(Serialize, ToSchema)]
#[schema(as = TwinDrift)]
pub(super) struct DriftView {
    /// Of each wheel, in deviations of what is known of it and what bodies differ by from day to day. Beyond 3 over 5 m of way
    /// the certificate is stale, and holds again within 2.
    deviations: WheelsView,
    /// Unix milliseconds since when the certificate is stale: the robot is to be calibrated anew. `null` where it holds.
    stale_since: Option<u64>,
}

/// How far off forecasts were, given what the robot then did.
#[derive(Serialize, ToSchema)]
#[schema(as = TwinError)]
pub(super) struct ErrorView {
    /// How far ahead they were, in seconds.
    ahead_s: f64,
    /// How many of late; 128 at most.
    count: usize,
    /// Half of them were off by less, in metres; `null` where there are none.
    median: Option<f64>,
    /// Nine in ten were.
    p90: Option<f64>,
}

impl ErrorView {
    fn new(errors: &Residual) -> Self {
        let of = |value: f64| (errors.count > 0 && value.is_finite()).then_some(value);
        Self {
            ahead_s: errors.horizon_s,
            count: errors.count,
            median: of(errors.median_m),
            p90: of(errors.p90_m),
        }
    }
}

/// What the twin of a robot knows.
#[derive(Serialize, ToSchema)]
#[schema(as = Twin)]
pub(super) struct TwinView {
    /// The robot.
    robot: String,
    /// Unix milliseconds of this, by the server's clock. It is one sample of telemetry behind the robot.
    time: u64,
    /// How long ago that is, in milliseconds.
    age_ms: u64,
    /// Id of the certificate whose body it has; `null` for the nominal body.
    certificate: Option<String>,
    /// Where it is.
    pose: PoseView,
    /// Speed ahead, in metres per second.
    v: f64,
    /// Turning rate, in radians per second.
    w: f64,
    /// What each wheel makes of its duty, beside that body.
    gains: WheelsView,
    /// One standard deviation of each.
    gain_sigma: WheelsView,
    /// Whether the certificate still holds; `null` for the nominal body.
    drift: Option<DriftView>,
    /// Mean of the normalised innovations squared, over three: about 1 where the twin is as sure as it may be, more where
    /// the robot is not like its body.
    consistency: f64,
    /// Share of the fixes within the region that 95 of 100 should be in.
    coverage: f64,
    /// Fixes that it has taken in.
    fixes: u64,
    /// Times that the robot was elsewhere at once.
    jumps: u64,
    /// Times that the robot was not heard of for too long, or a clock was set.
    gaps: u64,
    /// Samples and fixes that were no evidence.
    refused: u64,
    /// What is wrong with the robot, as far as can be told. Of a nominal body that is `stuck`, `tracker_wrong`, `late`.
    faults: Vec<FaultView>,
}

impl TwinView {
    fn new(robot: &RobotId, state: &TwinState) -> Self {
        let view = &state.view;
        Self {
            robot: robot.as_str().to_owned(),
            time: state.time_ms,
            age_ms: u64::try_from(state.age.as_millis()).unwrap_or(u64::MAX),
            certificate: state.body.as_ref().map(|body| body.id().to_owned()),
            pose: PoseView::new(&view.now),
            v: view.v,
            w: view.w,
            gains: WheelsView::new(view.gains),
            gain_sigma: WheelsView::new(view.gain_sigma),
            drift: view.drift.map(|drift| DriftView {
                deviations: WheelsView::new(drift.deviations),
                stale_since: state.stale_since_ms,
            }),
            consistency: view.consistency,
            coverage: view.coverage,
            fixes: view.fixes,
            jumps: view.jumps,
            gaps: view.gaps,
            refused: state.refused,
            faults: state.faults.iter().map(FaultView::new).collect(),
        }
    }
}

/// Where a robot will be.
#[derive(Serialize, ToSchema)]
#[schema(as = TwinForecast)]
pub(super) struct ForecastView {
    /// How far ahead, in seconds.
    ahead_s: f64,
    /// Where.
    pose: PoseView,
}

/// Where a robot is and will be, if its motors go on as they do.
#[derive(Serialize, ToSchema)]
#[schema(as = TwinForecasts)]
pub(super) struct ForecastsView {
    /// The robot.
    robot: String,
    /// Unix milliseconds of `pose`, by the server's clock.
    time: u64,
    /// Where it is.
    pose: PoseView,
    /// Where it will be, the nearest first: 1 s and 10 s ahead of that.
    forecasts: Vec<ForecastView>,
    /// How good such forecasts were of late.
    errors: Vec<ErrorView>,
}

impl ForecastsView {
    fn new(robot: &RobotId, ahead: &Ahead) -> Self {
        let forecasts = ahead.forecasts.iter().map(|forecast| ForecastView {
            ahead_s: forecast.horizon_s,
            pose: PoseView::new(&forecast.at),
        });
        Self {
            robot: robot.as_str().to_owned(),
            time: ahead.time_ms,
            pose: PoseView::new(&ahead.now),
            forecasts: forecasts.collect(),
            errors: ahead.errors.iter().map(ErrorView::new).collect(),
        }
    }
}

/// Why a certificate is not used.
#[derive(Serialize, ToSchema)]
#[schema(as = TwinRefusal)]
pub(super) struct RefusalView {
    /// `unreadable`, `too_long`, `no_certificate`, `other_format`, `unsound`, `other_robot`, `other_build` or `expired`.
    code: &'static str,
    /// For people.
    detail: String,
}

impl RefusalView {
    fn new(refusal: &Refusal) -> Self {
        Self {
            code: refusal.name(),
            detail: refusal.to_string(),
        }
    }
}

/// A number of a body.
#[derive(Serialize, ToSchema)]
#[schema(as = TwinValue)]
pub(super) struct ValueView {
    /// Its name.
    name: String,
    /// What it was found to be.
    value: f64,
    /// One standard deviation.
    sigma: f64,
    /// What the nominal body has.
    nominal: f64,
}

/// How a drive that was held out is predicted.
#[derive(Serialize, ToSchema)]
#[schema(as = TwinValidation)]
pub(super) struct ValidationView {
    /// How far ahead, in seconds.
    ahead_s: f64,
    /// Half of the predictions were off by less, in metres.
    median: f64,
    /// Nine in ten were.
    p90: f64,
    /// The same by the nominal body.
    nominal_median: f64,
    /// The same.
    nominal_p90: f64,
}

/// What was found of a body, and what proves it.
#[derive(Serialize, ToSchema)]
#[schema(as = TwinCertificate)]
pub(super) struct CertificateView {
    /// Its id.
    id: String,
    /// Unix milliseconds at which it was made; 0 where that is not known.
    made: u64,
    /// Unix milliseconds from which it is to be made anew; 0 where the beginning is not known.
    expires: u64,
    /// The program that the robot ran; empty where that is not known.
    build: String,
    /// What it drove on, in words; empty where nobody said.
    floor: String,
    /// The body.
    values: Vec<ValueView>,
    /// The proof.
    validation: Vec<ValidationView>,
}

impl CertificateView {
    fn new(certificate: &Certificate) -> Self {
        let value = |value: &Value| ValueView {
            name: value.name.clone(),
            value: value.value,
            sigma: value.sigma,
            nominal: value.nominal,
        };
        let validation = certificate.validation.iter();
        Self {
            id: certificate.id().to_owned(),
            made: certificate.about.made_ms,
            expires: certificate.expires_ms,
            build: certificate.about.build.clone(),
            floor: certificate.about.floor.clone(),
            values: certificate.values.iter().map(value).collect(),
            validation: validation
                .map(|validation| ValidationView {
                    ahead_s: validation.own.horizon_s,
                    median: validation.own.median_m,
                    p90: validation.own.p90_m,
                    nominal_median: validation.nominal.median_m,
                    nominal_p90: validation.nominal.p90_m,
                })
                .collect(),
        }
    }
}

/// A file in the place of a certificate.
#[derive(Serialize, ToSchema)]
#[schema(as = TwinCertificateFile)]
pub(super) struct FileView {
    /// Its name, in the folder `twins` of the data directory.
    file: String,
    /// Why it is not used; `null` where it is.
    refused: Option<RefusalView>,
    /// What it says; `null` where it is no certificate.
    certificate: Option<CertificateView>,
}

/// What there is of certificates of a robot.
#[derive(Serialize, ToSchema)]
#[schema(as = TwinCertificates)]
pub(super) struct CertificatesView {
    /// The robot.
    robot: String,
    /// One at most, so far.
    certificates: Vec<FileView>,
}

impl CertificatesView {
    fn new(robot: &RobotId, found: Option<&Found>) -> Self {
        let file = |found: &Found| FileView {
            file: format!("{robot}.json"),
            refused: found.refusal.as_ref().map(RefusalView::new),
            certificate: found.certificate.as_deref().map(CertificateView::new),
        };
        Self {
            robot: robot.as_str().to_owned(),
            certificates: found.map(file).into_iter().collect(),
        }
    }
}

fn problem(robot: &RobotId, reason: NoTwin) -> Problem {
    Problem::new(
        Code::NoTwin,
        format!("robot `{robot}` has no twin now: {reason}"),
    )
}

/// The robot of that name, where the fleet knows it.
pub(super) fn known(fleet: &SharedFleet, id: &str) -> Result<RobotId, Problem> {
    let robot = RobotId::new(id).map_err(|_| Problem::unknown_robot(id))?;
    match fleet.lock().get(&robot) {
        Some(_) => Ok(robot),
        None => Err(Problem::unknown_robot(id)),
    }
}

/// What the twin of a robot knows
///
/// A twin is a model of the robot's body that is driven by what its motors were told, and set right by what a tracker
/// sees. A robot has one from the first fix on that a tracker publishes of it.
#[utoipa::path(get, path = "/robots/{id}/twin", tag = "robots", operation_id = "twin",
    params(("id" = String, Path, description = "Robot id")),
    responses(
        (status = 200, description = "What it knows", body = TwinView),
        (status = 404, description = "Nobody knows the robot, or it has no twin; `detail` says why")))]
pub(super) async fn state(
    State(fleet): State<Arc<SharedFleet>>,
    State(twins): State<Arc<Twins>>,
    Path(id): Path<String>,
) -> Result<Json<TwinView>, Problem> {
    let robot = known(&fleet, &id)?;
    let state = twins.state(&robot, Instant::now(), clock::unix_ms());
    let state = state.map_err(|reason| problem(&robot, reason))?;
    Ok(Json(TwinView::new(&robot, &state)))
}

/// Where a robot will be
///
/// 1 s and 10 s ahead, if its motors go on as they do, with how sure that is; and how far off such forecasts were of
/// late, given what the robot then did.
#[utoipa::path(get, path = "/robots/{id}/twin/forecast", tag = "robots", operation_id = "twin_forecast",
    params(("id" = String, Path, description = "Robot id")),
    responses(
        (status = 200, description = "The forecasts", body = ForecastsView),
        (status = 404, description = "Nobody knows the robot, or it has no twin; `detail` says why")))]
pub(super) async fn forecast(
    State(fleet): State<Arc<SharedFleet>>,
    State(twins): State<Arc<Twins>>,
    Path(id): Path<String>,
) -> Result<Json<ForecastsView>, Problem> {
    let robot = known(&fleet, &id)?;
    let ahead = twins.forecast(&robot, Instant::now(), clock::unix_ms());
    let ahead = ahead.map_err(|reason| problem(&robot, reason))?;
    Ok(Json(ForecastsView::new(&robot, &ahead)))
}

/// Certificates of a robot
///
/// What `terracrawler twin calibrate` found, as files `{id}.json` in the folder `twins` of the server's data directory, and
/// why one is not used. The server looks there every ten seconds.
#[utoipa::path(get, path = "/robots/{id}/twin/certificates", tag = "robots", operation_id = "twin_certificates",
    params(("id" = String, Path, description = "Robot id")),
    responses(
        (status = 200, description = "What there is; nothing where the robot was never calibrated", body = CertificatesView),
        (status = 404, description = "Nobody knows the robot")))]
pub(super) async fn certificates(
    State(fleet): State<Arc<SharedFleet>>,
    State(twins): State<Arc<Twins>>,
    Path(id): Path<String>,
) -> Result<Json<CertificatesView>, Problem> {
    let robot = known(&fleet, &id)?;
    let found = twins.certificate(&robot, clock::unix_ms());
    Ok(Json(CertificatesView::new(&robot, found.as_ref())))
}
