//! A certificate as parameters of a scenario.

use crawler_sim::world::Parameters as World;
use crawler_twin::body::Parameters;
use crawler_twin::certificate::Certificate;

/// The sections of a scenario that give all its robots this body: what both motors have in common as parameters, and what they
/// make of that left and right.
pub(super) fn scenario(certificate: &Certificate) -> String {
    let (robot, id) = (&certificate.about.robot, certificate.id());
    let sections = sections(&certificate.parameters);
    format!("# The body of {robot} by its certificate {id}.\n{sections}")
}

fn sections(own: &Parameters) -> String {
    let world = body(own);
    let (chassis, pack) = (&world.chassis, &world.pack);
    let shares = |pair: [f64; 2], of: f32| {
        let of = f64::from(of).max(1e-6);
        pair.map(|value| value / of)
    };
    let motors = shares(own.speed_per_volt, chassis.speed_per_volt);
    // Of a motor's force, not of its volts: a weaker motor has more of them.
    let friction = shares(own.friction_v, chassis.running_v);
    let friction = [0, 1].map(|k| (motors[k] * friction[k]).clamp(0.0, 2.0));
    let motors = motors.map(|share| share.clamp(0.2, 2.0));
    format!(
        "[parameters.chassis]\n\
         track_m = {:.5}\nspeed_per_volt = {:.5}\nrunning_v = {:.4}\nbreakaway_v = {:.4}\n\
         rotor_kg = {:.4}\ngyration_m = {:.4}\ndrag_share = {:.3}\n\n\
         [parameters.pack]\ninternal_ohm = {:.3}\n\n\
         [parameters.spread]\nmotor = 0.0\ntrack = 0.0\nfriction = 0.0\nmass = 0.0\ncells = 0.0\n\n\
         [[bodies]]\nmotors = [{:.5}, {:.5}]\nfriction = [{:.4}, {:.4}]\n",
        chassis.track_m,
        chassis.speed_per_volt,
        chassis.running_v,
        chassis.breakaway_v,
        chassis.rotor_kg,
        chassis.gyration_m,
        chassis.drag_share,
        pack.internal_ohm,
        motors[0],
        motors[1],
        friction[0],
        friction[1],
    )
}

/// The simulator's body that moves like this one. Masses, windings and forces enter a drive as two time
/// constants: the mass of the robot stays as it is, and rotors and gyration make up for it.
pub(super) fn body(twin: &Parameters) -> World {
    let mut world = World::default();
    let mean = |pair: [f64; 2]| (pair[0] + pair[1]) * 0.5;
    let chassis = &mut world.chassis;
    let speed = mean(twin.speed_per_volt);
    let mass = f64::from(chassis.mass_kg);
    let damping = f64::from(chassis.force_per_amp) / (f64::from(chassis.winding_ohm) * speed);
    let rotor = (twin.lag_straight_s * damping - mass * 0.5).clamp(0.01, 5.0);
    let turning = (2.0 * (twin.lag_turn_s * damping - rotor)).max(0.0);
    let gyration = ((turning / mass).sqrt() * twin.track_m * 0.5).clamp(0.01, 0.1);
    let running = mean(twin.friction_v).clamp(0.0, 3.0);
    chassis.track_m = twin.track_m.clamp(0.02, 0.3) as f32;
    chassis.speed_per_volt = speed.clamp(0.01, 0.25) as f32;
    chassis.running_v = running as f32;
    chassis.breakaway_v = (running * twin.breakaway).clamp(running, 4.0) as f32;
    chassis.rotor_kg = rotor as f32;
    chassis.gyration_m = gyration as f32;
    chassis.drag_share = twin.coast.clamp(0.0, 0.8) as f32;
    world.pack.internal_ohm = twin.internal_ohm.clamp(0.0, 2.0) as f32;
    world
}

#[cfg(test)]
mod tests {
    use crawler_sim::run::Duration;
    use crawler_sim::run::bare::{BareWorld, Drive, Steering};
    use crawler_sim::scenario::{Scenario, SpawnPose};
    use crawler_sim::world::{RobotIndex, charge_at_rest};
    use crawler_twin::body::Wheels;

    use super::*;

    #[test]
    fn robots_of_an_exported_body_go_as_its_twin() {
        let own = Parameters {
            speed_per_volt: [0.15, 0.13],
            friction_v: [1.1, 0.5],
            lag_turn_s: 0.11,
            track_m: 0.13,
            ..Parameters::NOMINAL
        };
        let (volts, duty) = (7.6, [0.6, 0.7]);
        let mut scenario = Scenario::parse(&format!(
            "name = \"exported\"\nrobots = 1\narena = {{ width = 20.0, height = 20.0, scatter = {{ per_square_metre = 0.0 }} }}\n{}",
            sections(&own)
        ))
        .expect("a scenario");
        scenario.spawn.poses = vec![SpawnPose {
            x: 0.0,
            y: 0.0,
            theta: 0.0,
        }];
        scenario.bodies[0].charge = Some(charge_at_rest(volts));
        let mut world = BareWorld::of_scenario(&scenario, 1, Steering::Caller).expect("a world");
        let drive = Drive::Duties(duty.map(|duty| duty as f32));
        world.step_with(Duration::from_millis(2_000), |_, _| Some(drive));
        let (_, [ahead, turning]) = world.motion(RobotIndex::new(0)).expect("a robot");
        let mut wheels = Wheels::default();
        for _ in 0..200 {
            wheels.step(&own, duty, f64::from(volts));
        }
        let [left, right] = wheels.rims;
        let (way, turn) = ((left + right) * 0.5, (right - left) / own.track_m);
        assert!(
            (f64::from(ahead) - way).abs() < 0.01 * way,
            "{ahead} for {way}"
        );
        assert!(
            (f64::from(turning) - turn).abs() < 0.03 * turn.abs() + 0.03,
            "{turning} for {turn}"
        );
    }

    #[test]
    fn the_nominal_body_is_that_of_the_simulator_both_ways() {
        let (own, world) = (Parameters::NOMINAL, World::default());
        let exported = body(&own);
        let close = |name: &str, a: f32, b: f32| {
            assert!((a - b).abs() <= 0.01 * b.abs(), "{name}: {a} and {b}");
        };
        close("track", exported.chassis.track_m, world.chassis.track_m);
        close(
            "speed",
            exported.chassis.speed_per_volt,
            world.chassis.speed_per_volt,
        );
        close(
            "running",
            exported.chassis.running_v,
            world.chassis.running_v,
        );
        close(
            "breakaway",
            exported.chassis.breakaway_v,
            world.chassis.breakaway_v,
        );
        close("rotor", exported.chassis.rotor_kg, world.chassis.rotor_kg);
        close(
            "gyration",
            exported.chassis.gyration_m,
            world.chassis.gyration_m,
        );
        close(
            "drag",
            exported.chassis.drag_share,
            world.chassis.drag_share,
        );
        close("pack", exported.pack.internal_ohm, world.pack.internal_ohm);
        close(
            "lag",
            own.lag_straight_s as f32,
            world.chassis.time_constant(),
        );
        close(
            "bridge",
            own.bridge_drop_v as f32,
            world.chassis.bridge_drop_v,
        );
        close("winding", own.winding_ohm as f32, world.chassis.winding_ohm);
        close("quiescent", own.quiescent_a as f32, world.pack.quiescent_a);
    }
}
