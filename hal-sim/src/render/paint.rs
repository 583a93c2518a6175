//! From a scene to colours.

use super::coat::painted_at;
use super::decor::{Decor, Paint};
use super::frame::{Frame, Seen};
use super::rays::Optics;
use super::scene::Scene;
use super::shape::{Form, Shape, Vec3};
use crate::world::Vec2;

/// Height of the walls around an arena, metres.
const WALL_M: f32 = 0.30;

/// The floor is darker this near to what stands on it, metres.
const CONTACT_M: f32 = 0.07;

/// Draws the frame's scene.
pub(crate) fn paint(frame: &mut Frame) {
    let scene = core::mem::take(&mut frame.scene);
    let mut rays = core::mem::take(&mut frame.rays);
    let painter = Painter::new(&scene, frame);
    let all = rays.of(&painter.optics);
    painter.paint_room(frame, all);
    if painter.decor.contact() > 0.0 {
        for shape in &scene.shapes {
            painter.paint_shadow(frame, all, shape);
        }
    }
    for shape in &scene.shapes {
        painter.paint_shape(frame, all, shape);
    }
    frame.rays = rays;
    frame.scene = scene;
}

struct Painter<'a> {
    optics: Optics,
    decor: &'a Decor,
    width: usize,
    eye_m: f32,
    /// Axes of the arena in the frame of the lens.
    east: Vec2,
    north: Vec2,
    /// The lens in the arena.
    place: Vec2,
    half: Vec2,
    /// Towards the light, in the frame of the lens.
    light: Vec3,
}

impl<'a> Painter<'a> {
    fn new(scene: &'a Scene, frame: &Frame) -> Self {
        let lens = &scene.lens;
        let heading = Vec2::unit(lens.pose.theta);
        let light = scene.decor.light;
        let flat = Vec2::new(light.x, light.y).into_frame(heading);
        Self {
            optics: Optics::new(lens, frame.width(), frame.height()),
            decor: &scene.decor,
            width: usize::from(frame.width()),
            eye_m: lens.height,
            east: Vec2::new(1.0, 0.0).into_frame(heading),
            north: Vec2::new(0.0, 1.0).into_frame(heading),
            place: lens.pose.position(),
            half: scene.half,
            light: Vec3::new(flat.x, flat.y, light.z),
        }
    }

    /// Floor, walls and sky: every pixel shows one of them until something stands before it.
    fn paint_room(&self, frame: &mut Frame, rays: &[Vec3]) {
        let lit_floor = self.light_on(Vec3::new(0.0, 0.0, 1.0));
        for (at, ray) in rays.iter().enumerate() {
            let flat = Vec2::new(ray.x, ray.y);
            let (east, north) = (self.east.dot(flat), self.north.dot(flat));
            let out_x = leave(self.place.x, east, self.half.x);
            let out_y = leave(self.place.y, north, self.half.y);
            let wall = out_x.min(out_y);
            let floor = if ray.z < 0.0 {
                -self.eye_m / ray.z
            } else {
                f32::INFINITY
            };
            let (seen, depth, colour) = if floor <= wall {
                let place = Vec2::new(self.place.x + floor * east, self.place.y + floor * north);
                // A pixel covers more of the floor along the ray than across.
                let blot = floor / self.optics.focal * (floor / self.eye_m).max(1.0);
                let paint = self.decor.ground(place.x, place.y, blot);
                (Seen::Floor, floor, dimmed(paint, lit_floor))
            } else if wall.is_finite() && self.eye_m + wall * ray.z <= WALL_M {
                let (inward, along) = if out_x < out_y {
                    let inward = self.east.times(-east.signum());
                    (inward, self.place.y + wall * north)
                } else {
                    let inward = self.north.times(-north.signum());
                    (inward, self.place.x + wall * east)
                };
                let up = self.eye_m + wall * ray.z;
                let paint = self.decor.wall_at(along, up, wall / self.optics.focal);
                let light = self.light_on(Vec3::new(inward.x, inward.y, 0.0));
                (Seen::Wall, wall, dimmed(paint, light))
            } else {
                let sky = self.decor.sky.map(|channel| channel as u8);
                (Seen::Sky, f32::INFINITY, sky)
            };
            frame.depth[at] = depth;
            frame.seen[at] = seen;
            frame.rgb[3 * at..3 * at + 3].copy_from_slice(&colour);
        }
    }

    /// Where a thing stands, light from around does not reach the floor.
    fn paint_shadow(&self, frame: &mut Frame, rays: &[Vec3], shape: &Shape) {
        let (reach, _) = shape.form.extents();
        let reach = reach.plus(Vec2::new(CONTACT_M, CONTACT_M));
        let Some(window) = self.optics.window(shape.at, reach, 0.0, 0) else {
            return;
        };
        for row in window.rows.0..window.rows.1 {
            for column in window.columns.0..window.columns.1 {
                let at = row as usize * self.width + column as usize;
                if frame.seen[at] != Seen::Floor {
                    continue;
                }
                let (ray, along) = (rays[at], frame.depth[at]);
                let place = Vec2::new(ray.x * along, ray.y * along).minus(shape.at);
                let clear = (beside(&shape.form, place) / CONTACT_M).clamp(0.0, 1.0);
                let light = 1.0 - self.decor.contact() * (1.0 - clear) * (1.0 - clear);
                for channel in &mut frame.rgb[3 * at..3 * at + 3] {
                    *channel = (f32::from(*channel) * light) as u8;
                }
            }
        }
    }

    fn paint_shape(&self, frame: &mut Frame, rays: &[Vec3], shape: &Shape) {
        let Some(window) = self.optics.window_of(shape, 0) else {
            return;
        };
        for row in window.rows.0..window.rows.1 {
            for column in window.columns.0..window.columns.1 {
                let at = row as usize * self.width + column as usize;
                let ray = rays[at];
                let Some(hit) = shape.hit(self.eye_m, ray) else {
                    continue;
                };
                if hit.along < frame.depth[at] {
                    let place = Vec3::new(
                        hit.along * ray.x - shape.at.x,
                        hit.along * ray.y - shape.at.y,
                        self.eye_m + hit.along * ray.z,
                    );
                    let paint = painted_at(shape, &hit, place, self.light, self.decor.gloss());
                    let colour = dimmed(paint, self.light_on(hit.normal));
                    frame.depth[at] = hit.along;
                    frame.seen[at] = shape.of;
                    frame.rgb[3 * at..3 * at + 3].copy_from_slice(&colour);
                }
            }
        }
    }

    /// How much light falls on a surface.
    fn light_on(&self, normal: Vec3) -> f32 {
        let ambient = self.decor.ambient;
        ambient + (1.0 - ambient) * normal.dot(self.light).max(0.0)
    }
}

/// A colour under so much light.
fn dimmed(paint: Paint, light: f32) -> [u8; 3] {
    paint.map(|channel| (channel * light + 0.5) as u8)
}

/// How far a place on the floor, seen from the middle of a form, is outside of its base.
fn beside(form: &Form, place: Vec2) -> f32 {
    match *form {
        Form::Cylinder { radius, .. } | Form::Cone { radius, .. } => place.length() - radius,
        // It touches the floor in one point only.
        Form::Ball { radius } => place.length() - 0.6 * radius,
        Form::Box { axis, half, .. } => {
            let local = place.into_frame(axis);
            let out = Vec2::new(
                (local.x.abs() - half.x).max(0.0),
                (local.y.abs() - half.y).max(0.0),
            );
            out.length()
        }
    }
}

/// The way along one axis from `from` to the wall at ±`half`.
fn leave(from: f32, way: f32, half: f32) -> f32 {
    if way == 0.0 {
        f32::INFINITY
    } else {
        ((half.copysign(way) - from) / way).max(0.0)
    }
}
