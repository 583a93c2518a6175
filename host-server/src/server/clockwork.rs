//! What the server does by the clock.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use crawler_protocol::{MAX_MESSAGE, TimeMessage, Topic};
use tokio_util::sync::CancellationToken;

use super::cells::Cells;
use super::ingest;
use super::watch::Watch;
use super::writable::Writable;
use crate::accounts;
use crate::feed::{self, Numbers};
use crate::fences;
use crate::fleet::Level;
use crate::http::App;

/// What another process changes about sessions holds after this time.
const CATCH_UP: Duration = Duration::from_secs(5);
/// How often what is over is taken out of the records.
const PRUNE: Duration = Duration::from_hours(1);

/// What happens by the clock: the feed, overdue answers, what cannot be written, the time for robots and who
/// is near them.
pub(super) async fn run_periodic(app: Arc<App>, stop: CancellationToken) {
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
        app.feed.tick(&app.fleet, now, || Numbers {
            messages_in: app.metrics.messages_in_total(),
            commands: app.commands.totals(),
            real_time_factor: app
                .simulation
                .get()
                .map(|world| world.numbers().real_time_factor),
        });
        for command in app.commands.sweep(now) {
            ingest::tell(&app, &command);
        }
        writable.tell(&app);
        let wanted = app.time_wanted.load(Ordering::Relaxed);
        let wait = app.commands.time.tell_after(wanted);
        let due = time_sent.is_none_or(|at| now.saturating_duration_since(at) >= wait);
        // Of several servers one tells robots who is near, and the time.
        let membership = app.membership.as_ref();
        let leads = membership.is_none_or(|membership| membership.leads());
        if leads {
            cells.tell(&app, now);
        }
        // After a reconnect the first message goes out with the next tick.
        if !app.bus.is_up() {
            time_sent = None;
        } else if due {
            time_sent = Some(now);
            app.time_wanted.store(false, Ordering::Relaxed);
            tell_time(&app, leads);
        }
    }
}

/// What happens to the records by the clock.
pub(super) async fn upkeep(app: Arc<App>, stop: CancellationToken) {
    let mut pruned: Option<Instant> = None;
    let mut watch = Watch::default();
    // From here on changes count. Should it fail, the first look below takes its place.
    let _ = watch.changed(&app.records).await;
    loop {
        tokio::select! {
            () = stop.cancelled() => return,
            () = tokio::time::sleep(CATCH_UP) => {}
            // Another server tells that it has changed something.
            () = app.records_changed.notified() => {}
        }
        fences::catch_up(&app).await;
        if let Err(error) = app.accounts.catch_up().await {
            tracing::warn!(%error, "cannot read which sessions are alive");
        }
        match watch.changed(&app.records).await {
            Ok(names) => {
                for (kind, name) in names {
                    app.drop_client(kind, &name).await;
                }
            }
            Err(error) => tracing::warn!(%error, "cannot read what the console changed"),
        }
        if pruned.is_none_or(|at| at.elapsed() >= PRUNE) {
            pruned = Some(Instant::now());
            if let Err(error) = app.records.prune(accounts::now_ms()).await {
                tracing::warn!(%error, "cannot forget sessions that are over");
            }
        }
    }
}

/// Tells robots the time. A server that another one leads follows in the same way a clock that was set: that
/// of its leader was set as well, or it is for whoever set the one to set the other.
fn tell_time(app: &App, leads: bool) {
    let telling = app.commands.time.tell();
    if let Some(ms) = telling.set_by_ms {
        let seconds = ms as f64 / 1_000.0;
        let text = format!("the server's clock was set by {seconds:+.1} s");
        app.fleet.lock().events.push(Level::Warn, None, text);
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
            if let Err(error) = app.bus.publish(&Topic::Time, payload) {
                tracing::debug!(?error, "the time did not go out");
            }
        }
        Err(error) => tracing::error!(?error, "the time cannot be written"),
    }
}
