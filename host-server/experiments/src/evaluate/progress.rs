//! How far runs are, for whoever waits for them.

use std::fmt::Write as _;
use std::io::IsTerminal as _;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use crawler_sim::evaluate::Done;

/// How often a terminal is told.
const ON_TERMINAL: Duration = Duration::from_millis(200);
/// How often a file or a pipe is told, in a line of its own.
const ELSEWHERE: Duration = Duration::from_mins(1);
/// Nothing is said of the time that is left before so much of the work is done.
const ENOUGH: f64 = 0.01;

/// Says on standard error how far it is: in a line that is written over, or in one a minute.
pub(super) struct Progress {
    terminal: bool,
    began: Instant,
    told: Mutex<Instant>,
}

impl Progress {
    pub(super) fn new() -> Self {
        let now = Instant::now();
        Self {
            terminal: std::io::stderr().is_terminal(),
            began: now,
            told: Mutex::new(now),
        }
    }

    /// Says `text`, unless something was said a moment ago.
    pub(super) fn tell(&self, text: impl FnOnce() -> String) {
        let pause = if self.terminal {
            ON_TERMINAL
        } else {
            ELSEWHERE
        };
        // Whoever finds it taken is late: another thread says it.
        let Ok(mut told) = self.told.try_lock() else {
            return;
        };
        if told.elapsed() < pause {
            return;
        }
        *told = Instant::now();
        if self.terminal {
            eprint!("\r\x1b[K{}", text());
        } else {
            eprintln!("{}", text());
        }
    }

    /// Says how many of `all` runs are done, and how long the others will take at that pace.
    pub(super) fn tell_runs(&self, done: Done, all: usize) {
        self.tell(|| runs(done, all, self.began.elapsed()));
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        if self.terminal {
            eprint!("\r\x1b[K");
        }
    }
}

fn runs(done: Done, all: usize, took: Duration) -> String {
    let share = (done.runs as f64 + done.under_way) / all as f64;
    let mut text = format!("{} of {all} runs", done.runs);
    if done.under_way > 0.0 {
        // Writing to a String does not fail.
        let _ = write!(text, ", {:.1} under way", done.under_way);
    }
    if (ENOUGH..1.0).contains(&share) {
        let left = took.as_secs_f64() * (1.0 - share) / share;
        let _ = write!(text, ", {} left", span(left));
    }
    text
}

/// Seconds as people say them.
fn span(seconds: f64) -> String {
    let seconds = seconds.ceil() as u64;
    match seconds {
        0..=99 => format!("{seconds} s"),
        100..=5_999 => format!("{} min", seconds.div_ceil(60)),
        _ => format!("{} h {} min", seconds / 3_600, seconds % 3_600 / 60),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_left_follows_how_fast_it_goes() {
        let told = |runs: usize, under_way: f64, took: u64| {
            super::runs(Done { runs, under_way }, 10, Duration::from_secs(took))
        };
        assert_eq!(told(0, 0.0, 5), "0 of 10 runs");
        assert_eq!(told(0, 0.5, 10), "0 of 10 runs, 0.5 under way, 4 min left");
        assert_eq!(told(4, 1.0, 50), "4 of 10 runs, 1.0 under way, 50 s left");
        assert_eq!(told(1, 0.0, 1_000), "1 of 10 runs, 2 h 30 min left");
        assert_eq!(told(10, 0.0, 99), "10 of 10 runs");
    }
}
