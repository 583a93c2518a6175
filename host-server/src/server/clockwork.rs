//! What the server does by the clock.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use crawler_protocol::{MAX_MESSAGE, TimeMessage, Topic};
use crawler_records::Records;
use tokio::sync::Notify;
use tokio_util::sync::CancellationToken;

use super::cells::Cells;
use super::outcome_log::OutcomeLog;
use super::watch::Watch;
use super::writable::Writable;
use crawler_accounts::Accounts;
use crawler_broker::BrokerHandle;
use crawler_cluster::ClusterMembership;
use crawler_commands::CommandCenter;
use crawler_fleet::bus::Bus;
use crawler_fleet::enforcement;
use crawler_fleet::feed::{self, Feed, Numbers};
use crawler_fleet::{Level, SharedFleet};
use crawler_metrics::Metrics;
use crawler_records::audit_log::AuditLog;
use crawler_simulations::Simulation;
use crawler_system::clock;

/// What another process changes about sessions holds after this time.
const CATCH_UP: Duration = Duration::from_secs(5);
/// How often what is over is taken out of the records.
const PRUNE: Duration = Duration::from_hours(1);

/// What happens by the clock: the feed, overdue answers, what cannot be written, the time for robots and who
/// is near them.
pub(super) struct Clockwork {
    pub(super) fleet: Arc<SharedFleet>,
    pub(super) commands: Arc<CommandCenter>,
    pub(super) bus: Arc<Bus>,
    pub(super) feed: Arc<Feed>,
    pub(super) metrics: Arc<Metrics>,
    pub(super) audit: Arc<AuditLog>,
    pub(super) simulation: Arc<OnceLock<Arc<Simulation>>>,
    pub(super) membership: Option<Arc<ClusterMembership>>,
    pub(super) outcomes: OutcomeLog,
    /// Whether a robot has come online since the time last went out.
    pub(super) time_wanted: Arc<AtomicBool>,
}

impl Clockwork {
    /// Does all of it until `stop`.
    pub(super) async fn run(self, stop: CancellationToken) {
        let mut tick = tokio::time::interval(feed::INTERVAL);
        tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
        let mut time_sent: Option<Instant> = None;
        let mut cells = Cells::default();
        let mut writable = Writable::default();
        loop {
            tokio::select! {
                () = stop.cancelled() => return,
                _ = tick.tick() => {}
            }
            let now = Instant::now();
            self.feed.tick(&self.fleet, now, || Numbers {
                messages_in: self.metrics.messages_in_total(),
                commands: self.commands.totals(),
                real_time_factor: self
                    .simulation
                    .get()
                    .map(|world| world.numbers().real_time_factor),
            });
            for command in self.commands.sweep(now) {
                self.outcomes.tell(&command);
            }
            writable.tell(&self.commands, &self.audit, &self.fleet);
            let wanted = self.time_wanted.load(Ordering::Relaxed);
            let wait = self.commands.time.tell_after(wanted);
            let due = time_sent.is_none_or(|at| now.saturating_duration_since(at) >= wait);
            // Of several servers one tells robots who is near, and the time.
            let membership = self.membership.as_ref();
            let leads = membership.is_none_or(|membership| membership.leads());
            if leads {
                let unix = self.commands.time.now_ms();
                cells.tell(&self.fleet, &self.bus, unix, now);
            }
            // After a reconnect the first message goes out with the next tick.
            if !self.bus.is_up() {
                time_sent = None;
            } else if due {
                time_sent = Some(now);
                self.time_wanted.store(false, Ordering::Relaxed);
                self.tell_time(leads);
            }
        }
    }

    /// Tells robots the time. A server that another one leads follows in the same way a clock that was set: that
    /// of its leader was set as well, or it is for whoever set the one to set the other.
    fn tell_time(&self, leads: bool) {
        let telling = self.commands.time.tell();
        if let Some(ms) = telling.set_by_ms {
            let seconds = ms as f64 / 1_000.0;
            let text = format!("the server's clock was set by {seconds:+.1} s");
            self.fleet.lock().events.push(Level::Warn, None, text);
        }
        if !leads {
            return;
        }
        let message = TimeMessage {
            timestamp: telling.unix_ms,
        };
        let mut buffer = [0; MAX_MESSAGE];
        match message.to_json(&mut buffer) {
            Ok(length) => {
                let payload = buffer.get(..length).unwrap_or_default();
                if let Err(error) = self.bus.publish(&Topic::Time, payload) {
                    tracing::debug!(?error, "the time did not go out");
                }
            }
            Err(error) => tracing::error!(?error, "the time cannot be written"),
        }
    }
}

/// What happens to the records by the clock.
pub(super) struct Upkeep {
    pub(super) records: Records,
    pub(super) fleet: Arc<SharedFleet>,
    pub(super) accounts: Arc<Accounts>,
    /// The embedded broker, when it is ours.
    pub(super) broker: Option<BrokerHandle>,
    /// Another server has changed something in the records.
    pub(super) records_changed: Arc<Notify>,
}

impl Upkeep {
    /// Does all of it until `stop`.
    pub(super) async fn run(self, stop: CancellationToken) {
        let mut pruned: Option<Instant> = None;
        let mut watch = Watch::default();
        // From here on changes count. Should it fail, the first look below takes its place.
        let _ = watch.changed(&self.records).await;
        loop {
            tokio::select! {
                () = stop.cancelled() => return,
                () = tokio::time::sleep(CATCH_UP) => {}
                // Another server tells that it has changed something.
                () = self.records_changed.notified() => {}
            }
            enforcement::catch_up(self.records.fences(), &self.fleet).await;
            if let Err(error) = self.accounts.catch_up().await {
                tracing::warn!(%error, "cannot read which sessions are alive");
            }
            match watch.changed(&self.records).await {
                Ok(names) => {
                    // Sessions at an outside broker are not this server's to end.
                    if let Some(broker) = &self.broker {
                        for (kind, name) in names {
                            broker.drop_client(kind, &name).await;
                        }
                    }
                }
                Err(error) => tracing::warn!(%error, "cannot read what the console changed"),
            }
            if pruned.is_none_or(|at| at.elapsed() >= PRUNE) {
                pruned = Some(Instant::now());
                if let Err(error) = self.records.prune(clock::now_ms()).await {
                    tracing::warn!(%error, "cannot forget sessions that are over");
                }
            }
        }
    }
}
