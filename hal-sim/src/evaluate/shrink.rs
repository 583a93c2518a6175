//! Making a failing scenario as small as it can be, and still fail in the same way.
//!
//! Delta debugging (Zeller and Hildebrandt 2002) over what a scenario is made of: robots, faults,
//! commands, goals, obstacles, parameters, length, size, and digits. Every step is tried by
//! running it; the same find always shrinks to the same scenario.

use std::sync::atomic::{AtomicBool, Ordering};

use super::adversary::Find;
use super::trial::run_trial;
use super::verdict::{Criterion, Failure};
use crate::run::Simulation;
use crate::scenario::{Goal, Passable, Quota, Scatter, Scenario, Selector, SpawnPose, Success};
use crate::world::{Obstacle, Parameters, Profile, TABLE};

/// What a robot keeps from walls on a way that it can be asked to find, metres.
const WAY_MARGIN_M: f32 = 0.05;
/// Seconds that a robot may take for each metre of the shortest way to its goal, and at least. A
/// shorter run would fail for lack of time.
const SECONDS_PER_METRE: f32 = 15.0;
const LEAST_SECONDS: f32 = 40.0;

/// A scenario that cannot be made smaller.
#[derive(Debug, Clone)]
pub struct Shrunk {
    /// The scenario.
    pub scenario: Scenario,
    /// Its seed.
    pub seed: u64,
    /// What it breaks.
    pub failure: Failure,
    /// Runs that it took.
    pub runs: usize,
}

/// The find with everything stated that it draws from its seed, and nothing asked but what it
/// breaks. `None` when it asks for something impossible, or fails for lack of time alone.
pub(super) fn confirmed(find: &Find) -> Option<Find> {
    let go = AtomicBool::new(false);
    let mut shrinking = Shrinking::new(find, 1, &go, &|_| {});
    shrinking.state_only_what_breaks();
    let stated = shrinking.stated()?;
    shrinking.take(stated).then(|| Find {
        scenario: shrinking.best,
        failure: shrinking.failure,
        ..find.clone()
    })
}

/// Shrinks a find, with at most `budget` runs.
#[must_use]
pub fn shrink(find: &Find, budget: usize, stop: &AtomicBool, done: &dyn Fn(usize)) -> Shrunk {
    let mut shrinking = Shrinking::new(find, budget, stop, done);
    while shrinking.round() {}
    let criterion = find.failure.criterion.name().replace('_', "-");
    shrinking.best.name = format!("found-{criterion}-{}", find.seed);
    shrinking.best.name.truncate(64);
    Shrunk {
        scenario: shrinking.best,
        seed: find.seed,
        failure: shrinking.failure,
        runs: shrinking.runs,
    }
}

struct Shrinking<'a> {
    best: Scenario,
    seed: u64,
    failure: Failure,
    runs: usize,
    budget: usize,
    stop: &'a AtomicBool,
    done: &'a dyn Fn(usize),
}

impl<'a> Shrinking<'a> {
    fn new(find: &Find, budget: usize, stop: &'a AtomicBool, done: &'a dyn Fn(usize)) -> Self {
        Self {
            best: find.scenario.clone(),
            seed: find.seed,
            failure: find.failure.clone(),
            runs: 0,
            budget,
            stop,
            done,
        }
    }

    /// Takes `candidate` for the best one if it still fails in the same way.
    fn take(&mut self, candidate: Scenario) -> bool {
        if candidate == self.best
            || self.runs >= self.budget
            || self.stop.load(Ordering::Relaxed)
            || candidate.validate().is_err()
            || !self.is_fair(&candidate)
        {
            return false;
        }
        self.runs += 1;
        (self.done)(self.runs);
        let trial = run_trial(&candidate, self.seed);
        let same = trial.failures.into_iter();
        let criterion = self.failure.criterion;
        let Some(failure) = same.into_iter().find(|f| f.criterion == criterion) else {
            return false;
        };
        self.failure = failure;
        self.best = candidate;
        true
    }

    /// Whether the scenario asks for something that can be done: there is a way to every goal, and
    /// time to go there.
    fn is_fair(&self, scenario: &Scenario) -> bool {
        if self.failure.criterion != Criterion::Reach {
            return true;
        }
        self.least_seconds(scenario)
            .is_some_and(|least| scenario.duration_s >= least)
    }

    /// Seconds that robots need at least to reach all of their goals; `None` when there is no way,
    /// or goals are not stated.
    fn least_seconds(&self, scenario: &Scenario) -> Option<f32> {
        let arena = scenario.arena(self.seed).ok()?;
        let map = Passable::new(&arena, scenario.parameters.chassis.radius_m + WAY_MARGIN_M);
        let mut longest = 0.0_f32;
        for robot in 0..scenario.robots as usize {
            let start = scenario.spawn.poses.get(robot)?;
            let mut here = [start.x, start.y];
            let mut way = 0.0;
            for goal in scenario.goals.iter().filter(|goal| goal.robots.has(robot)) {
                let (x, y) = goal.x.zip(goal.y)?;
                way += map.way(here, [x, y]).filter(|_| map.is_free([x, y]))?;
                here = [x, y];
            }
            longest = longest.max(way);
        }
        Some((longest * SECONDS_PER_METRE).max(LEAST_SECONDS))
    }

    fn state_only_what_breaks(&mut self) {
        let stated = self.best.success;
        let mut success = Success::default();
        match self.failure.criterion {
            Criterion::Reach => {
                success.reach = stated.reach.or(Some(Quota::All));
                success.within_s = stated.within_s;
            }
            Criterion::Collisions => success.collisions = stated.collisions,
            Criterion::Impact => success.impact_mps = stated.impact_mps,
            Criterion::Alive => success.alive = stated.alive.or(Some(Quota::All)),
            Criterion::Stranded => success.stranded = stated.stranded.or(Some(0)),
            Criterion::CommandSuccess => success.command_success = stated.command_success,
            Criterion::Answer => success.answer_s = stated.answer_s,
            Criterion::Clearance => success.clearance_m = stated.clearance_m,
            Criterion::Distance => success.distance_m = stated.distance_m,
            Criterion::Recovery => success.recovery_s = stated.recovery_s,
            Criterion::Uptime => success.uptime = stated.uptime,
            Criterion::Still => success.still_s = stated.still_s,
            Criterion::ContactsPerMinute => {
                success.contacts_per_minute = stated.contacts_per_minute;
            }
            Criterion::Order => success.order = stated.order,
            Criterion::Clusters => success.clusters = stated.clusters,
            Criterion::LargestCluster => success.largest_cluster = stated.largest_cluster,
            Criterion::PairDistance => success.pair_distance_m = stated.pair_distance_m,
            Criterion::Coverage => success.coverage = stated.coverage,
            Criterion::Evenness => success.evenness = stated.evenness,
            Criterion::LatticeDegree => success.lattice_degree = stated.lattice_degree,
            Criterion::SpacingError => success.spacing_error_m = stated.spacing_error_m,
            Criterion::ShapeError => success.shape_error_m = stated.shape_error_m,
            Criterion::Found => success.found = stated.found,
            Criterion::Agreement => success.agreement = stated.agreement,
            Criterion::Served => success.served = stated.served,
            Criterion::Following => success.following = stated.following,
            Criterion::Idle => success.idle_s = stated.idle_s,
            // What it is to settle to stands beside it.
            Criterion::Settle => {
                success = Success {
                    order: stated.order,
                    clusters: stated.clusters,
                    largest_cluster: stated.largest_cluster,
                    pair_distance_m: stated.pair_distance_m,
                    coverage: stated.coverage,
                    evenness: stated.evenness,
                    lattice_degree: stated.lattice_degree,
                    spacing_error_m: stated.spacing_error_m,
                    shape_error_m: stated.shape_error_m,
                    settle_s: stated.settle_s,
                    ..success
                };
            }
            // Whatever is stated, these end a run.
            Criterion::SetUp | Criterion::Panic => success = stated,
        }
        self.best.success = success;
    }

    /// The scenario with everything stated that it draws from its seed.
    fn stated(&self) -> Option<Scenario> {
        let scenario = &self.best;
        let arena = scenario.arena(self.seed).ok()?;
        let simulation = Simulation::lockstep(scenario.clone(), self.seed).ok()?;
        let mut stated = scenario.clone();
        stated.parameters = scenario.drawn_parameters(self.seed);
        stated.randomisation = Profile::None;
        stated.difficulty = None;
        stated.arena.width = Some(arena.width);
        stated.arena.height = Some(arena.height);
        stated.arena.obstacles = arena.obstacles;
        stated.arena.generate = None;
        stated.arena.scatter = Scatter::default();
        stated.spawn.line = None;
        stated.spawn.zones.clear();
        stated.spawn.poses.clear();
        let mut goals = Vec::new();
        for robot in 0..simulation.robots() {
            let pose = simulation.observe(robot)?.pose;
            stated.spawn.poses.push(SpawnPose {
                x: pose.x,
                y: pose.y,
                theta: pose.theta,
            });
            let of_robot = scenario.goals.iter().filter(|goal| goal.robots.has(robot));
            for (goal, target) in of_robot.zip(simulation.targets(robot)) {
                goals.push(Goal {
                    robots: Selector::List(vec![robot as u32]),
                    x: Some(target.at[0]),
                    y: Some(target.at[1]),
                    places: Vec::new(),
                    draw: None,
                    ..goal.clone()
                });
            }
        }
        stated.goals = goals;
        if self.failure.criterion == Criterion::Reach {
            let least = libm::ceilf(self.least_seconds(&stated)?);
            stated.duration_s = stated.duration_s.max(least);
        }
        Some(stated)
    }

    /// Tries everything once; whether anything helped.
    fn round(&mut self) -> bool {
        let mut helped = self.drop_robots();
        helped |= self.drop_some(|scenario| &mut scenario.faults);
        helped |= self.drop_some(|scenario| &mut scenario.commands);
        helped |= self.drop_some(|scenario| &mut scenario.goals);
        helped |= self.drop_some(|scenario| &mut scenario.arena.obstacles);
        helped |= self.drop_some(|scenario| &mut scenario.arena.movers);
        helped |= self.drop_some(|scenario| &mut scenario.arena.objects);
        helped |= self.drop_some(|scenario| &mut scenario.arena.patches);
        helped |= self.plain_parameters();
        helped |= self.shorten();
        helped |= self.narrow();
        helped |= self.ease_faults();
        helped |= self.round_off();
        helped
    }

    fn changed(&mut self, change: impl FnOnce(&mut Scenario)) -> bool {
        let mut candidate = self.best.clone();
        change(&mut candidate);
        self.take(candidate)
    }

    fn drop_robots(&mut self) -> bool {
        let mut helped = false;
        let mut robot = self.best.robots;
        while robot > 0 && self.best.robots > 1 {
            robot -= 1;
            helped |= self.changed(|scenario| without_robot(scenario, robot));
        }
        helped
    }

    /// Drops parts of a list: halves, quarters, and so on down to single entries.
    fn drop_some<T: Clone>(&mut self, list: impl Fn(&mut Scenario) -> &mut Vec<T>) -> bool {
        let mut helped = false;
        let mut chunk = list(&mut self.best.clone()).len();
        while chunk > 0 {
            let mut start = 0;
            loop {
                let length = list(&mut self.best.clone()).len();
                if start >= length {
                    break;
                }
                let end = (start + chunk).min(length);
                let dropped = self.changed(|scenario| {
                    list(scenario).drain(start..end);
                });
                helped |= dropped;
                if !dropped {
                    start += chunk;
                }
            }
            chunk /= 2;
        }
        helped
    }

    fn plain_parameters(&mut self) -> bool {
        let plain = Parameters {
            ..Parameters::default()
        };
        if self.best.parameters == plain {
            return false;
        }
        if self.changed(|scenario| scenario.parameters = plain) {
            return true;
        }
        let mut helped = false;
        for row in TABLE {
            if row.value(&self.best.parameters) != row.nominal() {
                helped |= self.changed(|scenario| {
                    row.set(&mut scenario.parameters, row.nominal());
                });
            }
        }
        helped
    }

    fn shorten(&mut self) -> bool {
        let mut helped = false;
        for share in [0.5, 0.75, 0.9] {
            let shorter = |scenario: &mut Scenario| {
                scenario.duration_s = libm::ceilf(scenario.duration_s * share);
            };
            while self.changed(shorter) {
                helped = true;
            }
        }
        helped
    }

    fn narrow(&mut self) -> bool {
        let mut helped = false;
        for share in [0.6, 0.8, 0.9] {
            let narrow = |side: &mut Option<f32>| {
                *side = side.map(|side| libm::ceilf(side * share * 10.0) * 0.1);
            };
            while self.changed(|scenario| narrow(&mut scenario.arena.width)) {
                helped = true;
            }
            while self.changed(|scenario| narrow(&mut scenario.arena.height)) {
                helped = true;
            }
        }
        helped
    }

    /// Faults that begin later and are over sooner.
    fn ease_faults(&mut self) -> bool {
        let mut helped = false;
        for number in 0..self.best.faults.len() {
            for later in [8.0, 4.0, 2.0, 1.0] {
                while self.best.faults[number].at_s < self.best.duration_s
                    && self.changed(|scenario| {
                        let fault = &mut scenario.faults[number];
                        fault.at_s = libm::roundf((fault.at_s + later) * 10.0) * 0.1;
                    })
                {
                    helped = true;
                }
            }
            while self.changed(|scenario| {
                let fault = &mut scenario.faults[number];
                fault.for_s = fault.for_s.map(|span| libm::ceilf(span * 5.0) * 0.1);
            }) {
                helped = true;
            }
        }
        helped
    }

    /// Numbers with fewer digits.
    fn round_off(&mut self) -> bool {
        let mut helped = false;
        for per_metre in [10.0, 20.0, 100.0] {
            let to = |value: f32| libm::roundf(value * per_metre) / per_metre;
            for number in 0..self.best.arena.obstacles.len() {
                helped |= self.changed(|scenario| match &mut scenario.arena.obstacles[number] {
                    Obstacle::Circle { x, y, r } => {
                        (*x, *y, *r) = (to(*x), to(*y), to(*r));
                    }
                    Obstacle::Box { x, y, w, h, theta } => {
                        (*x, *y, *w, *h) = (to(*x), to(*y), to(*w), to(*h));
                        *theta = to(*theta);
                    }
                });
            }
            for number in 0..self.best.spawn.poses.len() {
                helped |= self.changed(|scenario| {
                    let pose = &mut scenario.spawn.poses[number];
                    (pose.x, pose.y, pose.theta) = (to(pose.x), to(pose.y), to(pose.theta));
                });
            }
            for number in 0..self.best.goals.len() {
                helped |= self.changed(|scenario| {
                    let goal = &mut scenario.goals[number];
                    goal.x = goal.x.map(to);
                    goal.y = goal.y.map(to);
                });
            }
        }
        // Coarser digits come first, so a second round has nothing to do.
        helped && self.runs < self.budget
    }
}

/// Takes a robot out, and renumbers the others.
fn without_robot(scenario: &mut Scenario, robot: u32) {
    let all = scenario.robots;
    let renumber = |selector: &mut Selector| {
        let those = (0..all).filter(|&number| number != robot && selector.has(number as usize));
        let moved = those.map(|number| if number > robot { number - 1 } else { number });
        *selector = match selector {
            Selector::All => Selector::All,
            Selector::Share(_) | Selector::List(_) => Selector::List(moved.collect()),
        };
    };
    scenario.robots -= 1;
    if (robot as usize) < scenario.spawn.poses.len() {
        scenario.spawn.poses.remove(robot as usize);
    }
    for goal in &mut scenario.goals {
        renumber(&mut goal.robots);
    }
    for fault in &mut scenario.faults {
        renumber(&mut fault.robots);
    }
    for command in &mut scenario.commands {
        renumber(&mut command.robots);
    }
    let someone =
        |selector: &Selector| !matches!(selector, Selector::List(list) if list.is_empty());
    scenario.goals.retain(|goal| someone(&goal.robots));
    scenario.faults.retain(|fault| someone(&fault.robots));
    scenario.commands.retain(|command| someone(&command.robots));
}
