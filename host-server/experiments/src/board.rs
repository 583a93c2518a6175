//! The parts of experiments that this process has claimed, and the threads that run their trials.

use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crawler_records::{Part, StoredTrial};
use crawler_sim::evaluate::{Job, Trial, run_unless};
use crawler_sim::scenario::Scenario;
use tokio::sync::Notify;

use super::recipe::MAX_ROBOTS;
use super::results::stored;

/// Robots in all worlds at the same time; one world runs however many it has.
const ROBOTS: u32 = 2 * MAX_ROBOTS;
/// Trials that take less than this are claimed ahead: who claims one by one would wait for the records most of the
/// time. Longer ones are left to whoever is idle.
const QUICK: Duration = Duration::from_millis(250);
/// Quick trials that wait, for each thread.
const AHEAD: usize = 4;

/// A part that is claimed.
#[derive(Debug)]
struct Held {
    part: i64,
    experiment: i64,
    scenario: Arc<Scenario>,
    /// Trials that nobody runs yet, with their seeds.
    waiting: VecDeque<(u32, u64)>,
    /// Trials that are not stored.
    open: usize,
    /// Gives up the trials under way.
    stop: Arc<AtomicBool>,
}

/// A trial to run.
#[derive(Debug)]
struct Task {
    part: i64,
    experiment: i64,
    number: u32,
    seed: u64,
    scenario: Arc<Scenario>,
    stop: Arc<AtomicBool>,
}

#[derive(Debug, Default)]
struct State {
    /// In the order in which they were claimed.
    held: Vec<Held>,
    /// Whose turn it is.
    turn: usize,
    /// Robots in the worlds that run.
    robots: u32,
    /// Threads without a trial.
    idle: usize,
    /// Threads altogether.
    threads: usize,
    /// Whether the last trial was.
    quick: bool,
    /// What is done and not in the records yet, with its part: by experiment and number.
    ready: BTreeMap<(i64, u32), (i64, StoredTrial)>,
    ended: bool,
}

impl State {
    /// The next trial of the next part that has one.
    fn claim(&mut self) -> Option<Task> {
        let count = self.held.len();
        for step in 0..count {
            let index = (self.turn + step) % count;
            let held = &mut self.held[index];
            let robots = self.robots.saturating_add(held.scenario.robots);
            if self.robots > 0 && robots > ROBOTS {
                continue;
            }
            let Some((number, seed)) = held.waiting.pop_front() else {
                continue;
            };
            self.turn = index + 1;
            self.robots = robots;
            return Some(Task {
                part: held.part,
                experiment: held.experiment,
                number,
                seed,
                scenario: Arc::clone(&held.scenario),
                stop: Arc::clone(&held.stop),
            });
        }
        None
    }

    /// Trials that should be claimed.
    fn wanted(&self) -> usize {
        if self.ended {
            return 0;
        }
        let waiting: usize = self.held.iter().map(|held| held.waiting.len()).sum();
        let ahead = if self.quick { self.threads * AHEAD } else { 0 };
        (self.idle + ahead).saturating_sub(waiting)
    }

    /// Takes away the parts that `gone` says; their trials under way are given up.
    fn drop_held(&mut self, gone: impl Fn(&Held) -> bool) {
        self.held.retain(|held| {
            let gone = gone(held);
            if gone {
                held.stop.store(true, Ordering::Relaxed);
            }
            !gone
        });
    }
}

/// What this process has claimed.
#[derive(Debug, Default)]
pub(super) struct Board {
    state: Mutex<State>,
    /// There may be a trial to run.
    wake: Condvar,
    /// A trial is done.
    pub(super) news: Notify,
    /// More could be done.
    pub(super) demand: Notify,
}

impl Board {
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes parts in. One that is here already stays as it is.
    pub(super) fn hold(&self, parts: Vec<Part>, scenario: &Arc<Scenario>) {
        let mut state = self.lock();
        for part in parts {
            if state.held.iter().any(|held| held.part == part.id) {
                continue;
            }
            state.held.push(Held {
                part: part.id,
                experiment: part.experiment,
                scenario: Arc::clone(scenario),
                open: part.trials.len(),
                waiting: part.trials.into(),
                stop: Arc::default(),
            });
        }
        self.wake.notify_all();
    }

    /// How many trials should be claimed.
    pub(super) fn wanted(&self) -> usize {
        self.lock().wanted()
    }

    /// The parts that are held, with their experiments.
    pub(super) fn held(&self) -> Vec<(i64, i64)> {
        let state = self.lock();
        let parts = state.held.iter();
        parts.map(|held| (held.part, held.experiment)).collect()
    }

    /// Gives up all parts but these.
    pub(super) fn keep_only(&self, parts: &[i64]) {
        self.lock().drop_held(|held| !parts.contains(&held.part));
    }

    /// Gives up the parts of an experiment. What is done of it stays to be stored.
    pub(super) fn leave(&self, experiment: i64) {
        self.lock().drop_held(|held| held.experiment == experiment);
    }

    /// Forgets what is done of an experiment.
    pub(super) fn forget(&self, experiment: i64) {
        self.lock().ready.retain(|(of, _), _| *of != experiment);
    }

    /// The experiments of which trials can be stored.
    pub(super) fn with_news(&self) -> Vec<i64> {
        let state = self.lock();
        let mut ids: Vec<i64> = state.ready.keys().map(|(id, _)| *id).collect();
        ids.dedup();
        ids
    }

    /// The trials of an experiment that can be stored.
    pub(super) fn batch(&self, experiment: i64) -> Vec<StoredTrial> {
        let state = self.lock();
        let ready = state.ready.range((experiment, 0)..=(experiment, u32::MAX));
        ready.map(|(_, (_, trial))| trial.clone()).collect()
    }

    /// Notes that these trials of an experiment are in the records.
    pub(super) fn stored(&self, experiment: i64, trials: &[u32]) {
        let mut state = self.lock();
        for number in trials {
            let Some((part, _)) = state.ready.remove(&(experiment, *number)) else {
                continue;
            };
            if let Some(held) = state.held.iter_mut().find(|held| held.part == part) {
                held.open = held.open.saturating_sub(1);
            }
        }
        state.held.retain(|held| held.open > 0);
    }

    /// Gives up what is under way, and lets nothing begin any more.
    pub(super) fn end(&self) {
        let mut state = self.lock();
        state.ended = true;
        for held in &state.held {
            held.stop.store(true, Ordering::Relaxed);
        }
        self.wake.notify_all();
    }

    /// Waits for a trial to run; `None` at the end.
    fn claim(&self) -> Option<Task> {
        let mut state = self.lock();
        while !state.ended {
            if let Some(task) = state.claim() {
                if state.wanted() > 0 {
                    self.demand.notify_one();
                }
                return Some(task);
            }
            state.idle += 1;
            self.demand.notify_one();
            state = self
                .wake
                .wait(state)
                .unwrap_or_else(PoisonError::into_inner);
            state.idle -= 1;
        }
        None
    }

    /// Takes what a trial came to, or that it was given up.
    fn post(&self, task: &Task, trial: Option<&Trial>, quick: bool) {
        let mut state = self.lock();
        state.robots = state.robots.saturating_sub(task.scenario.robots);
        state.quick = quick;
        // A part that was given up and claimed again has another flag, and this trial runs again.
        let own = |held: &Held| held.part == task.part && Arc::ptr_eq(&held.stop, &task.stop);
        if let Some(trial) = trial
            && state.held.iter().any(own)
        {
            let done = (task.part, stored(task.number, trial));
            state.ready.insert((task.experiment, task.number), done);
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
            let began = Instant::now();
            let trial = run_unless(&job, &task.stop);
            self.post(&task, trial.as_ref(), began.elapsed() < QUICK);
        }
    }

    /// Threads that run trials until [`Board::end`].
    pub(super) fn start(self: &Arc<Self>, threads: usize) -> std::io::Result<Vec<JoinHandle<()>>> {
        self.lock().threads = threads;
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

    const SEED: u64 = 100;

    fn scenario(robots: u32) -> Arc<Scenario> {
        let scenario = Scenario::built_in("empty").expect("there");
        Arc::new(scenario.with_robots(robots))
    }

    fn part(experiment: i64, numbers: std::ops::Range<u32>) -> Part {
        Part {
            id: experiment * 1_000 + i64::from(numbers.start),
            experiment,
            trials: numbers
                .map(|number| (number, SEED + u64::from(number)))
                .collect(),
        }
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

    fn post(board: &Board, task: &Task) {
        board.post(task, Some(&trial(task.seed)), false);
    }

    #[test]
    fn parts_take_turns() {
        let board = Board::default();
        for id in 1..=3 {
            board.hold(vec![part(id, 0..2)], &scenario(1));
        }
        // The same once more changes nothing.
        board.hold(vec![part(2, 0..2)], &scenario(1));
        let order: Vec<i64> = std::iter::from_fn(|| claimed(&board))
            .map(|task| task.experiment)
            .collect();
        assert_eq!(order, [1, 2, 3, 1, 2, 3]);
        assert_eq!(board.held(), [(1_000, 1), (2_000, 2), (3_000, 3)]);
    }

    #[test]
    fn robots_are_counted() {
        let board = Board::default();
        board.hold(vec![part(1, 0..10)], &scenario(MAX_ROBOTS));
        let both = [claimed(&board).expect("one"), claimed(&board).expect("two")];
        assert!(claimed(&board).is_none(), "three worlds are too many");
        board.post(&both[0], None, false);
        assert!(claimed(&board).is_some());
    }

    #[test]
    fn quick_trials_are_claimed_ahead_and_others_as_needed() {
        let board = Board::default();
        board.lock().threads = 2;
        assert_eq!(board.wanted(), 0, "nobody is idle");
        board.lock().idle = 2;
        assert_eq!(board.wanted(), 2);
        board.hold(vec![part(1, 0..1)], &scenario(1));
        assert_eq!(board.wanted(), 1);
        let task = claimed(&board).expect("work");
        board.lock().idle = 0;
        assert_eq!(board.wanted(), 0);
        board.post(&task, Some(&trial(SEED)), true);
        assert_eq!(board.wanted(), 2 * AHEAD);
    }

    #[test]
    fn what_was_given_up_is_not_taken_from_before() {
        let board = Board::default();
        board.hold(vec![part(1, 0..5), part(1, 5..6)], &scenario(1));
        let old = claimed(&board).expect("work");
        board.keep_only(&[1_005]);
        assert!(old.stop.load(Ordering::Relaxed));
        board.hold(vec![part(1, 0..5)], &scenario(1));
        post(&board, &old);
        assert!(board.with_news().is_empty());
        let mut tasks = std::iter::from_fn(|| claimed(&board));
        let new = tasks.find(|task| task.number == 0).expect("once more");
        assert_eq!(new.seed, SEED);
        post(&board, &new);
        assert_eq!(board.with_news(), [1]);
        // What is done stays to be stored when the rest is given up.
        board.leave(1);
        assert_eq!((board.held(), board.batch(1).len()), (vec![], 1));
        board.forget(1);
        assert!(board.with_news().is_empty());
    }

    proptest! {
        /// In whatever order trials come to their end, each is stored once, and then nothing is held.
        #[test]
        fn every_trial_is_stored_once(
            parts in proptest::collection::vec((1_i64..4, 1_u32..5), 1..12),
            picks in proptest::collection::vec(any::<prop::sample::Index>(), 60),
        ) {
            let board = Board::default();
            let mut next = [0_u32; 4];
            let mut wanted = Vec::new();
            for (experiment, size) in parts {
                let first = next[experiment as usize];
                next[experiment as usize] += size;
                wanted.extend((first..first + size).map(|number| (experiment, number)));
                board.hold(vec![part(experiment, first..first + size)], &scenario(1));
            }
            let mut under_way: Vec<Task> = std::iter::from_fn(|| claimed(&board)).collect();
            let mut all = Vec::new();
            for pick in picks.iter().cycle() {
                if under_way.is_empty() {
                    break;
                }
                let task = under_way.swap_remove(pick.index(under_way.len()));
                post(&board, &task);
                for id in board.with_news() {
                    let batch = board.batch(id);
                    let numbers: Vec<u32> = batch.iter().map(|trial| trial.number).collect();
                    for trial in &batch {
                        prop_assert_eq!(trial.seed, SEED + u64::from(trial.number));
                    }
                    all.extend(numbers.iter().map(|number| (id, *number)));
                    board.stored(id, &numbers);
                }
            }
            all.sort_unstable();
            wanted.sort_unstable();
            prop_assert_eq!(all, wanted);
            prop_assert!(board.held().is_empty());
        }
    }
}
