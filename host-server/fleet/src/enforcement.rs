//! What happens when a robot crosses a fence.
//!
//! Every pose that robots tell is held against every fence ([`crate::FleetState`]). A robot that crosses
//! one is told of, and stopped where the fence says so: once, so that it can be driven back. The list
//! is kept in the records; each server has a copy, which follows within seconds.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry as Place;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use crawler_protocol::{Action as Order, RobotId, Source};
use crawler_records::{Fences, RecordsError};
use futures_util::{StreamExt as _, stream};
use serde_json::json;
use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;

use crate::{Crossing, Fence, FenceAction, Level, SharedFleet};
use crawler_commands::{CommandCenter, SendError, Target};
use crawler_records::audit_log::{Entry, Notes};

/// As whose command a stop goes out, in commands and in the audit log.
const SOURCE: &str = "fence";
/// Stops under way at a time.
const CALLS: usize = 16;
/// Before a stop that could not be sent is tried again.
const AGAIN: Duration = Duration::from_secs(1);

/// Every fence of the records.
///
/// # Errors
/// [`RecordsError`] when they cannot be read.
pub async fn all(kept: Fences<'_>) -> Result<Vec<Fence>, RecordsError> {
    let kept = kept.all().await?;
    let fences = kept.into_iter().filter_map(|kept| {
        let id = kept.id.clone();
        let fence = Fence::of_kept(kept);
        if fence.is_none() {
            tracing::error!(id, "an invalid fence is stored: it is ignored");
        }
        fence
    });
    Ok(fences.collect())
}

/// Brings this server's copy of the list up to date.
pub async fn catch_up(kept: Fences<'_>, fleet: &SharedFleet) {
    match all(kept).await {
        Ok(fences) => fleet.lock().set_fences(fences),
        Err(error) => tracing::warn!(%error, "cannot read the fences"),
    }
}

/// Robots that are to be stopped.
#[derive(Default)]
pub struct Stops {
    due: Mutex<BTreeMap<RobotId, Due>>,
    wake: Notify,
}

struct Due {
    /// Name of the fence.
    fence: String,
    /// It could not be sent before, which was told.
    again: bool,
}

impl Stops {
    fn due(&self) -> MutexGuard<'_, BTreeMap<RobotId, Due>> {
        self.due.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Notes a crossing of a robot; it is stopped if the fence wants that. At most one entry for each
    /// robot of the fleet.
    pub fn note(&self, crossing: &Crossing) {
        if crossing.back || crossing.fence.action != FenceAction::Stop {
            return;
        }
        let fence = crossing.fence.name.clone();
        let due = Due {
            fence,
            again: false,
        };
        self.due().insert(crossing.robot.clone(), due);
        self.wake.notify_one();
    }
}

/// Stops robots that have crossed a fence.
pub struct Enforcer {
    /// Where crossings are told of.
    pub fleet: Arc<SharedFleet>,
    /// What stops them.
    pub commands: Arc<CommandCenter>,
    /// Where it is noted.
    pub audit: Notes,
    /// Which are to be stopped.
    pub stops: Arc<Stops>,
}

impl Enforcer {
    /// Stops robots that have crossed a fence which wants that, until `stop`.
    pub async fn run(self, stop: CancellationToken) {
        loop {
            // One that could not be sent is tried again in a while, or with the next.
            let waiting = !self.stops.due().is_empty();
            tokio::select! {
                () = stop.cancelled() => return,
                () = self.stops.wake.notified() => {}
                () = tokio::time::sleep(AGAIN), if waiting => {}
            }
            let due = std::mem::take(&mut *self.stops.due());
            stream::iter(due)
                .for_each_concurrent(CALLS, |(robot, due)| self.halt(robot, due))
                .await;
        }
    }

    /// Stops one robot, by the way that everybody's commands go.
    async fn halt(&self, robot: RobotId, due: Due) {
        // Whoever came back by itself needs no stop that is late.
        if due.again && !self.fleet.lock().must_stop(&robot) {
            return;
        }
        let target = Target::Robot(robot.clone());
        let given = self.commands.give(
            Source::new(SOURCE).ok(),
            Order::Stop,
            target,
            vec![robot.clone()],
        );
        let (id, outcome) = match given.await {
            Ok(view) => (Some(view.id), "ok"),
            // It went; the other servers do not know, and a stop needs no heir.
            Err(SendError::NotShared { sent: true }) => (None, "sent_not_shared"),
            Err(error) => {
                self.later(robot, due, error);
                return;
            }
        };
        self.audit.note(Entry {
            who: SOURCE.to_owned(),
            from: String::new(),
            action: "command.send",
            target: robot.to_string(),
            detail: json!({
                "id": id,
                "request": { "command": "stop" },
                "fence": due.fence,
            }),
            outcome: outcome.to_owned(),
        });
    }

    /// Says that a stop was not sent, once, and leaves it for later.
    fn later(&self, robot: RobotId, due: Due, error: SendError) {
        if !due.again {
            tracing::error!(%robot, fence = due.fence, ?error, "a robot cannot be stopped");
            let text = format!(
                "crossed fence {} and cannot be stopped: the stop was not sent",
                due.fence
            );
            let mut fleet = self.fleet.lock();
            fleet.events.push(Level::Error, Some(robot.clone()), text);
        }
        // A newer crossing that came in between is as good.
        if let Place::Vacant(place) = self.stops.due().entry(robot) {
            place.insert(Due { again: true, ..due });
        }
    }
}
