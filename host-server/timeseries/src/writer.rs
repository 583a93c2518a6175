//! The one task that writes to the engine.

use std::mem::{Discriminant, discriminant};
use std::sync::Arc;
use std::time::Duration;

use hyper::Method;
use hyper::body::Bytes;
use tokio::sync::mpsc;
use tokio::time::Instant;

use crate::address::encoded;
use crate::client::Client;
use crate::engine::{self, Engine};
use crate::error::EngineError;
use crate::line::push_line;
use crate::shared::{MANY, Shared, State};

/// How long a sample waits for others.
const TICK: Duration = Duration::from_millis(250);
/// First and longest wait before an engine is tried again.
const RETRY: (Duration, Duration) = (Duration::from_millis(250), Duration::from_secs(5));
/// After so long without a request the engine is asked whether it is still there.
const SILENCE: Duration = Duration::from_secs(10);
/// Refused batches are worth one line in so long a time.
const QUIET: Duration = Duration::from_secs(10);
/// For what waits when the server stops.
const FINISH: Duration = Duration::from_secs(3);
/// Bytes of a line, about.
const LINE: usize = 180;

/// Lines on their way.
struct Batch {
    text: Bytes,
    count: u64,
}

pub(crate) struct Writer {
    shared: Arc<Shared>,
    client: Arc<Client>,
    fleet: String,
    target: String,
    batch: Option<Batch>,
    /// The engine that is there, unless it has to be looked for.
    engine: Option<Engine>,
    /// Whether it has been told that it is there.
    announced: bool,
    /// What was told last of an engine that is not there.
    complaint: Option<Discriminant<EngineError>>,
    wait: Duration,
    heard: Instant,
    /// When a refused batch was told of last, and samples refused since.
    refusal: Option<Instant>,
    untold: u64,
}

impl Writer {
    pub(crate) fn new(shared: Arc<Shared>, client: Arc<Client>, fleet: String) -> Self {
        let database = encoded(&client.address().database);
        Self {
            target: format!("/write?db={database}&precision=ms"),
            shared,
            client,
            fleet,
            batch: None,
            engine: None,
            announced: false,
            complaint: None,
            wait: RETRY.0,
            heard: Instant::now(),
            refusal: None,
            untold: 0,
        }
    }

    /// Runs until the sender of `alive` is gone, and then writes what is left, for a while.
    pub(crate) async fn run(mut self, mut alive: mpsc::Receiver<()>) {
        while !alive.is_closed() {
            let Some(pause) = self.work().await else {
                continue;
            };
            // An engine that is away is not asked sooner because more comes in.
            let awake = self.engine.is_some();
            tokio::select! {
                () = self.shared.wake.notified(), if awake => {}
                () = tokio::time::sleep(pause) => {}
                _ = alive.recv() => {}
            }
        }
        self.finish().await;
    }

    /// Does what is next, and says how long nothing needs to be done; `None` when there is more.
    async fn work(&mut self) -> Option<Duration> {
        if self.engine.is_none() {
            match engine::prepare(&self.client).await {
                Ok(engine) => self.engine = Some(engine),
                Err(error) => return Some(self.failed(error)),
            }
            self.heard = Instant::now();
            // Where something waits, taking it is the proof.
            if self.batch.is_none() {
                self.announce();
            }
        }
        if self.batch.is_none() {
            self.batch = self.take();
        }
        let Some(batch) = &self.batch else {
            return self.listen().await;
        };
        let (text, count) = (batch.text.clone(), batch.count);
        let sent = self.client.send(Method::POST, &self.target, text).await;
        match sent.and_then(|answer| answer.accepted().map(drop)) {
            Ok(()) => self.settle(count, 0),
            Err(error) if error.may_pass() => return Some(self.failed(error)),
            Err(error) => {
                let refused = refused_of(&error, count);
                self.refused(&error, refused);
                self.settle(count - refused, refused);
            }
        }
        (self.shared.waiting() < MANY).then_some(TICK)
    }

    fn take(&self) -> Option<Batch> {
        let samples = self.shared.take();
        let mut text = String::with_capacity(samples.len() * LINE);
        for sample in &samples {
            push_line(&mut text, &self.fleet, sample);
        }
        (!samples.is_empty()).then(|| Batch {
            text: text.into(),
            count: samples.len() as u64,
        })
    }

    fn settle(&mut self, written: u64, refused: u64) {
        self.batch = None;
        self.heard = Instant::now();
        self.shared.settle(written, refused);
        self.announce();
    }

    /// Nothing is to be written: finds out now and then whether the engine is still there.
    async fn listen(&mut self) -> Option<Duration> {
        if self.heard.elapsed() >= SILENCE {
            if let Err(error) = self.client.get("/ping").await {
                return Some(self.failed(error));
            }
            self.heard = Instant::now();
        }
        Some(TICK)
    }

    /// Tells that the engine takes samples, where that is news.
    fn announce(&mut self) {
        self.wait = RETRY.0;
        self.complaint = None;
        let Some(engine) = self.engine.as_ref().filter(|_| !self.announced) else {
            return;
        };
        self.announced = true;
        self.shared.met(engine.clone());
        self.shared.set_state(State::Up);
        let (address, product) = (self.client.address(), &engine.product);
        if engine.dialect.is_some() {
            tracing::info!(%address, %product, "the history is kept by this engine");
        } else {
            tracing::warn!(
                %address,
                %product,
                "the history is written to this engine, but cannot be asked for here: {}",
                EngineError::Unreadable.advice()
            );
        }
    }

    /// Tells that the engine is away, where that is news, and says how long to leave it alone.
    fn failed(&mut self, error: EngineError) -> Duration {
        self.engine = None;
        self.announced = false;
        let kind = discriminant(&error);
        if self.complaint != Some(kind) {
            self.complaint = Some(kind);
            tracing::warn!(
                address = %self.client.address(),
                reason = %error,
                "the history's engine cannot be used, samples wait for it: {}",
                error.advice()
            );
        }
        self.shared.failed(error);
        let wait = self.wait;
        self.wait = (wait * 2).min(RETRY.1);
        wait
    }

    fn refused(&mut self, error: &EngineError, count: u64) {
        self.untold += count;
        if self.refusal.is_none_or(|at| at.elapsed() >= QUIET) {
            self.refusal = Some(Instant::now());
            tracing::error!(
                address = %self.client.address(),
                samples = self.untold,
                reason = %error,
                "the history's engine refused samples, which are lost: {}",
                error.advice()
            );
            self.untold = 0;
        }
    }

    /// Writes what is left where that does not take long.
    async fn finish(&mut self) {
        self.shared.shut();
        let end = Instant::now() + FINISH;
        // The engine may have come back since it was tried last.
        while self.batch.is_some() || self.shared.waiting() > 0 {
            match tokio::time::timeout_at(end, self.work()).await {
                Err(_) => break,
                Ok(Some(_)) if self.engine.is_none() => {
                    if Instant::now() + RETRY.0 >= end {
                        break;
                    }
                    tokio::time::sleep(RETRY.0).await;
                }
                Ok(_) => {}
            }
        }
        let lost = self.shared.close();
        if lost > 0 {
            tracing::error!(
                address = %self.client.address(),
                samples = lost,
                "the history's engine did not take these samples before the server stopped"
            );
        }
    }
}

/// How many of `count` samples are lost: `InfluxDB` takes the rest of a batch and says so.
fn refused_of(error: &EngineError, count: u64) -> u64 {
    let text = error.to_string();
    let partial = text
        .contains("partial write")
        .then(|| text.rsplit_once("dropped=")?.1.parse().ok())
        .flatten();
    partial.unwrap_or(count).min(count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn part_of_a_batch_may_be_refused() {
        let refused = |text: &str| refused_of(&EngineError::Refused(text.to_owned()), 100);
        assert_eq!(refused("400 partial write: beyond retention dropped=7"), 7);
        assert_eq!(refused("400 partial write: odd dropped=x"), 100);
        assert_eq!(refused("400 partial write: odd dropped=900"), 100);
        assert_eq!(refused("400 unable to parse"), 100);
    }
}
