//! The gap between bodies and robots, in virtual time.

use crawler_twin::body::{Parameters, Pose, STEP_S, Wheels, wrap};
use crawler_twin::certificate::{About, certify};
use crawler_twin::evidence::{Duty, Fix, Row, Supply};
use crawler_twin::gap::{Measures, Samples};
use crawler_twin::predict::quantile;
use crawler_twin::shadow::Shadow;

use crate::reference::{CALIBRATING, Hidden, Random, Rates, anyhow, calibration, drive};

const RATES: Rates = Rates {
    telemetry: 5,
    fixes: 2,
};
/// Longer than what is kept.
const SECONDS: f64 = 330.0;

fn follow(shadow: &mut Shadow, rows: impl IntoIterator<Item = Row>) -> Measures {
    for row in rows {
        let _ = shadow.take(row);
    }
    shadow.gap().measure()
}

/// What a robot says and a tracker sees that is just what a twin with these parameters believes it to be; and that `wanders`,
/// where it does, by what the twin allows for.
fn perfect(parameters: &Parameters, wanders: bool, seed: u64) -> Vec<Row> {
    let mut random = Random::new(seed);
    let (mut wheels, mut pose, mut duty) = (Wheels::default(), Pose::default(), [0.0_f64; 2]);
    let mut rows = vec![Row::Supply(Supply {
        at_s: 0.0,
        arrived_s: None,
        // Without load, less what everything but the motors draws.
        volts: 7.473,
    })];
    let (mut goal, mut until) = ([0.0_f64; 2], 0);
    for tick in 0..(SECONDS / STEP_S) as u32 {
        let at_s = f64::from(tick) * STEP_S;
        if tick >= until {
            let [middle, turn] = [
                0.4 + 0.3 * random.share(),
                0.2 * (2.0 * random.share() - 1.0),
            ];
            goal = [middle - turn, middle + turn];
            until = tick + 100 + (200.0 * random.share()) as u32;
        }
        // Duties change where a sample tells of it, by the rate that robots have.
        if tick % 5 == 0 {
            rows.push(Row::Duty(Duty {
                at_s,
                arrived_s: None,
                duty,
            }));
        }
        for (duty, goal) in duty.iter_mut().zip(goal) {
            *duty += (goal - *duty).clamp(-0.025, 0.025);
        }
        let before = wheels;
        wheels.step(parameters, duty, 7.5);
        let motion = wheels.motion(before, parameters.track_m);
        pose = pose.then(motion);
        if wanders {
            let root = motion.x.abs().sqrt();
            pose.theta += 0.015 * root * random.normal();
            pose.x += 0.004 * root * random.normal();
            pose.y += 0.004 * root * random.normal();
        }
        if tick % 50 == 7 {
            rows.push(Row::Fix(Fix {
                at_s: at_s + STEP_S,
                arrived_s: None,
                x: pose.x + 0.01 * random.normal(),
                y: pose.y + 0.01 * random.normal(),
                theta: wrap(pose.theta + 0.02 * random.normal()),
                sigma_m: 0.01,
            }));
        }
    }
    rows
}

#[test]
fn of_a_true_body_the_gap_is_the_noise_and_regions_hold_what_they_should() {
    let body = Parameters {
        speed_per_volt: [0.15, 0.14],
        track_m: 0.146,
        ..Parameters::NOMINAL
    };
    for seed in 0..3 {
        let told = follow(&mut Shadow::new(body, 0.0), perfect(&body, false, seed));
        assert!(told.is_whole(), "{told:?}");
        for errors in told.errors {
            assert!(errors.count > 200, "{errors:?}");
            let errors = errors.value.expect("enough");
            let [own, floor, nominal] =
                [errors.own, errors.floor, errors.nominal].map(|one| one.median_m);
            assert!(own < 1.5 * floor && floor < 1.5 * own, "{errors:?}");
            assert!(
                nominal > 3.0 * own && errors.ratio() < Some(0.35),
                "{errors:?}"
            );
        }
        let distances = told.displacements.value.expect("enough");
        assert!(
            distances.own_m < 3.0 * distances.floor_m + 2e-4
                && distances.nominal_m > 10.0 * distances.own_m,
            "{distances:?}"
        );
        // One that wanders is further off, and as far as the twin says.
        let told = follow(&mut Shadow::new(body, 0.0), perfect(&body, true, seed));
        let regions = told
            .errors
            .map(|errors| errors.value.expect("enough").coverage);
        let innovations = told.innovations.value.expect("enough");
        for coverage in regions.into_iter().chain([innovations]) {
            assert!((0.35..0.7).contains(&coverage.within_50), "{told:?}");
            assert!((0.89..=1.0).contains(&coverage.within_95), "{told:?}");
        }
    }
}

#[test]
fn a_certificate_closes_the_gap_of_a_hidden_robot() {
    let (mut with, mut without, mut pool) = (Vec::new(), Vec::new(), Vec::<Samples>::new());
    for seed in 0..5 {
        let hidden = Hidden::draw(6_000 + seed, 0.0);
        let evidence = calibration(&hidden, CALIBRATING).evidence();
        let made = certify(&evidence, About::default(), None).expect("a certificate");
        let rows = drive(&hidden, &anyhow(SECONDS, &mut Random::new(seed)), RATES).rows();
        let mut nominal = Shadow::uncalibrated();
        let mut own = Shadow::new(made.parameters, made.wander);
        let before = follow(&mut nominal, rows.clone());
        let after = follow(&mut own, rows);
        let ten = |told: &Measures| told.errors[1].value.expect("enough");
        let after_ten = ten(&after);
        assert!(after_ten.ratio() < Some(0.6), "{after_ten:?}");
        assert!(
            after_ten.floor.median_m < 1.5 * after_ten.own.median_m,
            "{after_ten:?}"
        );
        assert!(after_ten.coverage.within_95 > 0.7, "{after_ten:?}");
        let distance = |told: &Measures| told.displacements.value.expect("enough").own_m;
        with.push((after_ten.own.median_m, distance(&after)));
        without.push((ten(&before).own.median_m, distance(&before)));
        pool.push(own.gap().clone());
    }
    let median = |of: &[(f64, f64)], which: fn(&(f64, f64)) -> f64| {
        quantile(&mut of.iter().map(which).collect::<Vec<_>>(), 0.5)
    };
    assert!(
        2.0 * median(&with, |one| one.0) < median(&without, |one| one.0),
        "{with:?} {without:?}"
    );
    assert!(
        2.0 * median(&with, |one| one.1) < median(&without, |one| one.1),
        "{with:?} {without:?}"
    );
    let all = Samples::pool(&pool).measure();
    let ten = all.errors[1].value.expect("enough");
    let [least, most] = [f64::min, f64::max]
        .map(|of: fn(f64, f64) -> f64| with.iter().map(|one| one.0).reduce(of).expect("some"));
    assert!(
        (least..=most).contains(&ten.own.median_m),
        "{ten:?} {with:?}"
    );
}

#[test]
fn who_stands_or_has_a_fault_tells_nothing_of_a_gap() {
    let told = |tick: u32| {
        let at_s = f64::from(tick) * 0.2;
        let duty = Row::Duty(Duty {
            at_s,
            arrived_s: None,
            duty: [0.0; 2],
        });
        let fix = Row::Fix(Fix {
            at_s: at_s + 0.01,
            arrived_s: None,
            x: 1.0,
            y: 2.0,
            theta: 0.5,
            sigma_m: 0.01,
        });
        [duty, fix]
    };
    let standing = follow(&mut Shadow::uncalibrated(), (0..600).flat_map(told));
    assert_eq!(standing.errors.map(|errors| errors.count), [0, 0]);
    assert_eq!(standing.displacements.count, 0);
    assert!(!standing.is_whole() && standing.innovations.value.is_some());

    // From a minute on one motor makes half of its voltage: the body is as it was.
    let hidden = Hidden {
        weak: Some((0, 60.0, 0.5)),
        ..Hidden::draw(6_100, 0.0)
    };
    let evidence = calibration(&hidden, CALIBRATING).evidence();
    let made = certify(&evidence, About::default(), None).expect("a certificate");
    let mut shadow = Shadow::new(made.parameters, made.wander);
    let story = drive(&hidden, &anyhow(120.0, &mut Random::new(9)), RATES);
    let whole = follow(&mut shadow, story.rows());
    assert!(!shadow.faults().is_empty());
    // Those of the second minute are all but not there.
    assert!(whole.errors[1].count < 56, "{whole:?}");
    assert!(whole.errors[1].count > 30, "{whole:?}");
}
