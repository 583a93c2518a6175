//! A release that arrives: received, and looked at before anybody believes it.

use axum::extract::Request;
use axum::http::header;
use crawler_records::NewRelease;
use crawler_release::PublicKey;
use crawler_updates::release::{Expected, FILE_MAX, Fault, FileFault, inspect, split};
use futures_util::StreamExt as _;

use crate::problem::{Code, Problem};

fn too_large() -> Problem {
    Problem::new(
        Code::TooLarge,
        format!("a release has at most {FILE_MAX} bytes"),
    )
}

/// Bytes that are read before a body is cut off. Who sends a little too much is still listening to what becomes of it
/// when all of it has gone.
const MOST_READ: usize = 2 * FILE_MAX;

/// The body of a request, no longer than the file of a release can be.
pub(super) async fn receive(request: Request) -> Result<Vec<u8>, Problem> {
    let (head, body) = request.into_parts();
    let header = |name| {
        let value = head.headers.get(name)?;
        value.to_str().ok()
    };
    let is_file = header(header::CONTENT_TYPE)
        .and_then(|value| value.split(';').next())
        .is_some_and(|kind| kind.trim().eq_ignore_ascii_case("application/octet-stream"));
    if !is_file {
        return Err(Problem::new(
            Code::UnsupportedMediaType,
            "the body must be application/octet-stream",
        ));
    }
    let told = header(header::CONTENT_LENGTH).and_then(|length| length.parse::<u64>().ok());
    if told.is_some_and(|told| told > MOST_READ as u64) {
        return Err(too_large());
    }
    let (mut file, mut length) = (Vec::new(), 0);
    let mut body = body.into_data_stream();
    while let Some(piece) = body.next().await {
        let piece = piece.map_err(|_| Problem::new(Code::BadRequest, "the body did not arrive"))?;
        length += piece.len();
        if length <= FILE_MAX {
            file.extend_from_slice(&piece);
        } else if length <= MOST_READ {
            file = Vec::new();
        } else {
            break;
        }
    }
    if length > FILE_MAX {
        return Err(too_large());
    }
    Ok(file)
}

/// What is to be kept of the file of a release, if it is genuine. `now` is in Unix milliseconds.
pub(super) fn read(
    file: &[u8],
    keys: &[PublicKey],
    by: &str,
    now: i64,
) -> Result<NewRelease, Problem> {
    let no_file = |fault: FileFault| {
        Problem::of_release(vec![Fault {
            code: "no_release",
            text: fault.to_string(),
        }])
    };
    let expected = Expected {
        now: u64::try_from(now).unwrap_or(0) / 1_000,
        ..Expected::default()
    };
    let found = inspect(file, keys, &expected).map_err(no_file)?;
    if !found.authentic || !found.faults.is_empty() {
        return Err(Problem::of_release(found.faults));
    }
    let (envelope, image) = split(file).map_err(no_file)?;
    NewRelease::of(envelope, image, by, now)
        .map_err(|_| Problem::internal("a release that was verified cannot be read"))
}
