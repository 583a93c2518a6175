//! What a server keeps, and who may see it.

use std::sync::Arc;

use crawler_experiments as experiments;
use crawler_records::Records;

use super::parts::Parts;
use super::{StartError, history};
use crate::config::Settings;
use crawler_accounts::Accounts;
use crawler_commands::{Journal, Sequence};
use crawler_fleet::{FenceAction, FenceKind};
use crawler_history::HistoryStore;
use crawler_metrics::Metrics;
use crawler_records::audit_log::AuditLog;
use crawler_system::clock;
use crawler_system::data::{DataDir, Disk};

/// What this server alone keeps in its data directory.
pub(super) struct OwnFiles {
    pub(super) data: Arc<DataDir>,
    pub(super) journal: Journal,
    pub(super) sequence: Sequence,
    /// How it is called in records that it shares with others.
    pub(super) owner: String,
}

impl OwnFiles {
    pub(super) fn open(settings: &Settings, disk: Disk) -> Result<Self, StartError> {
        let data = Arc::new(DataDir::open_on(&settings.data, disk)?);
        let journal = Journal::of(&data)?;
        let owner = experiments::owner(&data)?;
        let sequence = Sequence::open(&data, clock::unix_ms())?;
        Ok(Self {
            data,
            journal,
            sequence,
            owner,
        })
    }
}

/// What is kept and counted, and who may see it.
pub(super) struct Storage {
    pub(super) records: Records,
    pub(super) history: HistoryStore,
    pub(super) metrics: Arc<Metrics>,
    pub(super) audit: Arc<AuditLog>,
    pub(super) accounts: Arc<Accounts>,
}

impl Storage {
    pub(super) async fn open(settings: &Settings, parts: &mut Parts) -> Result<Self, StartError> {
        let (records, history) = history::open(settings).await?;
        let closing = (records.clone(), history.clone());
        parts.end_with(async move {
            let (records, history) = closing;
            history.close().await;
            records.close().await;
        })?;
        let metrics = Arc::new(Metrics::new());
        metrics.expect_fence_crossings(
            &FenceKind::ALL.map(FenceKind::name),
            &FenceAction::ALL.map(FenceAction::name),
        );
        let (audit, writer) = AuditLog::new(records.clone(), Arc::clone(&metrics));
        parts.task("the audit log", |stop| writer.run(stop))?;
        let accounts = Accounts::open(records.clone(), settings.open).await?;
        Ok(Self {
            records,
            history,
            metrics,
            audit: Arc::new(audit),
            accounts: Arc::new(accounts),
        })
    }
}
