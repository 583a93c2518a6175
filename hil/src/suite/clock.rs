//! The fleet's time: heard from whoever publishes it, or published when nobody does.

use std::collections::VecDeque;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use tokio::time::Instant;

/// A server publishes every 5 s: nobody does when this passes at the start.
const LISTEN_FIRST: Duration = Duration::from_secs(6);
/// Whoever published and is silent for so long is gone.
const GONE: Duration = Duration::from_secs(12);
/// How often we publish.
const PERIOD: Duration = Duration::from_secs(5);
/// Own messages remembered, to know them again.
const OWN: usize = 8;

/// The fleet's clock as the suite knows it.
#[derive(Debug)]
pub(super) struct FleetClock {
    due: Instant,
    /// Fleet time less this machine's, in milliseconds.
    offset_ms: i64,
    /// Whether somebody else publishes.
    foreign: bool,
    /// Whether to keep silent.
    hold: bool,
    own: VecDeque<u64>,
}

/// Unix milliseconds of this machine.
fn local_ms() -> u64 {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_or(0, |elapsed| elapsed.as_millis() as u64)
}

impl FleetClock {
    pub(super) fn new(now: Instant) -> Self {
        Self {
            due: now + LISTEN_FIRST,
            offset_ms: 0,
            foreign: false,
            hold: false,
            own: VecDeque::new(),
        }
    }

    /// Unix milliseconds of the fleet.
    pub(super) fn now_ms(&self) -> u64 {
        local_ms().saturating_add_signed(self.offset_ms)
    }

    /// Whether somebody else publishes the time.
    pub(super) const fn is_foreign(&self) -> bool {
        self.foreign
    }

    /// Takes in a time message that arrived at `at`.
    pub(super) fn heard(&mut self, timestamp: u64, at: Instant) {
        if self.own.contains(&timestamp) {
            return;
        }
        self.foreign = true;
        let waited = at.elapsed().as_millis() as i64;
        self.offset_ms = (timestamp.cast_signed())
            .saturating_add(waited)
            .saturating_sub(local_ms().cast_signed());
        self.due = at + GONE;
    }

    /// When to look again whether something is to be published.
    pub(super) fn due(&self) -> Option<Instant> {
        (!self.hold).then_some(self.due)
    }

    /// The time to publish, when it is due.
    pub(super) fn take(&mut self, now: Instant) -> Option<u64> {
        if self.hold || now < self.due {
            return None;
        }
        self.foreign = false;
        self.due = now + PERIOD;
        let timestamp = self.now_ms();
        if self.own.len() == OWN {
            self.own.pop_front();
        }
        self.own.push_back(timestamp);
        Some(timestamp)
    }

    /// Keeps silent from now on, if it is ours to speak.
    pub(super) fn hold(&mut self) {
        self.hold = true;
    }

    /// Speaks again, at once when it is ours to speak.
    pub(super) fn resume(&mut self, now: Instant) {
        self.hold = false;
        if !self.foreign {
            self.due = now;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_speaks_when_nobody_else_does() {
        let start = Instant::now();
        let mut clock = FleetClock::new(start);
        assert_eq!(clock.take(start + Duration::from_secs(5)), None);
        let own = clock.take(start + LISTEN_FIRST).expect("silence until now");
        clock.heard(own, start + LISTEN_FIRST);
        assert!(!clock.is_foreign());
        assert!(clock.take(start + LISTEN_FIRST + PERIOD).is_some());
    }

    #[test]
    fn it_leaves_the_word_to_a_server_and_takes_its_time() {
        // The server's clock is an hour ahead. What passes between these two lines is what its
        // message takes to arrive: nobody can know of it.
        let told = local_ms() + 3_600_000;
        let start = Instant::now();
        let mut clock = FleetClock::new(start);
        clock.heard(told, start);
        assert!(clock.is_foreign());
        assert_eq!(clock.take(start + Duration::from_secs(10)), None);
        let ahead = clock.offset_ms;
        assert!((3_500_000..=3_600_000).contains(&ahead), "{ahead}");
        assert!(clock.now_ms() >= told, "and it goes on");
        assert!(
            clock.take(start + GONE).is_some(),
            "the server is gone by now"
        );
    }

    #[test]
    fn it_can_be_silent() {
        let start = Instant::now();
        let mut clock = FleetClock::new(start);
        clock.hold();
        assert_eq!(clock.due(), None);
        assert_eq!(clock.take(start + Duration::from_mins(1)), None);
        clock.resume(start);
        assert!(clock.take(start).is_some());
    }
}
