//! The conformance suite: MQTT in, MQTT out, whatever robot is behind it.
//!
//! [`CASES`] is the list of what a robot must do. [`run`] goes through it, one case after the
//! other, and leaves the robot as it was found: standing, without an emergency stop, with the
//! parameters it had. The robot's own words are read by the strict readers of
//! [`crawler_protocol`] all along.
//!
//! Times are bounded and generous: a robot under an emulator or behind a busy access point may
//! answer late, but it must answer.

mod bench;
mod case;
mod cases;
mod clock;
mod connection;
mod hearing;
mod report;

use std::fmt;
use std::time::{Duration, Instant};

use crawler_protocol::{Action, Fleet, RobotId, RobotState};

use crate::BrokerUrl;

pub use bench::{ANSWER, Bench, REST, is_standing};
pub use case::{CASES, Case};
pub use hearing::{Message, Word};
pub use report::{CaseReport, Outcome, Report};

/// For the first signs of a robot.
const SIGNS: Duration = Duration::from_secs(5);

/// Which robot to put on the bench.
#[derive(Debug, Clone)]
pub struct Target {
    /// Where its broker is.
    pub broker: BrokerUrl,
    /// Its fleet.
    pub fleet: Fleet,
    /// Its id.
    pub robot: RobotId,
}

/// What to run.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// Skip the cases that set wheels in motion.
    pub no_motion: bool,
    /// Run these cases alone; all when empty.
    pub only: Vec<String>,
}

/// Why the suite cannot start, or go on.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum BenchError {
    /// Nothing answers at the broker's address: address, and what happened.
    Unreachable(String, String),
    /// The broker does not want us: address, and what it says.
    Refused(String, String),
    /// The broker knows no such robot: id, and the robots it knows.
    Unknown(String, Vec<String>),
    /// The robot is not connected.
    Offline(String),
    /// The robot counts as connected and says nothing.
    Silent(String),
    /// The robot is in `ERROR`.
    InError(String),
    /// The robot cannot be brought to rest: id, and why.
    Restless(String, String),
    /// There is no such case.
    NoCase(String),
    /// A controller cannot be named so.
    Source(String),
    /// The session with the broker ended before the first case.
    Lost(String),
}

impl fmt::Display for BenchError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unreachable(broker, text) => {
                write!(f, "the broker {broker} cannot be reached: {text}")
            }
            Self::Refused(broker, text) => write!(f, "the broker {broker}: {text}"),
            Self::Unknown(robot, known) if known.is_empty() => {
                write!(f, "no robot '{robot}': the broker knows none of this fleet")
            }
            Self::Unknown(robot, known) => {
                write!(f, "no robot '{robot}'; the fleet has {}", known.join(", "))
            }
            Self::Offline(robot) => write!(f, "the robot '{robot}' is offline"),
            Self::Silent(robot) => write!(
                f,
                "the robot '{robot}' counts as online but sends no telemetry"
            ),
            Self::InError(robot) => write!(
                f,
                "the robot '{robot}' is in ERROR: see to its fault, or send `reset` after an emergency stop"
            ),
            Self::Restless(robot, text) => {
                write!(f, "the robot '{robot}' cannot be brought to rest: {text}")
            }
            Self::NoCase(name) => write!(f, "there is no case '{name}': --list names them"),
            Self::Source(name) => write!(f, "'{name}' cannot name a controller"),
            Self::Lost(text) => write!(f, "the broker ended the session: {text}"),
        }
    }
}

impl std::error::Error for BenchError {}

/// Why a case did not pass.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Failure {
    /// The robot did something else.
    Failed(String),
    /// The case cannot be run here.
    Skipped(String),
    /// The session with the broker is over: nothing more can be said.
    Lost(String),
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Failed(text) | Self::Skipped(text) => f.write_str(text),
            Self::Lost(text) => write!(f, "the session with the broker is over: {text}"),
        }
    }
}

impl std::error::Error for Failure {}

impl From<Failure> for BenchError {
    fn from(failure: Failure) -> Self {
        match failure {
            Failure::Failed(text) | Failure::Skipped(text) | Failure::Lost(text) => {
                Self::Lost(text)
            }
        }
    }
}

/// Runs the suite. `tell` hears of every case as it ends.
///
/// # Errors
/// [`BenchError`] when there is nothing to run it on. What the robot does wrong is in the report.
///
/// # Cancellation Safety
/// Dropping it leaves the robot to its failsafes and its parameters as the running case has them.
pub async fn run(
    target: &Target,
    options: &Options,
    mut tell: impl FnMut(&CaseReport),
) -> Result<Report, BenchError> {
    for name in &options.only {
        if !CASES.iter().any(|case| case.name == name) {
            return Err(BenchError::NoCase(name.clone()));
        }
    }
    let mut bench = Bench::open(target.clone()).await?;
    bench.meet().await?;
    let found = bench.parameters().cloned();
    let mut report = Report::new(target, bench.status());
    let mut lost = None;
    for case in CASES {
        if !options.only.is_empty() && !options.only.iter().any(|name| name == case.name) {
            continue;
        }
        let began = Instant::now();
        let outcome = if let Some(text) = &lost {
            Outcome::Failed(format!("not run: {text}"))
        } else if case.motion && options.no_motion {
            Outcome::Skipped("no motion wanted".into())
        } else {
            let result = bench.run(case, found.as_ref()).await;
            if let Err(Failure::Lost(_)) = &result {
                lost = result.as_ref().err().map(ToString::to_string);
            }
            match result {
                Ok(()) => Outcome::Passed,
                Err(Failure::Skipped(text)) => Outcome::Skipped(text),
                Err(failure) => Outcome::Failed(failure.to_string()),
            }
        };
        let line = CaseReport {
            name: case.name,
            shows: case.shows,
            outcome,
            seconds: began.elapsed().as_secs_f64(),
        };
        tell(&line);
        report.cases.push(line);
    }
    report.unknown = bench.book.unknown;
    bench.close().await;
    Ok(report)
}

impl Bench {
    /// Makes sure that the robot is there and ready, and brings it to rest.
    ///
    /// # Errors
    /// [`BenchError`] says in one line what is wrong with it.
    pub async fn meet(&mut self) -> Result<(), BenchError> {
        let id = self.target.robot.to_string();
        let until = tokio::time::Instant::now() + SIGNS;
        while self.book.status.as_ref().is_none_or(|s| !s.online) {
            if self.next(until).await?.is_none() {
                return Err(match self.book.status {
                    Some(_) => BenchError::Offline(id),
                    None => BenchError::Unknown(id, self.book.fleet.keys().cloned().collect()),
                });
            }
        }
        // Parameters are retained, so they come with the status; telemetry may be as slow as one
        // message in ten seconds.
        let patience = SIGNS + self.telemetry_period();
        let telemetry = match self.telemetry(patience).await {
            Ok(telemetry) => telemetry,
            Err(Failure::Failed(_) | Failure::Skipped(_)) => return Err(BenchError::Silent(id)),
            Err(lost) => return Err(lost.into()),
        };
        if telemetry.state == RobotState::Error {
            return Err(BenchError::InError(id));
        }
        match self.calm().await {
            Ok(()) => Ok(()),
            Err(Failure::Failed(text) | Failure::Skipped(text)) => {
                Err(BenchError::Restless(id, text))
            }
            Err(lost) => Err(lost.into()),
        }
    }

    /// Brings the robot to rest, and releases an emergency stop of ours.
    async fn calm(&mut self) -> Result<(), Failure> {
        let telemetry = self.telemetry(ANSWER).await?;
        if telemetry.state == RobotState::Error {
            self.ask(Action::Reset).await?;
        }
        if telemetry.state == RobotState::Idle && is_standing(&telemetry) {
            let rests = |t: &crawler_protocol::open::Telemetry| {
                t.state == RobotState::Idle && is_standing(t)
            };
            if self.stays("it stood", 1, rests).await.is_ok() {
                return Ok(());
            }
        }
        self.ask(Action::Stop).await?;
        self.rests(REST).await
    }

    /// Runs one case and puts the robot right after it.
    async fn run(
        &mut self,
        case: &Case,
        found: Option<&crawler_protocol::ParametersMessage>,
    ) -> Result<(), Failure> {
        self.catch_up()?;
        let work = (case.run)(self);
        let result = match tokio::time::timeout(case.limit, work).await {
            Ok(result) => result,
            Err(_) => Err(Failure::Failed(format!(
                "it takes longer than {} s",
                case.limit.as_secs()
            ))),
        };
        if let Err(Failure::Lost(_)) = result {
            return result;
        }
        self.clock.resume(tokio::time::Instant::now());
        let put_right = async {
            self.calm().await?;
            match found {
                Some(found) => self.restore(found).await,
                None => Ok(()),
            }
        };
        match (result, put_right.await) {
            (result, Ok(())) => result,
            (Ok(()), Err(after)) => Err(match after {
                Failure::Lost(_) => after,
                Failure::Failed(text) | Failure::Skipped(text) => {
                    Failure::Failed(format!("afterwards: {text}"))
                }
            }),
            (Err(during), Err(after)) => {
                Err(Failure::Failed(format!("{during}; afterwards: {after}")))
            }
        }
    }
}
