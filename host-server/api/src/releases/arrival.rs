//! A release that arrives: received, and looked at before anybody believes it.

use axum::extract::Request;
use axum::http::header;
use crawler_records::NewRelease;
use crawler_release::PublicKey;
use crawler_updates::release::{Expected, Fault, FileFault, inspect, split};
use futures_util::StreamExt as _;

use crate::problem::{Code, Problem};

/// The body of a request, of at most `most` bytes.
pub(super) async fn receive(request: Request, most: usize) -> Result<Vec<u8>, Problem> {
    let too_large = || {
        Problem::new(
            Code::TooLarge,
            format!("such a file has at most {most} bytes"),
        )
    };
    // Bytes that are read before a body is cut off. Who sends a little too much is still listening to what becomes of
    // it when all of it has gone.
    let most_read = 2 * most;
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
    if told.is_some_and(|told| told > most_read as u64) {
        return Err(too_large());
    }
    let (mut file, mut length) = (Vec::new(), 0);
    let mut body = body.into_data_stream();
    while let Some(piece) = body.next().await {
        let piece = piece.map_err(|_| Problem::new(Code::BadRequest, "the body did not arrive"))?;
        length += piece.len();
        if length <= most {
            file.extend_from_slice(&piece);
        } else if length <= most_read {
            file = Vec::new();
        } else {
            break;
        }
    }
    if length > most {
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
