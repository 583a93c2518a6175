//! How fast the bodies alone move: robots × physics steps per second, one thread, no programs.
//!
//! ```text
//! cargo run --release -p crawler-sim --example physics
//! ```

use std::time::Instant;

use crawler_sim::devices::BodyParts;
use crawler_sim::sched::SimClock;
use crawler_sim::world::{Arena, Obstacle, Pose, RobotIndex, World};
use embedded_hal::digital::OutputPin;
use embedded_hal::pwm::SetDutyCycle;
use rand_core::Rng;
use rand_pcg::Pcg32;

/// Square metres for each robot.
const AREA_M2: f32 = 2.0;

fn main() {
    println!("robots   Mrobot-steps/s   µs/step   ranges/s   contacts   bytes/robot");
    for robots in [50_usize, 100, 1_000, 10_000] {
        run(robots);
    }
}

fn run(robots: usize) {
    let side = (robots as f32 * AREA_M2).sqrt();
    let mut rng = Pcg32::new(1, 1);
    let mut random = move || (rng.next_u32() >> 8) as f32 / 16_777_216.0;
    let obstacles = (0..robots / 4)
        .map(|k| {
            let (x, y) = ((random() - 0.5) * side, (random() - 0.5) * side);
            if k % 2 == 0 {
                Obstacle::Circle { x, y, r: 0.15 }
            } else {
                Obstacle::Box {
                    x,
                    y,
                    w: 0.5,
                    h: 0.2,
                    theta: random() * 3.0,
                }
            }
        })
        .collect();
    let arena = Arena {
        width: side,
        height: side,
        obstacles,
    };
    let before = resident_bytes();
    let clock = SimClock::new();
    let mut world = World::new(arena, 1, &clock).expect("a sound arena");
    let mut parts: Vec<BodyParts> = Vec::new();
    while parts.len() < robots {
        let pose = Pose::new(
            (random() - 0.5) * side,
            (random() - 0.5) * side,
            random() * 6.0,
        );
        if let Ok((_, mut part)) = world.add_robot(pose) {
            for port in [&mut part.left, &mut part.right] {
                port.in1.set_high().expect("infallible");
            }
            parts.push(part);
        }
    }
    let bytes = resident_bytes().saturating_sub(before) / robots;

    let steps = (4_000_000 / robots).clamp(100, 20_000);
    let mut spent = 0.0;
    for step in 0..steps {
        // New duties now and then, so that they keep meeting each other.
        if step % 50 == 0 {
            for part in &mut parts {
                for port in [&mut part.left, &mut part.right] {
                    let duty = 100 + (random() * 155.0) as u16;
                    port.enable.set_duty_cycle(duty).expect("a duty");
                }
            }
        }
        let start = Instant::now();
        world.step();
        spent += start.elapsed().as_secs_f64();
    }
    let rate = (robots * steps) as f64 / spent;

    let asks = 100_000_u32;
    let start = Instant::now();
    let mut heard = 0_u32;
    for k in 0..asks {
        let robot = RobotIndex::new(k % robots as u32);
        heard += u32::from(world.true_range(robot).is_some());
    }
    let ranges = f64::from(asks) / start.elapsed().as_secs_f64();
    assert!(heard > 0, "walls echo");

    let contacts: u64 = (0..robots)
        .filter_map(|k| world.observe(RobotIndex::new(k as u32)))
        .map(|seen| u64::from(seen.contacts))
        .sum();
    println!(
        "{robots:>6} {:>16.2} {:>9.0} {ranges:>10.0} {contacts:>10} {bytes:>13}",
        rate * 1e-6,
        spent * 1e6 / steps as f64,
    );
}

/// Resident memory of this process, or 0 where the system does not tell.
fn resident_bytes() -> usize {
    std::fs::read_to_string("/proc/self/statm")
        .ok()
        .and_then(|text| text.split(' ').nth(1)?.parse::<usize>().ok())
        .map_or(0, |pages| pages * 4_096)
}
