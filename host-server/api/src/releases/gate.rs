//! What a release was tried on: reports that are attached, and shown.

use axum::Json;
use axum::extract::{Path, Request, State};
use crawler_records::KeptRelease;
use crawler_updates::gate::{GATE_MAX, GateFault, GateReport, check, signer, unverified};
use crawler_updates::release::Fault;
use serde::Serialize;
use serde_json::json;
use utoipa::ToSchema;

use super::{ReleaseDetail, ReleaseKeeper, arrival, called, failed, read_id};
use crate::access::Caller;
use crate::problem::{Code, Problem};
use crawler_fleet::Level;

/// What a release was tried on.
#[derive(Serialize, ToSchema)]
#[schema(as = Gate)]
pub(crate) struct GateView {
    /// Id of the key that has signed the report.
    key: String,
    /// What was signed: program, scenarios, recordings, and what came of them. `docs/updates.md` has every field.
    #[schema(value_type = Object)]
    report: GateReport,
}

fn refused(fault: &GateFault) -> Problem {
    let code = fault.code();
    let text = fault.to_string();
    Problem::of_file(Code::InvalidGate, vec![Fault { code, text }])
}

impl ReleaseKeeper {
    /// Takes in the report that a request brings, about a release that is here.
    async fn take_gate(
        &self,
        id: &str,
        request: Request,
    ) -> Result<(KeptRelease, GateReport), Problem> {
        self.believes()?;
        let release = self.find(id).await?;
        if release.withdrawn.is_some() {
            return Err(Problem::new(Code::WrongState, "the release was withdrawn"));
        }
        let file = arrival::receive(request, GATE_MAX).await?;
        let report = check(&file, &self.keys, id).map_err(|fault| refused(&fault))?;
        let releases = self.records.releases();
        let kept = releases.set_gate(id, file, report.passed).await;
        kept.map_err(|error| failed(&error))?;
        Ok((self.find(id).await?, report))
    }
}

/// Attaches a report on what a release was tried on
///
/// The body is the file that `terracrawler release gate` makes. It is kept when one of the keys of this server has
/// signed it and it is about this release, also when it says that the release did not pass: everybody is to see that,
/// and a rollout refuses it. Otherwise `faults` names the reason. A report that is there already makes room.
#[utoipa::path(post, path = "/releases/{id}/gate", tag = "updates",
    params(("id" = String, Path, description = "Id of the release")),
    request_body(content = Vec<u8>, content_type = "application/octet-stream"),
    responses(
        (status = 200, description = "It is kept", body = ReleaseDetail),
        (status = 404, description = "There is no release of that id"),
        (status = 409, description = "The release was withdrawn, or the server has no key to verify the report by"),
        (status = 413, description = "No report is that large"),
        (status = 415, description = "The body is not `application/octet-stream`"),
        (status = 422, description = "No report, not a genuine one, or one about another release; `faults` says why"),
        (status = 503, description = "The records cannot be written")))]
pub(crate) async fn attach(
    State(keeper): State<ReleaseKeeper>,
    caller: Caller,
    Path(id): Path<String>,
    request: Request,
) -> Result<Json<ReleaseDetail>, Problem> {
    let id = read_id(&id)?;
    let result = keeper.take_gate(&id, request).await;
    let detail = match &result {
        Ok((_, report)) => json!({
            "passed": report.passed,
            "plan": report.plan,
            "program": report.evaluator.program,
        }),
        Err(problem) => json!({ "why": problem.detail() }),
    };
    let audit = &keeper.audit;
    audit
        .write(&caller, "release.gate", &id, detail, &result)
        .await;
    let (release, report) = result?;
    let (level, outcome) = if report.passed {
        (Level::Info, "passed")
    } else {
        (Level::Warn, "did not pass")
    };
    let text = format!(
        "{} {outcome} its gate, which was attached by {}",
        called(&release),
        caller.name()
    );
    keeper.tell(level, text);
    Ok(Json(ReleaseDetail::new(release)?))
}

/// What a release was tried on, and what came of it
#[utoipa::path(get, path = "/releases/{id}/gate", tag = "updates",
    params(("id" = String, Path, description = "Id of the release")),
    responses(
        (status = 200, description = "The report", body = GateView),
        (status = 404, description = "There is no release of that id, or no report on it"),
        (status = 503, description = "The records cannot be read")))]
pub(crate) async fn one(
    State(keeper): State<ReleaseKeeper>,
    Path(id): Path<String>,
) -> Result<Json<GateView>, Problem> {
    let id = read_id(&id)?;
    keeper.find(&id).await?;
    let file = keeper.records.releases().gate(&id).await;
    let file = file.map_err(|error| failed(&error))?;
    let none = || {
        Problem::new(
            Code::NoGate,
            "nobody has said what this release was tried on",
        )
    };
    let file = file.ok_or_else(none)?;
    // It was verified when it came here.
    let read = signer(&file).and_then(|key| Ok((key, unverified(&file)?)));
    let (key, report) =
        read.map_err(|_| Problem::internal("a report in the records cannot be read"))?;
    Ok(Json(GateView {
        key: key.to_string(),
        report,
    }))
}
