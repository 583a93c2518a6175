//! Fences: polygons of the ground that robots are to stay in or out of.
//!
//! Every pose that robots tell is held against every fence ([`crate::fleet`]). A robot that crosses
//! one is told of, and stopped where the fence says so: once, so that it can be driven back. The list
//! is kept in the records; each server has a copy, which follows within seconds.

mod shape;
#[cfg(test)]
mod shape_tests;

use std::collections::BTreeMap;
use std::collections::btree_map::Entry as Place;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use crawler_protocol::{Action as Order, RobotId, Source};
use crawler_records::{KeptFence, Records, RecordsError};
use futures_util::{StreamExt as _, stream};
use serde::{Deserialize, Serialize};
use serde_json::json;
use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;
use utoipa::ToSchema;

use crate::accounts::{Entry, Notes};
use crate::commands::{CommandCenter, SendError, Target};
use crate::fleet::{Crossing, Level, SharedFleet};

pub(crate) use shape::{Shape, ShapeError};

/// So far, in metres, a robot must be on the right side before it counts as back: a pose that is sure
/// to a few centimetres makes one crossing of each.
pub(crate) const HYSTERESIS: f64 = 0.1;
/// As whose command a stop goes out, in commands and in the audit log.
const SOURCE: &str = "fence";
/// Stops under way at a time.
const CALLS: usize = 16;
/// Before a stop that could not be sent is tried again.
const AGAIN: Duration = Duration::from_secs(1);

/// On which side of its edge robots are to be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
#[schema(as = FenceKind)]
pub(crate) enum Kind {
    /// Within.
    KeepIn,
    /// Outside.
    KeepOut,
}

impl Kind {
    /// Both.
    pub(crate) const ALL: [Self; 2] = [Self::KeepIn, Self::KeepOut];

    /// The name in messages, records and metrics.
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::KeepIn => "keep_in",
            Self::KeepOut => "keep_out",
        }
    }
}

/// What happens to a robot that crosses it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
#[schema(as = FenceAction)]
pub(crate) enum Action {
    /// It is told of.
    Warn,
    /// It is told of, and the robot is stopped.
    Stop,
}

impl Action {
    /// Both.
    pub(crate) const ALL: [Self; 2] = [Self::Warn, Self::Stop];

    /// The name in messages, records and metrics.
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Warn => "warn",
            Self::Stop => "stop",
        }
    }
}

/// A fence.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Fence {
    pub(crate) id: String,
    pub(crate) name: String,
    pub(crate) kind: Kind,
    pub(crate) action: Action,
    pub(crate) shape: Shape,
    /// Who made it.
    pub(crate) by: String,
    /// Unix milliseconds.
    pub(crate) made_at: i64,
}

impl Fence {
    /// Whether a robot at `at` is on the wrong side; `was` says whether it was before.
    pub(crate) fn is_violated(&self, at: [f64; 2], was: bool) -> bool {
        let shape = &self.shape;
        match self.kind {
            Kind::KeepIn if !shape.holds(at) => true,
            // In a narrow one it is back where there is still a place to be.
            Kind::KeepIn => was && shape.to_edge(at) < HYSTERESIS.min(shape.depth() / 2.0),
            Kind::KeepOut if !shape.is_near(at, HYSTERESIS) => false,
            Kind::KeepOut => shape.holds(at) || (was && shape.to_edge(at) < HYSTERESIS),
        }
    }

    /// What a robot did that crossed it; `back` to where it should be.
    pub(crate) const fn crossing_verb(&self, back: bool) -> &'static str {
        match (self.kind, back) {
            (Kind::KeepIn, false) => "left",
            (Kind::KeepIn, true) => "came back into",
            (Kind::KeepOut, false) => "entered",
            (Kind::KeepOut, true) => "came out of",
        }
    }

    /// As it is kept.
    pub(crate) fn to_kept(&self) -> KeptFence {
        KeptFence {
            id: self.id.clone(),
            name: self.name.clone(),
            kind: self.kind.name().to_owned(),
            action: self.action.name().to_owned(),
            // Finite numbers, which JSON can write.
            corners: json!(self.shape.corners()).to_string(),
            by: self.by.clone(),
            made_at: self.made_at,
        }
    }

    /// From how it is kept; `None` for what this program could not have kept.
    pub(crate) fn of_kept(kept: KeptFence) -> Option<Self> {
        let corners = serde_json::from_str(&kept.corners).ok()?;
        Some(Self {
            kind: Kind::ALL
                .into_iter()
                .find(|kind| kind.name() == kept.kind)?,
            action: Action::ALL
                .into_iter()
                .find(|action| action.name() == kept.action)?,
            shape: Shape::new(corners).ok()?,
            id: kept.id,
            name: kept.name,
            by: kept.by,
            made_at: kept.made_at,
        })
    }
}

/// Every fence of the records.
///
/// # Errors
/// [`RecordsError`] when they cannot be read.
pub(crate) async fn all(records: &Records) -> Result<Vec<Fence>, RecordsError> {
    let kept = records.fences().await?;
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
pub(crate) async fn catch_up(records: &Records, fleet: &SharedFleet) {
    match all(records).await {
        Ok(fences) => fleet.lock().set_fences(fences),
        Err(error) => tracing::warn!(%error, "cannot read the fences"),
    }
}

/// Robots that are to be stopped.
#[derive(Default)]
pub(crate) struct Stops {
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
    pub(crate) fn note(&self, crossing: &Crossing) {
        if crossing.back || crossing.fence.action != Action::Stop {
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
pub(crate) struct Enforcer {
    pub(crate) fleet: Arc<SharedFleet>,
    pub(crate) commands: Arc<CommandCenter>,
    pub(crate) audit: Notes,
    pub(crate) stops: Arc<Stops>,
}

impl Enforcer {
    /// Stops robots that have crossed a fence which wants that, until `stop`.
    pub(crate) async fn run(self, stop: CancellationToken) {
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
