//! What stands before a robot's lens.

use super::bodies::Presence;
use super::geometry::{Beam, Cone, Vec2};
use super::parameters::Look;
use super::rng::mix;
use super::space::{Space, Thing};
use crate::render::{Frame, Motion, Scene, Seen};

/// How far a lens sees anything but walls, metres: a robot is less than two pixels wide there.
const SIGHT_M: f32 = 12.0;

/// What the noise of a picture is drawn by: who took it, and when.
pub(crate) const fn picture_key(look: &Look, robot: usize, steps: u64) -> u64 {
    mix((look.seed as u64) << 32 | robot as u64) ^ mix(steps)
}

impl Space {
    /// Draws what robot `i`'s camera sees; false when it is not in the world.
    pub(crate) fn render(&mut self, i: usize, frame: &mut Frame) -> bool {
        let published = &self.bodies.published;
        let Some((&velocity, &w)) = published.velocity.get(i).zip(published.spin.get(i)) else {
            return false;
        };
        let motion = Motion {
            v: velocity.dot(published.heading[i]),
            w,
        };
        self.render_moving(i, motion, frame)
    }

    /// The same as if it moved like this.
    pub(crate) fn render_moving(&mut self, i: usize, motion: Motion, frame: &mut Frame) -> bool {
        let present = self.bodies.published.presence.get(i);
        if present.is_none_or(|&presence| presence == Presence::Removed) {
            return false;
        }
        self.list_robots(0);
        let proportions = f32::from(frame.height()) / f32::from(frame.width());
        self.look(i, proportions, &mut frame.scene);
        let key = picture_key(&self.parameters.look, i, self.steps);
        frame.take(motion, key);
        true
    }

    /// Lists what robot `i`'s camera sees in a picture of these proportions.
    fn look(&self, i: usize, height_to_width: f32, scene: &mut Scene) {
        let body = self.bodies.pose(i);
        scene.begin(body, &self.parameters, &self.arena);
        let lens = scene.lens;
        let eye = lens.pose.position();
        let sweep = lens.half_sweep(height_to_width);
        let cone = Cone::new(eye, Vec2::unit(body.theta), Beam::new(sweep, 1.5));
        let mut listed = core::mem::take(&mut scene.listed);
        self.visit_cone(&cone, 0.0, SIGHT_M, |_, thing| match thing {
            Thing::Solid(solid) => listed.push(u64::from(solid)),
            Thing::Mover(mover) => listed.push(1 << 32 | u64::from(mover)),
            Thing::Robot(robot) if robot != i => listed.push(2 << 32 | robot as u64),
            Thing::Robot(_) => {}
        });
        // A thing is offered once for each cell it touches.
        listed.sort_unstable();
        listed.dedup();
        for &key in &listed {
            let index = (key & u64::from(u32::MAX)) as u32;
            match key >> 32 {
                0 => self.add_fixed(index, scene),
                1 => scene.add_solid(self.movers.now(index as usize), Seen::Mover(index)),
                _ => {
                    let pose = self.bodies.pose(index as usize);
                    scene.add_robot(pose, self.parameters.chassis.radius_m, index);
                }
            }
        }
        scene.listed = listed;
    }

    fn add_fixed(&self, index: u32, scene: &mut Scene) {
        let obstacles = self.arena.obstacles.len();
        let place = (index as usize).checked_sub(obstacles);
        if let Some(object) = place.and_then(|place| self.arena.objects.get(place)) {
            scene.add_object(object, index - obstacles as u32);
        } else {
            scene.add_solid(&self.solids[index as usize], Seen::Obstacle(index));
        }
    }
}
