//! Obstacles as the solver and the sensors want them.

use super::Obstacle;
use crate::world::geometry::Vec2;

/// An obstacle, prepared: the axis of a box is computed once.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Solid {
    Circle {
        centre: Vec2,
        radius: f32,
    },
    Box {
        centre: Vec2,
        axis: Vec2,
        half: Vec2,
    },
}

impl Solid {
    pub(crate) fn new(obstacle: &Obstacle) -> Self {
        match *obstacle {
            Obstacle::Circle { x, y, r } => Self::Circle {
                centre: Vec2::new(x, y),
                radius: r,
            },
            Obstacle::Box { x, y, w, h, theta } => Self::Box {
                centre: Vec2::new(x, y),
                axis: Vec2::unit(theta),
                half: Vec2::new(w * 0.5, h * 0.5),
            },
        }
    }

    pub(crate) const fn centre(&self) -> Vec2 {
        match *self {
            Self::Circle { centre, .. } | Self::Box { centre, .. } => centre,
        }
    }

    /// The same thing elsewhere.
    pub(crate) const fn moved_to(self, place: Vec2) -> Self {
        match self {
            Self::Circle { radius, .. } => Self::Circle {
                centre: place,
                radius,
            },
            Self::Box { axis, half, .. } => Self::Box {
                centre: place,
                axis,
                half,
            },
        }
    }

    /// Metres from its centre beyond which it does not reach.
    pub(crate) fn reach(&self) -> f32 {
        match *self {
            Self::Circle { radius, .. } => radius,
            Self::Box { half, .. } => half.length(),
        }
    }

    /// Half the extents of the axis-parallel box around it.
    pub(crate) fn half_extents(&self) -> Vec2 {
        match *self {
            Self::Circle { radius, .. } => Vec2::new(radius, radius),
            Self::Box { axis, half, .. } => {
                let (c, s) = (axis.x.abs(), axis.y.abs());
                Vec2::new(half.x * c + half.y * s, half.x * s + half.y * c)
            }
        }
    }

    /// Distance from `point` to the surface, negative inside, with the outward direction.
    pub(crate) fn separation(&self, point: Vec2) -> (f32, Vec2) {
        match *self {
            Self::Circle { centre, radius } => {
                let away = point.minus(centre);
                let distance = away.length();
                let direction = if distance > 0.0 {
                    away.times(1.0 / distance)
                } else {
                    Vec2::new(1.0, 0.0)
                };
                (distance - radius, direction)
            }
            Self::Box { centre, axis, half } => {
                let local = point.minus(centre).into_frame(axis);
                let nearest = Vec2::new(
                    local.x.clamp(-half.x, half.x),
                    local.y.clamp(-half.y, half.y),
                );
                let away = local.minus(nearest);
                let distance = away.length();
                if distance > 0.0 {
                    return (distance, away.times(1.0 / distance).out_of_frame(axis));
                }
                let (deep_x, deep_y) = (half.x - local.x.abs(), half.y - local.y.abs());
                let (depth, face) = if deep_x < deep_y {
                    (deep_x, Vec2::new(1.0_f32.copysign(local.x), 0.0))
                } else {
                    (deep_y, Vec2::new(0.0, 1.0_f32.copysign(local.y)))
                };
                (-depth, face.out_of_frame(axis))
            }
        }
    }

    /// The corners of a box, in order around it.
    pub(crate) fn corners(centre: Vec2, axis: Vec2, half: Vec2) -> [Vec2; 4] {
        [
            Vec2::new(half.x, half.y),
            Vec2::new(-half.x, half.y),
            Vec2::new(-half.x, -half.y),
            Vec2::new(half.x, -half.y),
        ]
        .map(|corner| centre.plus(corner.out_of_frame(axis)))
    }
}
