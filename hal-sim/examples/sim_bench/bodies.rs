//! Bodies without programs: motion, collisions, and every robot's cone at the sensor's rate.

use std::error::Error;

use crawler_sim::devices::BodyParts;
use crawler_sim::devices::World;
use crawler_sim::scenario::Scenario;
use crawler_sim::sched::SimClock;
use crawler_sim::tools::bench::Meter;
use crawler_sim::world::{Pose, RobotIndex};
use embedded_hal::digital::OutputPin;
use embedded_hal::pwm::SetDutyCycle;
use rand_core::Rng;
use rand_pcg::Pcg32;

/// Physics steps between two measurements of a ranger: 80 ms.
const PING_STEPS: usize = 8;
/// Physics steps after which robots get other duties, so that they keep meeting each other.
const DUTY_STEPS: u32 = 50;
/// Steps before anything is measured.
const WARM_UP_STEPS: u32 = 200;

struct Crowd {
    world: World,
    parts: Vec<BodyParts>,
    rng: Pcg32,
    step: u32,
    echoes: u64,
}

impl Crowd {
    fn new(robots: usize) -> Result<Self, Box<dyn Error>> {
        let mut rng = Pcg32::new(1, 1);
        let mut random = move || (rng.next_u32() >> 8) as f32 / 16_777_216.0;
        let arena = Scenario::built_in("arena")?
            .with_robots(robots as u32)
            .arena(1)?;
        let (width, height) = (arena.width, arena.height);
        let mut world = World::new(arena, 1, &SimClock::new())?;
        let mut parts: Vec<BodyParts> = Vec::new();
        let mut refused = 0;
        while parts.len() < robots {
            let (x, y) = ((random() - 0.5) * width, (random() - 0.5) * height);
            match world.add_robot(Pose::new(x, y, random() * 6.0)) {
                Ok((_, mut part)) => {
                    part.left.in1.set_high()?;
                    part.right.in1.set_high()?;
                    parts.push(part);
                }
                Err(error) => {
                    refused += 1;
                    if refused > 1_000 * robots {
                        return Err(error.into());
                    }
                }
            }
        }
        Ok(Self {
            world,
            parts,
            rng: Pcg32::new(2, 2),
            step: 0,
            echoes: 0,
        })
    }

    /// New duties now and then. Not part of what is measured.
    fn drive(&mut self) {
        for part in &mut self.parts {
            for port in [&mut part.left, &mut part.right] {
                let duty = 100 + (self.rng.next_u32() >> 24) * 155 / 255;
                port.enable
                    .set_duty_cycle(duty as u16)
                    .expect("at most 255");
            }
        }
    }

    fn advance(&mut self, steps: u32) {
        for _ in 0..steps {
            self.world.step();
            let first = self.step as usize % PING_STEPS;
            for robot in (first..self.parts.len()).step_by(PING_STEPS) {
                let heard = self.world.true_range(RobotIndex::new(robot as u32));
                self.echoes += u64::from(heard.is_some());
            }
            self.step += 1;
        }
    }
}

/// Measures `steps` physics steps of `robots` bodies.
pub(crate) fn measure(robots: usize, steps: u32, host: &impl Meter) -> Result<(), Box<dyn Error>> {
    let before = host.memory();
    let begun = host.cpu_s();
    let mut crowd = Crowd::new(robots)?;
    let spawn_s = host.cpu_s() - begun;
    crowd.drive();
    crowd.advance(WARM_UP_STEPS);
    let mut cpu_s = 0.0;
    let mut left = steps;
    while left > 0 {
        crowd.drive();
        let some = left.min(DUTY_STEPS);
        let begun = host.cpu_s();
        host.measured(&mut || crowd.advance(some));
        cpu_s += host.cpu_s() - begun;
        left -= some;
    }
    if crowd.echoes == 0 {
        return Err("walls send no echo".into());
    }
    let contacts: u64 = (0..robots)
        .filter_map(|k| crowd.world.observe(RobotIndex::new(k as u32)))
        .map(|seen| u64::from(seen.contacts))
        .sum();
    let all = robots as f64 * f64::from(steps);
    println!("robots {robots}");
    println!("steps {all:.0}");
    println!("cpu_s {cpu_s:.4}");
    println!("steps_per_cpu_s {:.0}", all / cpu_s);
    println!("times_real_time {:.2}", f64::from(steps) * 0.01 / cpu_s);
    println!("spawn_s {spawn_s:.4}");
    if let (Some(before), Some(after)) = (before, host.memory()) {
        let bytes = after.saturating_sub(before) / robots.max(1) as u64;
        println!("bytes_per_robot {bytes}");
    }
    println!("contacts {contacts}");
    println!("echoes {}", crowd.echoes);
    Ok(())
}
