//! What runs, and the threads that run it.
//!
//! A thread claims the next trial of an experiment whose turn it is, and puts on the board what it came
//! to. Trials are kept in their order: one that is done before an earlier one waits for that.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use crawler_sim::evaluate::{Job, Trial, run_unless};
use crawler_sim::scenario::Scenario;
use tokio::sync::Notify;

use super::recipe::MAX_ROBOTS;

/// Experiments that run at the same time; others wait for their turn.
pub(super) const AT_ONCE: usize = 4;
/// Trials that may be under way or done beyond the last that is stored.
const AHEAD: u32 = 1_000;
/// Robots in all worlds at the same time; one world runs however many it has.
const ROBOTS: u32 = 2 * MAX_ROBOTS;

/// An experiment that runs, or waits for its turn.
#[derive(Debug)]
pub(super) struct Entry {
    pub(super) id: i64,
    pub(super) scenario: Arc<Scenario>,
    pub(super) first_seed: u64,
    pub(super) seeds: u32,
    /// Trials that are in the records: the first ones.
    pub(super) stored: u32,
    /// The next trial to run.
    next: u32,
    /// What is done, and not in the records yet.
    ready: BTreeMap<u32, Trial>,
    /// Gives up the trials under way.
    stop: Arc<AtomicBool>,
}

impl Entry {
    pub(super) fn new(
        id: i64,
        scenario: Arc<Scenario>,
        first_seed: u64,
        seeds: u32,
        stored: u32,
    ) -> Self {
        Self {
            id,
            scenario,
            first_seed,
            seeds,
            stored,
            next: stored,
            ready: BTreeMap::new(),
            stop: Arc::new(AtomicBool::new(false)),
        }
    }

    /// The same, as if none but what is stored had been done.
    pub(super) fn afresh(self) -> Self {
        Self::new(
            self.id,
            self.scenario,
            self.first_seed,
            self.seeds,
            self.stored,
        )
    }

    /// The trials that can be stored: those without a gap after the last one.
    pub(super) fn batch(&self) -> Vec<Trial> {
        let waiting = (self.stored..).map_while(|number| self.ready.get(&number));
        waiting.cloned().collect()
    }

    /// Notes that `count` more trials are in the records.
    pub(super) fn advance(&mut self, count: u32) {
        self.stored += count;
        self.ready = self.ready.split_off(&self.stored);
    }

    fn may_go_on(&self) -> bool {
        self.next < self.seeds && self.next < self.stored.saturating_add(AHEAD)
    }
}

/// A trial to run.
#[derive(Debug)]
struct Task {
    id: i64,
    number: u32,
    seed: u64,
    scenario: Arc<Scenario>,
    stop: Arc<AtomicBool>,
}

#[derive(Debug, Default)]
struct State {
    /// In the order in which they were started.
    entries: Vec<Entry>,
    /// Whose turn it is.
    turn: usize,
    /// Robots in the worlds that run.
    robots: u32,
    ended: bool,
}

impl State {
    /// The next trial of the next experiment that has one.
    fn claim(&mut self) -> Option<Task> {
        let active = self.entries.len().min(AT_ONCE);
        for step in 0..active {
            let index = (self.turn + step) % active;
            let entry = &mut self.entries[index];
            let robots = self.robots.saturating_add(entry.scenario.robots);
            if !entry.may_go_on() || (self.robots > 0 && robots > ROBOTS) {
                continue;
            }
            let number = entry.next;
            entry.next += 1;
            self.turn = index + 1;
            self.robots = robots;
            return Some(Task {
                id: entry.id,
                number,
                seed: entry.first_seed.wrapping_add(number.into()),
                scenario: Arc::clone(&entry.scenario),
                stop: Arc::clone(&entry.stop),
            });
        }
        None
    }

    fn find(&mut self, id: i64) -> Option<&mut Entry> {
        self.entries.iter_mut().find(|entry| entry.id == id)
    }
}

/// What runs.
#[derive(Debug, Default)]
pub(super) struct Board {
    state: Mutex<State>,
    /// There may be a trial to claim.
    wake: Condvar,
    /// A trial is done.
    pub(super) news: Notify,
}

impl Board {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Has an experiment run, unless it does.
    pub(super) fn enter(&self, entry: Entry) {
        let mut state = self.lock();
        if state.find(entry.id).is_none() {
            state.entries.push(entry);
        }
        self.wake.notify_all();
    }

    /// Takes an experiment away; its trials under way are given up.
    pub(super) fn leave(&self, id: i64) -> Option<Entry> {
        let mut state = self.lock();
        let index = state.entries.iter().position(|entry| entry.id == id)?;
        let entry = state.entries.remove(index);
        entry.stop.store(true, Ordering::Relaxed);
        // Somebody else's turn may have come.
        self.wake.notify_all();
        Some(entry)
    }

    /// Whether an experiment waits for its turn.
    pub(super) fn is_waiting(&self, id: i64) -> bool {
        let state = self.lock();
        let mut late = state.entries.iter().skip(AT_ONCE);
        late.any(|entry| entry.id == id)
    }

    /// Whether an experiment is on the board.
    pub(super) fn has(&self, id: i64) -> bool {
        self.lock().find(id).is_some()
    }

    /// The experiments of which trials can be stored.
    pub(super) fn with_news(&self) -> Vec<i64> {
        let state = self.lock();
        let ready = |entry: &&Entry| entry.ready.contains_key(&entry.stored);
        state
            .entries
            .iter()
            .filter(ready)
            .map(|entry| entry.id)
            .collect()
    }

    /// The trials of an experiment that can be stored.
    pub(super) fn batch(&self, id: i64) -> Vec<Trial> {
        self.lock()
            .find(id)
            .map_or_else(Vec::new, |entry| entry.batch())
    }

    /// Notes that `count` more trials of an experiment are in the records.
    pub(super) fn advance(&self, id: i64, count: u32) {
        if let Some(entry) = self.lock().find(id) {
            entry.advance(count);
        }
        self.wake.notify_all();
    }

    /// Gives up what is under way, and lets nothing begin any more.
    pub(super) fn end(&self) {
        let mut state = self.lock();
        state.ended = true;
        for entry in &state.entries {
            entry.stop.store(true, Ordering::Relaxed);
        }
        self.wake.notify_all();
    }

    /// Waits for a trial to run; `None` at the end.
    fn claim(&self) -> Option<Task> {
        let mut state = self.lock();
        while !state.ended {
            if let Some(task) = state.claim() {
                return Some(task);
            }
            state = self
                .wake
                .wait(state)
                .unwrap_or_else(PoisonError::into_inner);
        }
        None
    }

    /// Takes what a trial came to, or that it was given up.
    fn post(&self, task: &Task, trial: Option<Trial>) {
        let mut state = self.lock();
        state.robots = state.robots.saturating_sub(task.scenario.robots);
        // One that was paused and resumed meanwhile has another flag, and runs this trial again.
        let entry = state.find(task.id);
        let entry = entry.filter(|entry| Arc::ptr_eq(&entry.stop, &task.stop));
        if let (Some(entry), Some(trial)) = (entry, trial) {
            entry.ready.insert(task.number, trial);
            self.news.notify_one();
        }
        self.wake.notify_all();
    }

    fn work(&self) {
        while let Some(task) = self.claim() {
            let job = Job {
                scenario: &task.scenario,
                seed: task.seed,
            };
            let trial = run_unless(&job, &task.stop);
            self.post(&task, trial);
        }
    }

    /// Threads that run trials until [`Board::end`].
    pub(super) fn start(self: &Arc<Self>, threads: usize) -> std::io::Result<Vec<JoinHandle<()>>> {
        let start = |_| {
            let board = Arc::clone(self);
            let thread = std::thread::Builder::new().name("experiment".to_owned());
            thread.spawn(move || board.work())
        };
        let mut started = Vec::with_capacity(threads);
        for thread in (0..threads).map(start) {
            match thread {
                Ok(thread) => started.push(thread),
                Err(error) => {
                    self.end();
                    // None of them has anything to do yet. One that panicked has ended as well.
                    for thread in started {
                        let _ = thread.join();
                    }
                    return Err(error);
                }
            }
        }
        Ok(started)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn entry(id: i64, robots: u32, seeds: u32) -> Entry {
        let scenario = Scenario::built_in("empty")
            .expect("there")
            .with_robots(robots);
        Entry::new(id, Arc::new(scenario), 100, seeds, 0)
    }

    fn trial(seed: u64) -> Trial {
        Trial {
            seed,
            measured: crawler_sim::evaluate::Measured::default(),
            failures: Vec::new(),
            ran_s: 1.0,
            history: seed,
        }
    }

    fn claimed(board: &Board) -> Option<Task> {
        board.lock().claim()
    }

    #[test]
    fn experiments_take_turns_and_four_run_at_once() {
        let board = Board::default();
        for id in 1..=6 {
            board.enter(entry(id, 1, 3));
        }
        let order: Vec<i64> = (0..8).map(|_| claimed(&board).expect("work").id).collect();
        assert_eq!(order, [1, 2, 3, 4, 1, 2, 3, 4]);
        assert!(board.is_waiting(5) && board.is_waiting(6) && !board.is_waiting(4));
        assert!(board.leave(2).expect("there").stop.load(Ordering::Relaxed));
        assert!(!board.is_waiting(5));
        let rest: Vec<i64> = std::iter::from_fn(|| claimed(&board))
            .map(|task| task.id)
            .collect();
        assert_eq!(rest.len(), 3 + 3);
        assert_eq!(rest.iter().filter(|id| **id == 5).count(), 3);
    }

    #[test]
    fn nobody_gets_too_far_ahead_and_robots_are_counted() {
        let board = Board::default();
        board.enter(entry(1, 1, 100_000));
        let ahead = std::iter::from_fn(|| claimed(&board)).count();
        assert_eq!(ahead, AHEAD as usize);
        board.advance(1, 3);
        assert_eq!(std::iter::from_fn(|| claimed(&board)).count(), 3);

        let board = Board::default();
        board.enter(entry(1, MAX_ROBOTS, 10));
        let both = [claimed(&board).expect("one"), claimed(&board).expect("two")];
        assert!(claimed(&board).is_none(), "three worlds are too many");
        board.post(&both[0], None);
        assert!(claimed(&board).is_some());
    }

    #[test]
    fn what_was_paused_is_not_taken_from_before() {
        let board = Board::default();
        board.enter(entry(1, 1, 5));
        let old = claimed(&board).expect("work");
        let left = board.leave(1).expect("there");
        board.enter(left.afresh());
        board.post(&old, Some(trial(100)));
        assert!(board.with_news().is_empty());
        let new = claimed(&board).expect("work");
        assert_eq!((new.number, new.seed), (0, 100));
        board.post(&new, Some(trial(100)));
        assert_eq!(board.with_news(), [1]);
    }

    proptest! {
        /// In whatever order trials come to their end, they are stored in theirs, each once.
        #[test]
        fn trials_are_stored_in_their_order(
            seeds in 1_u32..60,
            picks in proptest::collection::vec(any::<prop::sample::Index>(), 60),
        ) {
            let board = Board::default();
            board.enter(entry(1, 1, seeds));
            let mut under_way: Vec<Task> = std::iter::from_fn(|| claimed(&board)).collect();
            prop_assert_eq!(under_way.len(), seeds as usize);
            let mut stored = Vec::new();
            for pick in picks.iter().cycle() {
                if under_way.is_empty() {
                    break;
                }
                let task = under_way.swap_remove(pick.index(under_way.len()));
                board.post(&task, Some(trial(task.seed)));
                let batch = board.batch(1);
                board.advance(1, batch.len() as u32);
                stored.extend(batch.iter().map(|trial| trial.seed));
            }
            let wanted: Vec<u64> = (100..100 + u64::from(seeds)).collect();
            prop_assert_eq!(stored, wanted);
        }
    }
}
