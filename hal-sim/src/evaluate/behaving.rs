//! Whether a robot keeps to the behaviour it was sent to.

use crawler_hal::{Duration, Instant};

/// A robot that takes its behaviour up again within this time was not stranded.
const RECOVERY: Duration = Duration::from_secs(10);

/// See the [module](self).
#[derive(Debug, Default)]
pub(super) struct Behaving {
    /// It was seen to behave, and was not told to do anything else since.
    wanted: bool,
    ever: bool,
    /// Since when it does not.
    fell_out: Option<Instant>,
    dropouts: u32,
}

impl Behaving {
    /// Takes in whether it behaves; `settled` tells whether it has answered all that it was told.
    pub(super) fn see(&mut self, behaves: bool, settled: bool, now: Instant) {
        if !settled {
            return;
        }
        if behaves {
            (self.wanted, self.ever, self.fell_out) = (true, true, None);
        } else if self.wanted && self.fell_out.is_none() {
            self.fell_out = Some(now);
            self.dropouts += 1;
        }
    }

    /// It was told what to do: what it does next counts.
    pub(super) fn told(&mut self) {
        (self.wanted, self.fell_out) = (false, None);
    }

    /// It says that it came to the end of what it was to do: from now on it may stand. When it stands already, that is
    /// why.
    pub(super) fn completed(&mut self) {
        self.dropouts -= u32::from(self.fell_out.is_some());
        self.told();
    }

    /// Whether it ever did.
    pub(super) const fn ever(&self) -> bool {
        self.ever
    }

    /// How often it stopped without having been told.
    pub(super) const fn dropouts(&self) -> u32 {
        self.dropouts
    }

    /// Whether it stands although it is to behave, and not only for a moment.
    pub(super) fn is_stranded(&self, now: Instant) -> bool {
        self.fell_out.is_some_and(|since| now - since >= RECOVERY)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_stops_by_itself_drops_out_and_is_stranded_after_a_while() {
        let at = |seconds: u64| Instant::from_millis(1_000 * seconds);
        let mut robot = Behaving::default();
        robot.see(false, true, at(1));
        assert!(!robot.ever() && !robot.is_stranded(at(60)), "not sent yet");
        robot.see(true, true, at(2));
        robot.see(false, true, at(3));
        robot.see(false, true, at(4));
        assert_eq!(robot.dropouts(), 1);
        assert!(!robot.is_stranded(at(12)) && robot.is_stranded(at(13)));
        robot.see(true, true, at(14));
        assert!(!robot.is_stranded(at(60)), "it goes on");
        // Told to stand it may do so, and a word that is on its way is none of its own.
        robot.told();
        robot.see(true, false, at(15));
        robot.see(false, true, at(16));
        assert!(robot.dropouts() == 1 && !robot.is_stranded(at(60)));
    }

    #[test]
    fn who_comes_to_its_end_may_stand() {
        let at = |seconds: u64| Instant::from_millis(1_000 * seconds);
        let mut robot = Behaving::default();
        robot.see(true, true, at(1));
        // That it stands is seen in the look that hears of the end, or in the one before.
        robot.see(false, true, at(2));
        robot.completed();
        robot.see(false, true, at(3));
        assert!(robot.dropouts() == 0 && !robot.is_stranded(at(60)));
    }
}
