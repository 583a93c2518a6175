//! The shapes of a scene, and where a ray meets them.

use super::coat::Coat;
use super::frame::Seen;
use crate::world::Vec2;

/// A point or a direction in space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Vec3 {
    pub(super) x: f32,
    pub(super) y: f32,
    pub(super) z: f32,
}

impl Vec3 {
    pub(super) const fn new(x: f32, y: f32, z: f32) -> Self {
        Self { x, y, z }
    }

    pub(super) fn dot(self, other: Self) -> f32 {
        self.x * other.x + self.y * other.y + self.z * other.z
    }
}

/// Nearer than this to the lens nothing is drawn, metres along the optical axis.
pub(super) const NEAR_M: f32 = 0.005;

/// A form that stands on the floor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Form {
    /// An upright cylinder.
    Cylinder {
        /// Metres.
        radius: f32,
        /// Metres.
        height: f32,
    },
    /// An upright box, turned about its middle.
    Box {
        /// Unit vector of its own x axis.
        axis: Vec2,
        /// Half its sides, metres.
        half: Vec2,
        /// Metres.
        height: f32,
    },
    /// A ball that touches the floor.
    Ball {
        /// Metres.
        radius: f32,
    },
    /// A cone, point upwards.
    Cone {
        /// Of its base, metres.
        radius: f32,
        /// Metres.
        height: f32,
    },
}

/// A form at its place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Shape {
    pub(crate) form: Form,
    /// Middle of its base, in the frame of the lens.
    pub(crate) at: Vec2,
    /// Red, green and blue in full light.
    pub(crate) colour: [u8; 3],
    /// Direction of a face painted lighter, so that one sees where a robot looks.
    pub(crate) front: Option<Vec2>,
    pub(crate) coat: Coat,
    pub(crate) of: Seen,
}

/// Where a ray meets a surface.
#[derive(Debug, Clone, Copy)]
pub(super) struct Hit {
    /// Multiples of the ray.
    pub(super) along: f32,
    /// Outward, of length 1.
    pub(super) normal: Vec3,
}

impl Form {
    /// Half its extents seen from above, and its height.
    pub(super) fn extents(&self) -> (Vec2, f32) {
        match *self {
            Self::Cylinder { radius, height } | Self::Cone { radius, height } => {
                (Vec2::new(radius, radius), height)
            }
            Self::Ball { radius } => (Vec2::new(radius, radius), 2.0 * radius),
            Self::Box { axis, half, height } => {
                let (c, s) = (axis.x.abs(), axis.y.abs());
                let reach = Vec2::new(half.x * c + half.y * s, half.x * s + half.y * c);
                (reach, height)
            }
        }
    }
}

impl Shape {
    /// The nearest point at which `ray`, from a lens `eye_m` above the origin, comes in from
    /// outside.
    pub(super) fn hit(&self, eye_m: f32, ray: Vec3) -> Option<Hit> {
        match self.form {
            Form::Cylinder { radius, height } => cylinder(self.at, radius, height, eye_m, ray),
            Form::Box { axis, half, height } => {
                upright_box(self.at, axis, half, height, eye_m, ray)
            }
            Form::Ball { radius } => ball(self.at, radius, eye_m, ray),
            Form::Cone { radius, height } => cone(self.at, radius, height, eye_m, ray),
        }
    }
}

/// Both solutions of `a t² − 2 b t + c = 0`, the smaller one first.
fn roots(a: f32, b: f32, c: f32) -> Option<[f32; 2]> {
    let square = b * b - a * c;
    if square < 0.0 || a == 0.0 {
        return None;
    }
    let root = square.sqrt();
    let (one, two) = ((b - root) / a, (b + root) / a);
    Some(if one <= two { [one, two] } else { [two, one] })
}

fn flat(at: Vec2, ray: Vec3) -> (f32, f32) {
    (ray.x * ray.x + ray.y * ray.y, at.x * ray.x + at.y * ray.y)
}

fn cylinder(at: Vec2, radius: f32, height: f32, eye_m: f32, ray: Vec3) -> Option<Hit> {
    let (a, b) = flat(at, ray);
    let c = at.dot(at) - radius * radius;
    if let Some([along, _]) = roots(a, b, c)
        && along > NEAR_M
        && (0.0..=height).contains(&(eye_m + along * ray.z))
    {
        let out = Vec2::new(along * ray.x, along * ray.y).minus(at);
        let normal = Vec3::new(out.x / radius, out.y / radius, 0.0);
        return Some(Hit { along, normal });
    }
    lid(height, eye_m, ray, |place| {
        let away = place.minus(at);
        away.dot(away) <= radius * radius
    })
}

/// The upper side of something, seen from above.
fn lid(height: f32, eye_m: f32, ray: Vec3, inside: impl Fn(Vec2) -> bool) -> Option<Hit> {
    if eye_m <= height || ray.z >= 0.0 {
        return None;
    }
    let along = (height - eye_m) / ray.z;
    let normal = Vec3::new(0.0, 0.0, 1.0);
    (along > NEAR_M && inside(Vec2::new(along * ray.x, along * ray.y)))
        .then_some(Hit { along, normal })
}

fn upright_box(
    at: Vec2,
    axis: Vec2,
    half: Vec2,
    height: f32,
    eye_m: f32,
    ray: Vec3,
) -> Option<Hit> {
    // In the box's own frame, with the lens where it then is.
    let from = Vec2::default().minus(at).into_frame(axis);
    let way = Vec2::new(ray.x, ray.y).into_frame(axis);
    let mut enter = f32::NEG_INFINITY;
    let mut leave = f32::INFINITY;
    let mut side = Vec2::default();
    for (from, way, half, outward) in [
        (from.x, way.x, half.x, Vec2::new(1.0, 0.0)),
        (from.y, way.y, half.y, Vec2::new(0.0, 1.0)),
    ] {
        if way == 0.0 {
            if from.abs() > half {
                return None;
            }
            continue;
        }
        let (one, two) = ((-half - from) / way, (half - from) / way);
        let (first, last) = if one <= two { (one, two) } else { (two, one) };
        if first > enter {
            enter = first;
            side = outward.times(-way.signum());
        }
        leave = leave.min(last);
    }
    if enter > NEAR_M && enter <= leave && (0.0..=height).contains(&(eye_m + enter * ray.z)) {
        let normal = side.out_of_frame(axis);
        let normal = Vec3::new(normal.x, normal.y, 0.0);
        return Some(Hit {
            along: enter,
            normal,
        });
    }
    lid(height, eye_m, ray, |place| {
        let local = place.minus(at).into_frame(axis);
        local.x.abs() <= half.x && local.y.abs() <= half.y
    })
}

fn ball(at: Vec2, radius: f32, eye_m: f32, ray: Vec3) -> Option<Hit> {
    let up = radius - eye_m;
    let (a, b) = flat(at, ray);
    let [along, _] = roots(
        a + ray.z * ray.z,
        b + up * ray.z,
        at.dot(at) + up * up - radius * radius,
    )?;
    let normal = Vec3::new(
        (along * ray.x - at.x) / radius,
        (along * ray.y - at.y) / radius,
        (along * ray.z - up) / radius,
    );
    (along > NEAR_M).then_some(Hit { along, normal })
}

fn cone(at: Vec2, radius: f32, height: f32, eye_m: f32, ray: Vec3) -> Option<Hit> {
    // Its radius at height z is slope · (height − z); the equation also holds for its mirror image
    // above the point, which the heights rule out.
    let slope = radius / height;
    let above = height - eye_m;
    let (a, b) = flat(at, ray);
    let steep = slope * slope;
    let [one, two] = roots(
        a - steep * ray.z * ray.z,
        b - steep * above * ray.z,
        at.dot(at) - steep * above * above,
    )?;
    let along = [one, two]
        .into_iter()
        .find(|along| *along > NEAR_M && (0.0..=height).contains(&(eye_m + along * ray.z)))?;
    let away = Vec2::new(along * ray.x, along * ray.y).minus(at);
    let length = away.length();
    let lean = 1.0 / (1.0 + steep).sqrt();
    let (x, y) = if length > 0.0 {
        (away.x / length, away.y / length)
    } else {
        (0.0, 0.0)
    };
    let normal = Vec3::new(x * lean, y * lean, slope * lean);
    Some(Hit { along, normal })
}
