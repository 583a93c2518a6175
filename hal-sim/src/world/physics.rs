//! One step of the world.
//!
//! In a step every robot reads what was published at the end of the last one and its own private
//! state, and writes only its own. So a step comes out alike in whatever order and on however many
//! threads robots are moved.

mod contact;
mod drive;
mod supply;

use crawler_hal::Duration;

use super::bodies::{Inputs, NOBODY, Presence};
use super::geometry::{Turn, Vec2};
use super::members::Members;
use super::space::Space;
pub(crate) use contact::Limit;
use drive::{Speeds, roll, slide};
pub(crate) use drive::{Stop, Train};

/// The physics step.
pub const PHYSICS_STEP: Duration = Duration::from_millis(10);

/// The physics step in seconds.
pub(crate) const STEP_S: f32 = 0.01;

/// Steps from one rebuild of the grid to the next.
pub(crate) const REBUILD_STEPS: u64 = 10;

/// A robot is never faster than this share of the top speed of robots and movers. Pushed by
/// several others at once it could be, for a moment.
pub(crate) const MAX_SPEED_FACTOR: f32 = 1.25;

/// A supply that comes back this far above the brown-out voltage starts the robot again.
const BROWN_OUT_HYSTERESIS_V: f32 = 0.5;

/// Gap the solver leaves between things that touch, metres. It must exceed the resolution of a
/// coordinate, which is 0.03 mm at the edge of the largest arena.
pub(crate) const SKIN_M: f32 = 1e-4;

/// Time after a contact during which another touch is the same contact, seconds.
const CONTACT_HOLD_S: f32 = 0.2;

/// What a step found out about a robot's supply.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Power {
    /// It fell below the brown-out voltage.
    Lost,
    /// It came back.
    Restored,
}

/// What there is of walls, obstacles and movers for a robot in a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fixed {
    /// Nothing that it could reach.
    Far,
    /// Something it could reach.
    Near,
    /// Something that it would run into.
    Ahead,
}

/// What a robot is at the end of a step.
struct Outcome {
    at: Vec2,
    heading: Vec2,
    velocity: Vec2,
    spin: f32,
    rims: [f32; 2],
    rolls: bool,
    touched: bool,
    push: (u32, f32),
}

impl Space {
    /// Moves `members` on by one step and publishes what became of them; `power` hears of every
    /// brown-out and recovery among them.
    pub(crate) fn step(&mut self, members: Members, mut power: impl FnMut(usize, Power)) {
        self.members = members;
        if self.steps.is_multiple_of(REBUILD_STEPS) {
            self.rebuild_grid();
        } else {
            self.list_robots(0);
        }
        self.steps += 1;
        self.move_movers();
        for i in members.iter(self.bodies.len()) {
            if self.bodies.published.presence[i] == Presence::Removed {
                continue;
            }
            let mut inputs = self.bodies.acting(i);
            if self.draw_power(i, inputs, &mut power) {
                inputs = self.bodies.acting(i);
            }
            self.advance(i, inputs);
        }
        self.bodies.publish_all(members);
        self.movers.arrive();
    }

    /// Moves robot `i` and writes what it will publish.
    fn advance(&mut self, i: usize, inputs: Inputs) {
        let seen = &self.bodies.published;
        let at = seen.at[i];
        let touch = if self.neighbours.of(i).is_empty() {
            contact::Touch::default()
        } else {
            self.touch(i)
        };
        let motor_v = self.train.motor_v(self.bodies.supply_v[i]);
        let build = &self.bodies.build[i];
        let motors = [
            self.train
                .motor(inputs.left, build.left, build.friction[0], motor_v),
            self.train
                .motor(inputs.right, build.right, build.friction[1], motor_v),
        ];
        let rims = [self.bodies.left[i], self.bodies.right[i]];
        let hold = (CONTACT_HOLD_S / self.dt) as u16;
        let stands = self.bodies.rolls[i]
            && rims == [0.0; 2]
            && motors[0].holds()
            && motors[1].holds()
            && touch.hits == 0
            && !touch.pushed;
        if stands && !self.movers_near(at) {
            self.bodies.stand(i, touch.close, hold);
            return;
        }
        let outcome = self.travel(i, &motors, rims, &touch);
        let sound = outcome.at.x
            + outcome.at.y
            + outcome.velocity.x
            + outcome.velocity.y
            + outcome.spin
            + outcome.rims[0]
            + outcome.rims[1]
            + outcome.heading.x
            + outcome.heading.y;
        // Nothing above can give a number that is none. Should it do so all the same, this robot
        // stands, and no other one ever learns of it.
        if !sound.is_finite() {
            self.bodies.halt(i);
            return;
        }
        let held = touch.hits > 0 || touch.pushed || outcome.touched || outcome.push != NOBODY;
        self.bodies.count_contact(i, held, touch.close, hold);
        let bodies = &mut self.bodies;
        bodies.left[i] = outcome.rims[0];
        bodies.right[i] = outcome.rims[1];
        bodies.rolls[i] = outcome.rolls;
        let next = &mut bodies.next;
        next.at[i] = outcome.at;
        next.heading[i] = outcome.heading;
        next.velocity[i] = outcome.velocity;
        next.spin[i] = outcome.spin;
        next.push[i] = outcome.push;
        next.contacts_now[i] = (touch.hits.min(200) as u8) + u8::from(outcome.touched);
    }

    fn movers_near(&self, at: Vec2) -> bool {
        (0..self.movers.len()).any(|k| self.is_near_mover(at, k))
    }

    fn travel(
        &mut self,
        i: usize,
        motors: &[drive::Motor; 2],
        rims: [f32; 2],
        touch: &contact::Touch,
    ) -> Outcome {
        let dt = self.dt;
        let build = self.bodies.build[i];
        let seen = &self.bodies.published;
        let (at, heading) = (seen.at[i], seen.heading[i]);
        let velocity = seen.velocity[i].plus(touch.kick);
        let grip = self.grip(i, build.track_m);
        let walled = self.walled[i] || !self.movers.is_empty();
        let free = if self.bodies.rolls[i] && touch.hits == 0 && !touch.pushed {
            roll(&self.train, &build, motors, grip, rims)
        } else {
            None
        };
        let spin = seen.spin[i];
        if let Some(next) = free {
            let (longitudinal, yaw) = ((next[0] + next[1]) * 0.5, (next[1] - next[0]) * 0.5);
            let after = yaw * build.per_half_track;
            let bend = Turn::by((spin + after) * 0.5 * dt);
            let heading_after = bend.apply(heading);
            let middle = Turn::halfway(heading, heading_after);
            let was = (rims[0] + rims[1]) * 0.5;
            let way = middle.times((was + longitudinal) * 0.5 * dt);
            let mut outcome = Outcome {
                at: at.plus(way),
                heading: heading_after,
                velocity: heading_after.times(longitudinal),
                spin: after,
                rims: next,
                rolls: true,
                touched: false,
                push: NOBODY,
            };
            let fixed = if walled {
                self.fixed(at, way, outcome.velocity)
            } else {
                Fixed::Far
            };
            if fixed != Fixed::Ahead {
                if touch.company || fixed == Fixed::Near {
                    self.keep_clear(i, at, way, velocity, &mut outcome);
                }
                return outcome;
            }
        }
        // Wheels that slide, or something in the way.
        let half_track = build.track_m * 0.5;
        let bend = Turn::by(spin * dt);
        let middle = Turn::halfway(heading, bend.apply(heading));
        let local = velocity.into_frame(middle);
        let from = Speeds {
            longitudinal: local.x,
            lateral: local.y,
            yaw: spin * half_track,
            rims,
        };
        let mut stops = core::mem::take(&mut self.stops);
        stops.clear();
        if walled {
            self.stops(at, middle, &mut stops);
        }
        let sideways = local.x * bend.half_tangent();
        let (speeds, rolls) = slide(
            &self.train,
            &build,
            motors,
            grip,
            from,
            sideways,
            &mut stops,
        );
        let stopped = stops.iter().any(|stop| stop.taken > 0.0);
        self.stops = stops;
        let after = speeds.yaw * build.per_half_track;
        let heading_after = Turn::by((spin + after) * 0.5 * dt).apply(heading);
        let mut speed = Vec2::new(speeds.longitudinal, speeds.lateral).out_of_frame(middle);
        if rolls {
            // A rolling body goes where it looks.
            speed = heading_after.times(speeds.longitudinal);
        }
        let most = self.stride_m / dt;
        let size = speed.length();
        if size > most {
            speed = speed.times(most / size);
        }
        let mut way = velocity.plus(speed).times(0.5 * dt);
        let length = way.length();
        if length > self.stride_m {
            way = way.times(self.stride_m / length);
        }
        let mut outcome = Outcome {
            at: at.plus(way),
            heading: heading_after,
            velocity: speed,
            spin: after,
            rims: speeds.rims,
            rolls: rolls && size <= most,
            touched: stopped,
            push: NOBODY,
        };
        self.keep_clear(i, at, way, velocity, &mut outcome);
        outcome
    }

    /// What is fixed about a robot at `at` that wants to go `way` and then have this velocity.
    fn fixed(&mut self, at: Vec2, way: Vec2, velocity: Vec2) -> Fixed {
        let mut stops = core::mem::take(&mut self.stops);
        stops.clear();
        self.stops(at, Vec2::new(1.0, 0.0), &mut stops);
        let stopped = stops
            .iter()
            .any(|stop| velocity.dot(stop.normal) < stop.least);
        let far = stops.is_empty() && way.dot(way) <= self.stride_m * self.stride_m;
        self.stops = stops;
        match (stopped, far) {
            (true, _) => Fixed::Ahead,
            (false, true) => Fixed::Far,
            (false, false) => Fixed::Near,
        }
    }

    /// Brings `outcome` to where robot `i` can go when it wants to go `way`, having begun the step
    /// at velocity `before`.
    ///
    /// What its wheels gain in the step against another robot that is in the way goes to that
    /// one, with the next step.
    fn keep_clear(&mut self, i: usize, at: Vec2, way: Vec2, before: Vec2, outcome: &mut Outcome) {
        let mut limits = core::mem::take(&mut self.limits);
        self.limits(i, &mut limits);
        let found = self.fit(at, way, &limits);
        if let Some(taken) = found
            && let Some((whom, normal, lost)) = Self::held_back(&limits, way, taken)
        {
            let gained = before.minus(outcome.velocity).dot(normal);
            let denied = gained.min(lost / self.dt);
            if denied > 0.0 {
                outcome.velocity = outcome.velocity.plus(normal.times(denied));
                outcome.rolls = false;
                outcome.push = (whom, denied * self.bodies.build[i].mass_kg);
            }
        }
        self.limits = limits;
        let Some(found) = found else {
            // Where it is it may stay, unless a mover comes: then a way was found before.
            let ways = self.movers.ways.iter().rev();
            let noted = ways.copied().find(|&(robot, _)| robot as usize == i);
            let way = noted.map_or_else(Vec2::default, |(_, way)| way);
            outcome.at = at.plus(way);
            outcome.velocity = way.times(1.0 / self.dt);
            outcome.rolls = false;
            outcome.touched = true;
            return;
        };
        outcome.at = at.plus(found);
    }

    /// Share of the usual grip under the two wheels of robot `i`.
    fn grip(&self, i: usize, track_m: f32) -> [f32; 2] {
        if self.patches.is_empty() {
            return [1.0; 2];
        }
        let seen = &self.bodies.published;
        let axle = Vec2::new(-seen.heading[i].y, seen.heading[i].x).times(track_m * 0.5);
        [seen.at[i].plus(axle), seen.at[i].minus(axle)]
            .map(|wheel| self.patches.grip(&self.cells, wheel))
    }
}
