//! The live feed: a snapshot for whoever connects, then what changes, ten times a second.
//!
//! Frames are made once for all readers and handed out through a ring of bounded length. A reader
//! that falls behind by more than the ring is told so and dropped; it never holds up anybody.

mod encode;
#[cfg(test)]
mod tests;

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use bytes::Bytes;
use crawler_protocol::Fleet;
use serde_json::Value;
use tokio::sync::broadcast;

use crate::{FleetState, SharedFleet};
use crawler_commands::Totals;
use crawler_system::clock;
use encode::Sample;
pub use encode::drawn_kind;

/// Time between two looks at the fleet.
pub const INTERVAL: Duration = Duration::from_millis(100);
/// Frames a reader may be behind: ten seconds of everything. With the largest fleet all moving
/// that is 25 MB, once for all readers.
const RING: usize = 256;
/// Events told one by one in a tick; beyond that their number.
const EVENTS_PER_TICK: usize = 20;
/// Events a new reader gets to see.
const EVENTS_AT_START: usize = 50;

/// The feed.
pub struct Feed {
    fleet: Fleet,
    sender: broadcast::Sender<Bytes>,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    /// The simulated arena; null for robots out in the world.
    arena: Value,
    /// What readers have been told last, by index.
    told: Vec<Option<Sample>>,
    next_event: u64,
    metrics_at: Option<Instant>,
    messages: u64,
}

/// What the metrics frame tells beyond the fleet.
#[derive(Debug, Clone, Copy)]
pub struct Numbers {
    /// From robots, since the start.
    pub messages_in: u64,
    /// Commands so far.
    pub commands: Totals,
    /// Of the simulated world, where there is one; 1 is as fast as time.
    pub real_time_factor: Option<f64>,
}

impl Feed {
    /// Without readers.
    pub fn new(fleet: Fleet) -> Self {
        Self {
            fleet,
            sender: broadcast::Sender::new(RING),
            state: Mutex::default(),
        }
    }

    /// Makes the simulated arena known, to readers who are here as well: they are told hello once
    /// more. Returns the bytes of that frame.
    pub fn set_arena(&self, arena: Value) -> usize {
        let mut state = self.state();
        state.arena = arena;
        if self.sender.receiver_count() == 0 {
            return 0;
        }
        let hello = encode::hello(&self.fleet, clock::unix_ms(), &state.arena);
        let bytes = hello.len();
        // An error says that nobody listens any more.
        let _ = self.sender.send(hello);
        bytes
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The snapshot for a new reader, and what follows it.
    pub fn connect(&self, fleet: &SharedFleet) -> (Vec<Bytes>, broadcast::Receiver<Bytes>) {
        // Under this lock no frame goes out, so none is missed and none comes twice.
        let state = self.state();
        let receiver = self.sender.subscribe();
        let fleet = fleet.lock();
        let mut frames = vec![
            encode::hello(&self.fleet, clock::unix_ms(), &state.arena),
            encode::roster(&fleet, fleet.robots(), &[]),
        ];
        let samples: Vec<_> = fleet
            .robots()
            .filter_map(|robot| Sample::of(robot).map(|sample| (robot.index, sample)))
            .collect();
        frames.push(encode::poses(true, clock::unix_ms(), &samples));
        frames.extend(
            fleet
                .events
                .newest(EVENTS_AT_START)
                .filter_map(encode::event),
        );
        (frames, receiver)
    }

    /// Looks at the fleet and sends what is new.
    pub fn tick(&self, fleet: &SharedFleet, now: Instant, numbers: impl Fn() -> Numbers) {
        let mut state = self.state();
        let mut fleet = fleet.lock();
        fleet.sweep(now);
        let changes = fleet.take_roster_changes();
        for index in &changes.removed {
            if let Some(told) = state.told.get_mut(usize::from(*index)) {
                *told = None;
            }
        }
        let mut frames = Vec::new();
        if self.sender.receiver_count() == 0 {
            // Nobody listens. Whoever connects gets a snapshot and the events in it.
            let (_, _, next) = fleet.events.since(state.next_event);
            state.next_event = next;
        } else {
            // An index may have changed hands between two ticks: away with the old robot first.
            if !changes.removed.is_empty() {
                frames.push(encode::roster(&fleet, std::iter::empty(), &changes.removed));
            }
            if !changes.changed.is_empty() {
                let changed = fleet
                    .robots()
                    .filter(|robot| changes.changed.contains(&robot.index));
                frames.push(encode::roster(&fleet, changed, &[]));
            }
            let samples = state.changed_samples(&fleet);
            if !samples.is_empty() {
                frames.push(encode::poses(false, clock::unix_ms(), &samples));
            }
            state.new_events(&fleet, &mut frames);
        }
        let due = state
            .metrics_at
            .is_none_or(|at| now.saturating_duration_since(at) >= Duration::from_secs(1));
        if due {
            let numbers = numbers();
            frames.push(state.metrics(&fleet, now, &numbers));
        }
        drop(fleet);
        for frame in frames {
            // An error says that nobody listens.
            let _ = self.sender.send(frame);
        }
    }
}

impl State {
    fn changed_samples(&mut self, fleet: &FleetState) -> Vec<(u16, Sample)> {
        let mut changed = Vec::new();
        for robot in fleet.robots() {
            let Some(sample) = Sample::of(robot) else {
                continue;
            };
            let index = usize::from(robot.index);
            if self.told.len() <= index {
                self.told.resize(index + 1, None);
            }
            if let Some(told) = self.told.get_mut(index)
                && *told != Some(sample)
            {
                *told = Some(sample);
                changed.push((robot.index, sample));
            }
        }
        changed
    }

    fn new_events(&mut self, fleet: &FleetState, frames: &mut Vec<Bytes>) {
        let (events, lost, next) = fleet.events.since(self.next_event);
        self.next_event = next;
        let events: Vec<_> = events.collect();
        let skip = events.len().saturating_sub(EVENTS_PER_TICK);
        let untold = lost + skip as u64;
        if untold > 0 {
            frames.extend(encode::event(&crate::Event {
                time: clock::unix_ms(),
                level: crate::Level::Info,
                robot: None,
                text: format!("{untold} more events at the same time"),
            }));
        }
        frames.extend(events.into_iter().skip(skip).filter_map(encode::event));
    }

    fn metrics(&mut self, fleet: &FleetState, now: Instant, numbers: &Numbers) -> Bytes {
        let elapsed = self
            .metrics_at
            .map_or(1.0, |at| now.saturating_duration_since(at).as_secs_f64());
        let messages = numbers.messages_in.saturating_sub(self.messages);
        self.metrics_at = Some(now);
        self.messages = numbers.messages_in;
        encode::metrics(fleet, messages as f64 / elapsed.max(0.001), numbers)
    }
}
