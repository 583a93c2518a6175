//! Releases: taken in, with their gates, shown, withdrawn.

mod arrival;
pub(super) mod gate;
pub(super) mod view;

use std::sync::Arc;

use axum::Json;
use axum::extract::{FromRef, Path, Request, State};
use axum::http::StatusCode;
use crawler_protocol::ReleaseId;
use crawler_records::{
    KeptRelease, MAX_RELEASE_BYTES, MAX_RELEASE_REASON, MAX_RELEASES, NewRelease, Records,
    RecordsError, Withdrawal,
};
use crawler_release::PublicKey;
use crawler_rollouts::Rollouts;
use serde::Deserialize;
use serde_json::json;
use utoipa::{IntoParams, ToSchema};

use super::access::Caller;
use super::audit::Audit;
use super::guard::JsonBody;
use super::problem::{Code, FieldError, Problem};
use super::query::{self, ApiQuery, bad_query};
use super::state::{ApiState, Uploads};
use crawler_fleet::{Level, SharedFleet};
use crawler_system::clock::now_ms;
use crawler_updates::release::FILE_MAX;
use view::{ReleaseDetail, ReleaseList, ReleaseView};

/// Where releases are, and where new ones go.
pub(super) const ALL: &str = "/api/v1/releases";
/// Releases of a page, and most of them.
const PAGE: u32 = 50;
const LARGEST_PAGE: u32 = 200;

/// Which page of releases.
#[derive(Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct ListQuery {
    /// Only releases behind this one in the list
    #[param(pattern = "^[0-9a-f]{16}$")]
    before: Option<String>,
    /// How many at most, 1 to 200; 50 where it is left out
    #[param(minimum = 1, maximum = 200)]
    limit: Option<u32>,
}

/// Why a release is withdrawn.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = WithdrawRequest)]
pub(super) struct WithdrawBody {
    /// For people, 1 to 512 bytes of UTF-8: 128 characters always fit.
    #[schema(min_length = 1, max_length = 128)]
    reason: String,
}

fn unknown() -> Problem {
    Problem::new(Code::UnknownRelease, "there is no release of that id")
}

fn failed(error: &RecordsError) -> Problem {
    match error {
        RecordsError::NotFound => unknown(),
        RecordsError::Exists => Problem::new(
            Code::Exists,
            "this release is here already, or was, and has been withdrawn",
        ),
        RecordsError::TooMany("releases") => Problem::new(
            Code::TooMany,
            format!("there are {MAX_RELEASES} releases: withdraw some first"),
        ),
        RecordsError::TooMany(_) => Problem::new(
            Code::TooMany,
            format!(
                "the images of all releases have {} MiB at most: withdraw some first",
                MAX_RELEASE_BYTES / (1024 * 1024)
            ),
        ),
        error => Problem::records(error),
    }
}

/// An id as it is in an address.
fn read_id(text: &str) -> Result<String, Problem> {
    text.parse::<ReleaseId>()
        .map(|id| id.to_string())
        .map_err(|_| unknown())
}

/// Keeps releases, tells those who watch, and writes down who did what.
#[derive(Clone)]
pub(super) struct ReleaseKeeper {
    records: Records,
    fleet: Arc<SharedFleet>,
    audit: Audit,
    keys: Arc<[PublicKey]>,
    uploads: Uploads,
}

impl FromRef<ApiState> for ReleaseKeeper {
    fn from_ref(state: &ApiState) -> Self {
        Self {
            records: FromRef::from_ref(state),
            fleet: FromRef::from_ref(state),
            audit: FromRef::from_ref(state),
            keys: FromRef::from_ref(state),
            uploads: FromRef::from_ref(state),
        }
    }
}

impl ReleaseKeeper {
    async fn find(&self, id: &str) -> Result<KeptRelease, Problem> {
        let found = self.records.releases().get(id).await;
        found.map_err(|error| failed(&error))?.ok_or_else(unknown)
    }

    fn tell(&self, level: Level, text: String) {
        self.fleet.lock().events.push(level, None, text);
    }

    /// Refuses where there is no key to believe anything by.
    fn believes(&self) -> Result<(), Problem> {
        if self.keys.is_empty() {
            return Err(Problem::new(
                Code::NoReleaseKeys,
                "this server knows no public key, and so believes no release: name some with --release-key",
            ));
        }
        Ok(())
    }

    /// Takes in the file that a request brings.
    async fn take(&self, caller: &Caller, request: Request) -> Result<NewRelease, Problem> {
        self.believes()?;
        // As much of it is in memory as there are places.
        let _place = self.uploads.0.try_acquire().map_err(|_| {
            let wait = std::time::Duration::from_secs(2);
            Problem::later(Code::Busy, "other releases are arriving", wait)
        })?;
        let file = arrival::receive(request, FILE_MAX).await?;
        let keys = Arc::clone(&self.keys);
        let (by, now) = (caller.name(), now_ms());
        // Hashing megabytes takes its time.
        tokio::task::spawn_blocking(move || arrival::read(&file, &keys, &by, now))
            .await
            .map_err(|_| Problem::internal("a release could not be looked at"))?
    }
}

/// For people: which one it is.
fn called(release: &KeptRelease) -> String {
    let name = release.name.as_ref();
    let kind = release
        .what()
        .map_or(release.kind.as_str(), |kind| kind.name());
    let what = name.map_or_else(|| kind.to_owned(), |name| format!("{kind} {name}"));
    format!(
        "release {} ({what} {} for {})",
        release.id, release.version, release.board
    )
}

/// Releases, those that were added last first
#[utoipa::path(get, path = "/releases", tag = "updates",
    params(ListQuery),
    responses(
        (status = 200, description = "A page of them", body = ReleaseList),
        (status = 400, description = "The query is not valid"),
        (status = 503, description = "The records cannot be read")))]
pub(super) async fn list(
    State(keeper): State<ReleaseKeeper>,
    ApiQuery(asked): ApiQuery<ListQuery>,
) -> Result<Json<ReleaseList>, Problem> {
    let limit = query::page(asked.limit.unwrap_or(PAGE), LARGEST_PAGE)?;
    let before = asked.before.as_deref().map(read_id).transpose();
    let before = before.map_err(|_| bad_query("before", "must be the id of a release"))?;
    let rows = keeper
        .records
        .releases()
        .page(before.as_deref(), limit + 1)
        .await;
    let mut rows = rows.map_err(|error| failed(&error))?;
    let more = rows.len() > limit as usize;
    rows.truncate(limit as usize);
    let next = rows.last().filter(|_| more).map(|row| row.id.clone());
    Ok(Json(ReleaseList {
        releases: rows.into_iter().map(ReleaseView::new).collect(),
        next,
        can_add: !keeper.keys.is_empty(),
    }))
}

/// Adds a release
///
/// The body is the file that `terracrawler release sign` makes. It is kept when one of the keys of this server has
/// signed it, its image is the one that was signed, it is for the chip of its board, and it has not expired;
/// otherwise `faults` names every reason against it, with the codes of `terracrawler release verify`. One whose
/// sequence is not above that of others for its board is kept all the same: robots decide by their own.
#[utoipa::path(post, path = "/releases", tag = "updates",
    request_body(content = Vec<u8>, content_type = "application/octet-stream"),
    responses(
        (status = 201, description = "It is kept", body = ReleaseDetail),
        (status = 409, description = "It is here already, there is no room for it, or the server has no key \
                                      to verify it by"),
        (status = 413, description = "No release is that large"),
        (status = 415, description = "The body is not `application/octet-stream`"),
        (status = 422, description = "No release, or not a genuine one; `faults` says why"),
        (status = 503, description = "Others are arriving, or the records cannot be written")))]
pub(super) async fn add(
    State(keeper): State<ReleaseKeeper>,
    caller: Caller,
    request: Request,
) -> Result<(StatusCode, Json<ReleaseDetail>), Problem> {
    let taken = keeper.take(&caller, request).await;
    let (id, told) = taken.as_ref().map_or_else(
        |_| Default::default(),
        |new| (new.id.clone(), new.for_audit()),
    );
    let result = match taken {
        Ok(new) => keep(&keeper, new).await,
        Err(problem) => Err(problem),
    };
    let detail = match &result {
        Ok(_) => told,
        Err(problem) => json!({ "why": problem.detail() }),
    };
    let audit = &keeper.audit;
    audit
        .write(&caller, "release.add", &id, detail, &result)
        .await;
    let release = result?;
    keeper.tell(
        Level::Info,
        format!("{} was added by {}", called(&release), release.by),
    );
    Ok((StatusCode::CREATED, Json(ReleaseDetail::new(release)?)))
}

/// Puts a release into the records, and returns what is kept of it.
async fn keep(keeper: &ReleaseKeeper, new: NewRelease) -> Result<KeptRelease, Problem> {
    let id = new.id.clone();
    let added = keeper.records.releases().add(new).await;
    added.map_err(|error| failed(&error))?;
    keeper.find(&id).await
}

/// One release, with what its manifest says
#[utoipa::path(get, path = "/releases/{id}", tag = "updates",
    params(("id" = String, Path, description = "Id of the release")),
    responses(
        (status = 200, description = "The release", body = ReleaseDetail),
        (status = 404, description = "There is none of that id"),
        (status = 503, description = "The records cannot be read")))]
pub(super) async fn one(
    State(keeper): State<ReleaseKeeper>,
    Path(id): Path<String>,
) -> Result<Json<ReleaseDetail>, Problem> {
    let release = keeper.find(&read_id(&id)?).await?;
    Ok(Json(ReleaseDetail::new(release)?))
}

/// Withdraws a release, for good
///
/// No rollout can be started with it any more, and those that run with it are paused: robots that have not started
/// it give it up. Its image is deleted; what its manifest says stays. It cannot be added again: sign the image again
/// under a higher sequence.
#[utoipa::path(post, path = "/releases/{id}/withdraw", tag = "updates",
    params(("id" = String, Path, description = "Id of the release")),
    request_body = WithdrawBody,
    responses(
        (status = 200, description = "It is withdrawn", body = ReleaseDetail),
        (status = 400, description = "Not JSON"),
        (status = 404, description = "There is none of that id"),
        (status = 409, description = "It was withdrawn before"),
        (status = 422, description = "Not a reason"),
        (status = 503, description = "The records cannot be written")))]
pub(super) async fn withdraw(
    State(keeper): State<ReleaseKeeper>,
    State(rollouts): State<Arc<Rollouts>>,
    caller: Caller,
    Path(id): Path<String>,
    body: JsonBody,
) -> Result<Json<ReleaseDetail>, Problem> {
    let WithdrawBody { reason } = body.read()?;
    let why = reason.trim();
    if why.is_empty() || why.len() > MAX_RELEASE_REASON {
        let error = FieldError::at(
            "/reason",
            format!("must have 1 to {MAX_RELEASE_REASON} bytes"),
        );
        return Err(Problem::invalid(Code::InvalidBody, vec![error]));
    }
    let id = read_id(&id)?;
    let withdrawal = Withdrawal {
        by: caller.name(),
        at: now_ms(),
        why: why.to_owned(),
    };
    // Whoever carries these out may be faster with the pause than we are. Where they cannot be read, only the lines
    // about those are missing.
    let running = rollouts.running_with(&id).await.unwrap_or_default();
    let done = keeper.records.releases().withdraw(&id, withdrawal).await;
    let done = done.map_err(|error| match error {
        RecordsError::Exists => Problem::new(Code::WrongState, "the release was withdrawn before"),
        error => failed(&error),
    });
    let detail = json!({ "reason": why });
    let audit = &keeper.audit;
    audit
        .write(&caller, "release.withdraw", &id, detail, &done)
        .await;
    let release = done?;
    let text = format!(
        "{} was withdrawn by {}: {why}",
        called(&release),
        caller.name()
    );
    keeper.tell(Level::Warn, text);
    let (paused, all) = rollouts.pause_all_of(&id, running).await;
    for paused in paused {
        let detail = json!({ "because": "release.withdraw", "release": id });
        let done: Result<(), Problem> = Ok(());
        let paused = paused.to_string();
        audit
            .write(&caller, "rollout.pause", &paused, detail, &done)
            .await;
    }
    all?;
    Ok(Json(ReleaseDetail::new(release)?))
}
