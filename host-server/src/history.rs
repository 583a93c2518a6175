//! The history of telemetry, wherever it is: in the data directory, or in an engine outside.

use std::collections::BTreeSet;

use crawler_history::{Full, History as Local, Point, Recorded, Sample, Track};
use crawler_protocol::open::Telemetry;
use crawler_protocol::{RobotId, RobotState};
use crawler_records::{RECORDS_FILE, Records, RecordsError};
use crawler_timeseries::{Address, EngineError, QUEUE, Remote};

use crate::config::Settings;
use crate::server::StartError;
use crawler_metrics::Exposition;

/// The history of the fleet. A clone is another handle of the same.
#[derive(Debug, Clone)]
pub(crate) enum History {
    /// In a file of the data directory; it goes with the records.
    Local(Local),
    /// In an engine.
    Remote(Remote),
}

/// Why a question about history has no answer.
#[derive(Debug)]
pub(crate) enum HistoryError {
    /// The records failed.
    Local(RecordsError),
    /// The engine failed.
    Remote(EngineError),
}

/// The records, and where the history is. An engine need not be there yet.
pub(crate) async fn open(settings: &Settings) -> Result<(Records, History), StartError> {
    let Some(engine) = &settings.timeseries else {
        let records = open_records(settings).await?;
        let history = History::Local(records.history().clone());
        return Ok((records, history));
    };
    let wrong = |why: &dyn std::fmt::Display| StartError::Timeseries {
        engine: engine.to_string(),
        reason: why.to_string(),
    };
    // First: what is wrong with an address must not cost opening the records.
    let address: Address = engine.reveal().parse().map_err(|error| wrong(&error))?;
    let remote = Remote::start(address, settings.fleet.as_str(), QUEUE);
    let remote = remote.map_err(|error| wrong(&error))?;
    match open_records(settings).await {
        Ok(records) => Ok((records, History::Remote(remote))),
        Err(error) => {
            remote.close().await;
            Err(error.into())
        }
    }
}

/// What the history keeps of a message that came in at `at`. The server's clock counts: a robot's may
/// not be set, or be made up. A state that only a newer robot knows is an error to the history, as one that
/// a newer program has stored is.
pub(crate) fn sample(telemetry: &Telemetry, at: i64) -> Sample {
    Sample {
        robot: telemetry.robot.clone(),
        at,
        x: telemetry.pose.x,
        y: telemetry.pose.y,
        theta: telemetry.pose.theta,
        range_mm: telemetry.range_mm,
        battery_mv: telemetry.battery.mv,
        battery_percent: telemetry.battery.percent,
        rssi: telemetry.rssi_dbm,
        left: telemetry.wheels.left,
        right: telemetry.wheels.right,
        state: telemetry.state.known().unwrap_or(RobotState::Error),
    }
}

/// Opens the records where `settings` have them: in a database, or in the data directory. The history
/// is in the directory, unless an engine outside keeps it.
async fn open_records(settings: &Settings) -> Result<Records, RecordsError> {
    let elsewhere = settings.timeseries.is_some();
    let Some(url) = &settings.database else {
        return if elsewhere {
            Records::open_without_history(&settings.data).await
        } else {
            Records::open(&settings.data).await
        };
    };
    let file = settings.data.join(RECORDS_FILE);
    if file.exists() {
        tracing::warn!(file = %file.display(), database = %url,
            "the records in the data directory are not used: those of the database are");
    }
    let history = (!elsewhere).then_some(settings.data.as_path());
    Records::connect(url.reveal(), history, true).await
}

impl History {
    /// Takes a sample, without waiting.
    ///
    /// # Errors
    /// [`Full`] when it cannot be taken; it is counted as dropped.
    pub(crate) fn push(&self, sample: Sample) -> Result<(), Full> {
        match self {
            Self::Local(local) => local.push(sample),
            Self::Remote(remote) => remote.push(sample),
        }
    }

    /// What `robot` measured from `from` until before `to`, in stretches of `step` milliseconds.
    ///
    /// # Errors
    /// [`HistoryError`] of where the history is.
    pub(crate) async fn query(
        &self,
        robot: &RobotId,
        from: i64,
        to: i64,
        step: i64,
    ) -> Result<Vec<Point>, HistoryError> {
        match self {
            Self::Local(local) => local
                .query(robot, from, to, step)
                .await
                .map_err(HistoryError::Local),
            Self::Remote(remote) => remote
                .query(robot, from, to, step)
                .await
                .map_err(HistoryError::Remote),
        }
    }

    /// From when to when something is recorded.
    ///
    /// # Errors
    /// [`HistoryError`] of where the history is.
    pub(crate) async fn recorded(&self) -> Result<Option<Recorded>, HistoryError> {
        match self {
            Self::Local(local) => local.recorded().await.map_err(HistoryError::Local),
            Self::Remote(remote) => remote.recorded().await.map_err(HistoryError::Remote),
        }
    }

    /// The robots that something was ever recorded of, in order.
    ///
    /// # Errors
    /// [`HistoryError`] of where the history is.
    pub(crate) async fn robots(&self) -> Result<BTreeSet<RobotId>, HistoryError> {
        match self {
            Self::Local(local) => local.robots().await.map_err(HistoryError::Local),
            Self::Remote(remote) => remote.robots().await.map_err(HistoryError::Remote),
        }
    }

    /// Where `robots` were from `from` until before `to`, every `step` milliseconds.
    ///
    /// # Errors
    /// [`HistoryError`] of where the history is.
    pub(crate) async fn frames(
        &self,
        robots: &BTreeSet<RobotId>,
        from: i64,
        to: i64,
        step: i64,
    ) -> Result<Vec<Track>, HistoryError> {
        match self {
            Self::Local(local) => local
                .frames(robots, from, to, step)
                .await
                .map_err(HistoryError::Local),
            Self::Remote(remote) => remote
                .frames(robots, from, to, step)
                .await
                .map_err(HistoryError::Remote),
        }
    }

    /// Whether the engine takes samples; `None` where there is none.
    pub(crate) fn engine_up(&self) -> Option<bool> {
        match self {
            Self::Local(_) => None,
            Self::Remote(remote) => Some(remote.stats().up),
        }
    }

    /// How it is doing, in this process or outside.
    pub(crate) fn write_metrics(&self, out: &mut Exposition) {
        let (counters, queued) = match self {
            Self::Local(local) => {
                let stats = local.stats();
                out.flag(
                    "terracrawler_history_kept",
                    "1 while this process writes the history",
                    stats.keeper,
                );
                let damaged = ("damaged", "Blocks that could not be read", stats.damaged);
                let taken = [stats.accepted, stats.written, stats.dropped, stats.failures];
                ((taken, damaged), stats.queued)
            }
            Self::Remote(remote) => {
                let stats = remote.stats();
                out.flag(
                    "terracrawler_history_engine_up",
                    "1 while the engine outside takes samples",
                    stats.up,
                );
                let refused = ("refused", "Samples that the engine refused", stats.refused);
                let taken = [stats.accepted, stats.written, stats.dropped, stats.failures];
                ((taken, refused), stats.queued)
            }
        };
        let ([accepted, written, dropped, failures], own) = counters;
        for (name, help, value) in [
            (
                "accepted",
                "Telemetry samples taken for the history",
                accepted,
            ),
            (
                "written",
                "Samples that are on disk, or with the engine outside",
                written,
            ),
            (
                "dropped",
                "Samples let go because too many were waiting",
                dropped,
            ),
            (
                "failures",
                "Writes that failed and were tried again",
                failures,
            ),
            own,
        ] {
            out.counter(&format!("terracrawler_history_{name}"), help, value as f64);
        }
        out.gauge(
            "terracrawler_history_queued",
            "Samples waiting to be written",
            queued as f64,
        );
    }

    /// Finishes what waits for an engine. A local history ends with the records.
    pub(crate) async fn close(&self) {
        if let Self::Remote(remote) = self {
            remote.close().await;
        }
    }
}
