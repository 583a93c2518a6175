//! The bodies of robots in a draw.

use crawler_sim::scenario::KnownBody;
use crawler_sim::world::{Chassis, charge_at_rest};
use crawler_twin::belief::Belief;
use crawler_twin::body::Parameters;
use crawler_twin::drive::Drive;
use crawler_twin::identify::COUNT;
use rand_core::Rng as _;
use rand_pcg::Pcg32;

use crate::past::PastRobot;

/// How well the gauge that a body was identified by tells the voltage again, volts.
const SAME_GAUGE_V: f64 = 0.02;
/// How well any gauge tells it: 1 per cent of resistors, and the converter's offset, volts.
const ANY_GAUGE_V: f64 = 0.06;
/// How well a robot knows the charge of its pack, as a share of all, where no voltage is recorded.
const CHARGE_SIGMA: f64 = 0.1;

/// Where it is known from what body a robot has.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Known {
    /// A calibration, by the id of its certificate.
    Certificate(String),
    /// What it did before the moment.
    Record,
    /// Its make alone: it hardly moved before the moment.
    Make,
}

/// The body that a robot has, and how well that is known.
#[derive(Debug, Clone)]
pub(crate) struct Body {
    pub(crate) known: Known,
    belief: Belief,
    pack: Pack,
}

/// What is known of a pack at the moment.
#[derive(Debug, Clone, Copy)]
enum Pack {
    /// Its voltage without load, and one standard deviation of it, volts. A gauge is wrong by some per cent for years, and bodies
    /// are identified by what it shows: so that is what they have to have, and not what a robot makes of it in per cent.
    Rest { volts: f64, sigma_v: f64 },
    /// Its charge by what the robot says, 0 to 1.
    Charge(f64),
}

impl Pack {
    /// Its charge, 0 to 1, so many standard deviations from what is likeliest.
    fn charge(self, deviations: f64) -> f32 {
        match self {
            Self::Rest { volts, sigma_v } => charge_at_rest((volts + sigma_v * deviations) as f32),
            Self::Charge(charge) => (charge + CHARGE_SIGMA * deviations).clamp(0.0, 1.0) as f32,
        }
    }
}

impl Body {
    /// From its certificate, or what it did before the moment; else it is as its make has it. Takes a tenth of a second.
    pub(crate) fn of(past: &PastRobot) -> Self {
        let drive = Drive::new(&past.before);
        let recorded = || Belief::of_drive(drive.as_ref()?).ok();
        let (known, belief) = match past.certificate.as_deref() {
            Some(certificate) => {
                let id = certificate.id().to_owned();
                (Known::Certificate(id), Belief::from(certificate))
            }
            None => match recorded() {
                Some(belief) => (Known::Record, belief),
                None => (Known::Make, Belief::prior()),
            },
        };
        let sigma_v = match known {
            Known::Make => ANY_GAUGE_V,
            Known::Certificate(_) | Known::Record => SAME_GAUGE_V,
        };
        let open = drive.and_then(|drive| drive.open_voltage(&belief.parameters));
        let pack = match open {
            Some(open) => Pack::Rest {
                volts: open.at(0.0),
                sigma_v,
            },
            None => Pack::Charge(f64::from(past.charge)),
        };
        Self {
            known,
            belief,
            pack,
        }
    }

    /// The likeliest one.
    pub(crate) fn middle(&self) -> KnownBody {
        self.simulated(&self.belief.parameters, 0.0)
    }

    /// One that is possible as well.
    pub(crate) fn draw(&self, rng: &mut Pcg32) -> KnownBody {
        let normals: [f64; COUNT] = std::array::from_fn(|_| normal(rng));
        self.simulated(&self.belief.draw(&normals), normal(rng))
    }

    fn simulated(&self, parameters: &Parameters, deviations: f64) -> KnownBody {
        KnownBody {
            charge: Some(self.pack.charge(deviations)),
            ..simulated(parameters)
        }
    }
}

/// The simulator's body that moves like this one. Masses, windings and forces enter a drive as two time constants: mass and
/// gyration of the robot make them, and rotors stay as they are.
fn simulated(twin: &Parameters) -> KnownBody {
    let nominal = &Parameters::NOMINAL;
    let chassis = Chassis::default();
    let motors = [0, 1].map(|k| twin.speed_per_volt[k] / nominal.speed_per_volt[k]);
    // A simulated motor of half the speed has half the force, and its friction stays what it is: a twin's is told in volts.
    let friction = [0, 1].map(|k| motors[k] * twin.friction_v[k] / nominal.friction_v[k]);
    let damping =
        f64::from(chassis.force_per_amp) / f64::from(chassis.winding_ohm * chassis.speed_per_volt);
    let rotor = f64::from(chassis.rotor_kg);
    let mass = (2.0 * (twin.lag_straight_s * damping - rotor)).clamp(0.05, 5.0);
    let turning = (2.0 * (twin.lag_turn_s * damping - rotor)).max(0.0);
    let gyration = (turning / mass).sqrt() * twin.track_m * 0.5;
    KnownBody {
        motors: Some(motors.map(|share| share.clamp(0.2, 2.0) as f32)),
        friction: Some(friction.map(|share| share.clamp(0.0, 2.0) as f32)),
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
    use crawler_sim::run::Duration;
    use crawler_sim::run::bare::{BareWorld, Drive, Steering};
    use crawler_sim::scenario::{Scenario, SpawnPose};
    use crawler_sim::world::{Parameters as World, RobotIndex};
    use crawler_twin::body::Wheels;
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn the_nominal_body_is_that_of_the_simulator() {
        let body = simulated(&Parameters::NOMINAL);
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
    }

    /// Speeds ahead and of turning after two seconds at these duties.
    fn settled(body: KnownBody, duties: [f32; 2]) -> [f64; 2] {
        let mut scenario = Scenario::plain("open".to_owned());
        scenario.robots = 1;
        (scenario.arena.width, scenario.arena.height) = (Some(20.0), Some(20.0));
        scenario.arena.scatter.per_square_metre = 0.0;
        scenario.spawn.poses = vec![SpawnPose {
            x: 0.0,
            y: 0.0,
            theta: 0.0,
        }];
        scenario.bodies = vec![body];
        let mut world = BareWorld::of_scenario(&scenario, 1, Steering::Caller).expect("a world");
        world.step_with(Duration::from_millis(2_000), |_, _| {
            Some(Drive::Duties(duties))
        });
        let (_, speeds) = world.motion(RobotIndex::new(0)).expect("a robot");
        speeds.map(f64::from)
    }

    proptest! {
        #![proptest_config(crawler_properties::cases(24))]

        #[test]
        fn a_simulated_body_goes_as_the_one_that_is_believed(
            normals in prop::array::uniform11(-1.5_f64..1.5),
            duties in prop::array::uniform2(0.45_f32..1.0),
            volts in 6.8_f64..8.3,
        ) {
            let mut parameters = Belief::prior().draw(&normals);
            // What a simulated robot has of its world, and not of its own.
            (parameters.backward, parameters.breakaway) = (1.0, Parameters::NOMINAL.breakaway);
            parameters.coast = Parameters::NOMINAL.coast;
            let pack = Pack::Rest { volts, sigma_v: 0.0 };
            let body = KnownBody { charge: Some(pack.charge(0.0)), ..simulated(&parameters) };
            let [ahead, turning] = settled(body, duties);
            let mut wheels = Wheels::default();
            let duty = duties.map(f64::from);
            for _ in 0..200 {
                wheels.step(&parameters, duty, volts);
            }
            let [left, right] = wheels.rims;
            let (own, turn) = ((left + right) * 0.5, (right - left) / parameters.track_m);
            prop_assert!((ahead - own).abs() < 0.01 * own + 2e-3, "{ahead} for {own} m/s");
            prop_assert!((turning - turn).abs() < 0.03 * turn.abs() + 0.06, "{turning} for {turn} rad/s");
        }
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
