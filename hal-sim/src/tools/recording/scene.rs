//! Worlds as viewers draw them: `foxglove.SceneUpdate`.

use serde_json::{Value, json};

use super::file::EPOCH_NS;
use crate::run::Simulation;
use crate::world::{Arena, Obstacle};

const FRAME: &str = "world";
/// Height of walls and obstacles, metres.
const HEIGHT: f32 = 0.25;
/// Height of a robot, and thickness of walls.
const FLAT: f32 = 0.1;

fn time(at_us: u64) -> Value {
    let ns = EPOCH_NS.saturating_add(at_us.saturating_mul(1_000));
    json!({ "sec": ns / 1_000_000_000, "nsec": ns % 1_000_000_000 })
}

fn pose(x: f32, y: f32, z: f32, theta: f32) -> Value {
    let half = theta * 0.5;
    json!({
        "position": { "x": x, "y": y, "z": z },
        "orientation": { "x": 0.0, "y": 0.0, "z": libm::sinf(half), "w": libm::cosf(half) },
    })
}

fn colour(r: f32, g: f32, b: f32, a: f32) -> Value {
    json!({ "r": r, "g": g, "b": b, "a": a })
}

fn entity(at_us: u64, id: &str, shapes: [Vec<Value>; 3]) -> Value {
    let [cubes, cylinders, arrows] = shapes;
    json!({
        "timestamp": time(at_us),
        "frame_id": FRAME,
        "id": id,
        "lifetime": { "sec": 0, "nsec": 0 },
        "frame_locked": false,
        "metadata": [],
        "arrows": arrows,
        "cubes": cubes,
        "spheres": [],
        "cylinders": cylinders,
        "lines": [],
        "triangles": [],
        "texts": [],
        "models": [],
    })
}

/// Floor, walls and obstacles.
pub(super) fn arena(arena: &Arena, at_us: u64) -> Value {
    let (width, height) = (arena.width, arena.height);
    let cube = |x: f32, y: f32, theta: f32, size: [f32; 3], paint: Value| {
        json!({
            "pose": pose(x, y, size[2] * 0.5, theta),
            "size": { "x": size[0], "y": size[1], "z": size[2] },
            "color": paint,
        })
    };
    let wall = || colour(0.5, 0.5, 0.55, 0.6);
    let stone = || colour(0.55, 0.4, 0.3, 1.0);
    let mut cubes = vec![cube(
        0.0,
        0.0,
        0.0,
        [width, height, 0.001],
        colour(0.9, 0.9, 0.85, 1.0),
    )];
    for side in [-1.0_f32, 1.0] {
        let (x, y) = (side * (width + FLAT) * 0.5, side * (height + FLAT) * 0.5);
        cubes.push(cube(x, 0.0, 0.0, [FLAT, height, HEIGHT], wall()));
        cubes.push(cube(0.0, y, 0.0, [width, FLAT, HEIGHT], wall()));
    }
    let mut cylinders = Vec::new();
    for obstacle in &arena.obstacles {
        match *obstacle {
            Obstacle::Box { x, y, w, h, theta } => {
                cubes.push(cube(x, y, theta, [w, h, HEIGHT], stone()));
            }
            Obstacle::Circle { x, y, r } => cylinders.push(json!({
                "pose": pose(x, y, HEIGHT * 0.5, 0.0),
                "size": { "x": 2.0 * r, "y": 2.0 * r, "z": HEIGHT },
                "bottom_scale": 1.0,
                "top_scale": 1.0,
                "color": stone(),
            })),
        }
    }
    let all = entity(at_us, "arena", [cubes, cylinders, Vec::new()]);
    json!({ "deletions": [], "entities": [all] })
}

/// Every robot that is there, with an arrow where it looks.
pub(super) fn robots(simulation: &Simulation, at_us: u64) -> Value {
    let radius = simulation.scenario().parameters.chassis.radius_m;
    let entities: Vec<Value> = (0..simulation.robots())
        .filter_map(|robot| {
            let seen = simulation.observe(robot).filter(|seen| seen.present)?;
            let at = seen.pose;
            let paint = if seen.powered {
                colour(0.1, 0.5, 0.9, 1.0)
            } else {
                colour(0.3, 0.3, 0.3, 1.0)
            };
            let hull = json!({
                "pose": pose(at.x, at.y, FLAT * 0.5, at.theta),
                "size": { "x": 2.0 * radius, "y": 2.0 * radius, "z": FLAT },
                "bottom_scale": 1.0,
                "top_scale": 1.0,
                "color": paint,
            });
            let nose = json!({
                "pose": pose(at.x, at.y, FLAT, at.theta),
                "shaft_length": radius,
                "shaft_diameter": 0.02,
                "head_length": 0.04,
                "head_diameter": 0.05,
                "color": colour(1.0, 0.6, 0.0, 1.0),
            });
            let id = simulation.id(robot)?.as_str();
            Some(entity(at_us, id, [Vec::new(), vec![hull], vec![nose]]))
        })
        .collect();
    // Robots that are gone are not drawn any more.
    json!({ "deletions": [{ "timestamp": time(at_us), "type": 1, "id": "" }], "entities": entities })
}
