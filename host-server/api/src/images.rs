//! What robots see.

use std::sync::Arc;

use axum::extract::{Path, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use crawler_protocol::{IMAGE_TYPE, RobotId};

use super::problem::{Code, Problem};
use crawler_fleet::SharedFleet;

/// Number of the image.
const FRAME: HeaderName = HeaderName::from_static("x-image-frame");
/// When it was taken, by the robot's clock.
const TIMESTAMP: HeaderName = HeaderName::from_static("x-image-timestamp");

/// The newest image of a robot
///
/// A JPEG. `x-image-frame` counts the robot's images since it started; `x-image-timestamp` says in
/// Unix milliseconds when it was taken by the robot's clock, 0 when that was not set. A `capture`
/// command asks for a new one, which is here once the command is `completed`. The server keeps one
/// image of each robot in memory, fewer when they are large and many.
#[utoipa::path(get, path = "/robots/{id}/image", tag = "robots",
    params(("id" = String, Path, description = "Robot id")),
    responses(
        (status = 200, description = "The image", body = Vec<u8>, content_type = "image/jpeg"),
        (status = 304, description = "Still the one that `if-none-match` names"),
        (status = 404, description = "Nobody knows the robot, or it has sent no image")))]
pub(super) async fn newest(
    State(fleet): State<Arc<SharedFleet>>,
    Path(id): Path<String>,
    request: HeaderMap,
) -> Result<Response, Problem> {
    let unknown = || Problem::unknown_robot(&id);
    let robot = RobotId::new(&id).map_err(|_| unknown())?;
    let image = {
        let fleet = fleet.lock();
        fleet.get(&robot).ok_or_else(unknown)?;
        fleet.image(&robot).cloned()
    };
    let image = image.ok_or_else(|| {
        Problem::new(
            Code::NoImage,
            "the robot has sent no image since the server runs",
        )
    })?;
    let tag = format!("\"{}-{}\"", image.received, image.frame);
    let known = request
        .get_all(header::IF_NONE_MATCH)
        .iter()
        .filter_map(|value| value.to_str().ok())
        .flat_map(|value| value.split(','))
        .any(|candidate| candidate.trim().trim_start_matches("W/") == tag);
    let mut response = if known {
        StatusCode::NOT_MODIFIED.into_response()
    } else {
        ([(header::CONTENT_TYPE, IMAGE_TYPE)], image.jpeg).into_response()
    };
    let headers = response.headers_mut();
    // The next one may be there already.
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-cache"));
    headers.insert(FRAME, HeaderValue::from(image.frame));
    headers.insert(TIMESTAMP, HeaderValue::from(image.timestamp));
    if let Ok(tag) = HeaderValue::from_str(&tag) {
        headers.insert(header::ETAG, tag);
    }
    Ok(response)
}
