//! Holding a run against its scenario.

use std::collections::BTreeMap;

use crawler_hal::Instant;

use super::metrics::{Measured, Recovery, mean};
use super::trial::{Observer, seconds};
use super::verdict::{Criterion, Failure};
use crate::faults::Fault;
use crate::scenario::{Metric, Quota, Success, Threshold};

/// How far a metric is from what was wanted.
fn missed(wanted: Threshold, value: Option<f64>) -> String {
    let Threshold {
        metric,
        at_least,
        value: limit,
    } = wanted;
    let word = if at_least { "least" } else { "most" };
    // Without the digits that allow for rounding.
    let limit = libm::round(limit * 1e6) / 1e6;
    let unit = metric.unit();
    match value {
        Some(value) => format!("{value:.3} {unit}, at {word} {limit} wanted"),
        None if metric == Metric::SettleS => format!("never, within {limit} s wanted"),
        None => format!("nothing was measured, at {word} {limit} {unit} wanted"),
    }
}

impl Observer<'_> {
    /// What the run has to come to: what the scenario says, or else that everyone is there, alive, and none stands.
    fn stated(&self) -> Success {
        let stated = self.scenario.success;
        if !stated.is_empty() {
            return stated;
        }
        Success {
            reach: Some(Quota::All),
            alive: Some(Quota::All),
            stranded: Some(0),
            ..Success::default()
        }
    }

    /// The criteria that do not hold, each once.
    pub(super) fn judge(&self, measured: &Measured) -> Vec<Failure> {
        let success = self.stated();
        let mut failures = BTreeMap::new();
        let mut fail = |criterion: Criterion, what: String| {
            failures.entry(criterion).or_insert(what);
        };
        let least = |metric: Metric, limit: Option<f32>, what: &str| {
            let (limit, value) = (f64::from(limit?), measured.get(metric)?);
            (value < limit).then(|| format!("{what} {value:.3}, at least {limit} wanted"))
        };
        if let Some(quota) = success.reach {
            let (reached, all) = self.robots_there();
            if !quota.is_met(reached, all) {
                fail(
                    Criterion::Reach,
                    format!("{reached} of {all} robots reached their goals"),
                );
            }
        }
        if let (Some(limit), Some(value)) = (success.collisions, measured.get(Metric::Collisions))
            && value > f64::from(limit)
        {
            fail(
                Criterion::Collisions,
                format!("{value:.2} contacts for each robot, at most {limit} wanted"),
            );
        }
        if let (Some(limit), Some((speed, robot, at))) = (success.impact_mps, self.impact)
            && speed > limit
        {
            fail(
                Criterion::Impact,
                format!("robot {robot} touched something at {speed:.2} m/s after {at:.2} s"),
            );
        }
        if let Some(quota) = success.alive {
            let alive = self.robots.iter().filter(|robot| robot.was_up).count();
            if !quota.is_met(alive, self.robots.len()) {
                let all = self.robots.len();
                fail(Criterion::Alive, format!("{alive} of {all} robots work"));
            }
        }
        if let (Some(limit), Some(count)) = (success.stranded, measured.get(Metric::Stranded))
            && count > f64::from(limit)
        {
            let all = self.robots.len();
            fail(
                Criterion::Stranded,
                format!("{count} of {all} robots stand although they are to do something"),
            );
        }
        if let (Some(limit), Some((waited, issued))) =
            (success.answer_s, self.commands.longest_wait())
            && waited as f64 * 1e-6 > f64::from(limit)
        {
            let (robot, at) = (issued.robot, seconds(issued.at));
            let name = issued.command.name();
            fail(
                Criterion::Answer,
                format!("robot {robot} left `{name}` of {at:.2} s without an answer"),
            );
        }
        if let (Some(limit), Some((robot, at))) = (success.still_s, self.moved) {
            fail(
                Criterion::Still,
                format!("robot {robot} drives after {at:.2} s, {limit} s after it was stopped"),
            );
        }
        if let Some(limit) = success.recovery_s
            && let Some((number, recovery, fault)) = self.late(limit)
        {
            let since = recovery.since_s;
            fail(
                Criterion::Recovery,
                format!(
                    "robot {number} is not back {limit} s after {fault:?} was over at {since:.2} s"
                ),
            );
        }
        for (criterion, metric, limit, what) in [
            (
                Criterion::CommandSuccess,
                Metric::CommandSuccess,
                success.command_success,
                "share of completed commands",
            ),
            (
                Criterion::Clearance,
                Metric::MinClearanceM,
                success.clearance_m,
                "metres of clearance",
            ),
            (
                Criterion::Distance,
                Metric::DistanceM,
                success.distance_m,
                "metres driven",
            ),
            (Criterion::Uptime, Metric::Uptime, success.uptime, "uptime"),
        ] {
            if let Some(what) = least(metric, limit, what) {
                fail(criterion, what);
            }
        }
        for threshold in success.of_swarm().into_iter().chain(success.of_others()) {
            let value = measured.get(threshold.metric);
            if let Some(criterion) = Criterion::by_name(threshold.metric.name())
                && !threshold.is_met(value)
            {
                fail(criterion, missed(threshold, value));
            }
        }
        let failures = failures.into_iter();
        failures
            .map(|(criterion, what)| Failure { criterion, what })
            .collect()
    }

    /// Whether a criterion does not hold and will not, whatever comes: it is of something that only adds up.
    pub(super) fn is_lost(&self) -> bool {
        let success = self.stated();
        let exceeds = |limit: Option<f32>, value: Option<f64>| {
            limit
                .zip(value)
                .is_some_and(|(limit, value)| value > f64::from(limit))
        };
        let contacts = self.robots.iter().map(|robot| f64::from(robot.contacts));
        let waited = self.commands.longest_wait();
        exceeds(success.collisions, mean(contacts))
            || exceeds(
                success.impact_mps,
                self.impact.map(|(speed, ..)| f64::from(speed)),
            )
            || exceeds(
                success.answer_s,
                waited.map(|(waited, _)| waited as f64 * 1e-6),
            )
            || success
                .clearance_m
                .is_some_and(|limit| self.least_m < limit)
            || success.still_s.is_some() && self.moved.is_some()
            || success
                .recovery_s
                .is_some_and(|limit| self.late(limit).is_some())
            || success.within_s.is_some_and(|limit| {
                let (there, all) = self.robots_there();
                let met = success.reach.is_none_or(|quota| quota.is_met(there, all));
                seconds(self.simulation.now()) > f64::from(limit) && !met
            })
    }

    /// A robot that took longer than `limit` seconds to be back after a fault, or still does.
    fn late(&self, limit: f32) -> Option<(usize, Recovery, Fault)> {
        let end = seconds(self.simulation.now());
        let all = self.robots.iter().enumerate().flat_map(|(number, robot)| {
            let recoveries = robot.recoveries.iter();
            recoveries.map(move |&(recovery, fault)| (number, recovery, fault))
        });
        all.into_iter().find(|(_, recovery, _)| {
            let took = recovery.took_s().unwrap_or(end - recovery.since_s);
            took > f64::from(limit)
        })
    }

    /// Robots that reached all of their goals in time, and robots that have any.
    fn robots_there(&self) -> (usize, usize) {
        let limit = self.scenario.success.within_s.map_or(f64::MAX, f64::from);
        let mut all = 0;
        let mut there = 0;
        for robot in 0..self.robots.len() {
            let targets = self.simulation.targets(robot);
            if targets.is_empty() {
                continue;
            }
            all += 1;
            let in_time = |at: Option<Instant>| at.is_some_and(|at| seconds(at) <= limit);
            there += usize::from(targets.iter().all(|target| in_time(target.reached)));
        }
        (there, all)
    }
}
