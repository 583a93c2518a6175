//! Plane geometry of the world: vectors, poses, and what a sound cone meets first.
//!
//! Square roots are IEEE operations and exact everywhere; every transcendental function comes
//! from `libm`, because those of `std` differ between targets.

use serde::{Deserialize, Serialize};

/// A point or a direction, in metres.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
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

/// A turn by an angle, cheaply when it is small.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Turn(Vec2);

impl Turn {
    /// Below this the series are exact to the last bit or two of a float, radians.
    const SMALL: f32 = 0.25;

    pub(crate) fn by(angle: f32) -> Self {
        if angle.abs() > Self::SMALL {
            return Self(Vec2::unit(angle));
        }
        let square = angle * angle;
        let cosine = 1.0 - square * (0.5 - square * (1.0 / 24.0 - square * (1.0 / 720.0)));
        let sine = angle * (1.0 - square * (1.0 / 6.0 - square * (1.0 / 120.0)));
        Self(Vec2::new(cosine, sine))
    }

    /// A unit vector turned; it stays one however often that is done.
    pub(crate) fn apply(self, heading: Vec2) -> Vec2 {
        let turned = self.0.out_of_frame(heading);
        // One step of Newton's method for one over the length, from one.
        turned.times(1.5 - 0.5 * turned.dot(turned))
    }

    /// The unit vector in the middle between two.
    pub(crate) fn halfway(from: Vec2, to: Vec2) -> Vec2 {
        let sum = from.plus(to);
        let length = sum.length();
        if length > 0.0 {
            sum.times(1.0 / length)
        } else {
            from
        }
    }

    /// Tangent of half the angle.
    pub(crate) fn half_tangent(self) -> f32 {
        self.0.y / (1.0 + self.0.x).max(1e-3)
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

/// The shape of the beam of an ultrasonic ranger, wherever it points.
///
/// Sound comes back from a surface only when it strikes it steeply enough: beyond
/// `max_incidence` from the surface normal it glances off.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Beam {
    /// Cosine and sine of half the angle, which is below a quarter turn.
    edge: Vec2,
    /// Tangent of a quarter of the angle.
    tip: f32,
    /// Sine and tangent of the largest incidence.
    incidence: (f32, f32),
}

impl Beam {
    pub(crate) fn new(half_angle: f32, max_incidence: f32) -> Self {
        let edge = Vec2::unit(half_angle);
        let tangent = if max_incidence < core::f32::consts::FRAC_PI_2 {
            libm::tanf(max_incidence)
        } else {
            f32::INFINITY
        };
        Self {
            edge,
            tip: edge.y / (1.0 + edge.x),
            incidence: (libm::sinf(max_incidence), tangent),
        }
    }
}

/// The beam of a ranger somewhere.
///
/// Distances are to the *nearest* point that lies in the cone and sends an echo, computed from the
/// shapes themselves, so that nothing slips between rays.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cone {
    pub(crate) apex: Vec2,
    /// Unit vector of the axis.
    pub(crate) axis: Vec2,
    beam: Beam,
}

/// A point as a cone sees it.
#[derive(Debug, Clone, Copy)]
struct Corner {
    /// In the frame of the apex and the axis.
    at: Vec2,
    /// How far it lies to the left and to the right of the cone.
    left: f32,
    right: f32,
}

impl Cone {
    /// `axis` is a unit vector.
    pub(crate) const fn new(apex: Vec2, axis: Vec2, beam: Beam) -> Self {
        Self { apex, axis, beam }
    }

    fn local(&self, point: Vec2) -> Vec2 {
        point.minus(self.apex).into_frame(self.axis)
    }

    /// Whether a point lies in the cone: given in the frame of its apex and axis, so that another
    /// beam of the same width can be asked too.
    pub(crate) fn holds(&self, local: Vec2) -> bool {
        local.y.abs() * self.beam.edge.x <= local.x * self.beam.edge.y
    }

    /// Opposite corners of a rectangle around what lies in the cone and between two distances from
    /// its apex.
    pub(crate) fn bounds(&self, from: f32, to: f32) -> (Vec2, Vec2) {
        let Beam { edge, tip, .. } = self.beam;
        let turned = |x: f32, y: f32| Vec2::new(x, y).out_of_frame(self.axis);
        // The arc lies between its ends and the tangents there and in its middle, and a chord
        // between the apex and the nearer arc.
        let (left, right) = (turned(edge.x, edge.y), turned(edge.x, -edge.y));
        let corners = [
            left.times(from),
            right.times(from),
            left.times(to),
            right.times(to),
            turned(1.0, tip).times(to),
            turned(1.0, -tip).times(to),
        ];
        let (mut low, mut high) = (corners[0], corners[0]);
        for corner in corners {
            low = Vec2::new(low.x.min(corner.x), low.y.min(corner.y));
            high = Vec2::new(high.x.max(corner.x), high.y.max(corner.y));
        }
        (self.apex.plus(low), self.apex.plus(high))
    }

    /// Whether a disc may have to do with the cone within `limit` of its apex.
    pub(crate) fn may_meet(&self, centre: Vec2, radius: f32, limit: f32) -> bool {
        let local = self.local(centre);
        let reach = limit + radius;
        local.y.abs() * self.beam.edge.x - local.x * self.beam.edge.y <= radius
            && local.dot(local) <= reach * reach
    }

    /// Distance to the echo of a disc, if it sends one.
    pub(crate) fn echo_of_circle(&self, centre: Vec2, radius: f32) -> Option<f32> {
        let local = self.local(centre);
        let Beam { edge, .. } = self.beam;
        // `edge` is (cos, sin) of the half angle, and `beyond` is the distance from the centre to
        // the line of the cone's nearer edge, negative in the cone.
        let side = local.y.abs();
        let beyond = side * edge.x - local.x * edge.y;
        if beyond >= radius {
            return None;
        }
        let square = local.dot(local);
        if square <= radius * radius {
            return Some(0.0);
        }
        // In the cone: the near point faces us squarely.
        if beyond <= 0.0 {
            return Some(square.sqrt() - radius);
        }
        // Otherwise the near point within the cone is where the cone's edge cuts the disc.
        let along = local.x * edge.x + side * edge.y;
        let half_chord = (radius * radius - beyond * beyond).sqrt();
        let hit = along - half_chord;
        if hit < 0.0 {
            return None;
        }
        (beyond <= radius * self.beam.incidence.0).then_some(hit)
    }

    /// Distance to the nearest echo of the sides of a quadrangle that comes from at least `least`
    /// and less than `limit`.
    pub(crate) fn echo_of_sides(&self, corners: [Vec2; 4], least: f32, limit: f32) -> Option<f32> {
        let [first, second, third, last] = corners.map(|corner| self.corner(corner));
        let sides = [
            (&first, &second),
            (&second, &third),
            (&third, &last),
            (&last, &first),
        ];
        let mut nearest = limit;
        for (from, to) in sides {
            if let Some(echo) = self.echo_between(from, to, nearest)
                && echo >= least
            {
                nearest = echo;
            }
        }
        (nearest < limit).then_some(nearest)
    }

    /// Distance to the echo of a straight wall from `a` to `b`.
    #[cfg(test)]
    pub(crate) fn echo_of_segment(&self, a: Vec2, b: Vec2) -> Option<f32> {
        self.echo_between(&self.corner(a), &self.corner(b), f32::INFINITY)
    }

    fn corner(&self, point: Vec2) -> Corner {
        let at = self.local(point);
        let outward = at.x * self.beam.edge.y;
        Corner {
            at,
            left: at.y * self.beam.edge.x - outward,
            right: -at.y * self.beam.edge.x - outward,
        }
    }

    /// Distance to the echo of a straight wall between two corners, if it sends one from less than
    /// `limit`.
    fn echo_between(&self, a: &Corner, b: &Corner, limit: f32) -> Option<f32> {
        // Wholly behind the apex, or wholly beside the cone.
        if (a.at.x <= 0.0 && b.at.x <= 0.0)
            || (a.left > 0.0 && b.left > 0.0)
            || (a.right > 0.0 && b.right > 0.0)
        {
            return None;
        }
        let along = b.at.minus(a.at);
        let length = along.length();
        if length <= f32::EPSILON {
            return None;
        }
        // Signed distance of the wall's line from the apex.
        let offset = a.at.cross(along) / length;
        let distance = offset.abs();
        if distance < 1e-5 || distance >= limit {
            return None;
        }
        // Places on the line are told by how far they lie from the foot of the apex, anticlockwise
        // around it.
        let onward = along.times((1.0 / length).copysign(offset));
        let foot = Vec2::new(onward.y, -onward.x);
        // Where an edge of the cone meets the line. One that does not either leaves all of the
        // line on the side where the cone is, or none.
        let meets = |edge: Vec2, all: f32| {
            let (ahead, aside) = (edge.dot(foot), edge.dot(onward));
            if ahead > 0.0 {
                Some(distance * aside / ahead)
            } else {
                (aside * all > 0.0).then_some(all)
            }
        };
        let edge = self.beam.edge;
        let first = meets(Vec2::new(edge.x, -edge.y), f32::NEG_INFINITY)?;
        let last = meets(edge, f32::INFINITY)?;
        let steepest = distance * self.beam.incidence.1;
        let (one, other) = (a.at.dot(onward), b.at.dot(onward));
        let low = one.min(other).max(first).max(-steepest);
        let high = one.max(other).min(last).min(steepest);
        let visible = low <= high;
        if !visible {
            return None;
        }
        let nearest = 0.0_f32.clamp(low, high);
        let echo = (distance * distance + nearest * nearest).sqrt();
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
