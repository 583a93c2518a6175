//! What the cases do.

use crawler_protocol::open::{Open, Response};
use crawler_protocol::{Reason, ResponseStatus};

use super::Failure;
use super::case::Verdict;

pub(super) mod door;
pub(super) mod faults;
pub(super) mod motion;
pub(super) mod orders;
pub(super) mod reboot;
pub(super) mod reports;
pub(super) mod settings;

/// Fails with `text` unless `good`.
fn check(good: bool, text: impl FnOnce() -> String) -> Verdict {
    if good {
        Ok(())
    } else {
        Err(Failure::Failed(text()))
    }
}

/// Fails unless `answer` is `status` with `reason`.
fn is(answer: &Response, status: ResponseStatus, reason: Option<Reason>) -> Verdict {
    let (status, reason) = (Open::Known(status), reason.map(Open::Known));
    check(answer.status == status && answer.reason == reason, || {
        format!(
            "answered {}, expected {}",
            told(answer.status, answer.reason),
            told(status, reason)
        )
    })
}

fn told(status: Open<ResponseStatus>, reason: Option<Open<Reason>>) -> String {
    match reason {
        Some(reason) => format!("{status} ({reason})"),
        None => status.to_string(),
    }
}

/// Fails unless `answer` is `completed`.
fn completed(answer: &Response) -> Verdict {
    is(answer, ResponseStatus::Completed, None)
}
