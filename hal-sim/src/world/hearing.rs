//! What a ranger hears of its own echoes, and of the pings of others.

use super::arena::Solid;
use super::bodies::{NEVER_US, Presence};
use super::geometry::{Cone, Vec2, ray_to_circle, ray_to_segment};
use super::space::{Space, Thing};

/// How far ahead a ranger looks first, metres; it doubles from there.
const FIRST_REACH_M: f32 = 1.0;

impl Space {
    /// The beam of robot `i`'s ranger.
    fn beam(&self, i: usize) -> Cone {
        let seen = &self.bodies.published;
        let (at, axis) = (seen.at[i], seen.heading[i]);
        let apex = at.plus(axis.times(self.parameters.ranger.mount_m));
        Cone::new(apex, axis, self.beam)
    }

    /// Distance in metres from robot `i`'s ranger to the nearest echo between `least` and `most`.
    pub(crate) fn range(&self, i: usize, least: f32, most: f32) -> Option<f32> {
        let cone = self.beam(i);
        let mut nearest = most.next_up();
        let half = Vec2::new(self.arena.width * 0.5, self.arena.height * 0.5);
        let walls = Solid::corners(Vec2::default(), Vec2::new(1.0, 0.0), half);
        let (x, y) = (cone.apex.x.abs(), cone.apex.y.abs());
        if half.x - x < nearest || half.y - y < nearest {
            nearest = cone.echo_of_sides(walls, least, nearest).unwrap_or(nearest);
        }
        // Most echoes come from close by: look further only when there is nothing nearer.
        let (mut from, mut reach) = (0.0, FIRST_REACH_M);
        loop {
            let searched = reach.min(nearest);
            self.visit_cone(&cone, from, searched, |space, thing| {
                if thing != Thing::Robot(i) {
                    space.hear(&cone, thing, least, &mut nearest);
                }
            });
            if searched >= nearest || searched >= most {
                break;
            }
            from = searched;
            reach *= 2.0;
        }
        (nearest <= most).then_some(nearest)
    }

    /// Lowers `nearest` to the echo of `thing`, if that is nearer.
    fn hear(&self, cone: &Cone, thing: Thing, least: f32, nearest: &mut f32) {
        match self.body_of(thing) {
            Solid::Circle { centre, radius } => {
                if let Some(echo) = cone.echo_of_circle(centre, radius)
                    && echo >= least
                    && echo < *nearest
                {
                    *nearest = echo;
                }
            }
            Solid::Box { centre, axis, half } => {
                // Its corners are nearer to its centre than this.
                if cone.may_meet(centre, half.x + half.y, *nearest) {
                    let corners = Solid::corners(centre, axis, half);
                    let echo = cone.echo_of_sides(corners, least, *nearest);
                    *nearest = echo.unwrap_or(*nearest);
                }
            }
        }
    }

    /// The range that robot `i`, which listens from `at_us` on, takes the ping of another for:
    /// the nearest between `least` and `most` metres.
    ///
    /// A ping that left the other's ranger `t` before and comes straight from it has travelled
    /// `v t` and has the rest of the way to go. The sensor cannot tell it from the echo of its own
    /// burst, which would have gone there and back. Both have to look at each other, each within
    /// the other's beam, with nothing between them.
    ///
    /// Counts the pings that were known at the last step of the world, so that it does not matter
    /// in which order robots are asked; what robots send within one step does not disturb them.
    pub(crate) fn crosstalk(
        &self,
        i: usize,
        at_us: u64,
        metres_per_us: f32,
        least: f32,
        most: f32,
    ) -> Option<f32> {
        let farthest = self.parameters.ranger.crosstalk_m;
        if farthest <= 0.0 {
            return None;
        }
        let cone = self.beam(i);
        let seen = &self.bodies.published;
        let mut nearest: Option<f32> = None;
        for (first, last) in self.rows_of_cone(&cone, 0.0, farthest) {
            for &j in self.robots.in_row(first, last) {
                let j = j as usize;
                let sent = seen.last_ping[j];
                if sent == NEVER_US || sent > at_us || j == i {
                    continue;
                }
                let flown = (at_us - sent) as f32 * metres_per_us;
                if flown >= farthest || seen.presence[j] == Presence::Removed {
                    continue;
                }
                let ahead = seen.heading[j];
                let source = seen.at[j].plus(ahead.times(self.parameters.ranger.mount_m));
                let way = source.minus(cone.apex);
                let distance = way.length();
                let false_range = (distance - flown) * 0.5;
                if distance <= farthest
                    && false_range >= least
                    && false_range < nearest.unwrap_or(most)
                    && cone.holds(way.into_frame(cone.axis))
                    && cone.holds(Vec2::default().minus(way).into_frame(ahead))
                    && !self.hides(cone.apex, source, [i, j])
                {
                    nearest = Some(false_range);
                }
            }
        }
        nearest
    }

    /// Whether something other than two robots stands on the straight way between two points.
    fn hides(&self, from: Vec2, to: Vec2, pair: [usize; 2]) -> bool {
        let way = to.minus(from);
        let length = way.length();
        if length <= f32::EPSILON {
            return false;
        }
        let ray = way.times(1.0 / length);
        let mut hidden = false;
        let middle = from.plus(way.times(0.5));
        let half = Vec2::new(way.x.abs() * 0.5, way.y.abs() * 0.5);
        // A robot may reach into the rectangle from outside.
        let margin = self.parameters.chassis.radius_m;
        let half = half.plus(Vec2::new(margin, margin));
        self.visit_around(middle, half, |space, thing| {
            if hidden || pair.iter().any(|&robot| thing == Thing::Robot(robot)) {
                return;
            }
            hidden = match space.body_of(thing) {
                Solid::Circle { centre, radius } => {
                    ray_to_circle(from, ray, centre, radius).is_some_and(|hit| hit < length)
                }
                Solid::Box { centre, axis, half } => {
                    let corners = Solid::corners(centre, axis, half);
                    (0..4).any(|k| {
                        ray_to_segment(from, ray, corners[k], corners[(k + 1) % 4])
                            .is_some_and(|(hit, _)| hit < length)
                    })
                }
            };
        });
        hidden
    }
}
