//! Plane geometry of the world: vectors, poses, and what a sound cone meets first.
//!
//! Square roots are IEEE operations and exact everywhere; every transcendental function comes
//! from `libm`, because those of `std` differ between targets.

use serde::{Deserialize, Serialize};

/// A point or a direction, in metres.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Vec2 {
    pub(crate) x: f32,
    pub(crate) y: f32,
}

impl Vec2 {
    pub(crate) const fn new(x: f32, y: f32) -> Self {
        Self { x, y }
    }

    /// The unit vector at `angle` radians.
    pub(crate) fn unit(angle: f32) -> Self {
        let (y, x) = libm::sincosf(angle);
        Self { x, y }
    }

    pub(crate) fn plus(self, other: Self) -> Self {
        Self::new(self.x + other.x, self.y + other.y)
    }

    pub(crate) fn minus(self, other: Self) -> Self {
        Self::new(self.x - other.x, self.y - other.y)
    }

    pub(crate) fn times(self, factor: f32) -> Self {
        Self::new(self.x * factor, self.y * factor)
    }

    pub(crate) fn dot(self, other: Self) -> f32 {
        self.x * other.x + self.y * other.y
    }

    pub(crate) fn cross(self, other: Self) -> f32 {
        self.x * other.y - self.y * other.x
    }

    pub(crate) fn length(self) -> f32 {
        self.dot(self).sqrt()
    }

    /// The vector in a frame whose x axis is `axis` (a unit vector).
    pub(crate) fn into_frame(self, axis: Self) -> Self {
        Self::new(axis.dot(self), axis.cross(self))
    }

    /// The inverse of [`Vec2::into_frame`].
    pub(crate) fn out_of_frame(self, axis: Self) -> Self {
        Self::new(
            self.x * axis.x - self.y * axis.y,
            self.x * axis.y + self.y * axis.x,
        )
    }
}

/// Where a robot is and where it looks: metres, and radians anticlockwise from the x axis.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pose {
    /// Metres to the right of the centre of the arena.
    pub x: f32,
    /// Metres above the centre of the arena.
    pub y: f32,
    /// Heading, −π to π.
    pub theta: f32,
}

impl Pose {
    /// A pose at (`x`, `y`) looking along `theta`.
    pub const fn new(x: f32, y: f32, theta: f32) -> Self {
        Self { x, y, theta }
    }

    pub(crate) const fn position(self) -> Vec2 {
        Vec2::new(self.x, self.y)
    }

    pub(crate) fn is_finite(self) -> bool {
        self.x.is_finite() && self.y.is_finite() && self.theta.is_finite()
    }
}

/// Brings an angle that left −π…π by less than one turn back into it.
pub(crate) fn wrap(angle: f32) -> f32 {
    use core::f32::consts::{PI, TAU};
    if angle > PI {
        angle - TAU
    } else if angle <= -PI {
        angle + TAU
    } else {
        angle
    }
}

/// Brings any finite angle into −π…π.
pub(crate) fn wrap_any(angle: f32) -> f32 {
    wrap(libm::remainderf(angle, core::f32::consts::TAU))
}

/// The beam of an ultrasonic ranger.
///
/// Sound comes back from a surface only when it strikes it steeply enough: beyond
/// `max_incidence` from the surface normal it glances off. Distances are to the *nearest* point
/// that lies in the cone and sends an echo, computed from the shapes themselves, so that nothing
/// slips between rays.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cone {
    pub(crate) apex: Vec2,
    /// Unit vector of the axis.
    pub(crate) axis: Vec2,
    pub(crate) half_angle: f32,
    pub(crate) max_incidence: f32,
    /// Cosine and sine of `half_angle`, which is below a quarter turn.
    pub(crate) edge: Vec2,
    sine_of_max_incidence: f32,
}

impl Cone {
    pub(crate) fn new(apex: Vec2, heading: f32, half_angle: f32, max_incidence: f32) -> Self {
        Self {
            apex,
            axis: Vec2::unit(heading),
            half_angle,
            max_incidence,
            edge: Vec2::unit(half_angle),
            sine_of_max_incidence: libm::sinf(max_incidence),
        }
    }

    /// How far a point of the cone's own frame lies to the left and to the right of the cone.
    fn sides(&self, local: Vec2) -> (f32, f32) {
        let outward = local.x * self.edge.y;
        (
            local.y * self.edge.x - outward,
            -local.y * self.edge.x - outward,
        )
    }

    /// Distance to the echo of a disc, if it sends one.
    pub(crate) fn echo_of_circle(&self, centre: Vec2, radius: f32) -> Option<f32> {
        let local = centre.minus(self.apex).into_frame(self.axis);
        let distance = local.length();
        if distance <= radius {
            return Some(0.0);
        }
        // In the cone: the near point faces us squarely. `edge` is (cos, sin) of the half angle,
        // and the centre is inside when its bearing is no larger.
        let side = local.y.abs();
        let beyond = side * self.edge.x - local.x * self.edge.y;
        if beyond <= 0.0 {
            return Some(distance - radius);
        }
        // Otherwise the near point within the cone is where the cone's edge cuts the disc.
        // `beyond` is the distance from the centre to the line of that edge.
        if beyond >= radius {
            return None;
        }
        let along = local.x * self.edge.x + side * self.edge.y;
        let half_chord = (radius * radius - beyond * beyond).sqrt();
        let hit = along - half_chord;
        if hit < 0.0 {
            return None;
        }
        (beyond <= radius * self.sine_of_max_incidence).then_some(hit)
    }

    /// Distance to the echo of a straight wall from `a` to `b`, if it sends one from less than
    /// `limit`.
    pub(crate) fn echo_of_segment(&self, a: Vec2, b: Vec2, limit: f32) -> Option<f32> {
        let a = a.minus(self.apex).into_frame(self.axis);
        let b = b.minus(self.apex).into_frame(self.axis);
        // A wall wholly behind the apex, or wholly beside the cone.
        if a.x <= 0.0 && b.x <= 0.0 {
            return None;
        }
        let ((left_a, right_a), (left_b, right_b)) = (self.sides(a), self.sides(b));
        if (left_a > 0.0 && left_b > 0.0) || (right_a > 0.0 && right_b > 0.0) {
            return None;
        }
        let along = b.minus(a);
        let length = along.length();
        if length <= f32::EPSILON {
            return None;
        }
        // Signed distance of the wall's line from the apex, and the bearing of its foot.
        let offset = a.cross(along) / length;
        let distance = offset.abs();
        if distance < 1e-5 || distance >= limit {
            return None;
        }
        let sign = if offset > 0.0 { 1.0 } else { -1.0 };
        let foot = Vec2::new(along.y, -along.x).times(sign / length);
        let normal = libm::atan2f(foot.y, foot.x);
        // Everything below is relative to the normal, where the wall spans less than half a turn.
        let bearing = |p: Vec2| {
            let p = p.into_frame(foot);
            libm::atan2f(p.y, p.x)
        };
        let (first, second) = (bearing(a), bearing(b));
        let axis = wrap(-normal);
        let low = first
            .min(second)
            .max(axis - self.half_angle)
            .max(-self.max_incidence);
        let high = first
            .max(second)
            .min(axis + self.half_angle)
            .min(self.max_incidence);
        if low > high {
            return None;
        }
        // `low` and `high` lie within the incidence limit, hence the cosine is positive.
        let nearest = 0.0_f32.clamp(low, high);
        let echo = distance / libm::cosf(nearest);
        (echo < limit).then_some(echo)
    }
}

/// Distance along the ray from `origin` in the unit direction `ray` to a disc.
pub(crate) fn ray_to_circle(origin: Vec2, ray: Vec2, centre: Vec2, radius: f32) -> Option<f32> {
    let local = centre.minus(origin).into_frame(ray);
    if local.y.abs() >= radius {
        return None;
    }
    let hit = local.x - (radius * radius - local.y * local.y).sqrt();
    (hit > 0.0).then_some(hit)
}

/// Distance along the ray to a segment, with the share of the segment at which it is hit.
pub(crate) fn ray_to_segment(origin: Vec2, ray: Vec2, a: Vec2, b: Vec2) -> Option<(f32, f32)> {
    let along = b.minus(a);
    let across = ray.cross(along);
    if across.abs() <= f32::EPSILON {
        return None;
    }
    let to_a = a.minus(origin);
    let hit = to_a.cross(along) / across;
    let share = to_a.cross(ray) / across;
    (hit > 0.0 && (0.0..=1.0).contains(&share)).then_some((hit, share))
}
