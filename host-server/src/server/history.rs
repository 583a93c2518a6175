//! Where the records and the history are, as the settings say.

use std::sync::Arc;

use crawler_history::HistoryStore;
use crawler_records::{RECORDS_FILE, Records, RecordsError};
use crawler_timeseries::{Address, QUEUE, Remote};

use super::StartError;
use crate::config::Settings;

/// The records, and where the history is. An engine need not be there yet.
pub(super) async fn open(settings: &Settings) -> Result<(Records, HistoryStore), StartError> {
    let Some(engine) = &settings.timeseries else {
        let records = open_records(settings).await?;
        let history = HistoryStore::Local(records.history().clone());
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
        Ok(records) => Ok((records, HistoryStore::Engine(Arc::new(remote)))),
        Err(error) => {
            remote.close().await;
            Err(error.into())
        }
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
