//! One run of a scenario, measured.

use std::convert::Infallible;
use std::sync::atomic::{AtomicBool, Ordering};

use crawler_hal::{Duration, Instant};
use crawler_protocol::{BehaviourName, Detections, RobotState, Topic};

use super::behaving::Behaving;
use super::clearance::{LIMIT_M, Near};
use super::commands::{Commands, number};
use super::found::Found;
use super::metrics::{Measured, Recovery, mean, path_optimality, share};
use super::missions::Missions;
use super::swarm::{EVERY_S, Swarm};
use super::verdict::{Criterion, Failure};
use crate::faults::Fault;
use crate::net::lockstep::{Published, VirtualNetwork};
use crate::run::{Broken, Simulation, SimulationError};
use crate::scenario::{Metric, Passable, Scenario, apart};
use crate::world::{Observation, Obstacle};

/// How often robots are looked at.
const LOOK: Duration = Duration::from_millis(50);
/// So many looks from one at the swarm to the next.
const LOOKS_AT_SWARM: u32 = EVERY_S * 1_000 / LOOK.as_millis() as u32;
/// Robots have this long to boot, connect and learn the time; then it counts as down time.
const START: Duration = Duration::from_secs(10);
/// A run goes on for so long after its scenario is over.
const AFTERMATH: Duration = Duration::from_secs(1);
/// Messages that one look may find.
const RECORD: usize = 1_000_000;

/// What one run came to.
#[derive(Debug, Clone, PartialEq)]
pub struct Trial {
    /// Its seed.
    pub seed: u64,
    /// What was measured.
    pub measured: Measured,
    /// The criteria that do not hold; none when the run is a success.
    pub failures: Vec<Failure>,
    /// How long it ran, seconds of its own time.
    pub ran_s: f64,
    /// Fingerprint of its history.
    pub history: u64,
}

impl Trial {
    pub(super) fn broken(seed: u64, criterion: Criterion, what: String) -> Self {
        let mut measured = Measured::default();
        measured.set(Metric::Success, Some(0.0));
        Self {
            seed,
            measured,
            failures: vec![Failure { criterion, what }],
            ran_s: 0.0,
            history: 0,
        }
    }

    /// Whether everything came out as it should.
    #[must_use]
    pub fn is_success(&self) -> bool {
        self.failures.is_empty()
    }
}

/// Runs a scenario in lockstep for as long as it lasts. A world that cannot be built is a run that
/// failed.
///
/// # Panics
/// When simulator or program do: that would be a mistake in them.
#[must_use]
pub fn run_trial(scenario: &Scenario, seed: u64) -> Trial {
    run_trial_watched(scenario, seed, &mut |_| {})
}

/// The same; tells `watch` from time to time what share of its longest time has passed, 0 to 1.
pub(super) fn run_trial_watched(
    scenario: &Scenario,
    seed: u64,
    watch: &mut dyn FnMut(f64),
) -> Trial {
    let mut observer = match Observer::new(scenario, seed) {
        Ok(observer) => observer,
        Err(error) => return set_up(seed, &error),
    };
    let mut told = 0;
    observer.run(|observer| {
        let now = seconds(observer.simulation.now());
        // A second of the world is a few milliseconds here, or a few seconds with ten thousand robots.
        if now as u64 > told {
            told = now as u64;
            watch((now / f64::from(scenario.duration_s)).min(1.0));
        }
        true
    });
    observer.finish().0
}

/// The same, given up in the middle once `stop` is set; `None` then.
///
/// # Panics
/// As [`run_trial`].
#[must_use]
pub fn run_trial_unless(scenario: &Scenario, seed: u64, stop: &AtomicBool) -> Option<Trial> {
    if stop.load(Ordering::Relaxed) {
        return None;
    }
    let mut observer = match Observer::new(scenario, seed) {
        Ok(observer) => observer,
        Err(error) => return Some(set_up(seed, &error)),
    };
    observer.run(|_| !stop.load(Ordering::Relaxed));
    (!stop.load(Ordering::Relaxed)).then(|| observer.finish().0)
}

/// Runs a world of `scenario` that has not begun as [`run_trial`] does, and no further than to the moment at which
/// a criterion is lost for good. `advance` lets time pass in it up to a moment. What came of it so far, and the
/// world as it is then.
///
/// # Errors
/// The first of `advance`.
///
/// # Panics
/// As [`run_trial`].
pub fn run_to_failure<E>(
    scenario: &Scenario,
    simulation: Simulation,
    advance: impl FnMut(&mut Simulation, Instant) -> Result<(), E>,
) -> Result<(Trial, Simulation), E> {
    let mut observer = Observer::of(scenario, simulation);
    observer.run_by(advance, |observer| !observer.is_lost())?;
    Ok(observer.finish())
}

/// Runs a world of `scenario` that has not begun for as long as that lasts, like [`run_to_failure`] but whatever becomes of it.
///
/// # Errors
/// The first of `advance`.
///
/// # Panics
/// As [`run_trial`].
pub fn run_to_end<E>(
    scenario: &Scenario,
    simulation: Simulation,
    advance: impl FnMut(&mut Simulation, Instant) -> Result<(), E>,
) -> Result<(Trial, Simulation), E> {
    let mut observer = Observer::of(scenario, simulation);
    observer.run_by(advance, |_| true)?;
    Ok(observer.finish())
}

fn set_up(seed: u64, error: &SimulationError) -> Trial {
    Trial::broken(seed, Criterion::SetUp, error.to_string())
}

/// A robot so far.
#[derive(Debug, Default)]
pub(super) struct Robot {
    last: Option<[f32; 2]>,
    speed: f32,
    pub(super) contacts: u32,
    driven_m: f64,
    /// The way driven when it was sent to each target, and at the target.
    legs: Vec<Leg>,
    up: u32,
    counted: u32,
    pub(super) was_up: bool,
    /// Whether it has power and works, connected or not.
    works: bool,
    /// It is up, and what is sent to it comes through.
    hears: bool,
    behaving: Behaving,
    pub(super) recoveries: Vec<(Recovery, Fault)>,
}

#[derive(Debug, Default, Clone, Copy)]
struct Leg {
    from: Option<([f32; 2], f64)>,
    driven_m: Option<f64>,
}

/// A run under way.
pub(super) struct Observer<'a> {
    pub(super) scenario: &'a Scenario,
    seed: u64,
    pub(super) simulation: Simulation,
    pub(super) robots: Vec<Robot>,
    near: Near,
    /// What moves by itself, where it started.
    bodies: Vec<Obstacle>,
    radius: f32,
    pub(super) least_m: f32,
    /// One robot is none.
    swarm: Option<Swarm>,
    missions: Missions,
    /// Where robots can see, and there is something to find.
    found: Option<Found>,
    looks: u32,
    /// The fastest contact: speed, robot, and when.
    pub(super) impact: Option<(f32, usize, f64)>,
    /// Who moved although it had to stand, and when.
    pub(super) moved: Option<(usize, f64)>,
    pub(super) commands: Commands,
}

pub(super) fn seconds(at: Instant) -> f64 {
    at.as_micros() as f64 * 1e-6
}

impl<'a> Observer<'a> {
    fn new(scenario: &'a Scenario, seed: u64) -> Result<Self, SimulationError> {
        let simulation = Simulation::lockstep(scenario.clone(), seed)?;
        Ok(Self::of(scenario, simulation))
    }

    fn of(scenario: &'a Scenario, simulation: Simulation) -> Self {
        if let Some(network) = simulation.network() {
            network.record(RECORD);
        }
        let arena = simulation.world().arena();
        let robots = (0..simulation.robots()).map(|robot| Robot {
            legs: vec![Leg::default(); simulation.targets(robot).len()],
            ..Robot::default()
        });
        let radius = simulation.world().parameters().chassis.radius_m;
        let swarm = (simulation.robots() > 1).then(|| Swarm::new(scenario, &arena, radius));
        let sees = scenario.detector.is_some() && scenario.spawn.camera_share > 0.0;
        let things = arena.objects.iter().map(|object| [object.x, object.y]);
        let found = Found::new(things).filter(|_| sees);
        Self {
            scenario,
            seed: simulation.seed(),
            robots: robots.collect(),
            near: Near::new(&arena),
            bodies: arena.movers.iter().map(|mover| mover.body).collect(),
            radius,
            swarm,
            missions: Missions::new(scenario),
            found,
            looks: 0,
            least_m: LIMIT_M,
            impact: None,
            moved: None,
            commands: Commands::default(),
            simulation,
        }
    }

    /// Runs to the end, as long as `goes_on` says so.
    fn run(&mut self, goes_on: impl FnMut(&Self) -> bool) {
        let advance = |simulation: &mut Simulation, end| {
            simulation.run_until(end);
            Ok::<(), Infallible>(())
        };
        let Ok(()) = self.run_by(advance, goes_on);
    }

    /// The same, where `advance` lets time pass.
    fn run_by<E>(
        &mut self,
        mut advance: impl FnMut(&mut Simulation, Instant) -> Result<(), E>,
        mut goes_on: impl FnMut(&Self) -> bool,
    ) -> Result<(), E> {
        let end = Instant::from_micros((f64::from(self.scenario.duration_s) * 1e6) as u64);
        let ends_early = self.scenario.ends_early && !self.scenario.goals.is_empty();
        let mut over: Option<Instant> = None;
        while self.simulation.now() < end && goes_on(self) {
            let next = (self.simulation.now() + LOOK).min(end);
            advance(&mut self.simulation, next)?;
            self.look();
            if ends_early && self.simulation.is_over() {
                let since = *over.get_or_insert(self.simulation.now());
                if self.simulation.now() - since >= AFTERMATH && self.all_are_back() {
                    break;
                }
            }
        }
        Ok(())
    }

    fn all_are_back(&self) -> bool {
        let mut recoveries = self.robots.iter().flat_map(|robot| &robot.recoveries);
        recoveries.all(|(recovery, _)| recovery.back_s.is_some())
    }

    fn look(&mut self) {
        let now = self.simulation.now();
        for broken in self.simulation.take_broken() {
            self.note_broken(&broken);
        }
        let mut places = Vec::with_capacity(self.robots.len());
        let (mut at_work, mut headings) = (Vec::new(), Vec::new());
        for number in 0..self.robots.len() {
            let Some(seen) = self.simulation.observe(number).filter(|seen| seen.present) else {
                continue;
            };
            places.push([seen.pose.x, seen.pose.y]);
            self.look_at(number, &seen, now);
            if self.robots[number].works {
                at_work.push([seen.pose.x, seen.pose.y]);
                headings.push(seen.pose.theta);
            }
        }
        self.looks += 1;
        if self.looks.is_multiple_of(LOOKS_AT_SWARM) {
            if let Some(swarm) = &mut self.swarm {
                swarm.look(&at_work, &headings);
            }
            // Who came later is not measured.
            let works = |number: usize| self.robots.get(number).is_some_and(|robot| robot.works);
            self.missions.look(&self.simulation, works, seconds(now));
        }
        let movers = self.movers();
        let least = self.near.least(&places, &movers, self.radius);
        self.least_m = self.least_m.min(least);
        let hearing: Vec<bool> = self.robots.iter().map(|robot| robot.hears).collect();
        let published = self.simulation.network().map(VirtualNetwork::take_record);
        let published = published.unwrap_or_default();
        self.hear_of_things(&published);
        let hears = |robot| hearing.get(robot) == Some(&true);
        self.commands
            .follow(&mut self.simulation, &published, LOOK, hears);
        for number in std::mem::take(&mut self.commands.told) {
            if let Some(robot) = self.robots.get_mut(number) {
                robot.behaving.told();
            }
        }
        for number in std::mem::take(&mut self.commands.over) {
            if let Some(robot) = self.robots.get_mut(number) {
                robot.behaving.completed();
            }
        }
        for number in 0..self.robots.len() {
            self.look_for_motion(number, now);
        }
    }

    /// Takes in what robots say that they see.
    fn hear_of_things(&mut self, published: &[Published]) {
        let Some(found) = &mut self.found else {
            return;
        };
        let fleet = self.simulation.fleet();
        for message in published {
            let Ok(Topic::Vision(robot)) = Topic::parse(fleet, &message.topic) else {
                continue;
            };
            let seen = Detections::from_json(&message.payload).ok();
            let pose = number(&robot).and_then(|number| self.simulation.pose(number));
            if let Some((pose, seen)) = pose.zip(seen) {
                found.report(pose, &seen);
            }
        }
    }

    /// What moves by itself, where it is.
    fn movers(&self) -> Vec<Obstacle> {
        let bodies = self.bodies.iter().enumerate().map(|(number, &body)| {
            let place = self.simulation.world().mover(number);
            let Some([there_x, there_y]) = place else {
                return body;
            };
            let mut moved = body;
            match &mut moved {
                Obstacle::Circle { x, y, .. } | Obstacle::Box { x, y, .. } => {
                    (*x, *y) = (there_x, there_y);
                }
            }
            moved
        });
        bodies.collect()
    }

    fn note_broken(&mut self, broken: &Broken) {
        // What is never mended is nothing to recover from, except for what only happens once.
        let once = matches!(broken.fault, Fault::FlashPowerCut { .. });
        let Some(since) = broken.until.or(once.then_some(broken.at)) else {
            return;
        };
        if let Some(robot) = self.robots.get_mut(broken.robot) {
            let recovery = Recovery {
                had_goal: broken.had_goal,
                since_s: seconds(since),
                back_s: None,
            };
            robot.recoveries.push((recovery, broken.fault));
        }
    }

    fn look_at(&mut self, number: usize, seen: &Observation, now: Instant) {
        let robot = &mut self.robots[number];
        let place = [seen.pose.x, seen.pose.y];
        if let Some(last) = robot.last.replace(place) {
            robot.driven_m += f64::from(apart(last, place));
        }
        if seen.contacts > robot.contacts {
            // What it drove before it touched.
            let speed = robot.speed.max(seen.speed);
            if self.impact.is_none_or(|(fastest, ..)| speed > fastest) {
                self.impact = Some((speed, number, seconds(now)));
            }
        }
        robot.contacts = seen.contacts;
        robot.speed = seen.speed;
        let targets = self.simulation.targets(number);
        for (target, leg) in targets.iter().zip(&mut robot.legs) {
            if target.told.is_some() && leg.from.is_none() {
                leg.from = Some((place, robot.driven_m));
            }
            if let (Some(_), Some((_, before)), None) = (target.reached, leg.from, leg.driven_m) {
                leg.driven_m = Some(robot.driven_m - before);
            }
        }
        let done = targets.iter().all(|target| target.reached.is_some());
        let snapshot = self.simulation.robot(number).map(|robot| robot.snapshot());
        let able = seen.powered
            && self.simulation.takes_commands(number)
            && snapshot.is_some_and(|snapshot| snapshot.state != RobotState::Error);
        let connected = match (self.simulation.network(), self.simulation.id(number)) {
            (Some(network), Some(id)) => {
                let topic = Topic::CommandRobot(id.clone()).render(self.simulation.fleet());
                network.listens(id.as_str(), &topic)
            }
            _ => true,
        };
        let up = able && connected;
        let started = robot.counted > 0 || up || now - Instant::BOOT >= START;
        robot.counted += u32::from(started);
        robot.up += u32::from(up);
        robot.was_up = up;
        robot.works = able;
        // A session outlives a partition for as long as neither end notices.
        let network = self.simulation.network();
        robot.hears = up && network.is_none_or(|network| network.carries(number));
        let behaviour = snapshot.map_or(BehaviourName::Manual, |snapshot| snapshot.behaviour);
        let busy = behaviour != BehaviourName::Manual;
        // To go somewhere has an end.
        let behaves = busy && behaviour != BehaviourName::Goto;
        let settled = self.commands.is_settled(number);
        robot.behaving.see(behaves, settled, now);
        let has_goals = !targets.is_empty();
        for (recovery, _) in &mut robot.recoveries {
            recovery.see(seconds(now), up, busy || has_goals && done);
        }
    }

    /// Looks for wheels that turn although the robot said that it stands.
    fn look_for_motion(&mut self, number: usize, now: Instant) {
        let Some(limit) = self.scenario.success.still_s else {
            return;
        };
        let Some(since) = self.commands.stands_since(number) else {
            return;
        };
        let late = seconds(now) - seconds(since) > f64::from(limit);
        let driven = self.simulation.observe(number).map(|seen| seen.duty);
        if late && driven.is_some_and(|duty| duty != [0, 0]) && self.moved.is_none() {
            self.moved = Some((number, seconds(now)));
        }
    }

    fn finish(self) -> (Trial, Simulation) {
        let measured = self.measure();
        let failures = self.judge(&measured);
        let mut trial = Trial {
            seed: self.seed,
            measured,
            ran_s: seconds(self.simulation.now()),
            history: self.simulation.history_hash(),
            failures,
        };
        let success = if trial.is_success() { 1.0 } else { 0.0 };
        trial.measured.set(Metric::Success, Some(success));
        (trial, self.simulation)
    }

    /// Goals that were reached by the time they had to be, and all there are.
    fn goals(&self) -> (usize, usize) {
        let limit = self.scenario.success.within_s.map_or(f64::MAX, f64::from);
        let targets = (0..self.robots.len()).flat_map(|robot| self.simulation.targets(robot));
        let in_time = |at: Option<Instant>| at.is_some_and(|at| seconds(at) <= limit);
        targets.fold((0, 0), |(reached, all), target| {
            (reached + usize::from(in_time(target.reached)), all + 1)
        })
    }

    fn measure(&self) -> Measured {
        let mut measured = Measured::default();
        let robots = self.robots.len();
        let (reached, goals) = self.goals();
        measured.set(Metric::Reached, share(reached, goals));
        let legs = self.robots.iter().enumerate().flat_map(|(number, robot)| {
            let targets = self.simulation.targets(number);
            targets.iter().zip(&robot.legs)
        });
        let legs: Vec<_> = legs.collect();
        let times = legs
            .iter()
            .filter_map(|(target, _)| Some(seconds(target.reached?) - seconds(target.told?)));
        measured.set(Metric::TimeToGoalS, mean(times));
        measured.set(Metric::PathOptimality, self.optimality(&legs));
        measured.set(Metric::EnergyJ, mean(self.energy()));
        let contacts = self.robots.iter().map(|robot| f64::from(robot.contacts));
        let each = mean(contacts);
        measured.set(Metric::Collisions, each);
        let minutes = seconds(self.simulation.now()) / 60.0;
        measured.set(Metric::ContactsPerMinute, each.map(|each| each / minutes));
        let clearance = (robots > 0).then_some(f64::from(self.least_m));
        measured.set(Metric::MinClearanceM, clearance);
        let recoveries = self.robots.iter().flat_map(|robot| &robot.recoveries);
        let took = recoveries.filter_map(|(recovery, _)| recovery.took_s());
        measured.set(Metric::RecoveryS, mean(took));
        let (completed, ended) = self.commands.success(self.simulation.now());
        measured.set(Metric::CommandSuccess, share(completed, ended));
        let tasks = if goals > 0 { reached } else { completed };
        let messages = self
            .simulation
            .network()
            .map(|network| network.statistics().received);
        let each = messages.filter(|_| tasks > 0);
        measured.set(
            Metric::MessagesPerTask,
            each.map(|all| all as f64 / tasks as f64),
        );
        let up: u64 = self.robots.iter().map(|robot| u64::from(robot.up)).sum();
        let counted: u64 = self
            .robots
            .iter()
            .map(|robot| u64::from(robot.counted))
            .sum();
        measured.set(Metric::Uptime, share(up as usize, counted as usize));
        let ways = self.robots.iter().map(|robot| robot.driven_m);
        measured.set(Metric::DistanceM, mean(ways));
        if self.robots.iter().any(|robot| robot.behaving.ever()) {
            let now = self.simulation.now();
            let stranded = self
                .robots
                .iter()
                .filter(|robot| robot.behaving.is_stranded(now));
            measured.set(Metric::Stranded, Some(stranded.count() as f64));
            let dropouts = self
                .robots
                .iter()
                .map(|robot| f64::from(robot.behaving.dropouts()));
            let hours = self.robots.len() as f64 * seconds(now) / 3_600.0;
            measured.set(
                Metric::Dropouts,
                Some(100.0 * dropouts.sum::<f64>() / hours),
            );
        }
        self.missions.measure(&mut measured);
        measured.set(Metric::Found, self.found.as_ref().map(Found::share));
        if let Some(swarm) = &self.swarm {
            swarm.measure(&mut measured);
        }
        measured
    }

    fn optimality(&self, legs: &[(&crate::run::Target, &Leg)]) -> Option<f64> {
        if legs.iter().all(|(_, leg)| leg.driven_m.is_none()) {
            return None;
        }
        let map = Passable::new(&self.simulation.world().arena(), self.radius);
        let shares = legs.iter().filter_map(|(target, leg)| {
            let (from, _) = leg.from?;
            let shortest = map.way(from, target.at)?;
            path_optimality(f64::from(shortest), f64::from(target.r), leg.driven_m?)
        });
        mean(shares)
    }

    /// What each robot drew from its battery, joules.
    fn energy(&self) -> impl Iterator<Item = f64> {
        let robots = (0..self.robots.len()).filter_map(|robot| self.simulation.observe(robot));
        robots.map(|seen| seen.energy_j)
    }
}
