//! A fleet of points with a heading, fast enough to see what comes of a rule within seconds.
//!
//! Everything that makes a rule hard is in it: neighbours are told twice a second, cell by cell, sixteen of a
//! cell and sixteen in all, one message in twenty is lost, and what was told last is moved on meanwhile; a
//! robot is a centimetre from where it takes itself to be; its one ranger looks ahead, and makes it turn
//! aside at 0.25 m; wheels take a while to speed up; a robot restarts, and the ranger of another is silent
//! for three seconds. Seeded: the same every time.

use std::collections::{BTreeMap, BTreeSet};
use std::vec::Vec;

use crawler_hal::Instant;
use crawler_protocol::Pose;

use super::super::{Scene, swarm_twist};
use crate::goal::Swarm;
use crate::motion::angle::{PoseMm, length, millimetres};
use crate::motion::{Twist, wrap};
use crate::neighbours::{Cell, MOST, Neighbour, cell_at};

/// Time of a step, in seconds: that of control.
const STEP: f32 = 0.02;
/// Steps between two messages about a cell.
const TOLD_EVERY: u32 = 25;
/// Steps between two readings of the ranger.
const READ_EVERY: u32 = 3;
/// Largest change of a wheel's speed in a step, in metres per second.
const RAMP: f32 = 0.025;
/// Radius of a body, in metres.
pub(super) const BODY: f32 = 0.08;
/// The ranger sits so far ahead of the middle, in metres.
const MOUNT: f32 = 0.06;
/// Half of what its beam covers, in radians.
const BEAM: f32 = 0.15;
/// Farthest that it sees, in metres.
const REACH: f32 = 4.5;
/// Permitted speed, in metres and radians per second.
pub(super) const SPEED: f32 = 0.3;
pub(super) const TURN: f32 = 3.0;
/// Of a message about a cell, for one robot.
const LOSS: f32 = 0.05;
/// Standard deviation of where a robot takes itself to be, in metres and radians.
const SIGMA: [f32; 3] = [0.01, 0.01, 0.015];

#[derive(Debug, Clone, Copy)]
struct Told {
    who: usize,
    cell: Cell,
    at: u32,
    is: Neighbour,
}

#[derive(Debug, Clone, Default)]
struct Body {
    pose: [f32; 3],
    off: [f32; 3],
    twist: [f32; 2],
    range: f32,
    /// Steps until which it backs off, does not look for a way out, and has failed to find one.
    escape: Option<[u32; 3]>,
    attempts: u32,
    side: f32,
    told: Vec<Told>,
    /// Step until which it is not there.
    off_until: u32,
    touches: BTreeSet<usize>,
}

/// Robots in a square room.
pub(super) struct Fleet {
    /// Of the generator: xorshift.
    random: u64,
    bodies: Vec<Body>,
    half: f32,
    step: u32,
    contacts: u32,
}

impl Fleet {
    /// So many robots at random places of a room that has `area` square metres for each.
    pub(super) fn new(robots: usize, area: f32, seed: u64) -> Self {
        let mut fleet = Self {
            random: 0x9E37_79B9_7F4A_7C15 ^ (seed << 17),
            bodies: Vec::new(),
            half: 0.5 * (robots as f32 * area).sqrt().max(3.0),
            step: 0,
            contacts: 0,
        };
        while fleet.bodies.len() < robots {
            let reach = fleet.half - 0.2;
            let [x, y] = [(); 2].map(|()| reach * (2.0 * fleet.uniform() - 1.0));
            let free = |body: &Body| (body.pose[0] - x).hypot(body.pose[1] - y) > 0.3;
            if fleet.bodies.iter().all(free) {
                let theta = wrap(core::f32::consts::TAU * fleet.uniform());
                fleet.bodies.push(Body {
                    pose: [x, y, theta],
                    range: REACH,
                    side: 1.0,
                    ..Body::default()
                });
            }
        }
        fleet
    }

    fn uniform(&mut self) -> f32 {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        (self.random >> 40) as f32 / (1_u32 << 24) as f32
    }

    /// Where everybody is.
    pub(super) fn poses(&self) -> Vec<[f32; 3]> {
        self.bodies.iter().map(|body| body.pose).collect()
    }

    /// Contacts with other robots, for each robot.
    pub(super) fn contacts(&self) -> f32 {
        self.contacts as f32 / self.bodies.len() as f32
    }

    /// Lets everybody behave so for so many seconds. Two seconds in, the first robot restarts, and the ranger of
    /// the last one is silent.
    pub(super) fn run(&mut self, swarm: Swarm, seconds: u32) {
        self.run_with(swarm, seconds, |_| ());
    }

    /// As [`Self::run`], with a look at everybody every second.
    pub(super) fn run_with(&mut self, swarm: Swarm, seconds: u32, mut look: impl FnMut(&Self)) {
        let begun = self.step;
        while self.step < begun + seconds * 50 {
            if self.step == begun + 100 {
                let last = self.bodies.len() - 1;
                self.bodies[0].off_until = self.step + 200;
                self.bodies[last].off_until = self.step + 150;
            }
            if self.step.is_multiple_of(TOLD_EVERY) {
                self.tell();
            }
            for own in 0..self.bodies.len() {
                if (self.step + own as u32).is_multiple_of(READ_EVERY) {
                    self.bodies[own].range = self.range(own);
                }
            }
            let wanted: Vec<Twist> = (0..self.bodies.len())
                .map(|own| self.wanted(own, swarm))
                .collect();
            for (body, twist) in self.bodies.iter_mut().zip(wanted) {
                body.advance(twist, self.half);
            }
            self.touch();
            self.step += 1;
            if (self.step - begun).is_multiple_of(50) {
                look(self);
            }
        }
    }

    fn tell(&mut self) {
        let cell = |pose: &[f32; 3]| cell_at(pose[0], pose[1]).expect("in the room");
        let mut cells: BTreeMap<_, Vec<Told>> = BTreeMap::new();
        for (who, body) in self.bodies.iter().enumerate() {
            let there = cells.entry(cell(&body.pose)).or_default();
            let [x, y, theta] = body.pose;
            let [v, turn] = body.twist;
            if body.off_until <= self.step && there.len() < MOST {
                there.push(Told {
                    who,
                    cell: cell(&body.pose),
                    at: self.step,
                    is: Neighbour::new([x, y], theta, v, turn).seen(at(self.step)),
                });
            }
        }
        for own in 0..self.bodies.len() {
            let mut told = core::mem::take(&mut self.bodies[own].told);
            let here = self.bodies[own].pose;
            let (column, row) = cell(&here);
            for around in 0..9_i16 {
                let at = (column + around / 3 - 1, row + around % 3 - 1);
                if self.uniform() < LOSS {
                    continue;
                }
                told.retain(|known| known.cell != at);
                for new in cells.get(&at).into_iter().flatten() {
                    if new.who != own {
                        told.retain(|known| known.who != new.who);
                        told.push(*new);
                    }
                }
            }
            let fresh = self.step.saturating_sub((1.5 / STEP) as u32);
            told.retain(|known| known.at >= fresh);
            let here = [here[0], here[1]].map(millimetres);
            let away = |t: &Told| length([t.is.at[0] - here[0], t.is.at[1] - here[1]]);
            told.sort_by_key(away);
            told.truncate(MOST);
            self.bodies[own].told = told;
            for (axis, sigma) in SIGMA.into_iter().enumerate() {
                // Uniform, as wide as its deviation asks for; half of it stays until the next one.
                let noise = sigma * 3.0 * (self.uniform() - 0.5);
                let off = &mut self.bodies[own].off[axis];
                *off = 0.5 * *off + noise;
            }
        }
    }

    fn range(&self, own: usize) -> f32 {
        let [x, y, theta] = self.bodies[own].pose;
        let [x, y] = [x + MOUNT * theta.cos(), y + MOUNT * theta.sin()];
        let mut range = REACH;
        for ray in [-BEAM, 0.0, BEAM] {
            for (at, along) in [(x, (theta + ray).cos()), (y, (theta + ray).sin())] {
                if along.abs() > 1e-6 {
                    range = range.min(((self.half * along.signum() - at) / along).max(0.0));
                }
            }
        }
        for (other, body) in self.bodies.iter().enumerate() {
            let [dx, dy] = [body.pose[0] - x, body.pose[1] - y];
            let apart = dx.hypot(dy);
            if other == own || apart > range + BODY {
                continue;
            }
            let wide = (BODY / apart.max(BODY)).asin();
            if wrap(dy.atan2(dx) - theta).abs() < BEAM + wide {
                range = range.min((apart - BODY).max(0.02));
            }
        }
        range
    }

    /// What control makes of the rule: turning aside, and slowing down before that.
    fn wanted(&mut self, own: usize, swarm: Swarm) -> Twist {
        let (step, flip) = (self.step, self.uniform() < 0.5);
        let body = &mut self.bodies[own];
        if step < body.off_until {
            body.escape = None;
            return Twist::ZERO;
        }
        match body.escape {
            Some([_, _, until]) if step >= until => {
                body.attempts = (body.attempts + 1).min(3);
                body.side = if flip { 1.0 } else { -1.0 };
                let turn = step + 30;
                body.escape = Some([turn, turn + 12 * (body.attempts + 1), turn + 150]);
            }
            Some([_, least, _]) if step >= least && body.range >= 0.425 => {
                body.escape = None;
                body.attempts = 0;
            }
            None if body.range < 0.25 => {
                let turn = body.twist[1];
                body.side = match turn {
                    _ if turn.abs() > 0.3 => turn.signum(),
                    _ if flip => 1.0,
                    _ => -1.0,
                };
                body.escape = Some([step, step + 12, step + 75]);
                body.twist = [0.0; 2];
            }
            Some(_) | None => {}
        }
        if let Some([back, _, _]) = body.escape {
            let backing = step < back;
            return Twist {
                v: if backing { -0.15 } else { 0.0 },
                w: if backing { 0.0 } else { 2.0 * body.side },
            };
        }
        let near: Vec<Neighbour> = body
            .told
            .iter()
            .filter_map(|told| {
                let mut is = told.is;
                is.advance(at(step)).then_some(is)
            })
            .collect();
        let [x, y, theta] = [0, 1, 2].map(|axis| body.pose[axis] + body.off[axis]);
        let pose = Pose {
            x,
            y,
            theta: wrap(theta),
            sigma: 0.02,
        };
        let scene = Scene {
            here: PoseMm::new(&pose),
            sigma: pose.sigma,
            near: &near,
            ahead_mm: Some((body.range * 1_000.0) as u16),
            speed: SPEED,
            max_turn: TURN,
        };
        let mut twist = swarm_twist(swarm, &scene);
        if twist.v > 0.0 {
            twist.v *= ((body.range - 0.25) / 0.35).clamp(0.3, 1.0);
        }
        twist
    }

    /// Parts bodies that overlap, and counts those that begin to touch.
    fn touch(&mut self) {
        let places = self.poses();
        let mut order: Vec<usize> = (0..places.len()).collect();
        order.sort_by(|a, b| places[*a][0].total_cmp(&places[*b][0]));
        let mut touches = std::vec![BTreeSet::new(); places.len()];
        for (index, a) in order.iter().enumerate() {
            for b in &order[index + 1..] {
                let [dx, dy] = [0, 1].map(|axis| places[*b][axis] - places[*a][axis]);
                if dx > 2.0 * BODY {
                    break;
                }
                let apart = dx.hypot(dy);
                if apart < 2.0 * BODY {
                    touches[*a].insert(*b);
                    touches[*b].insert(*a);
                    let push = 0.5 * (2.0 * BODY - apart) / apart.max(1e-3);
                    for (body, along) in [(*a, -push), (*b, push)] {
                        self.bodies[body].pose[0] += along * dx;
                        self.bodies[body].pose[1] += along * dy;
                    }
                }
            }
        }
        for (body, touches) in self.bodies.iter_mut().zip(touches) {
            self.contacts += touches.difference(&body.touches).count() as u32;
            body.touches = touches;
        }
    }
}

impl Body {
    fn advance(&mut self, wanted: Twist, half: f32) {
        let [v, w] = &mut self.twist;
        *v += (wanted.v - *v).clamp(-RAMP, RAMP);
        let turn = RAMP / 0.075;
        *w += (wanted.w - *w).clamp(-turn, turn);
        let middle = self.pose[2] + 0.5 * STEP * *w;
        let reach = half - BODY;
        self.pose[0] = (self.pose[0] + STEP * *v * middle.cos()).clamp(-reach, reach);
        self.pose[1] = (self.pose[1] + STEP * *v * middle.sin()).clamp(-reach, reach);
        self.pose[2] = wrap(self.pose[2] + STEP * *w);
    }
}

/// When a step is taken.
fn at(step: u32) -> Instant {
    Instant::from_millis(u64::from(step) * 20)
}

fn apart(a: &[f32; 3], b: &[f32; 3]) -> f32 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// Sizes of the clusters of robots that are linked by distances of at most `link` metres, largest first.
pub(super) fn clusters(poses: &[[f32; 3]], link: f32) -> Vec<usize> {
    let mut left: Vec<[f32; 3]> = poses.to_vec();
    let mut sizes = Vec::new();
    while let Some(first) = left.pop() {
        let mut open = std::vec![first];
        let mut size = 0;
        while let Some(one) = open.pop() {
            size += 1;
            let linked = left.extract_if(.., |other| apart(&one, other) <= link);
            open.extend(linked);
        }
        sizes.push(size);
    }
    sizes.sort_by(|a: &usize, b| b.cmp(a));
    sizes
}

/// Length of the mean of everybody's heading: 1 when all point one way.
pub(super) fn order(poses: &[[f32; 3]]) -> f32 {
    let (sin, cos) = poses.iter().fold((0.0, 0.0), |(sin, cos), pose| {
        (sin + pose[2].sin(), cos + pose[2].cos())
    });
    f32::hypot(sin, cos) / poses.len() as f32
}

/// Neighbours within 1.3 of `spacing` for each robot, and by how much they are off it on average, in metres.
pub(super) fn lattice(poses: &[[f32; 3]], spacing: f32) -> [f32; 2] {
    let beside: Vec<f32> = pairs(poses)
        .into_iter()
        .filter(|distance| *distance < 1.3 * spacing)
        .collect();
    let off: f32 = beside.iter().map(|d| (d - spacing).abs()).sum();
    [
        2.0 * beside.len() as f32 / poses.len() as f32,
        off / beside.len() as f32,
    ]
}

/// Distances of all pairs.
pub(super) fn pairs(poses: &[[f32; 3]]) -> Vec<f32> {
    let mut all = Vec::new();
    for (index, a) in poses.iter().enumerate() {
        all.extend(poses[index + 1..].iter().map(|b| apart(a, b)));
    }
    all
}
