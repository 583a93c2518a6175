//! Whoever runs the scenario: gives commands in their time, breaks things, sends robots to their
//! goals.
//!
//! It acts on the truth about each robot alone, so that what one robot is told never depends on
//! another one, and everything it draws comes from the seed.

use crawler_hal::{Duration, Instant};
use crawler_protocol::{Action, BehaviourName, CommandName, RobotState};
use rand_core::Rng;
use rand_pcg::Pcg32;

use crate::faults::Fault;
use crate::scenario::{Draw, Goal, Passable, Scenario, Times, apart};
use crate::world::{Arena, Pose};

/// How often goals are looked at.
pub(crate) const LOOK: Duration = Duration::from_millis(100);
/// A robot that has reached its goal and still drives is sent on after this.
const PATIENCE: Duration = Duration::from_secs(3);
/// What robots keep from everything at a goal that is drawn, metres beyond their radius: nearer to
/// a wall they would take it for an obstacle in their way.
const GOAL_MARGIN_M: f32 = 0.35;
/// Commands that wait to be taken at most.
const MOST_ISSUED: usize = 10_000;
/// Draws for one goal.
const TRIES: u32 = 200;

/// A thing to do.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum ScenarioAction {
    /// Give this command.
    Tell(Box<Action>),
    /// Break this, for so long.
    Break(Fault, Option<Duration>),
}

/// A command that the scenario gave.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Issued {
    /// To whom.
    pub robot: usize,
    /// Its number.
    pub seq: u64,
    /// When.
    pub at: Instant,
    /// Which.
    pub command: CommandName,
}

/// A fault that the scenario brought about.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Broken {
    /// Whose.
    pub robot: usize,
    /// When.
    pub at: Instant,
    /// When it is mended; `None` when it never is.
    pub until: Option<Instant>,
    /// Whether the robot had a goal then.
    pub had_goal: bool,
    /// What.
    pub fault: Fault,
}

/// An entry of the timeline, and when it happens next.
#[derive(Debug)]
struct Entry {
    next: Instant,
    every: Option<Duration>,
    until: Instant,
    robots: crate::scenario::Selector,
    action: ScenarioAction,
}

/// A place a robot is to go to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Target {
    /// Where, metres.
    pub at: [f32; 2],
    /// How near counts, metres.
    pub r: f32,
    /// It does not count before.
    pub from: Instant,
    /// When it was reached.
    pub reached: Option<Instant>,
    /// When the robot was first told, where it was.
    pub told: Option<Instant>,
}

#[derive(Debug, Default)]
struct Route {
    targets: Vec<Target>,
    /// Which goal of the scenario each is.
    goals: Vec<u32>,
    /// The first one that is not dealt with.
    current: usize,
    told: Option<Instant>,
}

/// See the [module](self).
#[derive(Debug)]
pub(crate) struct Director {
    entries: Vec<Entry>,
    goals: Vec<Goal>,
    routes: Vec<Route>,
    map: Option<Passable>,
    seed: u64,
    next_look: Instant,
    /// The first moment at which there is something to do.
    next_due: Instant,
    issued: Vec<Issued>,
    broken: Vec<Broken>,
    /// How many commands each robot was given.
    given: Vec<u64>,
}

/// What a robot looks like to the director.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sighting {
    pub(crate) pose: Pose,
    /// State and behaviour as the robot reports them; `None` while it cannot take commands.
    pub(crate) ready: Option<(RobotState, BehaviourName)>,
}

fn instant(seconds: f32) -> Instant {
    Instant::from_micros((f64::from(seconds) * 1e6) as u64)
}

fn span(seconds: f32) -> Duration {
    Duration::from_micros((f64::from(seconds) * 1e6) as u64)
}

impl Director {
    /// For a scenario that was validated.
    pub(crate) fn new(scenario: &Scenario, arena: &Arena, seed: u64) -> Self {
        let entry = |times: Times, robots: &crate::scenario::Selector, action| Entry {
            next: instant(times.at_s),
            every: times.every_s.map(span),
            until: times.until_s.map_or(Instant::FAR_FUTURE, instant),
            robots: robots.clone(),
            action,
        };
        let faults = scenario.faults.iter().map(|timed| {
            let action = ScenarioAction::Break(timed.fault, timed.for_s.map(span));
            entry(timed.times(), &timed.robots, action)
        });
        // A validated command is one.
        let commands = scenario.commands.iter().filter_map(|timed| {
            let action = timed.action().ok()?;
            Some(entry(
                timed.times(),
                &timed.robots,
                ScenarioAction::Tell(Box::new(action)),
            ))
        });
        let drawn = scenario.goals.iter().any(|goal| goal.draw.is_some());
        let radius = scenario.parameters.chassis.radius_m;
        let mut director = Self {
            entries: faults.chain(commands).collect(),
            goals: scenario.goals.clone(),
            routes: Vec::new(),
            map: drawn.then(|| Passable::new(arena, radius + GOAL_MARGIN_M)),
            seed,
            next_look: if scenario.goals.is_empty() {
                Instant::FAR_FUTURE
            } else {
                Instant::BOOT + LOOK
            },
            next_due: Instant::FAR_FUTURE,
            issued: Vec::new(),
            broken: Vec::new(),
            given: Vec::new(),
        };
        director.plan();
        director
    }

    fn plan(&mut self) {
        let entries = self.entries.iter().map(|entry| entry.next);
        let first = entries.min().unwrap_or(Instant::FAR_FUTURE);
        self.next_due = first.min(self.next_look);
    }

    /// Counts a command for a robot; how many it had before.
    pub(crate) fn count(&mut self, robot: usize) -> u64 {
        let Some(given) = self.given.get_mut(robot) else {
            return 0;
        };
        *given += 1;
        *given - 1
    }

    /// Takes note of a command that was given.
    pub(crate) fn note(&mut self, issued: Issued) {
        if self.issued.len() < MOST_ISSUED {
            self.issued.push(issued);
        }
    }

    /// Takes note of a fault that was brought about.
    pub(crate) fn note_broken(&mut self, broken: Broken) {
        if self.broken.len() < MOST_ISSUED {
            self.broken.push(broken);
        }
    }

    /// Takes the faults brought about since the last call.
    pub(crate) fn take_broken(&mut self) -> Vec<Broken> {
        core::mem::take(&mut self.broken)
    }

    /// Takes the commands given since the last call.
    pub(crate) fn take_issued(&mut self) -> Vec<Issued> {
        core::mem::take(&mut self.issued)
    }

    /// Takes note of a new robot, which starts at `pose`. Robots come in the order of their
    /// numbers.
    pub(crate) fn add(&mut self, pose: Pose) {
        let robot = self.routes.len();
        let mut route = Route::default();
        for (index, goal) in self.goals.iter().enumerate() {
            if !goal.robots.has(robot) {
                continue;
            }
            let turn = (0..robot).filter(|&other| goal.robots.has(other)).count();
            let at = match (goal.x, goal.y, goal.draw) {
                (Some(x), Some(y), _) => [x, y],
                (_, _, Some(draw)) => self.drawn(draw, index, robot, pose),
                _ => match goal.places.get(turn % goal.places.len().max(1)) {
                    Some(&place) => place,
                    None => continue,
                },
            };
            route.goals.push(index as u32);
            route.targets.push(Target {
                at,
                r: goal.r,
                from: instant(goal.at_s),
                reached: None,
                told: None,
            });
        }
        self.routes.push(route);
        self.given.push(0);
    }

    /// Takes note of a robot that was here before: it has no goals any more.
    #[cfg(feature = "live")]
    pub(crate) fn add_idle(&mut self) {
        self.routes.push(Route::default());
        self.given.push(0);
    }

    /// Has nothing in store any more.
    #[cfg(feature = "live")]
    pub(crate) fn end(&mut self) {
        self.entries.clear();
        self.next_look = Instant::FAR_FUTURE;
        self.plan();
    }

    /// Leaves out what happened up to `now`.
    #[cfg(feature = "live")]
    pub(crate) fn skip_to(&mut self, now: Instant) {
        // What is due then has been done.
        while self.entries.iter().any(|entry| entry.next <= now) {
            self.due(0, now);
        }
        if self.next_look < Instant::FAR_FUTURE {
            self.next_look = self.next_look.max(now);
        }
        self.plan();
    }

    fn drawn(&self, draw: Draw, goal: usize, robot: usize, start: Pose) -> [f32; 2] {
        let Some(map) = &self.map else {
            return [start.x, start.y];
        };
        let across = [-start.x, -start.y];
        match draw {
            Draw::Opposite => map.nearest_free(across).unwrap_or(across),
            Draw::Random => {
                let places: Vec<_> = map.free_places().collect();
                if places.is_empty() {
                    return [start.x, start.y];
                }
                let mut rng = Pcg32::new(self.seed, (goal as u64) << 32 | robot as u64);
                let mut best = ([start.x, start.y], f32::MIN);
                for _ in 0..TRIES {
                    let place = places[rng.next_u32() as usize % places.len()];
                    let others = self.routes.iter().filter_map(|route| {
                        let same = route.goals.iter().position(|&g| g as usize == goal)?;
                        Some(route.targets[same].at)
                    });
                    let alone = others
                        .map(|other| apart(other, place))
                        .fold(f32::MAX, f32::min);
                    let room = alone.min(1.0) + apart(place, [start.x, start.y]).min(1.0);
                    if room > best.1 {
                        best = (place, room);
                    }
                    if room >= 2.0 {
                        break;
                    }
                }
                best.0
            }
        }
    }

    /// The next moment at which there is something to do.
    pub(crate) const fn next_due(&self) -> Instant {
        self.next_due
    }

    /// What the timeline has for robot numbers below `robots` at `now`.
    pub(crate) fn due(&mut self, robots: usize, now: Instant) -> Vec<(usize, ScenarioAction)> {
        let mut actions = Vec::new();
        for entry in &mut self.entries {
            if entry.next > now {
                continue;
            }
            let those = (0..robots).filter(|&robot| entry.robots.has(robot));
            actions.extend(those.map(|robot| (robot, entry.action.clone())));
            entry.next = match entry.every {
                Some(every) if entry.next + every <= entry.until => entry.next + every,
                Some(_) | None => Instant::FAR_FUTURE,
            };
        }
        self.entries
            .retain(|entry| entry.next < Instant::FAR_FUTURE);
        self.plan();
        actions
    }

    /// Whether it is time to look at goals; if so, the next time is set.
    pub(crate) fn looks(&mut self, now: Instant) -> bool {
        let due = now >= self.next_look;
        if due {
            self.next_look = now + LOOK;
            self.plan();
        }
        due
    }

    /// Looks at one robot; what to tell it, if anything.
    pub(crate) fn look(&mut self, robot: usize, seen: Sighting, now: Instant) -> Option<Action> {
        let route = self.routes.get_mut(robot)?;
        let target = route.targets.get_mut(route.current)?;
        let goal = self.goals.get(route.goals[route.current] as usize)?;
        let near = apart([seen.pose.x, seen.pose.y], target.at) <= target.r;
        let may_count = now >= instant(goal.at_s) && (!goal.tell || target.told.is_some());
        if near && may_count && target.reached.is_none() {
            target.reached = Some(now);
        }
        let on_its_way = seen
            .ready
            .is_some_and(|(_, behaviour)| behaviour == BehaviourName::Goto);
        if let Some(reached) = target.reached {
            if goal.tell && on_its_way && now - reached < PATIENCE {
                return None;
            }
            route.current += 1;
            route.told = None;
            return None;
        }
        let (state, _) = seen.ready?;
        if !goal.tell || on_its_way || now < instant(goal.at_s) || state == RobotState::Error {
            return None;
        }
        let again = route
            .told
            .is_none_or(|told| goal.retry_s > 0.0 && now - told >= span(goal.retry_s));
        if !again {
            return None;
        }
        route.told = Some(now);
        target.told.get_or_insert(now);
        let [x, y] = target.at;
        Some(Action::Goto { x, y })
    }

    /// Whether nothing is to come any more: the timeline is over, and every goal was reached.
    pub(crate) fn is_over(&self) -> bool {
        self.entries.is_empty()
            && self
                .routes
                .iter()
                .all(|route| route.current >= route.targets.len())
    }

    /// The places a robot is to go to, in order.
    pub(crate) fn targets(&self, robot: usize) -> &[Target] {
        self.routes.get(robot).map_or(&[], |route| &route.targets)
    }
}
