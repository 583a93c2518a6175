//! A process that works on experiments of servers whose database it shares, and does nothing else.

use std::sync::Arc;

use crawler_experiments::{self as experiments, Worker};
use crawler_records::{Records, RecordsError};

use super::StartError;
use super::parts::Parts;
use crate::config::Settings;

/// A running worker.
pub struct WorkerProcess {
    name: String,
    threads: usize,
    parts: Parts,
}

impl WorkerProcess {
    /// Starts to work on experiments in the database of `settings`.
    ///
    /// # Errors
    /// [`StartError`] when the database cannot be used, or holds no records of a server.
    pub async fn start(settings: &Settings) -> Result<Self, StartError> {
        let url = settings.database.as_ref();
        let url = url.ok_or(StartError::Internal("a worker without a database"))?;
        let records = match Records::connect(url.reveal(), None, false).await {
            Err(RecordsError::NotFound) => return Err(StartError::NoRecords(url.to_string())),
            records => records?,
        };
        let mut parts = Parts::default();
        match Self::start_parts(settings, records, &mut parts) {
            Ok((name, threads)) => Ok(Self {
                name,
                threads,
                parts,
            }),
            Err(error) => {
                parts.stop().await;
                Err(error)
            }
        }
    }

    fn start_parts(
        settings: &Settings,
        records: Records,
        parts: &mut Parts,
    ) -> Result<(String, usize), StartError> {
        let closing = records.clone();
        parts.end_with(async move { closing.close().await })?;
        let mark = experiments::mark().ok_or(StartError::Internal("no randomness"))?;
        let name = settings.worker_name();
        // Nobody watches or steers here: the whole machine is for experiments.
        let threads = settings.experiment_threads.map_or_else(
            || std::thread::available_parallelism().map_or(1, usize::from),
            |threads| usize::from(threads.get()),
        );
        let worker = Arc::new(Worker::new(records, &name, &mark, threads));
        let own = Arc::clone(&worker);
        parts.task("the experiments", |stop| experiments::work(own, stop))?;
        worker.begin().map_err(StartError::Experiments)?;
        parts.end_with(async move { worker.end().await })?;
        Ok((name, threads))
    }

    /// How people know it.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// How many trials it runs at a time.
    #[must_use]
    pub const fn threads(&self) -> usize {
        self.threads
    }

    /// Gives up the trials under way, stores what is done, and gives back what it has claimed.
    pub async fn stop(self) {
        self.parts.stop().await;
    }
}
