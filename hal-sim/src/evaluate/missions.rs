//! How far robots are with what they do together: what they say of it, held against where they are.

use crawler_protocol::{Action, BehaviourName, BehaviourSpec};

use super::metrics::{Measured, share};
use crate::run::Simulation;
use crate::scenario::{Metric, Scenario, apart};

/// Who is no farther away than this from a place is at it, metres.
const AT_M: f32 = 0.35;
/// Values of a consensus that are no farther apart are one, thousandths.
const AGREED: i32 = 20;

/// See the [module](self).
#[derive(Debug, Default)]
pub(super) struct Missions {
    tasks: Vec<[f32; 2]>,
    /// Of each place of a patrol: where it is, and since when nobody was there, seconds.
    places: Vec<([f32; 2], f64)>,
    /// The longest that one of them was left alone in the second half of the run.
    idle_s: Option<f64>,
    /// When that begins.
    half_s: f64,
    seen: Seen,
}

/// What the last look showed.
#[derive(Debug, Default, Clone, Copy)]
struct Seen {
    agreement: Option<f64>,
    served: Option<f64>,
    following: Option<f64>,
}

impl Missions {
    /// Of what the robots of `scenario` are told to do last.
    pub(super) fn new(scenario: &Scenario) -> Self {
        let timed = scenario.commands.iter();
        let timed = timed.filter_map(|timed| timed.action().ok());
        let first = scenario.action().ok().flatten();
        let mut missions = Self {
            half_s: f64::from(scenario.duration_s) / 2.0,
            ..Self::default()
        };
        for action in first.into_iter().chain(timed) {
            match action {
                Action::Behave(BehaviourSpec::Allocate { tasks }) => {
                    missions.tasks = tasks.as_slice().to_vec();
                }
                Action::Behave(BehaviourSpec::Patrol { waypoints, .. }) => {
                    let places = waypoints.as_slice().iter();
                    missions.places = places.map(|place| (*place, missions.half_s)).collect();
                }
                _ => {}
            }
        }
        missions
    }

    /// Takes in how the robots are that work.
    pub(super) fn look(
        &mut self,
        simulation: &Simulation,
        works: impl Fn(usize) -> bool,
        now_s: f64,
    ) {
        let (mut values, mut places) = (Vec::new(), Vec::new());
        let (mut followers, mut following) = (0, 0);
        for number in (0..simulation.robots()).filter(|number| works(*number)) {
            let Some(robot) = simulation.robot(number).map(|robot| robot.snapshot()) else {
                continue;
            };
            if let Some(seen) = simulation.observe(number) {
                places.push([seen.pose.x, seen.pose.y]);
            }
            let says = |behaviour| robot.says.as_ref()?.by(behaviour);
            if let Some([value, ..]) = says(BehaviourName::Consensus) {
                values.push(*value);
            }
            if let Some([_, hops]) = says(BehaviourName::Follow) {
                followers += 1;
                following += usize::from(*hops > 0);
            }
        }
        let is_at = |place: [f32; 2]| places.iter().any(|&there| apart(there, place) <= AT_M);
        let served = self.tasks.iter().filter(|&&task| is_at(task)).count();
        self.seen = Seen {
            agreement: largest_group(values),
            served: share(served, self.tasks.len()),
            following: share(following, followers),
        };
        for (place, since) in &mut self.places {
            if now_s >= self.half_s {
                let idle = now_s - *since;
                self.idle_s = Some(self.idle_s.map_or(idle, |longest| longest.max(idle)));
            }
            if is_at(*place) || now_s < self.half_s {
                *since = now_s;
            }
        }
    }

    pub(super) fn measure(&self, measured: &mut Measured) {
        measured.set(Metric::Agreement, self.seen.agreement);
        measured.set(Metric::Served, self.seen.served);
        measured.set(Metric::Following, self.seen.following);
        measured.set(Metric::IdleS, self.idle_s);
    }
}

/// The largest share of `values` that are one.
fn largest_group(mut values: Vec<i32>) -> Option<f64> {
    values.sort_unstable();
    let groups = values.iter().enumerate().map(|(first, &least)| {
        let end = values.partition_point(|&value| value <= least.saturating_add(AGREED));
        end - first
    });
    share(groups.max()?, values.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_that_are_near_are_one() {
        assert_eq!(largest_group(vec![]), None);
        assert_eq!(largest_group(vec![5]), Some(1.0));
        assert_eq!(largest_group(vec![40, 0, 20, 10, 100]), Some(0.6));
    }
}
