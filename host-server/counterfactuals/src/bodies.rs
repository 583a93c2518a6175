//! The bodies of robots in a draw.

use crawler_sim::scenario::KnownBody;
use crawler_sim::world::Chassis;
use crawler_twin::body::Parameters;
use crawler_twin::certificate::Certificate;
use crawler_twin::identify::COUNT;
use rand_core::Rng as _;
use rand_pcg::Pcg32;

/// How well a robot knows the charge of its pack, as a share of all: by a gauge, and under whatever load there is.
const CHARGE_SIGMA: f64 = 0.1;

/// A body between the others: that of the certificate, or the nominal one.
pub(crate) fn middle(certificate: Option<&Certificate>, charge: f32) -> KnownBody {
    let parameters = certificate.map_or(&Parameters::NOMINAL, |known| &known.parameters);
    KnownBody {
        charge: Some(charge),
        ..known(parameters)
    }
}

/// A body that the certificate allows; without one all but the charge is left to the world to draw.
pub(crate) fn drawn(certificate: Option<&Certificate>, charge: f32, rng: &mut Pcg32) -> KnownBody {
    let normals: [f64; COUNT] = std::array::from_fn(|_| normal(rng));
    let charge = f64::from(charge) + CHARGE_SIGMA * normal(rng);
    let body = certificate.map(|certificate| known(&certificate.draw(&normals)));
    KnownBody {
        charge: Some(charge.clamp(0.0, 1.0) as f32),
        ..body.unwrap_or_default()
    }
}

/// The simulator's body that moves like this one. Masses, windings and forces enter a drive as two time constants: mass and
/// gyration of the robot make them, and rotors stay as they are.
fn known(twin: &Parameters) -> KnownBody {
    let nominal = &Parameters::NOMINAL;
    let chassis = Chassis::default();
    let share = |of: [f64; 2], to: [f64; 2], most: f64| {
        [0, 1].map(|k| (of[k] / to[k]).clamp(0.2, most) as f32)
    };
    let friction = [0, 1].map(|k| (twin.friction_v[k] / nominal.friction_v[k]).clamp(0.0, 2.0));
    let damping =
        f64::from(chassis.force_per_amp) / f64::from(chassis.winding_ohm * chassis.speed_per_volt);
    let rotor = f64::from(chassis.rotor_kg);
    let mass = (2.0 * (twin.lag_straight_s * damping - rotor)).clamp(0.05, 5.0);
    let turning = (2.0 * (twin.lag_turn_s * damping - rotor)).max(0.0);
    let gyration = (turning / mass).sqrt() * twin.track_m * 0.5;
    KnownBody {
        motors: Some(share(twin.speed_per_volt, nominal.speed_per_volt, 2.0)),
        friction: Some(friction.map(|share| share as f32)),
        track_m: Some(twin.track_m.clamp(0.02, 0.3) as f32),
        mass_kg: Some(mass as f32),
        gyration_m: Some(gyration.clamp(0.01, 0.1) as f32),
        internal_ohm: Some(twin.internal_ohm.clamp(0.0, 2.0) as f32),
        ..KnownBody::default()
    }
}

/// A draw from the standard normal distribution (Box and Muller, 1958).
fn normal(rng: &mut Pcg32) -> f64 {
    let mut unit = || (f64::from(rng.next_u32()) + 0.5) / 4_294_967_296.0;
    let (one, other) = (unit(), unit());
    (-2.0 * one.ln()).sqrt() * (std::f64::consts::TAU * other).cos()
}

#[cfg(test)]
mod tests {
    use crawler_sim::world::Parameters as World;

    use super::*;

    #[test]
    fn the_nominal_body_is_that_of_the_simulator() {
        let body = middle(None, 0.25);
        let world = World::default();
        let close = |a: f32, b: f32| assert!((a - b).abs() <= 0.01 * b, "{body:?}");
        for k in 0..2 {
            close(body.motors.expect("known")[k], 1.0);
            close(body.friction.expect("known")[k], 1.0);
        }
        close(body.track_m.expect("known"), world.chassis.track_m);
        close(body.mass_kg.expect("known"), world.chassis.mass_kg);
        close(body.gyration_m.expect("known"), world.chassis.gyration_m);
        close(body.internal_ohm.expect("known"), world.pack.internal_ohm);
        assert_eq!(body.charge, Some(0.25));
    }

    #[test]
    fn normals_have_the_moments_of_the_normal_distribution() {
        let mut rng = Pcg32::new(1, 2);
        let all: Vec<f64> = (0..20_000).map(|_| normal(&mut rng)).collect();
        let moment = |k: i32| all.iter().map(|value| value.powi(k)).sum::<f64>() / 20_000.0;
        assert!(moment(1).abs() < 0.03, "{}", moment(1));
        assert!((moment(2) - 1.0).abs() < 0.05, "{}", moment(2));
        assert!((moment(4) - 3.0).abs() < 0.3, "{}", moment(4));
    }
}
