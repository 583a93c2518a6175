//! Certificates: what they are worth, and when there is none.

use crawler_twin::belief::Belief;
use crawler_twin::body::Parameters;
use crawler_twin::certificate::{About, Certificate, Refused, certify};
use crawler_twin::drive::Drive;
use crawler_twin::evidence::{Evidence, Fix};
use crawler_twin::identify::{COUNT, NAMES, Unidentified};
use crawler_twin::predict::{errors, quantile, score};

use crate::reference::{Hidden, Random, Rates, Story, anyhow, calibration, drive};

const RATES: Rates = Rates {
    telemetry: 20,
    fixes: 10,
};

/// Errors ten seconds ahead on a drive that nothing was made of: by a body, and by the nominal one.
fn ten_seconds_on(hidden: &Hidden, own: &Parameters) -> (Vec<f64>, Vec<f64>) {
    let other = Hidden {
        seed: hidden.seed ^ 0xd1ff,
        ..hidden.clone()
    };
    let story = drive(&other, &anyhow(60.0, &mut Random::new(other.seed)), RATES);
    let evidence = story.evidence();
    let test = Drive::new(&evidence).expect("a drive");
    let nominal = Parameters {
        latency_s: own.latency_s,
        ..Parameters::NOMINAL
    };
    let distances = |parameters: &Parameters| {
        let errors = errors(&test, parameters, 10.0);
        errors.iter().map(|(_, error, _)| *error).collect()
    };
    (distances(own), distances(&nominal))
}

#[test]
fn hidden_robots_are_found_out() {
    let (mut speed, mut ratio, mut track, mut clock) = (vec![], vec![], vec![], vec![]);
    let (mut own, mut nominal) = (vec![], vec![]);
    for seed in 0..6 {
        let hidden = Hidden::draw(1_000 + seed, 0.0);
        let evidence = calibration(&hidden, RATES).evidence();
        let made = certify(&evidence, About::default(), None).expect("a certificate");
        let p = made.parameters;
        let pairs: Vec<[f64; 2]> = [0.4, 0.6, 0.8]
            .iter()
            .map(|duty| {
                // Whoever drives it has the gauge's volts, not those of the pack.
                let got = p.settled(*duty, hidden.shown(7.4));
                [0, 1].map(|k| got[k] / hidden.settled(k, *duty, 7.4))
            })
            .collect();
        for [left, right] in &pairs {
            speed.extend([(left - 1.0).abs(), (right - 1.0).abs()]);
            ratio.push((left / right - 1.0).abs());
        }
        track.push((p.track_m / hidden.track - 1.0).abs());
        let late = p.latency_s + made.behind_s.expect("arrivals are known");
        clock.push((late - hidden.late_s).abs());
        let (mine, theirs) = ten_seconds_on(&hidden, &p);
        own.extend(mine);
        nominal.extend(theirs);
        assert_eq!(
            Certificate::read(made.write().as_bytes())
                .expect("itself")
                .id(),
            made.id()
        );
    }
    for (what, values, most) in [
        ("settled speed", &mut speed, 0.01),
        ("left to right", &mut ratio, 0.003),
        ("track", &mut track, 0.005),
        ("clock, s", &mut clock, 0.01),
        ("10 s ahead, m", &mut own, 0.06),
    ] {
        let median = quantile(values, 0.5);
        assert!(median <= most, "{what}: {median}");
    }
    let gain = quantile(&mut nominal, 0.5) / quantile(&mut own, 0.5);
    assert!(
        gain > 5.0,
        "ten seconds ahead only {gain} times better than nominal"
    );
}

#[test]
fn what_no_twin_models_makes_certificates_rarer_and_never_wrong() {
    let mut made = 0;
    for seed in 0..8 {
        let hidden = Hidden::draw(1_000 + seed, 1.0);
        let evidence = calibration(&hidden, RATES).evidence();
        let Ok(certificate) = certify(&evidence, About::default(), None) else {
            continue;
        };
        made += 1;
        let (mut own, mut nominal) = ten_seconds_on(&hidden, &certificate.parameters);
        let (own, nominal) = (quantile(&mut own, 0.5), quantile(&mut nominal, 0.5));
        assert!(own < nominal, "{seed}: {own} against {nominal}");
    }
    assert!(made >= 4, "of eight only {made}");
}

#[test]
fn bodies_that_a_certificate_allows_are_spread_as_it_says() {
    let hidden = Hidden::draw(1_000, 0.0);
    let evidence = calibration(&hidden, RATES).evidence();
    let mut made = certify(&evidence, About::default(), None).expect("a certificate");
    assert_eq!(Belief::from(&made).draw(&[0.0; COUNT]), made.parameters);
    let mut random = Random::new(5);
    let drawn: Vec<Parameters> = (0..2_000)
        .map(|_| Belief::from(&made).draw(&std::array::from_fn(|_| random.normal())))
        .collect();
    assert!(drawn.iter().all(Parameters::is_sound));
    let of = |name: &str| {
        let found = made.values.iter().find(|value| value.name == name);
        found.unwrap_or_else(|| panic!("no {name}")).sigma
    };
    let spread = |value: fn(&Parameters) -> f64| {
        let mean = drawn.iter().map(value).sum::<f64>() / 2_000.0;
        let squares: f64 = drawn.iter().map(|body| (value(body) - mean).powi(2)).sum();
        (squares / 1_999.0).sqrt()
    };
    for (name, value) in [
        (
            NAMES[0],
            (|body| body.speed_per_volt[0]) as fn(&Parameters) -> f64,
        ),
        (NAMES[8], |body| body.track_m),
        (NAMES[9], |body| body.latency_s),
    ] {
        let ratio = spread(value) / of(name);
        assert!((0.93..1.07).contains(&ratio), "{name}: {ratio}");
    }
    // Rims of one pack go up and down together: their ratio is known better than either.
    let apart = spread(|body| body.speed_per_volt[0] - body.speed_per_volt[1]);
    assert!(apart < 1.2 * of(NAMES[0]), "{apart}");
    // A covariance that is none says nothing.
    made.covariance[3][3] = -1.0;
    assert_eq!(Belief::from(&made).draw(&[1.0; COUNT]), made.parameters);
    made.covariance.clear();
    assert_eq!(Belief::from(&made).draw(&[1.0; COUNT]), made.parameters);
}

#[test]
fn a_certificate_must_be_better_than_the_one_before() {
    let hidden = Hidden::draw(2_001, 0.0);
    let evidence = calibration(&hidden, RATES).evidence();
    let first = certify(&evidence, About::default(), None).expect("a certificate");
    let again = certify(&evidence, About::default(), Some(&first));
    assert!(
        matches!(again, Err(Refused::NotBetterThanPrevious(_))),
        "{again:?}"
    );
    // A motor that has aged is worth a new one.
    let aged = Hidden {
        gain: [hidden.gain[0] * 0.85, hidden.gain[1]],
        ..hidden
    };
    let evidence = calibration(&aged, RATES).evidence();
    certify(&evidence, About::default(), Some(&first)).expect("a better one");
}

/// The evidence of a story whose rows come as `change` has them.
fn changed(story: &Story, change: impl Fn(usize, Fix) -> Fix) -> Evidence {
    let mut evidence = Evidence::default();
    for row in &story.duties {
        let _ = evidence.duty(*row);
    }
    for row in &story.supply {
        let _ = evidence.supply(*row);
    }
    for (i, row) in story.fixes.iter().enumerate() {
        let _ = evidence.fix(change(i, *row));
    }
    evidence
}

#[test]
fn doubled_and_reordered_rows_make_the_same_certificate() {
    let story = calibration(&Hidden::draw(2_002, 0.0), RATES);
    let plain = story.evidence();
    let mut evidence = Evidence::default();
    // Rows of three swap places, and each comes twice.
    for rows in story.duties.chunks(3) {
        for row in rows.iter().rev().chain(rows) {
            let _ = evidence.duty(*row);
        }
    }
    for rows in story.fixes.chunks(3) {
        for row in rows.iter().rev().chain(rows) {
            let _ = evidence.fix(*row);
        }
    }
    for row in &story.supply {
        let _ = evidence.supply(*row);
    }
    assert_eq!(evidence.hash(), plain.hash());
    let counts = evidence.counts();
    assert_eq!(
        counts.doubled as usize,
        story.duties.len() + story.fixes.len()
    );
    assert!(counts.reordered > 0 && counts.absurd == 0, "{counts:?}");
    let made = certify(&evidence, About::default(), None).expect("a certificate");
    let same = certify(&plain, About::default(), None).expect("a certificate");
    assert_eq!(made.parameters, same.parameters);
}

#[test]
fn a_clock_that_jumps_is_named() {
    let story = calibration(&Hidden::draw(2_003, 0.0), RATES);
    let jumped = changed(&story, |i, fix| Fix {
        at_s: fix.at_s + if i > 400 { 2.0 } else { 0.0 },
        ..fix
    });
    let made = certify(&jumped, About::default(), None);
    assert!(matches!(made, Err(Refused::ClockJumped(_))), "{made:?}");
}

#[test]
fn a_tracker_that_takes_another_robot_for_it_or_mirrors_is_found_out() {
    let story = calibration(&Hidden::draw(2_004, 0.0), RATES);
    let other = calibration(&Hidden::draw(2_005, 0.0), RATES);
    let swapped = changed(&story, |i, fix| {
        let there = other.fixes[i.min(other.fixes.len() - 1)];
        if (i / 50) % 2 == 0 {
            fix
        } else {
            Fix {
                at_s: fix.at_s,
                ..there
            }
        }
    });
    let made = certify(&swapped, About::default(), None);
    assert!(made.is_err(), "{made:?}");
    let mirrored = changed(&story, |_, fix| Fix {
        y: -fix.y,
        theta: -fix.theta,
        ..fix
    });
    let made = certify(&mirrored, About::default(), None);
    assert!(made.is_err(), "{made:?}");
}

#[test]
fn gaps_and_a_robot_that_is_carried_do_no_harm() {
    let hidden = Hidden::draw(2_006, 0.0);
    let story = calibration(&hidden, RATES);
    let mut evidence = Evidence::default();
    let gap = |at_s: f64| (20.0..23.0).contains(&at_s) || (50.0..55.0).contains(&at_s);
    for row in story.duties.iter().filter(|row| !gap(row.at_s)) {
        let _ = evidence.duty(*row);
    }
    for row in &story.supply {
        let _ = evidence.supply(*row);
    }
    for row in &story.fixes {
        // After half a minute somebody puts it elsewhere, turned by a quarter.
        let fix = if row.at_s > 30.0 {
            Fix {
                x: 2.0 - row.y,
                y: row.x - 1.0,
                theta: row.theta + 1.571,
                ..*row
            }
        } else {
            *row
        };
        let _ = evidence.fix(fix);
    }
    let made = certify(&evidence, About::default(), None).expect("a certificate");
    assert_eq!(made.jumps, 1);
    let (mut own, mut nominal) = ten_seconds_on(&hidden, &made.parameters);
    let (own, nominal) = (quantile(&mut own, 0.5), quantile(&mut nominal, 0.5));
    assert!(own < 0.5 * nominal, "{own} against {nominal}");
}

#[test]
fn who_stands_or_says_nothing_is_not_identified() {
    let hidden = Hidden::draw(2_007, 0.0);
    let still = drive(&hidden, &vec![(60.0, 0.0, 0.0)], RATES).evidence();
    let made = certify(&still, About::default(), None);
    let stood = Refused::Unidentified(Unidentified::StoodStill);
    assert_eq!(made.expect_err("it stood"), stood);
    let made = certify(&Evidence::default(), About::default(), None);
    let little = Refused::Unidentified(Unidentified::TooLittle);
    assert_eq!(made.expect_err("nothing is known"), little);
}

#[test]
fn one_second_ahead_is_the_noise_of_the_tracker() {
    let hidden = Hidden::draw(2_008, 0.0);
    let evidence = calibration(&hidden, RATES).evidence();
    let made = certify(&evidence, About::default(), None).expect("a certificate");
    let test = drive(&hidden, &anyhow(40.0, &mut Random::new(3)), RATES).evidence();
    let test = Drive::new(&test).expect("a drive");
    // A fix itself is off by 1.2 cm at the median.
    let own = score(&errors(&test, &made.parameters, 1.0), 1.0);
    assert!(own.median_m < 0.016, "{own:?}");
}
