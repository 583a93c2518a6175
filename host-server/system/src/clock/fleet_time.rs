//! The time that robots go by, across a clock that is set.
//!
//! A robot takes a motion command only while it is young by the time that it was told. It follows a clock
//! that was set once three messages in a row agree about it (`crawler_app::timesync`), which may have been
//! late. Until then commands must carry the time as robots still know it, or motion would be refused as too
//! old, or as from the future.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use rustix::time::{ClockId, clock_gettime};

use super::unix_ms;

/// A difference of more than this is not delay or drift but a clock that was set, for robots too.
const STEP_MS: u64 = 1_000;
/// How well the times of a clock that was set must agree: less than robots ask for.
const AGREEMENT_MS: u64 = 200;
/// How long it may take to read two clocks, and how often that is tried.
const READING_MS: u64 = 20;
const READINGS: u8 = 5;
/// How often the time is told while robots follow a step: they take no two messages within two seconds.
const TELL_EVERY: Duration = Duration::from_millis(2_500);
/// How often at other times.
const TIME_EVERY: Duration = Duration::from_secs(5);
/// A robot that has just come online takes no motion command before it knows the time. One message
/// serves all that come within this time.
const TIME_AGAIN: Duration = Duration::from_millis(200);
/// As many messages as robots want to hear.
const CONFIRMATIONS: u8 = 3;
/// And some for those that have lost one.
const TELLINGS: u8 = 6;

/// What the machine's clocks say.
#[derive(Debug, Clone, Copy)]
struct Reading {
    /// Unix milliseconds, by the clock that may be set.
    wall_ms: u64,
    /// Milliseconds of a clock that nobody sets, and that does not stand still while the machine sleeps.
    steady_ms: u64,
}

/// Unix time as robots know it.
pub struct FleetTime {
    state: Mutex<State>,
    /// Unix milliseconds, by the clock that may be set.
    wall_ms: Box<dyn Fn() -> u64 + Send + Sync>,
}

#[derive(Debug, Default)]
struct State {
    /// Unix time less the steady clock, in milliseconds, as robots know it.
    offset_ms: Option<i64>,
    step: Option<Step>,
}

/// A clock that was set, as far as robots have been told.
#[derive(Debug)]
struct Step {
    offset_ms: i64,
    /// Messages that robots count.
    told: u8,
    /// The last of them, by the steady clock.
    told_at: Option<u64>,
}

/// What is to be told, and what has come to light.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Telling {
    /// Unix milliseconds.
    pub unix_ms: u64,
    /// By how many milliseconds the clock was set, where that is news.
    pub set_by_ms: Option<i64>,
}

impl FleetTime {
    /// By a clock that tells Unix milliseconds and may be set.
    pub fn by(wall_ms: impl Fn() -> u64 + Send + Sync + 'static) -> Self {
        Self {
            state: Mutex::default(),
            wall_ms: Box::new(wall_ms),
        }
    }

    /// Unix milliseconds for what robots hold against their own clock.
    pub fn now_ms(&self) -> u64 {
        let reading = self.reading_now();
        self.state().now_ms(reading)
    }

    /// The time to tell robots now.
    pub fn tell(&self) -> Telling {
        let reading = self.reading_now();
        self.state().tell(reading)
    }

    /// How long after one message the next is due; `wanted` says whether a robot waits for it.
    pub fn tell_after(&self, wanted: bool) -> Duration {
        let reading = self.reading_now();
        self.state().after(wanted, reading)
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn reading_now(&self) -> Reading {
        let mut reading = Reading {
            wall_ms: 0,
            steady_ms: 0,
        };
        // A thread that has to wait between the two must not take that for a clock that was set.
        for _ in 0..READINGS {
            let before_ms = steady_ms();
            reading = Reading {
                wall_ms: (self.wall_ms)(),
                steady_ms: steady_ms(),
            };
            if reading.steady_ms.saturating_sub(before_ms) <= READING_MS {
                break;
            }
        }
        reading
    }
}

impl Default for FleetTime {
    /// By the clock of this machine.
    fn default() -> Self {
        Self::by(unix_ms)
    }
}

impl State {
    /// Takes in what the clocks say. Returns the offset that robots go by.
    fn look(&mut self, reading: Reading) -> i64 {
        let measured = signed(reading.wall_ms).saturating_sub(signed(reading.steady_ms));
        let known = self.offset_ms.unwrap_or_else(|| {
            // Robots may know the time of a server that was there before.
            self.step = Some(Step::to(measured));
            measured
        });
        self.step.take_if(|step| {
            step.told >= TELLINGS || measured.abs_diff(step.offset_ms) > AGREEMENT_MS
        });
        if measured.abs_diff(known) <= STEP_MS {
            // Adjusted, as clocks are all the time: robots follow by themselves.
            self.offset_ms = Some(measured);
            return measured;
        }
        if self.step.is_none() {
            self.step = Some(Step::to(measured));
        }
        known
    }

    fn after(&mut self, wanted: bool, reading: Reading) -> Duration {
        let known = self.look(reading);
        match &self.step {
            // Robots count what they hear, and must not be further than this is. Nor does a robot that is
            // told the new time gain by it before commands carry that.
            Some(step) if step.told < CONFIRMATIONS && step.differs(known) => {
                if step.told == 0 {
                    TIME_AGAIN
                } else {
                    TELL_EVERY
                }
            }
            _ if wanted => TIME_AGAIN,
            Some(_) => TELL_EVERY,
            None => TIME_EVERY,
        }
    }

    fn now_ms(&mut self, reading: Reading) -> u64 {
        let offset = self.look(reading);
        u64::try_from(offset.saturating_add(signed(reading.steady_ms))).unwrap_or(0)
    }

    fn tell(&mut self, reading: Reading) -> Telling {
        let known = self.look(reading);
        let mut telling = Telling {
            unix_ms: reading.wall_ms,
            set_by_ms: None,
        };
        let Some(step) = &mut self.step else {
            return telling;
        };
        let every = TELL_EVERY.as_millis() as u64;
        let early = |at: u64| reading.steady_ms.saturating_sub(at) < every;
        if step.told_at.is_some_and(early) {
            return telling;
        }
        if step.told == 0 && step.differs(known) {
            telling.set_by_ms = Some(step.offset_ms.saturating_sub(known));
        }
        step.told += 1;
        step.told_at = Some(reading.steady_ms);
        if step.told == CONFIRMATIONS {
            // Whatever goes out after this message finds robots that have followed.
            self.offset_ms = Some(step.offset_ms);
        }
        telling
    }
}

impl Step {
    const fn to(offset_ms: i64) -> Self {
        Self {
            offset_ms,
            told: 0,
            told_at: None,
        }
    }

    /// Whether robots that go by `known` take this for a clock that was set.
    const fn differs(&self, known: i64) -> bool {
        self.offset_ms.abs_diff(known) > STEP_MS
    }
}

fn signed(ms: u64) -> i64 {
    i64::try_from(ms).unwrap_or(i64::MAX)
}

/// Milliseconds of a clock that nobody sets. Of those, this one goes on while the machine sleeps: so do
/// robots.
fn steady_ms() -> u64 {
    #[cfg(target_os = "linux")]
    let clock = ClockId::Boottime;
    #[cfg(not(target_os = "linux"))]
    let clock = ClockId::Monotonic;
    let steady = clock_gettime(clock);
    let seconds = u64::try_from(steady.tv_sec).unwrap_or(0);
    let nanoseconds = u64::try_from(steady.tv_nsec).unwrap_or(0);
    seconds * 1_000 + nanoseconds / 1_000_000
}

#[cfg(test)]
mod tests {
    use crawler_app::timesync::TimeSync;
    use crawler_hal::Instant;
    use embassy_sync::blocking_mutex::raw::NoopRawMutex;
    use proptest::prelude::*;

    use super::*;

    const START_MS: u64 = 1_800_000_000_000;
    /// How often the server looks at its clock, and somebody steers.
    const TICK_MS: u64 = 100;

    /// A server and a robot beside each other, with a clock that can be set.
    struct Pair {
        server: State,
        robot: TimeSync<NoopRawMutex>,
        now_ms: u64,
        set_by: i64,
        told_at: Option<u64>,
        /// Times on their way to the robot: when they arrive, and what they say.
        under_way: Vec<(u64, u64)>,
    }

    impl Pair {
        fn new() -> Self {
            Self {
                server: State::default(),
                robot: TimeSync::new(),
                now_ms: 7_000,
                set_by: 0,
                told_at: None,
                under_way: Vec::new(),
            }
        }

        fn reading(&self) -> Reading {
            Reading {
                wall_ms: (START_MS + self.now_ms).saturating_add_signed(self.set_by),
                steady_ms: self.now_ms,
            }
        }

        /// How often the server tells the time.
        fn every(&mut self) -> Duration {
            self.server.after(false, self.reading())
        }

        /// A tick of the server, whose messages take `delay_ms`, and of which somebody else may want the
        /// time. Returns how old a command of this moment is for the robot when it arrives, once that
        /// knows a time.
        fn tick(&mut self, delay_ms: u64, wanted: bool) -> Option<i64> {
            self.now_ms += TICK_MS;
            let reading = self.reading();
            let every = self.server.after(wanted, reading).as_millis() as u64;
            if self.told_at.is_none_or(|at| self.now_ms - at >= every) {
                self.told_at = Some(self.now_ms);
                let told = self.server.tell(reading).unix_ms;
                self.under_way.push((self.now_ms + delay_ms, told));
            }
            let stamp = self.server.now_ms(reading);
            let arrival = self.now_ms + delay_ms;
            for (at, unix_ms) in self.under_way.extract_if(.., |(at, _)| *at <= arrival) {
                self.robot.observe(unix_ms, Instant::from_millis(at));
            }
            let robot = self.robot.unix_ms(Instant::from_millis(arrival))?;
            Some(signed(robot) - signed(stamp))
        }
    }

    proptest! {
        /// A robot takes motion commands that are less than 2 s old and at most 0.5 s from the future.
        #[test]
        fn no_command_is_too_old_while_robots_follow_a_clock_that_was_set(
            steps in prop::collection::vec(
                (prop_oneof![-40_000_000_000_i64..-1_001, 1_001..40_000_000_000_i64], 0..1_000_usize),
                1..4,
            ),
            rounds in prop::collection::vec((0..150_u64, prop::bool::weighted(0.1)), 64),
        ) {
            let mut pair = Pair::new();
            let mut rounds = rounds.into_iter().cycle();
            let mut tick = |pair: &mut Pair| {
                let (delay_ms, wanted) = rounds.next().unwrap_or_default();
                pair.tick(delay_ms, wanted)
            };
            for _ in 0..300 {
                tick(&mut pair);
            }
            for (set_by, ticks) in steps {
                pair.set_by += set_by;
                for number in 0..ticks {
                    let age = tick(&mut pair).expect("a time");
                    prop_assert!((-400..1_000).contains(&age), "{age} ms, {number} ticks after {set_by}");
                }
            }
            for _ in 0..300 {
                tick(&mut pair);
            }
            let wall = pair.reading().wall_ms;
            let robot = pair.robot.unix_ms(Instant::from_millis(pair.now_ms)).expect("a time");
            prop_assert!(robot.abs_diff(wall) < 300, "followed: {robot} and {wall}");
            prop_assert_eq!(pair.every(), TIME_EVERY);
        }
    }

    #[test]
    fn who_sets_the_clock_is_told_of_once() {
        let mut pair = Pair::new();
        let tell = |pair: &mut Pair, after: u64| {
            pair.now_ms += after;
            let reading = pair.reading();
            pair.server.tell(reading).set_by_ms
        };
        for _ in 0..20 {
            assert_eq!(tell(&mut pair, 5_000), None);
        }
        pair.set_by = -60_000;
        assert_eq!(tell(&mut pair, 5_000), Some(-60_000));
        for _ in 0..20 {
            assert_eq!(tell(&mut pair, 2_500), None);
        }
        // Forth and back before anybody follows.
        pair.set_by = 0;
        assert_eq!(tell(&mut pair, 2_500), Some(60_000));
        pair.set_by = -60_000;
        assert_eq!(tell(&mut pair, 2_500), None);
        assert_eq!(pair.every(), TIME_EVERY);
    }

    #[test]
    fn a_restarted_server_brings_robots_of_another_time_to_its_own() {
        let mut pair = Pair::new();
        for _ in 0..300 {
            pair.tick(5, false);
        }
        pair.server = State::default();
        pair.told_at = None;
        pair.set_by = -60_000;
        let ticks = (1..1_000).find(|_| pair.tick(5, false).expect("a time").abs() < 400);
        // At once, and twice more after two and a half seconds.
        assert_eq!(ticks.map(|ticks| ticks * TICK_MS), Some(5_100));
    }
}
