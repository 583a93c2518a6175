//! What becomes of commands that a server has acknowledged and must not lose.

use std::collections::VecDeque;
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::agent;

/// Before a command is asked about.
const FIRST: Duration = Duration::from_secs(1);
/// Between two questions about any of them. One address may ask 200 a second.
const ASK_EVERY: Duration = Duration::from_millis(12);
/// For whoever gave a command to read that it was acknowledged, when the server has just ended. It takes longer
/// to start.
const LAST_WORDS: Duration = Duration::from_millis(100);
/// For all commands to come to an end, when no more are given.
const PATIENCE: Duration = Duration::from_mins(2);
/// For a command that is still under way.
const AGAIN: Duration = Duration::from_secs(2);

/// A command and when it was acknowledged.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Acknowledged {
    id: String,
    at: Instant,
}

impl Acknowledged {
    pub(super) fn now(id: String) -> Self {
        Self {
            id,
            at: Instant::now(),
        }
    }
}

/// What became of the commands of a cycle.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Fates {
    /// Done by their robot, refused by it, or overtaken by a later one.
    pub(super) ended: u64,
    /// Ended before the server was started again, and not asked about until then.
    pub(super) forgotten: u64,
    /// Neither.
    pub(super) lost: Vec<String>,
}

/// What one question came to.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Fate {
    Ended,
    UnderWay,
    Forgotten,
    Lost(String),
}

/// Asks about every command, on a thread of its own.
pub(super) struct Follower {
    new: Sender<Acknowledged>,
    restarted: Arc<Mutex<Option<Instant>>>,
    thread: JoinHandle<Fates>,
}

impl Follower {
    pub(super) fn start(url: &str) -> Self {
        let (new, coming) = channel();
        let restarted = Arc::new(Mutex::new(None));
        let (url, when) = (url.to_owned(), Arc::clone(&restarted));
        Self {
            new,
            restarted,
            thread: std::thread::spawn(move || follow(&url, &coming, &when)),
        }
    }

    /// Takes what is to be followed.
    pub(super) fn hand(&self) -> impl Fn(Acknowledged) + Send + 'static {
        let new = self.new.clone();
        move |command| new.send(command).expect("whoever follows")
    }

    /// The server has just ended, and is to be started again.
    pub(super) fn note_restart(&self) {
        let mut when = self
            .restarted
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        *when = Some(Instant::now() + LAST_WORDS);
    }

    /// Follows the last ones to their end.
    pub(super) fn stop(self) -> Fates {
        drop(self.new);
        self.thread.join().expect("whoever follows")
    }
}

fn follow(url: &str, coming: &Receiver<Acknowledged>, restarted: &Mutex<Option<Instant>>) -> Fates {
    let agent = agent();
    let mut fates = Fates::default();
    let mut open: VecDeque<(Instant, Acknowledged)> = VecDeque::new();
    let mut over: Option<Instant> = None;
    loop {
        let gone = loop {
            match coming.try_recv() {
                Ok(command) => open.push_back((command.at + FIRST, command)),
                Err(error) => break error,
            }
        };
        if gone == TryRecvError::Disconnected {
            let since = *over.get_or_insert_with(Instant::now);
            if open.is_empty() || since.elapsed() > PATIENCE {
                let left = open.into_iter().map(|(_, command)| command.id);
                fates
                    .lost
                    .extend(left.map(|id| format!("{id}: has not ended")));
                return fates;
            }
        }
        std::thread::sleep(ASK_EVERY);
        let Some((due, command)) = open.pop_front() else {
            continue;
        };
        if due > Instant::now() {
            open.push_front((due, command));
            continue;
        }
        let answer = agent
            .get(format!("{url}/api/v1/commands/{}", command.id))
            .call();
        let answer = answer.ok().map(|mut answer| {
            let status = answer.status().as_u16();
            (status, answer.body_mut().read_json().unwrap_or_default())
        });
        let restarted = *restarted.lock().unwrap_or_else(PoisonError::into_inner);
        match fate(answer, restarted.is_some_and(|at| at > command.at)) {
            Fate::Ended => fates.ended += 1,
            Fate::Forgotten => fates.forgotten += 1,
            Fate::Lost(why) => fates.lost.push(format!("{}: {why}", command.id)),
            Fate::UnderWay => open.push_back((Instant::now() + AGAIN, command)),
        }
    }
}

/// What an answer says about a command that was acknowledged. A server that was started again knows those
/// that were open.
fn fate(answer: Option<(u16, Value)>, restarted: bool) -> Fate {
    // Nobody answers while the server is down.
    let Some((status, view)) = answer else {
        return Fate::UnderWay;
    };
    match (status, view["status"].as_str()) {
        (200, Some("pending" | "accepted")) => Fate::UnderWay,
        (200, Some("completed" | "rejected" | "stale")) => Fate::Ended,
        (200, other) => Fate::Lost(format!("{other:?}")),
        (404, _) if restarted => Fate::Forgotten,
        (404, _) => Fate::Lost("unknown".to_owned()),
        // Too many questions, or a server that is not there yet.
        _ => Fate::UnderWay,
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn only_what_is_unknown_or_came_to_nothing_is_lost() {
        let view = |status: &str| Some((200, json!({ "status": status })));
        assert_eq!(fate(None, false), Fate::UnderWay);
        assert_eq!(fate(view("pending"), false), Fate::UnderWay);
        assert_eq!(fate(Some((429, Value::Null)), false), Fate::UnderWay);
        assert_eq!(fate(view("completed"), false), Fate::Ended);
        assert_eq!(fate(view("stale"), true), Fate::Ended);
        for status in ["timeout", "failed", "expired"] {
            assert!(
                matches!(fate(view(status), true), Fate::Lost(_)),
                "{status}"
            );
        }
        let unknown = || Some((404, Value::Null));
        assert_eq!(fate(unknown(), true), Fate::Forgotten);
        assert!(matches!(fate(unknown(), false), Fate::Lost(_)));
    }
}
