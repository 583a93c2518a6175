//! The one task that writes the history.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use crawler_database::{Db, Lock, RecordsError};
use crawler_protocol::RobotId;
use tokio::sync::mpsc;

use super::fold::{self, Raw};
use super::memory::{Lots, Shared, Waiting};
use super::retention::{self, Retention};
use super::{MAX_ROBOTS, Sample, codec};

/// How long a sample waits for others.
const TICK: Duration = Duration::from_millis(250);
/// Samples that are worth a row of their own before the tick.
pub(super) const BATCH: usize = 16_384;
/// Most callers that wait for the disk.
pub(super) const MOST_WAITING: usize = 1_024;
/// Samples on disk that are worth being made into blocks, and ...
pub(super) const SEAL_AT: usize = 250_000;
/// ... how long fewer wait for that.
const SEAL_AFTER: Duration = Duration::from_mins(1);
/// How long to leave the disk alone after it refused.
const RETRY_AFTER: Duration = Duration::from_secs(1);
/// How often to look for what is too old.
const RETAIN_EVERY: Duration = Duration::from_mins(1);

/// A sample in the tail: as a [`Raw`], with the number of its robot behind.
pub(super) type TailRow = [i64; 12];

pub(super) struct HistoryWriter {
    pub(super) shared: Arc<Shared>,
    pub(super) db: Db,
    /// Taken from the inbox, and not on disk.
    pending: Vec<Sample>,
    /// Number of the next row of the tail.
    pub(super) next_tail: i64,
    /// Last row of the tail that is in what is being sealed.
    pub(super) sealing_up_to: i64,
    /// Room for the samples of the next seal, left by the last one.
    pub(super) spare: Lots,
    sealed: Instant,
    retained: Instant,
    refused: Option<Instant>,
    /// Shows other processes that the history is kept.
    _lock: Option<Lock>,
}

impl HistoryWriter {
    pub(super) fn new(shared: Arc<Shared>, db: Db, next_tail: i64, lock: Option<Lock>) -> Self {
        let now = Instant::now();
        Self {
            shared,
            db,
            pending: Vec::new(),
            next_tail,
            sealing_up_to: 0,
            spare: Lots::new(),
            sealed: now,
            retained: now,
            refused: None,
            _lock: lock,
        }
    }

    /// Runs until the sender of `alive` is gone, and then writes what is left.
    pub(super) async fn run(mut self, mut alive: mpsc::Receiver<()>) {
        loop {
            let ends = tokio::select! {
                () = self.shared.wake.notified() => false,
                () = tokio::time::sleep(TICK) => false,
                _ = alive.recv() => true,
            };
            if ends {
                self.shared.inbox().open = false;
                self.refused = None;
            }
            if self.refused.is_some_and(|at| at.elapsed() < RETRY_AFTER) {
                continue;
            }
            self.write().await;
            if ends {
                break;
            }
            let open = self.shared.memory().open_count;
            if open >= SEAL_AT || self.sealed.elapsed() >= SEAL_AFTER || self.is_sealing() {
                self.sealed = Instant::now();
                let outcome = self.seal().await;
                self.note(outcome);
            }
            if self.retained.elapsed() >= RETAIN_EVERY {
                self.retained = Instant::now();
                let now = retention::now();
                let kept =
                    retention::apply(&self.shared, &self.db, Retention::default(), now).await;
                self.note(kept.map(|_| ()));
            }
        }
        // The rest is in the tail, which the next start reads.
        self.db.close().await;
    }

    fn is_sealing(&self) -> bool {
        self.shared.memory().sealing.is_some()
    }

    /// Writes what came in, and answers who waits for it.
    async fn write(&mut self) {
        let (waiting, settling) = {
            let mut inbox = self.shared.inbox();
            (
                std::mem::take(&mut inbox.waiting),
                std::mem::take(&mut inbox.settling),
            )
        };
        let mut outcome = self.write_all().await;
        answer(waiting, &outcome);
        if outcome.is_ok() && !settling.is_empty() {
            outcome = self.seal().await;
        }
        answer(settling, &outcome);
        self.note(outcome);
    }

    async fn write_all(&mut self) -> Result<(), RecordsError> {
        // What an earlier attempt left behind goes first.
        if !self.pending.is_empty() {
            self.write_tail().await?;
        }
        if self.shared.memory().open_count >= 2 * SEAL_AT {
            // Blocks cannot be written: rather refuse samples than run out of memory.
            return Err(RecordsError::TooMany("samples that are in no block"));
        }
        {
            let mut inbox = self.shared.inbox();
            let next = Vec::with_capacity(inbox.samples.len());
            self.pending = std::mem::replace(&mut inbox.samples, next);
        }
        if self.pending.is_empty() {
            return Ok(());
        }
        self.write_tail().await
    }

    fn note(&mut self, outcome: Result<(), RecordsError>) {
        match outcome {
            Ok(()) => self.refused = None,
            Err(error) => {
                tracing::warn!(%error, "the history cannot be written; trying again");
                self.shared.counts.failures.fetch_add(1, Ordering::Relaxed);
                self.refused = Some(Instant::now());
            }
        }
    }

    async fn write_tail(&mut self) -> Result<(), RecordsError> {
        let (mut rows, fresh) = self.number();
        // Neighbours of one robot are alike, and so are short.
        rows.sort_by_key(|row| row[11]);
        let tail: Vec<(i64, Vec<u8>)> = rows
            .chunks(BATCH)
            .zip(self.next_tail..)
            .map(|(rows, id)| (id, codec::encode(rows)))
            .collect();
        let after = self.next_tail + tail.len() as i64;
        let robots: Vec<(i64, String)> = fresh
            .iter()
            .map(|(robot, &number)| (number, robot.to_string()))
            .collect();
        self.db
            .write(move |connection| {
                Box::pin(async move {
                    for (number, robot) in robots {
                        sqlx::query("INSERT INTO robot (id, name) VALUES (?, ?)")
                            .bind(number)
                            .bind(robot)
                            .execute(&mut *connection)
                            .await?;
                    }
                    for (id, data) in tail {
                        sqlx::query("INSERT INTO tail (id, data) VALUES (?, ?)")
                            .bind(id)
                            .bind(data)
                            .execute(&mut *connection)
                            .await?;
                    }
                    Ok(())
                })
            })
            .await?;
        self.next_tail = after;
        self.pending.clear();
        let written = rows.len() as u64;
        let mut memory = self.shared.memory();
        memory.next_robot += fresh.len() as i64;
        memory.numbers.extend(fresh);
        memory.open_count += rows.len();
        for row in &rows {
            let (raw, number) = split(row);
            memory.open.entry(number).or_default().push(raw);
        }
        drop(memory);
        self.shared
            .counts
            .written
            .fetch_add(written, Ordering::Relaxed);
        Ok(())
    }

    /// What is pending in whole numbers, and the robots that had no number yet.
    fn number(&self) -> (Vec<TailRow>, HashMap<RobotId, i64>) {
        let memory = self.shared.memory();
        let mut fresh = HashMap::new();
        let mut rows = Vec::with_capacity(self.pending.len());
        let (mut next, mut beyond) = (memory.next_robot, 0);
        for sample in &self.pending {
            let robot = &sample.robot;
            let known = memory.numbers.get(robot).or_else(|| fresh.get(robot));
            let number = if let Some(&number) = known {
                number
            } else {
                if memory.numbers.len() + fresh.len() >= MAX_ROBOTS {
                    beyond += 1;
                    continue;
                }
                fresh.insert(robot.clone(), next);
                next += 1;
                next - 1
            };
            let mut row = [number; 12];
            row[..11].copy_from_slice(&fold::raw(sample));
            rows.push(row);
        }
        drop(memory);
        self.shared
            .counts
            .beyond
            .fetch_add(beyond, Ordering::Relaxed);
        (rows, fresh)
    }
}

fn answer(waiting: Vec<Waiting>, outcome: &Result<(), RecordsError>) {
    for waiting in waiting {
        // Whoever stopped waiting need not know.
        let _ = waiting.send(outcome.clone());
    }
}

/// A row of the tail as sample and number of its robot.
pub(super) fn split(row: &TailRow) -> (Raw, i64) {
    let mut raw = [0; 11];
    raw.copy_from_slice(&row[..11]);
    (raw, row[11])
}
