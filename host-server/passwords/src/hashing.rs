//! Hashing passwords: a few at a time, in memory that stays.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use crawler_access::password::Memory;
use tokio::sync::Semaphore;

/// Passwords hashed at a time, wherever they come from: each takes 19 MiB and a core.
const MEMORIES: usize = 2;

/// Too many passwords are being checked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Busy;

/// Memory for all passwords of a server.
struct Memories {
    places: Arc<Semaphore>,
    free: Mutex<Vec<Memory>>,
}

/// Where passwords are hashed that come from one side, over HTTP or at the broker.
///
/// Each side may have as many under way as there are memories, and they take turns: a crowd on one side
/// costs the other half of its pace.
pub struct Hashing {
    places: Arc<Semaphore>,
    patience: Duration,
    memories: Arc<Memories>,
}

impl Hashing {
    /// The first side. Whoever gets no place within `patience` is sent away.
    pub fn new(patience: Duration) -> Self {
        Self {
            places: Arc::new(Semaphore::new(MEMORIES)),
            patience,
            memories: Arc::new(Memories {
                places: Arc::new(Semaphore::new(MEMORIES)),
                free: Mutex::new((0..MEMORIES).map(|_| Memory::new()).collect()),
            }),
        }
    }

    /// Another side of the same server.
    #[must_use]
    pub fn other(&self, patience: Duration) -> Self {
        Self {
            places: Arc::new(Semaphore::new(MEMORIES)),
            patience,
            memories: Arc::clone(&self.memories),
        }
    }

    /// Does what takes a core and 19 MiB, off the threads that serve others.
    ///
    /// # Errors
    /// [`Busy`] when there is no place for it, or the work panicked.
    ///
    /// # Cancellation safety
    /// Work that has begun is done, and keeps its place until then.
    pub async fn run<T: Send + 'static>(
        &self,
        work: impl FnOnce(&mut Memory) -> T + Send + 'static,
    ) -> Result<T, Busy> {
        let memories = Arc::clone(&self.memories);
        let places = async {
            let side = Arc::clone(&self.places).acquire_owned().await;
            let memory = Arc::clone(&memories.places).acquire_owned().await;
            (side, memory)
        };
        let places = match tokio::time::timeout(self.patience, places).await {
            Ok((Ok(side), Ok(memory))) => (side, memory),
            _ => return Err(Busy),
        };
        let working = tokio::task::spawn_blocking(move || {
            // Here, so that whoever hangs up makes no room for another before this is done.
            let _places = places;
            // One is missing after a panic.
            let mut memory = memories.take().unwrap_or_default();
            let outcome = work(&mut memory);
            memories.put_back(memory);
            outcome
        });
        working.await.map_err(|error| {
            tracing::error!(%error, "a password could not be checked");
            Busy
        })
    }

    /// Takes every place of this side, for as long as the result lives: a test of what comes then.
    ///
    /// # Panics
    /// Never: the places stay open.
    pub async fn occupy(&self) -> tokio::sync::OwnedSemaphorePermit {
        let all = Arc::clone(&self.places).acquire_many_owned(MEMORIES as u32);
        all.await.expect("open")
    }
}

impl Memories {
    fn take(&self) -> Option<Memory> {
        let mut free = self.free.lock().unwrap_or_else(PoisonError::into_inner);
        free.pop()
    }

    fn put_back(&self, memory: Memory) {
        let mut free = self.free.lock().unwrap_or_else(PoisonError::into_inner);
        free.push(memory);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::sync::mpsc;

    use super::*;

    const LONG: Duration = Duration::from_mins(1);

    /// Work that has begun cannot be taken back: whoever hangs up must not make room for more of it.
    #[tokio::test(flavor = "multi_thread")]
    async fn whoever_hangs_up_keeps_the_place_until_the_work_is_done() {
        let http = Hashing::new(LONG);
        let broker = http.other(LONG);
        let under_way = Arc::new(AtomicUsize::new(0));
        let (release, held) = mpsc::channel::<()>();
        let held = Arc::new(Mutex::new(held));
        let (begun, mut begins) = tokio::sync::mpsc::unbounded_channel();
        let work = || {
            let (held, begun) = (Arc::clone(&held), begun.clone());
            let under_way = Arc::clone(&under_way);
            move |_: &mut Memory| {
                let now = under_way.fetch_add(1, Ordering::SeqCst) + 1;
                let _ = begun.send(now);
                let _ = held.lock().expect("held").recv();
                under_way.fetch_sub(1, Ordering::SeqCst);
            }
        };
        for side in [&http, &broker] {
            let hangs_up = async {
                tokio::select! {
                    _ = side.run(work()) => panic!("it is held"),
                    now = begins.recv() => now,
                }
            };
            let now = tokio::time::timeout(LONG, hangs_up).await.expect("begins");
            assert!(now <= Some(MEMORIES));
        }
        let free = &http.memories.places;
        assert_eq!(free.available_permits(), 0, "both are at work");
        assert!(http.memories.take().is_none(), "in all the memory there is");
        for _ in 0..MEMORIES {
            release.send(()).expect("somebody waits");
        }
        drop(release);
        let done = tokio::time::timeout(LONG, http.run(|_| ())).await;
        assert_eq!(done.expect("there is room again"), Ok(()));
        let all = tokio::time::timeout(LONG, free.acquire_many(MEMORIES as u32));
        drop(all.await.expect("all come back").expect("open"));
        assert_eq!(http.memories.free.lock().expect("free").len(), MEMORIES);
    }

    #[tokio::test(start_paused = true)]
    async fn whoever_gets_no_place_in_time_is_sent_away_and_the_other_side_is_not() {
        let http = Hashing::new(LONG);
        let broker = http.other(LONG);
        let all = broker.occupy().await;
        assert_eq!(broker.run(|_| ()).await, Err(Busy));
        assert_eq!(http.run(|_| 7).await, Ok(7));
        drop(all);
        assert_eq!(broker.run(|_| ()).await, Ok(()));
    }

    #[tokio::test]
    async fn a_panic_costs_no_place() {
        let http = Hashing::new(LONG);
        for _ in 0..2 * MEMORIES {
            let outcome = http.run(|_| panic!("for the test")).await;
            assert_eq!(outcome, Err::<(), _>(Busy));
        }
        assert_eq!(http.run(|memory| memory.verify("x", "y")).await, Ok(false));
    }
}
