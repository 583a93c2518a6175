//! What the step of 10 ms costs: the same manoeuvres with steps of 5, 2.5 and 1.25 ms.

use std::fmt::Write as _;

use super::*;
use crate::world::bodies::Bridge;

/// A space whose steps have another length.
pub(super) struct Fine {
    pub(super) space: Space,
    pub(super) dt: f32,
}

impl Fine {
    pub(super) fn new(arena: Arena, parameters: Parameters, dt: f32) -> Self {
        let space = Space::with_step(arena, parameters, dt).expect("a sound arena");
        Self { space, dt }
    }

    pub(super) fn add(&mut self, x: f32, y: f32, theta: f32) {
        self.space
            .place(Pose::new(x, y, theta), 1, &Body::default())
            .expect("a free place");
    }

    pub(super) fn drive(&mut self, robot: usize, left: i16, right: i16) {
        let bridge = |duty: i16| Bridge {
            duty: duty.unsigned_abs() as u8,
            in1: duty > 0,
            in2: duty < 0,
        };
        let inputs = &mut self.space.bodies.inputs[robot];
        inputs.left = bridge(left);
        inputs.right = bridge(right);
    }

    pub(super) fn brake(&mut self, robot: usize) {
        let braking = Bridge {
            duty: 255,
            in1: false,
            in2: false,
        };
        let inputs = &mut self.space.bodies.inputs[robot];
        (inputs.left, inputs.right) = (braking, braking);
    }

    pub(super) fn run(&mut self, seconds: f32) {
        let steps = libm::roundf(seconds / self.dt) as u32;
        for _ in 0..steps {
            self.space.step(Members::ALL, |_, _| {});
        }
    }
}

/// Where each robot is at the end.
type Manoeuvre = fn(&mut Fine);

fn straight(fine: &mut Fine) {
    fine.add(-4.0, 0.0, 0.0);
    fine.drive(0, 200, 200);
    fine.run(2.0);
}

fn spin(fine: &mut Fine) {
    fine.add(0.0, 0.0, 0.0);
    fine.drive(0, -150, 150);
    fine.run(1.0);
}

fn arc(fine: &mut Fine) {
    fine.add(0.0, 0.0, 0.0);
    fine.drive(0, 140, 180);
    fine.run(3.0);
}

fn brake(fine: &mut Fine) {
    fine.add(-3.0, 0.0, 0.0);
    fine.drive(0, 200, 200);
    fine.run(1.0);
    fine.brake(0);
    fine.run(1.0);
}

fn push(fine: &mut Fine) {
    fine.add(0.0, 0.0, 0.0);
    fine.add(0.4, 0.02, 0.0);
    fine.drive(0, 180, 180);
    fine.run(2.0);
}

fn slip(fine: &mut Fine) {
    fine.add(-4.0, 0.0, 0.0);
    fine.drive(0, 255, 255);
    fine.run(1.0);
    fine.drive(0, -255, 255);
    fine.run(0.5);
}

/// Largest distance in metres, and angle in radians, between the ends of a manoeuvre with steps
/// of `dt` and with steps of 1.25 ms.
fn error(manoeuvre: Manoeuvre, grip: f32, dt: f32) -> (f32, f32) {
    let run = |dt: f32| {
        let mut parameters = alike();
        parameters.chassis.grip = grip;
        let mut fine = Fine::new(Arena::empty(10.0, 10.0), parameters, dt);
        manoeuvre(&mut fine);
        let robots = fine.space.bodies.len();
        (0..robots)
            .map(|i| fine.space.bodies.pose(i))
            .collect::<Vec<Pose>>()
    };
    let (coarse, fine) = (run(dt), run(0.001_25));
    coarse
        .iter()
        .zip(&fine)
        .fold((0.0, 0.0), |worst: (f32, f32), (a, b)| {
            let way = a.position().minus(b.position()).length();
            let turn = crate::world::geometry::wrap_any(a.theta - b.theta).abs();
            (worst.0.max(way), worst.1.max(turn))
        })
}

/// Name, manoeuvre, grip, and what 10 ms may be off by: metres and radians.
const MANOEUVRES: [(&str, Manoeuvre, f32, f32, f32); 6] = [
    ("straight", straight, 0.9, 0.000_5, 1e-4),
    ("spin", spin, 0.9, 0.000_1, 0.001),
    ("arc", arc, 0.9, 0.000_5, 0.000_5),
    ("brake", brake, 0.9, 0.000_5, 1e-4),
    // What a robot cannot give to another one in a step it gives in the next: first order.
    ("push", push, 0.9, 0.07, 0.001),
    ("slip", slip, 0.15, 0.001, 0.003),
];

#[test]
fn ten_milliseconds_are_short_enough() {
    let mut table = String::new();
    let mut wrong = Vec::new();
    for (name, manoeuvre, grip, way_bound, turn_bound) in MANOEUVRES {
        let [ten, five, two] = [0.01, 0.005, 0.002_5].map(|dt| error(manoeuvre, grip, dt));
        writeln!(
            table,
            "{name}: {:.2} {:.2} {:.2} mm, {:.2} {:.2} {:.2} mrad",
            ten.0 * 1e3,
            five.0 * 1e3,
            two.0 * 1e3,
            ten.1 * 1e3,
            five.1 * 1e3,
            two.1 * 1e3
        )
        .expect("a string takes all");
        if ten.0 > way_bound || ten.1 > turn_bound {
            wrong.push(name);
        }
        // Finer steps come nearer, but for rounding and for the moment of a stop.
        if two.0 > ten.0 + 5e-4 || two.1 > ten.1 + 2e-3 {
            wrong.push(name);
        }
    }
    println!("{table}");
    assert!(wrong.is_empty(), "{wrong:?}\n{table}");
}
