//! What is measured of a run. `docs/scenarios.md` defines every metric.

use crate::scenario::Metric;

/// What was measured of one run; a metric is missing where the run has nothing it could be
/// measured on.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Measured([Option<f64>; Metric::COUNT]);

impl Measured {
    /// These values, in the order of [`Metric::ALL`]; what is not finite is not measured.
    #[must_use]
    pub fn of(values: [Option<f64>; Metric::COUNT]) -> Self {
        Self(values.map(|value| value.filter(|value| value.is_finite())))
    }

    /// All of them, in the order of [`Metric::ALL`].
    #[must_use]
    pub const fn values(&self) -> &[Option<f64>; Metric::COUNT] {
        &self.0
    }

    /// One of them.
    #[must_use]
    pub fn get(&self, metric: Metric) -> Option<f64> {
        self.0[metric as usize]
    }

    pub(crate) fn set(&mut self, metric: Metric, value: Option<f64>) {
        // What is not finite is not measured.
        self.0[metric as usize] = value.filter(|value| value.is_finite());
    }
}

/// The mean, where there is any.
pub(crate) fn mean(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values
        .into_iter()
        .fold((0.0, 0_u32), |(sum, count), value| (sum + value, count + 1));
    (count > 0).then(|| sum / f64::from(count))
}

/// A share; of nothing there is none.
pub(crate) fn share(part: usize, all: usize) -> Option<f64> {
    (all > 0).then(|| part as f64 / all as f64)
}

/// How much of the way driven was needed: the shortest way to the rim of the goal, divided by the
/// way driven, 1 at most. `None` when nothing had to be driven.
pub(crate) fn path_optimality(shortest_m: f64, rim_m: f64, driven_m: f64) -> Option<f64> {
    let needed = shortest_m - rim_m;
    (needed > 0.0 && driven_m > 0.0).then(|| (needed / driven_m).min(1.0))
}

/// When a robot is back at work after something was broken about it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Recovery {
    /// Whether it had a goal before.
    pub(crate) had_goal: bool,
    /// When the fault was mended, or came, if it is never mended, seconds.
    pub(crate) since_s: f64,
    /// When the robot was back, seconds.
    pub(crate) back_s: Option<f64>,
}

impl Recovery {
    /// Takes in how the robot is at `now_s`: whether it can take commands, and whether it is on an
    /// goal or has none to do any more.
    pub(crate) fn see(&mut self, now_s: f64, able: bool, busy_or_done: bool) {
        let back = able && (busy_or_done || !self.had_goal);
        if self.back_s.is_none() && now_s >= self.since_s && back {
            self.back_s = Some(now_s);
        }
    }

    /// How long it took, seconds; `None` while it is not back.
    pub(crate) fn took_s(&self) -> Option<f64> {
        self.back_s.map(|back| back - self.since_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_finite_is_not_measured() {
        let mut measured = Measured::default();
        measured.set(Metric::EnergyJ, Some(f64::NAN));
        measured.set(Metric::Uptime, Some(0.5));
        assert_eq!(measured.get(Metric::EnergyJ), None);
        assert_eq!(measured.get(Metric::Uptime), Some(0.5));
        let mut values = *measured.values();
        assert_eq!(Measured::of(values), measured);
        values[Metric::Collisions as usize] = Some(f64::INFINITY);
        assert_eq!(Measured::of(values), measured);
    }

    #[test]
    fn means_and_shares_of_nothing_do_not_exist() {
        assert_eq!(mean([]), None);
        assert_eq!(mean([1.0, 2.0, 6.0]), Some(3.0));
        assert_eq!(share(0, 0), None);
        assert_eq!(share(3, 4), Some(0.75));
    }

    #[test]
    fn a_way_is_optimal_that_leads_straight_to_the_rim() {
        // 3 m away, counts from 0.25 m: 2.75 m have to be driven.
        assert_eq!(path_optimality(3.0, 0.25, 2.75), Some(1.0));
        assert_eq!(path_optimality(3.0, 0.25, 5.5), Some(0.5));
        // A map of squares may find a way that is a little too long.
        assert_eq!(path_optimality(3.0, 0.25, 2.7), Some(1.0));
        assert_eq!(path_optimality(0.2, 0.25, 0.3), None);
        assert_eq!(path_optimality(3.0, 0.25, 0.0), None);
    }

    #[test]
    fn recovery_counts_from_the_end_of_the_fault() {
        let fault = Recovery {
            had_goal: true,
            since_s: 10.0,
            back_s: None,
        };
        let mut robot = fault;
        // It works on while the fault lasts; that is no recovery yet.
        robot.see(9.0, true, true);
        assert_eq!(robot.took_s(), None);
        robot.see(10.5, false, false);
        robot.see(11.0, true, false);
        assert_eq!(robot.took_s(), None, "able, and not back on its goal");
        robot.see(12.5, true, true);
        robot.see(20.0, true, true);
        assert_eq!(robot.took_s(), Some(2.5));
        let mut idle = Recovery {
            had_goal: false,
            ..fault
        };
        idle.see(10.0, true, false);
        assert_eq!(idle.took_s(), Some(0.0));
    }
}
