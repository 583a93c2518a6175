//! What robots in a simulated arena may touch.

use crawler_sim::world::{Arena, Obstacle};
use crawler_twins::{Room, Solid};

/// The room that the robots of an arena are in.
pub(crate) fn room(arena: &Arena) -> Room {
    let still = arena.obstacles.iter().map(solid);
    let objects = arena.objects.iter().map(|object| Solid {
        at: [object.x, object.y].map(f64::from),
        radius: f64::from(object.size) * 0.75,
        ..Solid::default()
    });
    // What moves is wherever it may get.
    let movers = arena.movers.iter().flat_map(|mover| {
        let body = solid(&mover.body);
        let corners = mover.path.iter().map(|corner| corner.map(f64::from));
        let from = std::iter::once(body.at).chain(corners.clone());
        let to: Vec<_> = corners.chain([body.at]).collect();
        let legs: Vec<_> = from.zip(to).collect();
        legs.into_iter().map(move |(a, b)| {
            let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
            Solid {
                at: [(a[0] + b[0]) * 0.5, (a[1] + b[1]) * 0.5],
                half: [dx.hypot(dy) * 0.5, 0.0],
                theta: dy.atan2(dx),
                radius: body.radius + body.half[0].hypot(body.half[1]),
            }
        })
    });
    let all = still.chain(objects).chain(movers);
    Room {
        sides: [arena.width, arena.height].map(f64::from),
        solids: all.collect(),
    }
}

fn solid(obstacle: &Obstacle) -> Solid {
    match *obstacle {
        Obstacle::Circle { x, y, r } => Solid {
            at: [x, y].map(f64::from),
            radius: r.into(),
            ..Solid::default()
        },
        Obstacle::Box { x, y, w, h, theta } => Solid {
            at: [x, y].map(f64::from),
            half: [f64::from(w) * 0.5, f64::from(h) * 0.5],
            theta: theta.into(),
            radius: 0.0,
        },
    }
}
