//! Lines on their way to the journal, and who waits for them.

use std::collections::BTreeMap;
use std::mem;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use crawler_protocol::RobotId;
use tokio::sync::oneshot;
use tokio_util::sync::CancellationToken;

use super::super::pending::{Leg, Store};
use super::{JournalEntry, Line};

/// Robots of commands that wait to be written, all together. One command is always taken.
const MOST_WAITING: usize = 50_000;

/// Why a command cannot be written down.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Refused {
    /// The disk takes nothing at the moment, or the server is about to end.
    Failing,
    /// Too much waits for it.
    Full,
}

/// What is to be done with the file.
#[derive(Debug)]
pub(super) enum Job {
    Line(Line),
    /// A command is accepted, and somebody wants to know.
    Accept(JournalEntry, oneshot::Sender<()>),
    /// Nothing is owed any more.
    Clear,
}

/// What waits for the thread that writes.
#[derive(Debug, Default)]
pub(super) struct Batch {
    pub(super) jobs: Vec<Job>,
    /// Numbers up to here are to be kept free, whatever becomes of this server.
    pub(super) reserve: Option<u64>,
    /// Nothing follows.
    pub(super) last: bool,
    /// How many jobs there were, with these.
    pub(super) count: u64,
    /// Robots of the commands in it.
    robots: usize,
}

/// Between those who write lines and the thread that brings them to the disk. Nobody who adds to it
/// waits for the disk.
#[derive(Debug, Default)]
pub(crate) struct Lines {
    batch: Mutex<Batch>,
    added: Condvar,
    /// How many jobs are on the disk.
    pub(super) safe: AtomicU64,
    /// The last write failed.
    pub(super) failing: AtomicBool,
    /// The thread has come to its end.
    pub(super) ended: CancellationToken,
}

impl Lines {
    fn batch(&self) -> MutexGuard<'_, Batch> {
        self.batch.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds a job and returns its number.
    fn push(&self, job: Job) -> u64 {
        let mut batch = self.batch();
        batch.jobs.push(job);
        batch.count += 1;
        self.added.notify_one();
        batch.count
    }

    /// Has numbers up to `number` kept free. Whatever is accepted from here on counts as written only
    /// when they are.
    pub(crate) fn reserve(&self, number: u64) {
        let mut batch = self.batch();
        batch.reserve = batch.reserve.max(Some(number));
        self.added.notify_one();
    }

    /// Has everything written, and no more taken. What this returns is cancelled when the thread has come
    /// to its end.
    pub(crate) fn end(&self) -> CancellationToken {
        self.batch().last = true;
        self.added.notify_one();
        self.ended.clone()
    }

    /// Whether commands are refused because they cannot be written down.
    pub(crate) fn is_failing(&self) -> bool {
        self.failing.load(Ordering::Acquire)
    }

    /// Waits for something to do and takes all of it; waits no longer than `most`, if that is given.
    pub(super) fn next(&self, most: Option<Duration>) -> Batch {
        let idle = |batch: &mut Batch| match most {
            // What failed is tried again after a while, whatever comes in between.
            Some(_) => !batch.last,
            None => batch.jobs.is_empty() && batch.reserve.is_none() && !batch.last,
        };
        let batch = self.batch();
        let mut batch = if let Some(most) = most {
            let waited = self.added.wait_timeout_while(batch, most, idle);
            waited.unwrap_or_else(PoisonError::into_inner).0
        } else {
            let waited = self.added.wait_while(batch, idle);
            waited.unwrap_or_else(PoisonError::into_inner)
        };
        let (last, count) = (batch.last, batch.count);
        let rest = Batch {
            last,
            count,
            ..Batch::default()
        };
        mem::replace(&mut *batch, rest)
    }
}

/// Tells when a command is safe on the disk.
///
/// # Cancellation safety
/// The command is written whether or not anybody waits for it.
#[derive(Debug)]
pub(crate) struct Ticket(oneshot::Receiver<()>);

impl Ticket {
    /// Whether the command is on the disk, when that is decided.
    pub(crate) async fn safe(self) -> bool {
        self.0.await.is_ok()
    }

    /// The same for tests outside of any runtime.
    #[cfg(test)]
    pub(crate) fn wait(self) -> bool {
        self.0.blocking_recv().is_ok()
    }

    /// Whether it is decided, and how.
    #[cfg(test)]
    pub(crate) fn decided(&mut self) -> Option<bool> {
        match self.0.try_recv() {
            Ok(()) => Some(true),
            Err(oneshot::error::TryRecvError::Empty) => None,
            Err(oneshot::error::TryRecvError::Closed) => Some(false),
        }
    }
}

/// A new number under which a command is about to go to a robot.
#[derive(Debug, Clone, Copy)]
struct Numbered {
    leg: Leg,
    /// The job that says so.
    job: u64,
}

/// The journal as the commands see it: what is owed, and where lines go. Dropping it has the thread write
/// what waits and end.
#[derive(Debug)]
pub(crate) struct JournalQueue {
    lines: Arc<Lines>,
    /// What is owed to whom, and the number that it is about to go under.
    owed: BTreeMap<(u64, RobotId), Option<Numbered>>,
    /// How many jobs were on the disk when that was looked at last.
    safe: u64,
    /// Whether the disk took nothing then.
    failing: bool,
}

impl JournalQueue {
    pub(super) fn new<'a>(lines: Arc<Lines>, owed: impl Iterator<Item = &'a JournalEntry>) -> Self {
        let owed = owed.flat_map(|owed| owed.robots.keys().map(|robot| (owed.id, robot)));
        let owed = owed.filter_map(|(id, robot)| Some(((id, RobotId::new(robot).ok()?), None)));
        Self {
            owed: owed.collect(),
            lines,
            safe: 0,
            failing: false,
        }
    }

    /// Where jobs go that are none of a command.
    pub(crate) const fn lines(&self) -> &Arc<Lines> {
        &self.lines
    }

    /// Whether a command for so many robots can be written down.
    ///
    /// # Errors
    /// [`Refused`] says why not.
    pub(crate) fn check(&self, robots: usize) -> Result<(), Refused> {
        if self.lines.is_failing() {
            return Err(Refused::Failing);
        }
        let batch = self.lines.batch();
        if batch.last {
            return Err(Refused::Failing);
        }
        let waiting = batch.robots;
        if waiting > 0 && waiting + robots > MOST_WAITING {
            return Err(Refused::Full);
        }
        Ok(())
    }

    /// Notes a command. `None` when there is nothing to note: it is for nobody.
    pub(crate) fn accepted(&mut self, owed: JournalEntry) -> Option<Ticket> {
        if owed.robots.is_empty() {
            return None;
        }
        let robots = owed.robots.keys();
        let robots = robots.filter_map(|robot| RobotId::new(robot).ok());
        self.owed
            .extend(robots.map(|robot| ((owed.id, robot), None)));
        let (sender, receiver) = oneshot::channel();
        self.lines.batch().robots += owed.robots.len();
        self.lines.push(Job::Accept(owed, sender));
        Some(Ticket(receiver))
    }

    /// Notes that nothing at all is to be delivered.
    pub(crate) fn clear(&mut self) {
        self.owed.clear();
        self.lines.push(Job::Clear);
    }
}

impl Store for JournalQueue {
    /// The number that was set aside for a command that waited. Not one below `above`, unless it is not
    /// on the disk yet: another one would only join the queue.
    fn reserved(&mut self, id: u64, robot: &RobotId, above: u64) -> Option<u64> {
        self.safe = self.lines.safe.load(Ordering::Acquire);
        self.failing = self.lines.is_failing();
        let known = (*self.owed.get(&(id, robot.clone()))?)?;
        let waits = known.job > self.safe && !self.failing;
        (known.leg.seq > above || waits).then_some(known.leg.seq)
    }

    /// Whether a command may go under a new number: it is on the disk, since after a crash it must not go
    /// under yet another. If it is not, it is written. While the disk takes nothing it goes all the
    /// same: it was accepted, telling the robot matters more, and others wait behind it.
    fn may_go(&mut self, id: u64, robot: &RobotId, seq: u64, boot: Option<u32>) -> bool {
        let Some(known) = self.owed.get_mut(&(id, robot.clone())) else {
            return true;
        };
        let leg = Leg { seq, boot };
        match known {
            Some(known) if known.job > self.safe && !self.failing => false,
            Some(known) if known.leg == leg => true,
            _ => {
                let robot = robot.as_str().to_owned();
                let job = self
                    .lines
                    .push(Job::Line(Line::Numbered { id, robot, leg }));
                *known = Some(Numbered { leg, job });
                self.failing
            }
        }
    }

    /// Notes that nothing more is to be delivered.
    fn done(&mut self, id: u64, robot: &RobotId) {
        if self.owed.remove(&(id, robot.clone())).is_some() {
            let robot = robot.as_str().to_owned();
            self.lines.push(Job::Line(Line::Done { id, robot }));
        }
    }
}

impl Drop for JournalQueue {
    fn drop(&mut self) {
        self.lines.end();
    }
}
