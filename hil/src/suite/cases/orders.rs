//! Commands that do not set a robot in motion.

use crawler_protocol::open::Response;
use crawler_protocol::{Action, BehaviourSpec, Capability, PolicyName, Reason, ResponseStatus};

use super::super::Failure;
use super::super::case::Verdict;
use super::super::{ANSWER, Bench, Word, is_standing};
use super::{check, completed, is};

pub(in super::super) async fn identify(bench: &mut Bench) -> Verdict {
    completed(&bench.ask(Action::Identify).await?)?;
    bench
        .stays("it stood before it blinked", 2, is_standing)
        .await
}

pub(in super::super) async fn stop_at_rest(bench: &mut Bench) -> Verdict {
    completed(&bench.ask(Action::Stop).await?)?;
    bench.stays("it stood", 2, is_standing).await
}

pub(in super::super) async fn swarm(bench: &mut Bench) -> Verdict {
    // Blinking disturbs nobody else in the fleet.
    let seq = bench.send_swarm(Action::Identify)?;
    completed(&bench.outcome(seq, ANSWER).await?)
}

pub(in super::super) async fn capture(bench: &mut Bench) -> Verdict {
    let sees = bench
        .status()
        .is_some_and(|status| status.capabilities.contains(&Capability::Camera.into()));
    let seq = bench.send(Action::Capture)?;
    if !sees {
        let answer = bench.outcome(seq, ANSWER).await?;
        return is(&answer, ResponseStatus::Rejected, Some(Reason::Unsupported));
    }
    // Image and answer come in either order.
    let mut image = None;
    let mut answer = None;
    let limit = ANSWER * 2;
    bench
        .wait("an image and an answer", limit, |message| {
            match &message.word {
                Word::Image(bytes) => image = Some(bytes.clone()),
                Word::Response(response) if response.seq == seq && response.status.is_final() => {
                    answer = Some(response.clone());
                }
                _ => {}
            }
            // A refusal comes without an image.
            let refused = answer
                .as_ref()
                .is_some_and(|answer| answer.status != ResponseStatus::Completed);
            (refused || (image.is_some() && answer.is_some())).then_some(())
        })
        .await?;
    if let Some(answer) = &answer {
        completed(answer)?;
    }
    let image = image.unwrap_or_default();
    check(
        image.starts_with(&[0xff, 0xd8]) && image.ends_with(&[0xff, 0xd9]),
        || format!("the image ({} bytes) is no JPEG", image.len()),
    )
}

pub(in super::super) async fn no_policy(bench: &mut Bench) -> Verdict {
    let policy =
        PolicyName::new("none-of-this-name").map_err(|error| Failure::Failed(error.to_string()))?;
    let behave = Action::Behave(BehaviourSpec::Policy { policy });
    let answer = bench.ask(behave).await?;
    is(&answer, ResponseStatus::Rejected, Some(Reason::NoPolicy))?;
    bench.stays("it stood", 2, is_standing).await
}

/// Behind a `goto`, which leaves a map for half a minute.
pub(in super::super) async fn map(bench: &mut Bench) -> Verdict {
    let tells = bench
        .status()
        .is_some_and(|status| status.capabilities.contains(&Capability::Map.into()));
    let seq = bench.send(Action::ReportMap)?;
    if !tells {
        let answer = bench.outcome(seq, ANSWER).await?;
        let unknown = Some(Reason::UnknownCommand);
        return is(&answer, ResponseStatus::Rejected, unknown);
    }
    // Map and answer come in either order.
    let (mut rows, mut whole, mut answer) = (0, false, None);
    let answer = bench
        .wait("a whole map and an answer", ANSWER, |message| {
            match &message.word {
                Word::Map(segment) if segment.seq == seq && segment.is_consistent() => {
                    // A window that has moved is told anew.
                    let first = usize::from(segment.row);
                    let follows = first == 0 || first == rows;
                    rows = if follows {
                        first + segment.row_count()
                    } else {
                        0
                    };
                    whole = rows == usize::from(segment.rows);
                }
                Word::Response(response) if response.seq == seq && response.status.is_final() => {
                    answer = Some(response.clone());
                }
                _ => {}
            }
            let refused = |answer: &Response| answer.status != ResponseStatus::Completed;
            answer.clone().filter(|answer| whole || refused(answer))
        })
        .await?;
    if whole {
        return completed(&answer);
    }
    is(&answer, ResponseStatus::Failed, Some(Reason::NoMap))
}
