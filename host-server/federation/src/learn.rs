//! A node at the broker: it answers the rounds of whatever run is announced.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use crawler_federated::{Announcement, Report, Update};
use crawler_learning::federated::{Answer, Node, NodeError};
use crawler_protocol::Fleet;
use rumqttc::v5::MqttOptions;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use crate::NodeName;
use crate::session::{self, Saying};
use crate::topics;

/// What a node tells whoever looks at it.
#[derive(Debug)]
#[non_exhaustive]
pub enum Told<'a> {
    /// A round was learned from, and is answered.
    Answered {
        /// Of which run.
        run: u64,
        /// Rounds of the run that are over.
        round: u32,
        /// How it went.
        report: Report,
        /// How long it took.
        took: Duration,
        /// Bytes of the answer.
        bytes: usize,
    },
    /// A run is over.
    Over {
        /// Which one.
        run: u64,
    },
    /// What was announced cannot be answered.
    Refused {
        /// Of which run.
        run: u64,
        /// Why.
        error: &'a NodeError,
    },
}

/// Runs of which announcements wait at most; there is one at a time for each server.
const RUNS: usize = 16;

/// What was announced last of each run, and is not looked at yet.
type Heard = BTreeMap<u64, Vec<u8>>;

/// Learns until `stop`: in worlds of its own, as `make` gives them anew for each run. A round that is being learned from when `stop` comes is
/// learned to its end, and not answered.
///
/// # Errors
/// [`tokio::task::JoinError`] when learning panics.
pub async fn learn(
    session: MqttOptions,
    fleet: Fleet,
    name: NodeName,
    make: impl Fn() -> Node + Send,
    mut tell: impl FnMut(&Told<'_>) + Send,
    stop: CancellationToken,
) -> Result<(), tokio::task::JoinError> {
    // Nobody is to listen where nobody learns any more.
    let stop = stop.child_token();
    let (say, said) = watch::channel(None);
    let (hear, mut heard) = watch::channel(Heard::new());
    let taken = hear.clone();
    let own = fleet.clone();
    let hear = move |topic: &str, payload: &[u8]| {
        if let Some(run) = topics::run_of(&own, topic) {
            hear.send_modify(|heard| {
                heard.insert(run, payload.to_vec());
                // Newer runs have higher numbers.
                if heard.len() > RUNS {
                    heard.pop_first();
                }
            });
        }
    };
    let filter = topics::all_rounds(&fleet);
    let keeping = session::keep(session, filter, said, hear, stop.clone());
    let learning = async {
        let mut current: Option<(u64, Node)> = None;
        loop {
            let some = tokio::select! {
                () = stop.cancelled() => return Ok(()),
                some = heard.wait_for(|heard| !heard.is_empty()) => some.is_ok(),
            };
            if !some {
                return Ok(());
            }
            // What came of runs that are over is retained for a while; the newest is the one that may go on.
            let mut newest = None;
            taken.send_if_modified(|heard| {
                newest = heard.pop_last();
                false
            });
            let Some((run, announced)) = newest else {
                continue;
            };
            // Taken back: the run stands.
            if announced.is_empty() {
                continue;
            }
            let is_over = Announcement::from_bytes(&announced).is_ok_and(|told| told.is_over());
            if is_over {
                if current.take_if(|(of, _)| *of == run).is_some() {
                    tell(&Told::Over { run });
                    // It is not to be said again.
                    say.send_replace(None);
                }
                continue;
            }
            let mut node = match current.take() {
                Some((of, node)) if of == run => node,
                _ => make(),
            };
            let begun = Instant::now();
            let learned = tokio::task::spawn_blocking(move || {
                let answer = node.answer(&announced);
                (node, answer)
            });
            let (node, answer) = learned.await.inspect_err(|_| stop.cancel())?;
            current = Some((run, node));
            match answer {
                Ok(Answer::Update(bytes)) => {
                    if let Ok(update) = Update::from_bytes(&bytes) {
                        tell(&Told::Answered {
                            run,
                            round: update.round,
                            report: update.report,
                            took: begun.elapsed(),
                            bytes: bytes.len(),
                        });
                    }
                    say.send_replace(Some(Saying {
                        topic: topics::update(&fleet, run, &name),
                        payload: bytes,
                        retain: false,
                        expires_s: None,
                    }));
                }
                // Looked at before.
                Ok(Answer::Over(_)) => {}
                Err(error) => tell(&Told::Refused { run, error: &error }),
            }
        }
    };
    let ((), learned) = tokio::join!(keeping, learning);
    learned
}
