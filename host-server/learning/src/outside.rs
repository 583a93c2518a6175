//! What comes to robots from outside: fixes of the tracker, and digests of who is near.

use crawler_app::neighbours::{FRESH_FOR, Neighbour};
use crawler_app::tracking::Fix;
use crawler_hal::{Duration, Instant};
use crawler_sim::run::bare::BareWorld;
use crawler_sim::scenario::Tracker;
use crawler_sim::world::{Pose, RobotIndex};
use rand_core::Rng;
use rand_pcg::Pcg32;

use crate::agent::Agent;

/// Time between two digests, as under the firmware.
const DIGESTS: Duration = Duration::from_millis(500);
/// Least and most time that a message takes.
const LATENCY_MS: [u32; 2] = [10, 110];
/// One of so many messages is lost.
const LOST: u32 = 50;

/// Where a robot was, as others are told.
#[derive(Debug, Clone, Copy)]
struct Sighting {
    seen: Instant,
    at: [f32; 2],
    theta: f32,
    /// Speed ahead.
    v: f32,
}

/// A message under way.
#[derive(Debug, Clone, Copy)]
struct Underway<T> {
    due: Instant,
    to: usize,
    what: T,
}

/// See the [module](self).
#[derive(Debug, Clone)]
pub(crate) struct Outside {
    tracker: Tracker,
    rng: Pcg32,
    fixes: Vec<Underway<Fix>>,
    next_fixes: Vec<Instant>,
    digests: Vec<Underway<usize>>,
    next_digest: Instant,
    /// What digests told, from the last one on; digests name their place here.
    told: Vec<Vec<Sighting>>,
    /// For each robot, what it was told last of all of them.
    known: Vec<Option<usize>>,
}

impl Outside {
    /// What comes to `robots` of the world of this seed, from `now` on.
    pub(crate) fn new(tracker: Tracker, robots: usize, seed: u64, now: Instant) -> Self {
        let mut rng = Pcg32::new(seed, 0x6F75_7473);
        let period = (1e6 / tracker.rate_hz) as u32;
        let phase = |rng: &mut Pcg32| Duration::from_micros(u64::from(below(rng, period)));
        let first = now + Duration::from_micros(u64::from(below(&mut rng, 500_000)));
        Self {
            tracker,
            fixes: Vec::new(),
            next_fixes: (0..robots).map(|_| now + phase(&mut rng)).collect(),
            rng,
            digests: Vec::new(),
            next_digest: first,
            told: Vec::new(),
            known: vec![None; robots],
        }
    }

    /// Tells every robot at once where it is: what it knew before the order came. Who is near it asks for from then on.
    pub(crate) fn begin(&mut self, world: &BareWorld, agents: &mut [Agent]) {
        let now = world.now();
        for (robot, agent) in agents.iter_mut().enumerate() {
            agent.fix = self.fix(world, robot, now);
        }
    }

    /// Hands over what has come by now.
    pub(crate) fn pass(&mut self, world: &BareWorld, agents: &mut [Agent]) {
        let now = world.now();
        let period = Duration::from_micros((1e6 / self.tracker.rate_hz) as u64);
        for robot in 0..self.known.len() {
            if now >= self.next_fixes[robot] {
                self.next_fixes[robot] += period;
                let due = now + self.latency();
                if let (Some(what), true) = (self.fix(world, robot, now), self.arrives()) {
                    let to = robot;
                    self.fixes.push(Underway { due, to, what });
                }
            }
        }
        if now >= self.next_digest {
            self.next_digest += DIGESTS;
            self.tell(world, now);
            let what = self.told.len() - 1;
            for to in 0..self.known.len() {
                let due = now + self.latency();
                if self.arrives() {
                    self.digests.push(Underway { due, to, what });
                }
            }
        }
        self.fixes.retain(|message| {
            if message.due <= now {
                agents[message.to].fix = Some(message.what);
            }
            message.due > now
        });
        let known = &mut self.known;
        self.digests.retain(|message| {
            if message.due <= now {
                known[message.to] = known[message.to].max(Some(message.what));
            }
            message.due > now
        });
    }

    /// Says who is near, as each robot reckons it at `at`.
    pub(crate) fn say_who_is_near(&self, agents: &mut [Agent], at: Instant) {
        for (robot, agent) in agents.iter_mut().enumerate() {
            agent.near.clear();
            let sightings = self.known[robot].and_then(|which| self.told.get(which));
            for (other, sighting) in sightings.into_iter().flatten().enumerate() {
                if other != robot && at - sighting.seen <= FRESH_FOR {
                    agent.near.push(sighting.after(at));
                }
            }
        }
    }

    fn tell(&mut self, world: &BareWorld, now: Instant) {
        let robots = 0..self.known.len();
        let sightings = robots.map(|robot| {
            let nowhere = (Pose::default(), [0.0; 2]);
            let (pose, [v, _]) = world.motion(index(robot)).unwrap_or(nowhere);
            Sighting {
                seen: now,
                at: [pose.x, pose.y],
                theta: pose.theta,
                v,
            }
        });
        self.told.push(sightings.collect());
    }

    fn fix(&mut self, world: &BareWorld, robot: usize, now: Instant) -> Option<Fix> {
        let Tracker {
            on,
            sigma_m,
            sigma_rad,
            ..
        } = self.tracker;
        let truth = world.observe(index(robot)).filter(|_| on)?.pose;
        let theta = truth.theta + sigma_rad * self.normal();
        let pose = crawler_protocol::Pose {
            x: truth.x + sigma_m * self.normal(),
            y: truth.y + sigma_m * self.normal(),
            theta: libm::remainderf(theta, core::f32::consts::TAU),
            sigma: sigma_m,
        };
        Some(Fix { pose, seen: now })
    }

    fn latency(&mut self) -> Duration {
        let [least, most] = LATENCY_MS;
        let ms = least + below(&mut self.rng, most - least);
        Duration::from_millis(u64::from(ms))
    }

    fn arrives(&mut self) -> bool {
        below(&mut self.rng, LOST) != 0
    }

    /// Nearly normal: the sum of twelve even draws (the tails that it lacks are beyond six deviations).
    fn normal(&mut self) -> f32 {
        let rng = &mut self.rng;
        let sum: f32 = (0..12).map(|_| (rng.next_u32() >> 8) as f32).sum();
        sum * (1.0 / 16_777_216.0) - 6.0
    }
}

impl Sighting {
    /// As the robot that was told reckons it: straight on.
    fn after(&self, at: Instant) -> Neighbour {
        let way = self.v * (at - self.seen).as_secs_f32();
        let (sin, cos) = libm::sincosf(self.theta);
        let [x, y] = self.at;
        Neighbour::new([x + way * cos, y + way * sin], self.theta, self.v, 0.0)
    }
}

pub(crate) const fn index(robot: usize) -> RobotIndex {
    RobotIndex::new(robot as u32)
}

fn below(rng: &mut Pcg32, end: u32) -> u32 {
    ((u64::from(rng.next_u32()) * u64::from(end)) >> 32) as u32
}
