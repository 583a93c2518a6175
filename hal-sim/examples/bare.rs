//! How fast worlds without programs run: the shipped controller, and a function that steers.
//!
//! ```text
//! cargo run --release -p crawler-sim --example bare
//! ```

use std::time::Instant;

use crawler_app::motion::Twist;
use crawler_app::order::Task;
use crawler_hal::Duration;
use crawler_sim::run::bare::{BareWorld, Drive, Steering};
use crawler_sim::scenario::Scenario;
use crawler_sim::world::RobotIndex;

/// Virtual time of each measurement.
const SPAN: Duration = Duration::from_secs(20);

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("worlds robots  steering  control steps/CPU s");
    for (worlds, robots) in [(1, 1), (1, 100), (1, 1_000), (1_000, 3)] {
        for steering in [Steering::Shipped, Steering::Caller] {
            measure(worlds, robots, steering)?;
        }
    }
    Ok(())
}

fn measure(worlds: u64, robots: u32, steering: Steering) -> Result<(), Box<dyn std::error::Error>> {
    let mut scenario = Scenario::built_in("arena")?.with_robots(robots);
    scenario.command = None;
    let mut all: Vec<BareWorld> = (0..worlds)
        .map(|seed| BareWorld::of_scenario(&scenario, seed, steering))
        .collect::<Result<_, _>>()?;
    for world in &mut all {
        world.step(Duration::from_secs(1));
        for robot in 0..robots {
            world.order(RobotIndex::new(robot), Task::Wander { speed: 80 });
        }
    }
    let start = Instant::now();
    for world in &mut all {
        world.step_with(SPAN, |_, senses| {
            let near = senses
                .reading
                .range_mm(senses.now)
                .is_some_and(|mm| mm < 400);
            let twist = if near {
                Twist { v: 0.0, w: 2.0 }
            } else {
                Twist { v: 0.3, w: 0.0 }
            };
            Some(Drive::Twist(twist))
        });
    }
    let steps = worlds * u64::from(robots) * (SPAN.as_millis() / 20);
    let rate = steps as f64 / start.elapsed().as_secs_f64();
    println!(
        "{worlds:>6} {robots:>6}  {steering:>8?}  {:>10.2} M",
        rate * 1e-6
    );
    Ok(())
}
