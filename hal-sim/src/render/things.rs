//! How the things of a world look: form, size and paint.

use super::coat::{Coat, Pattern, from_another_tin, obstacle, painted_obstacle, robot};
use super::decor::Decor;
use super::frame::{Frame, Seen};
use super::paint::paint;
use super::rays::Optics;
use super::scene::{Lens, Scene};
use super::sensor::{Motion, develop};
use super::shape::{Form, Shape};
use crate::world::{Arena, Look, Object, ObjectShape, Obstacle, Parameters, Pose, Solid, Vec2};

/// Height of obstacles and of robots, metres.
const OBSTACLE_M: f32 = 0.25;
const ROBOT_M: f32 = 0.12;

const OBSTACLE: [u8; 3] = [150, 125, 95];
const ROBOT: [u8; 3] = [55, 60, 66];

impl Scene {
    /// Begins anew with what the camera of a robot at `body` is to see, keeping the memory.
    pub(crate) fn begin(&mut self, body: Pose, parameters: &Parameters, arena: &Arena) {
        let camera = &parameters.camera;
        let ahead = Vec2::unit(body.theta).times(camera.forward_m);
        let eye = body.position().plus(ahead);
        let lens = Lens {
            pose: Pose::new(eye.x, eye.y, body.theta),
            height: camera.height_m,
            pitch: camera.pitch,
            half_view: camera.half_view,
            distortion: parameters.look.distortion,
        };
        let half = Vec2::new(arena.width * 0.5, arena.height * 0.5);
        self.set(lens, half, Decor::new(&parameters.look));
        self.look = parameters.look;
        self.paint = arena.paint;
    }

    /// A place on the ground, as the lens sees it.
    fn local(&self, place: Vec2) -> Vec2 {
        place
            .minus(self.lens.pose.position())
            .into_frame(Vec2::unit(self.lens.pose.theta))
    }

    /// A direction of the arena, as the lens sees it.
    fn turned(&self, axis: Vec2) -> Vec2 {
        axis.into_frame(Vec2::unit(self.lens.pose.theta))
    }

    /// Puts up an obstacle or a mover.
    pub(crate) fn add_solid(&mut self, solid: &Solid, of: Seen) {
        let height = OBSTACLE_M;
        let (form, axis) = match *solid {
            Solid::Circle { radius, .. } => {
                let axis = self.turned(Vec2::new(1.0, 0.0));
                (Form::Cylinder { radius, height }, axis)
            }
            Solid::Box { axis, half, .. } => {
                let axis = self.turned(axis);
                (Form::Box { axis, half, height }, axis)
            }
        };
        let Look { seed, variety, .. } = self.look;
        let (colour, coat) = match self.paint {
            None => obstacle(OBSTACLE, seed, variety, key(of)),
            Some(paint) => painted_obstacle(paint.rgb(), seed, variety, key(of)),
        };
        self.shapes.push(Shape {
            form,
            at: self.local(solid.centre()),
            colour,
            front: None,
            coat: Coat { axis, ..coat },
            of,
        });
    }

    /// Puts up an object.
    pub(crate) fn add_object(&mut self, object: &Object, index: u32) {
        let (radius, height) = (object.size * 0.5, object.size);
        let axis = self.turned(Vec2::new(1.0, 0.0));
        let form = match object.shape {
            ObjectShape::Cylinder => Form::Cylinder { radius, height },
            ObjectShape::Box => Form::Box {
                axis,
                half: Vec2::new(radius, radius),
                height,
            },
            ObjectShape::Ball => Form::Ball { radius },
            ObjectShape::Cone => Form::Cone { radius, height },
        };
        let (Obstacle::Circle { x, y, .. } | Obstacle::Box { x, y, .. }) = object.body();
        let of = Seen::Object(index);
        let Look { seed, variety, .. } = self.look;
        self.shapes.push(Shape {
            form,
            at: self.local(Vec2::new(x, y)),
            colour: from_another_tin(object.colour.rgb(), seed, variety, key(of)),
            front: None,
            coat: Coat {
                pattern: Pattern::Glossy,
                axis,
                ..Coat::default()
            },
            of,
        });
    }

    /// Puts up another robot.
    pub(crate) fn add_robot(&mut self, pose: Pose, radius: f32, index: u32) {
        let front = Vec2::unit(pose.theta - self.lens.pose.theta);
        let of = Seen::Robot(index);
        let height = ROBOT_M;
        self.shapes.push(Shape {
            form: Form::Cylinder { radius, height },
            at: self.local(pose.position()),
            colour: robot(ROBOT, self.look.seed, self.look.variety, key(of)),
            front: Some(front),
            coat: Coat {
                pattern: Pattern::Robot,
                axis: front,
                ..Coat::default()
            },
            of,
        });
    }
}

impl Frame {
    /// Takes the picture of what was put up, with a camera that moves like this. `key` names the
    /// picture: another key is other noise.
    pub(crate) fn take(&mut self, motion: Motion, key: u64) {
        paint(self);
        let optics = Optics::new(&self.scene.lens, self.width(), self.height());
        let look = self.scene.look;
        develop(self, &look, optics.focal, motion, key);
    }
}

/// What the paint of a thing is drawn by: its kind and number.
const fn key(of: Seen) -> u32 {
    let (index, kind) = match of {
        Seen::Sky | Seen::Floor | Seen::Wall => (0, 0),
        Seen::Obstacle(index) => (index, 1),
        Seen::Mover(index) => (index, 2),
        Seen::Object(index) => (index, 3),
        Seen::Robot(index) => (index, 4),
    };
    index.wrapping_mul(8).wrapping_add(8 + kind)
}
