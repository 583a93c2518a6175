//! What a robot's camera sees, as a PPM file that picture viewers open.
//!
//! ```text
//! cargo run --release -p crawler-sim --example picture -- /tmp/picture.ppm
//! ```

use std::time::Instant;

use crawler_sim::devices::World;
use crawler_sim::render::{Frame, Seen};
use crawler_sim::sched::SimClock;
use crawler_sim::world::{Arena, Colour, Object, ObjectShape, Obstacle, Pose};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let object = |shape, x, y, colour| Object {
        shape,
        x,
        y,
        size: 0.12,
        colour,
    };
    let mut arena = Arena::empty(4.0, 4.0);
    arena.obstacles = vec![
        Obstacle::Circle {
            x: 0.6,
            y: 0.5,
            r: 0.12,
        },
        Obstacle::Box {
            x: 1.2,
            y: -0.5,
            w: 0.3,
            h: 0.2,
            theta: 0.5,
        },
    ];
    arena.objects = vec![
        object(ObjectShape::Ball, -0.3, 0.1, Colour::Red),
        object(ObjectShape::Box, 0.1, -0.3, Colour::Green),
        object(ObjectShape::Cone, -0.4, -0.25, Colour::Orange),
        object(ObjectShape::Cylinder, 0.2, 0.25, Colour::Blue),
    ];
    let mut world = World::new(arena, 1, &SimClock::new())?;
    let (robot, _parts) = world.add_robot(Pose::new(-1.0, 0.0, 0.0))?;
    let (_, _others) = world.add_robot(Pose::new(0.3, -0.02, 2.4))?;

    let mut frame = Frame::square();
    world.render(robot, &mut frame);
    for spot in frame.spots() {
        println!(
            "{:?} at ({:.1}, {:.1}), {} pixels",
            spot.of, spot.x, spot.y, spot.pixels
        );
    }
    let floor = (0..96).filter(|&row| frame.seen(48, row) == Some(Seen::Floor));
    println!("{} rows of floor in the middle", floor.count());
    let count = 2_000_u32;
    let start = Instant::now();
    for _ in 0..count {
        world.render(robot, &mut frame);
    }
    let each = start.elapsed().as_secs_f64() / f64::from(count);
    println!("{:.0} µs for each picture", each * 1e6);
    if let Some(path) = std::env::args().nth(1) {
        let mut file = format!("P6\n{} {}\n255\n", frame.width(), frame.height()).into_bytes();
        file.extend_from_slice(frame.rgb());
        std::fs::write(path, file)?;
    }
    Ok(())
}
