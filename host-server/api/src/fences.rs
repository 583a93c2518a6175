//! Fences: polygons of the ground that robots are to stay in or out of.

use std::sync::Arc;

use axum::Json;
use axum::extract::{FromRef, Path, State};
use axum::http::StatusCode;
use crawler_records::{KeptFence, MAX_FENCE_NAME, MAX_FENCES, Records, RecordsError};
use serde::{Deserialize, Serialize};
use serde_json::json;
use utoipa::ToSchema;
use utoipa::openapi::schema::{Array, ArrayBuilder, ObjectBuilder, Type};

use super::access::Caller;
use super::audit::Audit;
use super::guard::JsonBody;
use super::problem::{Code, FieldError, Problem, member};
use super::state::ApiState;
use crawler_fleet::enforcement;
use crawler_fleet::{Fence, FenceAction, FenceKind, Shape, ShapeError, SharedFleet};
use crawler_system::clock::now_ms;

/// A fence.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Fence)]
pub(super) struct FenceView {
    /// Its id.
    id: String,
    /// Its name; no two have the same.
    name: String,
    /// On which side of its edge robots are to be.
    kind: FenceKind,
    /// Its corners, x and y in metres. The last is joined to the first.
    corners: Vec<[f64; 2]>,
    /// What happens when a robot crosses it.
    action: FenceAction,
    /// Who made it.
    by: String,
    /// Unix milliseconds.
    made_at: i64,
}

impl FenceView {
    fn new(fence: Fence) -> Self {
        Self {
            id: fence.id,
            name: fence.name,
            kind: fence.kind,
            corners: fence.shape.corners().to_vec(),
            action: fence.action,
            by: fence.by,
            made_at: fence.made_at,
        }
    }
}

/// Every fence.
#[derive(Serialize, ToSchema)]
#[schema(as = Fences)]
pub(super) struct FenceList {
    /// The oldest first.
    fences: Vec<FenceView>,
}

/// Pairs of numbers.
fn corners() -> Array {
    let number = ObjectBuilder::new().schema_type(Type::Number);
    let corner = ArrayBuilder::new().items(number);
    ArrayBuilder::new()
        .items(corner.min_items(Some(2)).max_items(Some(2)))
        .min_items(Some(3))
        .max_items(Some(32))
        .build()
}

/// What somebody wants a fence to be.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct NewFence {
    /// Its name: 1 to 32 characters, and no other fence's.
    #[schema(min_length = 1, max_length = 32)]
    name: String,
    /// On which side of its edge robots are to be.
    kind: FenceKind,
    /// Its corners, x and y in metres: 3 to 32, in either direction. Edges meet in corners alone, and
    /// enclose more than 0.01 m².
    #[schema(schema_with = corners)]
    corners: Vec<Vec<f64>>,
    /// What happens when a robot crosses it.
    action: FenceAction,
}

impl NewFence {
    fn read(body: &JsonBody) -> Result<Self, Problem> {
        body.read()
    }

    fn into_fence(self, id: String, by: String) -> Result<Fence, Problem> {
        if !is_name(&self.name) {
            let rule = format!(
                "must have 1 to {MAX_FENCE_NAME} characters that can be seen, and no space at either end"
            );
            return Err(invalid("/name", rule));
        }
        // The corners together are none.
        let refused =
            |error: ShapeError| Problem::new(Code::InvalidFence, error.to_string()).at("/corners");
        let mut corners = Vec::with_capacity(self.corners.len());
        for (number, corner) in self.corners.into_iter().enumerate() {
            let Ok(corner) = <[f64; 2]>::try_from(corner) else {
                let pointer = member("/corners", number);
                return Err(invalid(&pointer, "must be two numbers, x and y".to_owned()));
            };
            corners.push(corner);
        }
        Ok(Fence {
            id,
            name: self.name,
            kind: self.kind,
            action: self.action,
            shape: Shape::new(corners).map_err(refused)?,
            by,
            made_at: now_ms(),
        })
    }
}

/// Whether a text can be read where names stand, and changes nothing around it.
fn is_name(text: &str) -> bool {
    // Marks that turn the direction of what follows them.
    let turns = |c: char| matches!(c, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    (1..=MAX_FENCE_NAME).contains(&text.chars().count())
        && text.trim() == text
        && !text.chars().any(|c| c.is_control() || turns(c))
}

fn invalid(pointer: &str, detail: String) -> Problem {
    let error = FieldError::at(pointer, detail);
    Problem::invalid(Code::InvalidFence, vec![error])
}

fn unknown() -> Problem {
    Problem::new(Code::UnknownFence, "there is no such fence")
}

fn failed(error: &RecordsError) -> Problem {
    match error {
        RecordsError::NotFound => unknown(),
        RecordsError::Exists => Problem::new(Code::Exists, "there is a fence of that name already"),
        RecordsError::TooMany(_) => Problem::new(
            Code::TooMany,
            format!("there are {MAX_FENCES} fences already: delete one first"),
        ),
        error => Problem::records(error),
    }
}

/// Keeps fences in the records, has them hold here at once, and writes down who changed them.
#[derive(Clone)]
pub(super) struct FenceKeeper {
    records: Records,
    fleet: Arc<SharedFleet>,
    audit: Audit,
}

impl FromRef<ApiState> for FenceKeeper {
    fn from_ref(state: &ApiState) -> Self {
        Self {
            records: FromRef::from_ref(state),
            fleet: FromRef::from_ref(state),
            audit: FromRef::from_ref(state),
        }
    }
}

impl FenceKeeper {
    async fn catch_up(&self) {
        enforcement::catch_up(self.records.fences(), &self.fleet).await;
    }

    /// Has a change hold here at once, and writes it down.
    async fn note<T>(
        &self,
        caller: &Caller,
        action: &'static str,
        fence: &Fence,
        result: &Result<T, Problem>,
    ) {
        self.catch_up().await;
        let detail = json!({
            "name": fence.name,
            "kind": fence.kind,
            "action": fence.action,
            "corners": fence.shape.corners(),
        });
        self.audit
            .write(caller, action, &fence.id, detail, result)
            .await;
    }
}

/// Every fence
#[utoipa::path(get, path = "/fences", tag = "fences",
    responses(
        (status = 200, description = "The fences", body = FenceList),
        (status = 503, description = "The records cannot be read")))]
pub(super) async fn list(State(records): State<Records>) -> Result<Json<FenceList>, Problem> {
    let fences = enforcement::all(records.fences())
        .await
        .map_err(|error| failed(&error))?;
    Ok(Json(FenceList {
        fences: fences.into_iter().map(FenceView::new).collect(),
    }))
}

/// Puts up a fence
///
/// From then on the server holds the place of every robot against it. A robot that crosses it, or is
/// on its wrong side from the beginning, is told of as an event; with the action `stop` it is sent a
/// `stop` as well, once: it can be driven back. It is back when it is 0.1 m on the right side.
#[utoipa::path(post, path = "/fences", tag = "fences",
    request_body = NewFence,
    responses(
        (status = 201, description = "The fence", body = FenceView),
        (status = 400, description = "Not JSON"),
        (status = 409, description = "Its name is another's, or there are too many"),
        (status = 422, description = "Not a fence"),
        (status = 503, description = "The records cannot be written")))]
pub(super) async fn add(
    State(fences): State<FenceKeeper>,
    caller: Caller,
    body: JsonBody,
) -> Result<(StatusCode, Json<FenceView>), Problem> {
    let wanted = NewFence::read(&body)?;
    let fence = wanted.into_fence(new_id()?, caller.name())?;
    let added = fences.records.fences().add(&fence.to_kept()).await;
    let result = added.map_err(|error| failed(&error));
    fences.note(&caller, "fence.add", &fence, &result).await;
    result?;
    Ok((StatusCode::CREATED, Json(FenceView::new(fence))))
}

/// Changes a fence
///
/// The body says all of it anew. Who is beyond it and stays beyond it is not told of again.
#[utoipa::path(put, path = "/fences/{id}", tag = "fences",
    params(("id" = String, Path, description = "Id of the fence")),
    request_body = NewFence,
    responses(
        (status = 200, description = "The fence", body = FenceView),
        (status = 400, description = "Not JSON"),
        (status = 404, description = "There is no such fence"),
        (status = 409, description = "Its name is another's"),
        (status = 422, description = "Not a fence"),
        (status = 503, description = "The records cannot be written")))]
pub(super) async fn change(
    State(fences): State<FenceKeeper>,
    caller: Caller,
    Path(id): Path<String>,
    body: JsonBody,
) -> Result<Json<FenceView>, Problem> {
    let wanted = NewFence::read(&body)?;
    if !is_id(&id) {
        return Err(unknown());
    }
    let fence = wanted.into_fence(id, caller.name())?;
    let changed: Result<KeptFence, RecordsError> =
        fences.records.fences().change(&fence.to_kept()).await;
    let result = changed.map_err(|error| failed(&error));
    fences.note(&caller, "fence.change", &fence, &result).await;
    let kept = result?;
    Ok(Json(FenceView::new(Fence {
        by: kept.by,
        made_at: kept.made_at,
        ..fence
    })))
}

/// Takes a fence down
#[utoipa::path(delete, path = "/fences/{id}", tag = "fences",
    params(("id" = String, Path, description = "Id of the fence")),
    responses(
        (status = 204, description = "It is gone"),
        (status = 404, description = "There is no such fence"),
        (status = 503, description = "The records cannot be written")))]
pub(super) async fn delete(
    State(fences): State<FenceKeeper>,
    caller: Caller,
    Path(id): Path<String>,
) -> Result<StatusCode, Problem> {
    if !is_id(&id) {
        return Err(unknown());
    }
    let deleted = fences.records.fences().delete(&id).await;
    let result = deleted.map_err(|error| failed(&error));
    let detail = json!({ "name": result.as_ref().ok() });
    fences.catch_up().await;
    fences
        .audit
        .write(&caller, "fence.delete", &id, detail, &result)
        .await;
    result?;
    Ok(StatusCode::NO_CONTENT)
}

/// Ids are not counted up: one that was deleted does not come back as another fence.
fn new_id() -> Result<String, Problem> {
    let mut id = [0; 8];
    getrandom::fill(&mut id).map_err(|_| Problem::internal("no randomness"))?;
    Ok(crawler_system::text::hex(&id))
}

fn is_id(text: &str) -> bool {
    text.len() == 16 && text.bytes().all(|byte| byte.is_ascii_hexdigit())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_short_and_can_be_read() {
        for good in ["a", "yard 2", "Höfe/北", &"ä".repeat(32)] {
            assert!(is_name(good), "{good}");
        }
        for bad in [
            "",
            " ",
            " a",
            "a ",
            "a\nb",
            "a\u{7f}",
            "a\0",
            "\u{202e}cba",
            &"a".repeat(33),
        ] {
            assert!(!is_name(bad), "{bad:?}");
        }
    }

    #[test]
    fn an_id_is_new_and_one() {
        let (one, other) = (new_id().expect("an id"), new_id().expect("an id"));
        assert!(is_id(&one) && is_id(&other) && one != other);
        for wrong in ["", "0", "../../etc/passwd", "00000000000000000"] {
            assert!(!is_id(wrong), "{wrong}");
        }
    }
}
