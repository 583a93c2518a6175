//! The audit log: writing to it, and reading it.

use std::sync::Arc;
use std::time::Duration;

use axum::Json;
use axum::extract::State;
use crawler_records::Records;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use tokio_util::task::TaskTracker;
use utoipa::{IntoParams, ToSchema};

use super::access::Caller;
use super::problem::{Code, Problem};
use super::query::{self, ApiQuery, bad_query};
use crawler_cluster::ClusterMembership;
use crawler_records::audit_log::{AuditLog, Entry};

/// What came of something that cannot fail.
pub(super) const DONE: Result<(), Problem> = Ok(());
/// The call that takes long.
pub(super) const VERIFY: &str = "/api/v1/audit/verify";
/// Entries of a page, and most of them.
const PAGE: u32 = 100;
const LARGEST_PAGE: u32 = 1_000;
/// No entry has a greater number: readers of JSON have whole numbers up to 2^53 - 1.
const LARGEST_NUMBER: u64 = (1 << 53) - 1;

/// Writes down who did what, and tells the other servers that something has changed.
#[derive(Clone)]
pub(super) struct Audit {
    log: Arc<AuditLog>,
    membership: Option<Arc<ClusterMembership>>,
    tasks: TaskTracker,
}

impl Audit {
    pub(super) const fn new(
        log: Arc<AuditLog>,
        membership: Option<Arc<ClusterMembership>>,
        tasks: TaskTracker,
    ) -> Self {
        Self {
            log,
            membership,
            tasks,
        }
    }

    /// Writes down what the caller did and what came of it.
    pub(super) async fn write<T>(
        &self,
        caller: &Caller,
        action: &'static str,
        target: &str,
        detail: Value,
        result: &Result<T, Problem>,
    ) {
        self.write_as(&caller.name(), caller, action, target, detail, result)
            .await;
    }

    /// The same for whoever cannot wait for the records: it is written as soon as they take it.
    pub(super) fn note<T>(
        &self,
        caller: &Caller,
        action: &'static str,
        target: &str,
        detail: Value,
        result: &Result<T, Problem>,
    ) {
        let entry = entry(&caller.name(), caller, action, target, detail, result);
        self.log.note(entry);
    }

    /// Whether the records took what was written last.
    pub(super) fn is_written(&self) -> bool {
        self.log.is_written()
    }

    /// Whether something may be done that has to be in the log: it must not be lost on its way there.
    ///
    /// # Errors
    /// What the caller is told when it may not.
    pub(super) fn has_room(&self) -> Result<(), Problem> {
        if self.log.has_room() {
            return Ok(());
        }
        Err(Problem::later(
            Code::NotAudited,
            "the audit log cannot be written, and this has to be in it; nothing was done",
            Duration::from_secs(1),
        ))
    }

    /// The same as [`Audit::write`] for somebody whom the request did not name.
    pub(super) async fn write_as<T>(
        &self,
        who: &str,
        caller: &Caller,
        action: &'static str,
        target: &str,
        detail: Value,
        result: &Result<T, Problem>,
    ) {
        let entry = entry(who, caller, action, target, detail, result);
        self.log.write(entry).await;
        // Whoever logs in here, or is locked out, is so everywhere. What is not told is found by
        // looking, some seconds later.
        if let Some(membership) = self.membership.clone()
            && result.is_ok()
            && !action.starts_with("command.")
        {
            self.tasks.spawn(async move {
                if let Err(error) = membership.cluster.changed().await {
                    tracing::debug!(%error, "the other servers are not told of a change");
                }
            });
        }
    }
}

/// What the caller did and what came of it.
fn entry<T>(
    who: &str,
    caller: &Caller,
    action: &'static str,
    target: &str,
    detail: Value,
    result: &Result<T, Problem>,
) -> Entry {
    let outcome = match result {
        Ok(_) => "ok",
        Err(problem) => problem.code().name(),
    };
    Entry {
        who: who.to_owned(),
        from: caller.peer.ip().to_string(),
        action,
        target: target.to_owned(),
        detail,
        outcome: outcome.to_owned(),
    }
}

/// Which entries are wanted.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct AuditQuery {
    /// Only entries older than this one.
    #[param(minimum = 0, maximum = 9_007_199_254_740_991_u64)]
    before: Option<u64>,
    /// At most so many, up to 1,000; 100 when not given.
    #[param(minimum = 1, maximum = 1_000)]
    limit: Option<u32>,
    /// Only what this account did.
    who: Option<String>,
}

/// One line of the audit log.
#[derive(Serialize, ToSchema)]
#[schema(as = AuditEntry)]
pub(super) struct AuditView {
    /// Its number; they have no gaps.
    seq: u64,
    /// When, in Unix milliseconds.
    at: i64,
    /// The account; `anonymous` for nobody in particular, `server` for the server itself.
    who: String,
    /// The address it came from.
    from: String,
    /// What was done, like `command.send`.
    action: String,
    /// To what.
    target: String,
    /// How.
    #[schema(value_type = serde_json::Value)]
    detail: Value,
    /// `ok`, or the code of what was in the way.
    outcome: String,
    /// Fingerprint of this line and all before it: SHA-256, hexadecimal.
    hash: String,
}

/// A page of the audit log.
#[derive(Serialize, ToSchema)]
#[schema(as = AuditPage)]
pub(super) struct AuditList {
    /// Newest first.
    entries: Vec<AuditView>,
    /// `before` of the next page; `null` where there is none.
    next: Option<u64>,
}

/// Who did what, newest first
#[utoipa::path(get, path = "/audit", tag = "accounts",
    params(AuditQuery),
    responses(
        (status = 200, description = "A page of the log", body = AuditList),
        (status = 400, description = "The query is not valid")))]
pub(super) async fn page(
    State(records): State<Records>,
    ApiQuery(wanted): ApiQuery<AuditQuery>,
) -> Result<Json<AuditList>, Problem> {
    if wanted.before.is_some_and(|before| before > LARGEST_NUMBER) {
        return Err(bad_query(
            "before",
            format!("must be 0 to {LARGEST_NUMBER}"),
        ));
    }
    let limit = query::page(wanted.limit.unwrap_or(PAGE), LARGEST_PAGE)?;
    let stored = records
        .audit()
        .page(wanted.before, limit, wanted.who.as_deref())
        .await
        .map_err(|error| Problem::records(&error))?;
    let entries: Vec<AuditView> = stored
        .into_iter()
        .map(|stored| AuditView {
            seq: stored.seq,
            at: stored.entry.at,
            who: stored.entry.who,
            from: stored.entry.from,
            action: stored.entry.action,
            target: stored.entry.target,
            detail: stored.entry.detail,
            outcome: stored.entry.outcome,
            hash: stored.hash,
        })
        .collect();
    let full = entries.len() == limit as usize;
    let next = entries
        .last()
        .map(|entry| entry.seq)
        .filter(|seq| full && *seq > 1);
    Ok(Json(AuditList { entries, next }))
}

/// Whether the audit log is whole.
#[derive(Serialize, ToSchema)]
#[schema(as = AuditVerdict)]
pub(super) struct Verdict {
    /// How many lines are good.
    entries: u64,
    /// Whether all of them are.
    intact: bool,
    /// The first line that is not.
    broken_at: Option<u64>,
    /// How many lines could not be written when they came, by what the log says in their place.
    lost: u64,
}

/// Whether the audit log is whole
///
/// Computes the chain of fingerprints anew, from the first line.
#[utoipa::path(get, path = "/audit/verify", tag = "accounts",
    responses((status = 200, description = "The verdict", body = Verdict)))]
pub(super) async fn verify(State(records): State<Records>) -> Result<Json<Verdict>, Problem> {
    let lost = records.audit().lost().await;
    let lost = lost.map_err(|error| Problem::records(&error))?;
    Ok(Json(match records.audit().verify().await {
        Ok(entries) => Verdict {
            entries,
            intact: true,
            broken_at: None,
            lost,
        },
        Err(broken) => {
            tracing::error!(%broken, "the audit log is not whole");
            Verdict {
                entries: broken.seq.saturating_sub(1),
                intact: false,
                broken_at: Some(broken.seq),
                lost,
            }
        }
    }))
}
