//! What a program is compared with: robots that wander about, and the least that anybody needs.

use crawler_app::parameters::{Parameter, Parameters};

use super::metrics::{Measured, mean, share};
use super::trial::{Trial, seconds};
use super::verdict::{Criterion, Failure};
use crate::run::Simulation;
use crate::run::machine::geometry;
use crate::scenario::{Metric, Passable, Quota, Scenario, Start};

/// Who drives the robots of an evaluated run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Driver {
    /// The robots' program, as the scenario tells it.
    #[default]
    Program,
    /// The same program, told to wander and nothing else: see [`wandering`].
    Wander,
    /// Nobody: see [`ideal`].
    Ideal,
}

impl Driver {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Program, Self::Wander, Self::Ideal];

    /// Its name in options and files.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Program => "program",
            Self::Wander => "wander",
            Self::Ideal => "ideal",
        }
    }

    /// The driver of this name.
    #[must_use]
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|driver| driver.name() == name)
    }
}

/// The same scenario for robots that wander from the beginning on and are sent nowhere: goals count
/// when they come by. Commands that have robots move are left out, all others stay.
#[must_use]
pub fn wandering(mut scenario: Scenario) -> Scenario {
    let moves = |command: &str| matches!(command, "move" | "drive" | "goto" | "behave" | "scan");
    for goal in &mut scenario.goals {
        goal.tell = false;
    }
    scenario.commands.retain(|timed| !moves(&timed.command));
    let wander = ("behaviour".to_owned(), serde_json::json!("wander"));
    scenario.command = Some(Start {
        command: "behave".to_owned(),
        parameters: [wander].into_iter().collect(),
    });
    scenario
}

/// What goals come to when every robot knows the map, is sent at once, and drives the shortest way at
/// the full speed of `goto`, as if it were alone and turned in no time: a bound that no program can
/// beat. Nothing is simulated; there are no other metrics, and no criterion but `reach` is judged.
#[must_use]
pub fn ideal(scenario: &Scenario, seed: u64) -> Trial {
    let simulation = match Simulation::lockstep(scenario.clone(), seed) {
        Ok(simulation) => simulation,
        Err(error) => return Trial::broken(seed, Criterion::SetUp, error.to_string()),
    };
    let chassis = simulation.world().parameters().chassis;
    let map = Passable::new(&simulation.world().arena(), chassis.radius_m);
    let settings = Parameters::default();
    let top_mps = settings
        .number(Parameter::MaxSpeed)
        .min(geometry(&chassis).top_speed_mps);
    let speed_mps = f64::from(settings.number(Parameter::GotoSpeed) * 0.01 * top_mps);
    let limit_s = f64::from(scenario.duration_s);
    let limit_s = limit_s.min(scenario.success.within_s.map_or(f64::MAX, f64::from));
    let mut times_s = Vec::new();
    let mut ways_m = Vec::new();
    let (mut goals, mut there, mut bound) = (0, 0, 0);
    let mut last_s = 0.0_f64;
    for robot in 0..simulation.robots() {
        let targets = simulation.targets(robot);
        let Some(seen) = simulation.observe(robot) else {
            continue;
        };
        let (mut here, mut rim) = ([seen.pose.x, seen.pose.y], 0.0);
        let (mut now_s, mut way_m, mut reached) = (0.0_f64, 0.0, 0);
        for target in targets {
            now_s = now_s.max(seconds(target.from));
            // From the rim of one goal to that of the next.
            let Some(way) = map.way(here, target.at) else {
                break;
            };
            let way = f64::from((way - target.r - rim).max(0.0));
            let took_s = way / speed_mps;
            now_s += took_s;
            if now_s > limit_s {
                break;
            }
            times_s.push(took_s);
            way_m += way;
            reached += 1;
            (here, rim) = (target.at, target.r);
        }
        goals += targets.len();
        there += reached;
        bound += usize::from(reached == targets.len() && reached > 0);
        last_s = last_s.max(now_s.min(limit_s));
        ways_m.push(way_m);
    }
    let sent = (0..simulation.robots()).filter(|&robot| !simulation.targets(robot).is_empty());
    let sent = sent.count();
    let mut failures = Vec::new();
    let quota = scenario.success.reach;
    let quota = quota.or(scenario.success.is_empty().then_some(Quota::All));
    if quota.is_some_and(|quota| !quota.is_met(bound, sent)) {
        failures.push(Failure {
            criterion: Criterion::Reach,
            what: format!("{bound} of {sent} robots can reach their goals in time"),
        });
    }
    let mut measured = Measured::default();
    measured.set(Metric::Reached, share(there, goals));
    measured.set(Metric::PathOptimality, (!times_s.is_empty()).then_some(1.0));
    measured.set(Metric::TimeToGoalS, mean(times_s));
    measured.set(Metric::DistanceM, mean(ways_m));
    let success = if failures.is_empty() { 1.0 } else { 0.0 };
    measured.set(Metric::Success, Some(success));
    Trial {
        seed,
        measured,
        failures,
        ran_s: last_s,
        history: 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scenario(more: &str) -> Scenario {
        let text = format!(
            "name = \"a\"\nduration_s = 30.0\n[arena]\nwidth = 6.0\nheight = 4.0\n[spawn]\n\
             poses = [{{ x = -2.0, y = 0.0 }}]\n[[goals]]\nx = 2.0\ny = 0.0\n{more}"
        );
        Scenario::parse(&text).unwrap()
    }

    #[test]
    fn drivers_are_found_by_their_names() {
        for driver in Driver::ALL {
            assert_eq!(Driver::by_name(driver.name()), Some(driver));
        }
        assert_eq!(Driver::by_name("luck"), None);
    }

    #[test]
    fn the_ideal_is_the_shortest_way_at_full_speed() {
        let trial = ideal(&scenario(""), 1);
        assert_eq!(trial.failures, []);
        let near = |trial: &Trial, metric, expected: f64| {
            let value = trial.measured.get(metric).unwrap();
            assert!((value - expected).abs() < 0.01, "{metric:?} {value}");
        };
        // 4 m less 0.25 m at 0.3 m/s.
        near(&trial, Metric::TimeToGoalS, 12.5);
        near(&trial, Metric::DistanceM, 3.75);
        near(&trial, Metric::PathOptimality, 1.0);
        // Not in five seconds, nor back again in thirty with a wait before.
        let late = ideal(&scenario("[success]\nreach = \"all\"\nwithin_s = 5.0\n"), 1);
        assert_eq!(late.failures[0].criterion, Criterion::Reach);
        near(&late, Metric::Reached, 0.0);
        let back = "[[goals]]\nx = -2.0\ny = 0.0\nat_s = 20.0\n";
        let twice = ideal(&scenario(back), 1);
        near(&twice, Metric::Reached, 0.5);
        near(&twice, Metric::Success, 0.0);
        let sooner = ideal(&scenario(&back.replace("20.0", "15.0")), 1);
        near(&sooner, Metric::Success, 1.0);
        // 3.75 m and 3.5 m.
        near(&sooner, Metric::DistanceM, 7.25);
        // What is walled off cannot be reached.
        let walled = "[[arena.obstacles]]\nshape = \"box\"\nx = 0.0\ny = 0.0\nw = 0.1\nh = 4.0\n";
        near(&ideal(&scenario(walled), 1), Metric::Reached, 0.0);
    }

    #[test]
    fn who_wanders_is_told_nothing_else() {
        let more = "[[commands]]\nat_s = 5.0\ncommand = \"scan\"\n\
                    [[commands]]\nat_s = 6.0\ncommand = \"reboot\"\n";
        let told = wandering(scenario(more));
        told.validate().unwrap();
        assert!(!told.goals[0].tell);
        let names: Vec<_> = told.commands.iter().map(|timed| &timed.command).collect();
        assert_eq!(names, ["reboot"]);
        assert_eq!(told.command.as_ref().unwrap().command, "behave");
        assert_eq!(wandering(told.clone()), told);
    }
}
