//! What stands before a robot's lens.

use super::{Frame, Motion, Scene, Seen};
use crate::world::{Beam, Cone, Look, Presence, Space, Thing, Vec2, mix};

/// How far a lens sees anything but walls, metres: a robot is less than two pixels wide there.
const SIGHT_M: f32 = 12.0;

/// What the noise of a picture is drawn by: who took it, and when.
pub(crate) const fn picture_key(look: &Look, robot: usize, steps: u64) -> u64 {
    mix((look.seed as u64) << 32 | robot as u64) ^ mix(steps)
}

/// Draws what robot `i`'s camera sees; false when it is not in the world.
pub(crate) fn view(space: &mut Space, i: usize, frame: &mut Frame) -> bool {
    let published = &space.bodies.published;
    let Some((&velocity, &w)) = published.velocity.get(i).zip(published.spin.get(i)) else {
        return false;
    };
    let motion = Motion {
        v: velocity.dot(published.heading[i]),
        w,
    };
    view_moving(space, i, motion, frame)
}

/// The same as if it moved like this.
pub(crate) fn view_moving(space: &mut Space, i: usize, motion: Motion, frame: &mut Frame) -> bool {
    let present = space.bodies.published.presence.get(i);
    if present.is_none_or(|&presence| presence == Presence::Removed) {
        return false;
    }
    space.list_robots(0);
    let proportions = f32::from(frame.height()) / f32::from(frame.width());
    gather(space, i, proportions, &mut frame.scene);
    let key = picture_key(&space.parameters.look, i, space.steps);
    frame.take(motion, key);
    true
}

/// Lists what robot `i`'s camera sees in a picture of these proportions.
fn gather(space: &Space, i: usize, height_to_width: f32, scene: &mut Scene) {
    let body = space.bodies.pose(i);
    scene.begin(body, &space.parameters, &space.arena);
    let lens = scene.lens;
    let eye = lens.pose.position();
    let sweep = lens.half_sweep(height_to_width);
    let cone = Cone::new(eye, Vec2::unit(body.theta), Beam::new(sweep, 1.5));
    let mut listed = core::mem::take(&mut scene.listed);
    space.visit_cone(&cone, 0.0, SIGHT_M, |_, thing| match thing {
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
            0 => add_fixed(space, index, scene),
            1 => scene.add_solid(space.movers.now(index as usize), Seen::Mover(index)),
            _ => {
                let pose = space.bodies.pose(index as usize);
                scene.add_robot(pose, space.parameters.chassis.radius_m, index);
            }
        }
    }
    scene.listed = listed;
}

fn add_fixed(space: &Space, index: u32, scene: &mut Scene) {
    let obstacles = space.arena.obstacles.len();
    let place = (index as usize).checked_sub(obstacles);
    if let Some(object) = place.and_then(|place| space.arena.objects.get(place)) {
        scene.add_object(object, index - obstacles as u32);
    } else {
        scene.add_solid(&space.solids[index as usize], Seen::Obstacle(index));
    }
}
