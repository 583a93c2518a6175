//! Events and changes of the arena on their way to the records: nobody waits for the disk.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crawler_records::{Event, EventRetention, Records, RecordsError};
use serde_json::Value;
use tokio_util::sync::CancellationToken;

use crawler_cluster::ClusterMembership;
use crawler_metrics::Exposition;
use crawler_system::clock::now_ms;

/// Events that wait to be written.
const EVENTS: usize = 8_192;
/// Arenas that wait. Where there are more, the newest takes the place of the one before it.
const ARENAS: usize = 64;
/// How long an event waits for others.
const TICK: Duration = Duration::from_millis(500);
/// Before something is tried again that a database did not take.
const AGAIN: Duration = Duration::from_secs(1);
/// How often to look for what is too old, or too much.
const RETAIN_EVERY: Duration = Duration::from_mins(10);

/// Who comes to know of an event.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Known {
    /// This server alone.
    Here,
    /// Every server of the fleet, from what robots say: one of them records it.
    Everywhere,
}

#[derive(Debug, Default)]
struct Inbox {
    events: Vec<Event>,
    /// With their times. None is an arena that is none.
    arenas: VecDeque<(i64, Option<String>)>,
}

impl Inbox {
    fn is_empty(&self) -> bool {
        self.events.is_empty() && self.arenas.is_empty()
    }

    fn len(&self) -> usize {
        self.events.len() + self.arenas.len()
    }
}

/// How it goes, since the start.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Stats {
    /// Events in the records.
    pub written: u64,
    /// Events let go because too many waited, or because the records refused them.
    pub dropped: u64,
    /// Writes that failed.
    pub failures: u64,
    /// Events that wait.
    pub queued: usize,
}

struct Inner {
    inbox: Mutex<Inbox>,
    membership: Option<Arc<ClusterMembership>>,
    written: AtomicU64,
    dropped: AtomicU64,
    failures: AtomicU64,
}

/// Takes what is to be recorded. A clone is another handle of the same.
#[derive(Clone)]
pub struct Recorder(Arc<Inner>);

impl std::fmt::Debug for Recorder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("Recorder").field(&self.stats()).finish()
    }
}

impl Recorder {
    /// A recorder for one of the servers in `membership`, or for the only one.
    pub fn new(membership: Option<Arc<ClusterMembership>>) -> Self {
        Self(Arc::new(Inner {
            inbox: Mutex::default(),
            membership,
            written: AtomicU64::new(0),
            dropped: AtomicU64::new(0),
            failures: AtomicU64::new(0),
        }))
    }

    fn inbox(&self) -> MutexGuard<'_, Inbox> {
        self.0.inbox.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes an event, without waiting. One too many is counted as dropped.
    pub fn record(&self, event: Event, known: Known) {
        let leads = || self.0.membership.as_ref().is_none_or(|all| all.leads());
        if known == Known::Everywhere && !leads() {
            return;
        }
        let mut inbox = self.inbox();
        if inbox.events.len() >= EVENTS {
            drop(inbox);
            self.0.dropped.fetch_add(1, Ordering::Relaxed);
            return;
        }
        inbox.events.push(event);
    }

    /// Takes note that the simulated arena is `arena` from now on, `null` where there is none. Call it
    /// whenever it may have changed: one that is as it was is not recorded again.
    pub fn record_arena(&self, arena: &Value) {
        let arena = (!arena.is_null()).then(|| arena.to_string());
        let mut inbox = self.inbox();
        if inbox.arenas.len() >= ARENAS {
            inbox.arenas.pop_back();
        }
        inbox.arenas.push_back((now_ms(), arena));
    }

    /// How it goes.
    pub fn stats(&self) -> Stats {
        Stats {
            written: self.0.written.load(Ordering::Relaxed),
            dropped: self.0.dropped.load(Ordering::Relaxed),
            failures: self.0.failures.load(Ordering::Relaxed),
            queued: self.inbox().events.len(),
        }
    }

    /// How events get into the records.
    pub fn write_metrics(&self, out: &mut Exposition) {
        let stats = self.stats();
        for (name, help, value) in [
            ("written", "Events in the records", stats.written),
            (
                "dropped",
                "Events let go because too many were waiting, or the records refused them",
                stats.dropped,
            ),
            ("failures", "Writes of events that failed", stats.failures),
        ] {
            out.counter(&format!("terracrawler_events_{name}"), help, value as f64);
        }
        out.gauge(
            "terracrawler_events_queued",
            "Events waiting to be written",
            stats.queued as f64,
        );
    }

    /// What writes to `records` what comes in.
    pub fn writer(&self, records: Records) -> Writer {
        Writer {
            recorder: self.clone(),
            records,
            pending: Inbox::default(),
            complained: false,
        }
    }
}

/// What writes; there is one.
pub struct Writer {
    recorder: Recorder,
    records: Records,
    /// Taken from the inbox, and not written.
    pending: Inbox,
    complained: bool,
}

impl Writer {
    /// Writes what comes in, until `stop`, and then what is left.
    pub async fn run(mut self, stop: CancellationToken) {
        let mut retained: Option<Instant> = None;
        loop {
            let wait = if self.pending.is_empty() { TICK } else { AGAIN };
            tokio::select! {
                () = stop.cancelled() => {}
                () = tokio::time::sleep(wait) => {}
            }
            let ends = stop.is_cancelled();
            self.write().await;
            if self.pending.is_empty() {
                self.pending = std::mem::take(&mut *self.recorder.inbox());
                self.write().await;
            }
            if ends {
                let lost = self.pending.len();
                if lost > 0 {
                    tracing::error!(lost, "events were not recorded before the server stopped");
                }
                return;
            }
            if retained.is_none_or(|at| at.elapsed() >= RETAIN_EVERY) {
                retained = Some(Instant::now());
                let kept = self
                    .records
                    .prune_events(EventRetention::default(), now_ms());
                if let Err(error) = kept.await {
                    tracing::warn!(%error, "old events cannot be forgotten");
                }
            }
        }
    }

    /// Writes what is pending. What the records do not take for now stays.
    async fn write(&mut self) {
        while let Some((at, arena)) = self.pending.arenas.front().cloned() {
            let outcome = self.records.arenas().add(at, arena).await;
            if !self.is_settled(outcome, 0) {
                return;
            }
            self.pending.arenas.pop_front();
        }
        if self.pending.events.is_empty() {
            return;
        }
        let count = self.pending.events.len() as u64;
        let outcome = self.records.events().add(self.pending.events.clone()).await;
        if self.is_settled(outcome, count) {
            self.pending.events.clear();
        }
    }

    /// Counts what came of writing so many events. `false` where they are worth another try.
    fn is_settled(&mut self, outcome: Result<(), RecordsError>, events: u64) -> bool {
        let inner = &self.recorder.0;
        let error = match outcome {
            Ok(()) => {
                self.complained = false;
                inner.written.fetch_add(events, Ordering::Relaxed);
                return true;
            }
            Err(error) => error,
        };
        inner.failures.fetch_add(1, Ordering::Relaxed);
        if !std::mem::replace(&mut self.complained, true) {
            tracing::warn!(%error, "events cannot be recorded");
        }
        if error.is_passing() {
            return false;
        }
        inner.dropped.fetch_add(events, Ordering::Relaxed);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crawler_records::{EventLevel, EventQuery};
    use serde_json::json;

    fn event(text: &str) -> Event {
        Event {
            at: 5,
            level: EventLevel::Warn,
            robot: None,
            text: text.to_owned(),
        }
    }

    #[tokio::test]
    async fn what_waits_is_bounded_and_written_at_the_end() {
        let records = Records::in_memory().await.expect("records");
        let recorder = Recorder::new(None);
        for n in 0..EVENTS + 3 {
            recorder.record(event(&format!("event {n}")), Known::Everywhere);
        }
        for n in 0..ARENAS + 5 {
            recorder.record_arena(&json!({ "width": n }));
        }
        let stats = recorder.stats();
        assert_eq!((stats.queued, stats.dropped), (EVENTS, 3), "{stats:?}");

        let stop = CancellationToken::new();
        stop.cancel();
        recorder.writer(records.clone()).run(stop).await;
        let stats = recorder.stats();
        assert_eq!(
            (stats.queued, stats.written),
            (0, EVENTS as u64),
            "{stats:?}"
        );
        let newest = EventQuery {
            from: 0,
            to: i64::MAX,
            level: EventLevel::Info,
            robot: None,
            before: None,
            limit: 1,
        };
        let found = records.events().page(newest).await.expect("events");
        assert_eq!(found[0].event.text, format!("event {}", EVENTS - 1));
        // The newest arena is there, whatever was left out before it.
        let arena = records.arenas().at(i64::MAX).await.expect("an arena");
        let width = ARENAS + 4;
        assert_eq!(arena, Some(json!({ "width": width }).to_string()));
        let arenas = records
            .arenas()
            .changes(0, i64::MAX, 1)
            .await
            .expect("arenas");
        assert!(arenas.len() <= ARENAS, "{}", arenas.len());
        records.close().await;
    }

    #[tokio::test]
    async fn events_that_records_refuse_are_counted() {
        let records = Records::in_memory().await.expect("records");
        records.close().await;
        let recorder = Recorder::new(None);
        recorder.record(event("lost"), Known::Here);
        let stop = CancellationToken::new();
        stop.cancel();
        recorder.writer(records).run(stop).await;
        let stats = recorder.stats();
        assert_eq!((stats.dropped, stats.written), (1, 0), "{stats:?}");
        assert_eq!(stats.failures, 1, "{stats:?}");
    }
}
