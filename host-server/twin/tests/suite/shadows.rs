//! Shadows: they stick to their robots, and name what is wrong with them.

use crawler_twin::body::Parameters;
use crawler_twin::certificate::{About, certify};
use crawler_twin::detect::{Fault, FaultName};
use crawler_twin::evidence::{Duty, Fix, Row, Supply};
use crawler_twin::predict::quantile;
use crawler_twin::shadow::Shadow;
use proptest::prelude::*;

use crate::reference::{CALIBRATING, Hidden, Random, Rates, Story, anyhow, calibration, drive};

const RATES: Rates = Rates {
    telemetry: 5,
    fixes: 2,
};

/// Hands a story to a shadow in the order in which it arrives, and looks after each fix.
fn follow(shadow: &mut Shadow, story: &Story, look: impl FnMut(f64, &mut Shadow)) {
    assert_eq!(follow_any(shadow, story, look), 0, "rows were refused");
}

/// The same with rows that may be refused; how many were.
fn follow_any(shadow: &mut Shadow, story: &Story, mut look: impl FnMut(f64, &mut Shadow)) -> usize {
    let mut refused = 0;
    for row in story.rows() {
        refused += usize::from(shadow.take(row).is_err());
        if let (Row::Fix(_), Some(at_s)) = (row, row.arrived_s()) {
            look(at_s, shadow);
        }
    }
    refused
}

/// A shadow of a hidden robot that was calibrated.
fn shadow(hidden: &Hidden) -> Shadow {
    let evidence = calibration(hidden, CALIBRATING).evidence();
    let made = certify(&evidence, About::default(), None).expect("a certificate");
    Shadow::new(made.parameters, made.wander)
}

#[test]
fn it_sticks_to_its_robot_and_knows_how_well() {
    let (mut off, mut ahead, mut within, mut looks) = (Vec::new(), Vec::new(), 0, 0);
    for seed in 0..6 {
        let hidden = Hidden::draw(4_000 + seed, 0.0);
        let mut shadow = shadow(&hidden);
        let story = drive(&hidden, &anyhow(120.0, &mut Random::new(seed)), RATES);
        follow(&mut shadow, &story, |_, shadow| {
            let Some(view) = shadow.view() else { return };
            // Its time is the tracker's, which is the world's.
            let truth = story.truth[(view.at_s * 1e3) as usize];
            let error = view.now.pose.distance(truth);
            off.push(error);
            looks += 1;
            within += usize::from(error < 2.5 * view.now.sigma_m);
        });
        let view = shadow.view().expect("something is known");
        assert!(
            view.faults.is_empty() && view.gaps == 0 && view.jumps == 0,
            "{view:?}"
        );
        assert!(
            (0.5..2.0).contains(&view.consistency) && view.coverage > 0.8,
            "{view:?}"
        );
        ahead.push(view.residuals[1].median_m);
        let forecast = shadow.forecast();
        let sigmas: Vec<f64> = forecast
            .iter()
            .map(|forecast| forecast.at.sigma_m)
            .collect();
        assert!(sigmas.len() == 2 && view.now.sigma_m < sigmas[0] && sigmas[0] < sigmas[1]);
    }
    assert!(
        quantile(&mut off, 0.5) < 0.01,
        "off by {}",
        quantile(&mut off, 0.5)
    );
    assert!(quantile(&mut ahead, 0.5) < 0.08, "{ahead:?}");
    assert!(within * 100 > looks * 90, "{within} of {looks}");
}

#[test]
fn a_motor_that_fades_makes_its_certificate_stale_and_health_does_not() {
    let rows = |hidden: &Hidden, seconds: f64| {
        drive(
            hidden,
            &anyhow(seconds, &mut Random::new(hidden.seed)),
            RATES,
        )
    };
    for seed in 0..4 {
        // A hundredth of the voltage a minute: no fault, and six hundredths after all.
        let fading = Hidden {
            fades: Some((1, 60.0, 0.01 / 60.0)),
            ..Hidden::draw(5_200 + seed, 0.0)
        };
        let healthy = Hidden {
            fades: None,
            ..fading.clone()
        };
        let mut known = shadow(&healthy);
        let mut watched = known.clone();
        follow(&mut known, &rows(&healthy, 540.0), |_, _| {});
        let view = known.view().expect("something is known");
        let drift = view.drift.expect("a certificate");
        assert_eq!(drift.stale_since_s, None, "{seed}: {view:?}");

        let mut stale = None;
        follow(&mut watched, &rows(&fading, 540.0), |at_s, shadow| {
            let drift = shadow.view().and_then(|view| view.drift);
            if stale.is_none() && drift.is_some_and(|drift| drift.stale_since_s.is_some()) {
                stale = Some((at_s, shadow.faults()));
            }
        });
        let view = watched.view().expect("something is known");
        let (at_s, faults) = stale.unwrap_or_else(|| panic!("{seed}: {view:?}"));
        assert!(
            at_s > 120.0 && faults.is_empty(),
            "{seed}: {at_s} {faults:?}"
        );
        let drift = view.drift.expect("a certificate");
        assert!(
            drift.deviations[1] > drift.deviations[0],
            "{seed}: {drift:?}"
        );
    }
    assert!(Shadow::uncalibrated().view().is_none());
    let mut nobody = Shadow::uncalibrated();
    follow(
        &mut nobody,
        &rows(&Hidden::draw(5_210, 0.0), 30.0),
        |_, _| {},
    );
    assert_eq!(nobody.view().expect("something is known").drift, None);
}

/// When which fault was named first.
fn first_fault(shadow: &mut Shadow, story: &Story) -> Option<(f64, Fault)> {
    let mut found = None;
    follow_any(shadow, story, |at_s, shadow| {
        let view = shadow.view().filter(|_| found.is_none());
        let fault = view.and_then(|view| view.faults.first().copied());
        found = found.or(fault.map(|fault| (at_s, fault)));
    });
    found
}

#[test]
fn a_weak_motor_is_named_by_its_side_within_seconds() {
    for (share, within_s) in [(0.8, 3.0), (0.9, 5.0), (0.95, 20.0)] {
        let mut delays = Vec::new();
        for seed in 0..6 {
            let wheel = seed as usize % 2;
            let hidden = Hidden {
                weak: Some((wheel, 60.0, share)),
                ..Hidden::draw(5_000 + seed, 0.0)
            };
            let story = drive(&hidden, &anyhow(90.0, &mut Random::new(seed)), RATES);
            let (at_s, fault) = first_fault(&mut shadow(&hidden), &story).expect("found");
            let side = [FaultName::LeftWeak, FaultName::RightWeak][wheel];
            assert_eq!(fault.fault, side, "{share} {seed}: {fault:?}");
            assert!(
                (60.0..60.0 + within_s).contains(&at_s),
                "{share} {seed}: {at_s}"
            );
            // A tenth less voltage is more than a tenth less speed: friction takes its part first.
            assert!(
                (1.0 - share) * 0.7 < fault.amount,
                "{share} {seed}: {fault:?}"
            );
            delays.push(at_s - 60.0);
        }
        println!("{share}: {:.1} s", quantile(&mut delays, 0.5));
    }
}

#[test]
fn who_is_stuck_or_elsewhere_or_late_is_told_so() {
    let hidden = Hidden::draw(5_101, 0.0);
    let story = drive(&hidden, &anyhow(60.0, &mut Random::new(1)), RATES);
    // From half a minute on it stands although its wheels are told to turn.
    let stuck = story.fixes[60];
    let held = Story {
        fixes: (0..story.fixes.len())
            .map(|i| {
                let fix = story.fixes[i];
                let noise = story.fixes[i % 60];
                let there = Fix {
                    x: stuck.x,
                    y: stuck.y,
                    theta: stuck.theta,
                    ..fix
                };
                if i > 60 {
                    Fix {
                        x: there.x + noise.x * 1e-3,
                        ..there
                    }
                } else {
                    fix
                }
            })
            .collect(),
        duties: story.duties.clone(),
        supply: story.supply.clone(),
        truth: Vec::new(),
        way: Vec::new(),
    };
    let (at_s, fault) = first_fault(&mut shadow(&hidden), &held).expect("found");
    assert_eq!(fault.fault, FaultName::Stuck, "{fault:?}");
    assert!((30.0..36.0).contains(&at_s), "{at_s}");

    // A tracker that takes another robot for it now and then.
    let swapped = Story {
        fixes: (0..story.fixes.len())
            .map(|i| {
                let fix = story.fixes[i];
                if (i / 4) % 3 == 2 {
                    Fix {
                        x: fix.x + 3.0,
                        ..fix
                    }
                } else {
                    fix
                }
            })
            .collect(),
        ..held
    };
    let mut jumpy = shadow(&hidden);
    let (_, fault) = first_fault(&mut jumpy, &swapped).expect("found");
    assert_eq!(fault.fault, FaultName::TrackerWrong, "{fault:?}");
    assert!(jumpy.view().is_some_and(|view| view.jumps > 5));

    // A network that holds everything up by half a second after a while.
    let late = Story {
        duties: story
            .duties
            .iter()
            .enumerate()
            .map(|(i, row)| {
                let held_s = if i > 150 {
                    0.3 + 0.4 * ((i % 3) as f64)
                } else {
                    0.0
                };
                Duty {
                    arrived_s: row.arrived_s.map(|at| at + held_s),
                    ..*row
                }
            })
            .collect(),
        fixes: story.fixes.clone(),
        ..swapped
    };
    let (_, fault) = first_fault(&mut shadow(&hidden), &late).expect("found");
    assert_eq!(fault.fault, FaultName::Late, "{fault:?}");
}

#[test]
fn after_a_gap_or_a_new_clock_it_begins_where_the_robot_is() {
    let hidden = Hidden::draw(5_201, 0.0);
    let story = drive(&hidden, &anyhow(60.0, &mut Random::new(2)), RATES);
    let mut broken = Story {
        duties: story.duties.clone(),
        supply: story.supply.clone(),
        fixes: story.fixes.clone(),
        truth: Vec::new(),
        way: Vec::new(),
    };
    // Five seconds of silence, and later a robot that boots with another clock.
    broken
        .duties
        .retain(|row| !(20.0..25.0).contains(&row.at_s));
    for row in broken.duties.iter_mut().filter(|row| row.at_s > 40.0) {
        row.at_s += 1_000.0;
    }
    let mut shadow = shadow(&hidden);
    let mut off = Vec::new();
    let mut rows = 0;
    follow_any(&mut shadow, &broken, |_, shadow| {
        rows += 1;
        if let Some(view) = shadow.view() {
            off.push(
                view.now
                    .pose
                    .distance(story.truth[(view.at_s * 1e3) as usize]),
            );
        }
    });
    let view = shadow.view().expect("something is known");
    assert!(view.gaps >= 2 && view.faults.is_empty(), "{view:?}");
    assert!(off.len() * 10 > rows * 6, "{} of {rows}", off.len());
    assert!(
        quantile(&mut off, 0.9) < 0.03,
        "{}",
        quantile(&mut off, 0.9)
    );
}

#[test]
fn of_a_robot_that_nobody_calibrated_only_what_shows_on_any_body_is_named() {
    let (mut off, mut nominal_off) = (Vec::new(), Vec::new());
    for seed in 0..6 {
        // A wild body that is none of the nominal one, and later has a motor that is weaker still.
        let hidden = Hidden {
            weak: Some((0, 60.0, 0.9)),
            ..Hidden::draw(7_000 + seed, 0.0)
        };
        let story = drive(&hidden, &anyhow(120.0, &mut Random::new(seed)), RATES);
        let mut shadow = Shadow::uncalibrated();
        follow(&mut shadow, &story, |_, shadow| {
            let Some(view) = shadow.view() else { return };
            assert!(view.faults.is_empty(), "{seed}: {view:?}");
            let truth = story.truth[(view.at_s * 1e3) as usize];
            off.push(view.now.pose.distance(truth));
        });
        let mut nominal = Shadow::new(Parameters::NOMINAL, 0.0);
        follow(&mut nominal, &story, |_, shadow| {
            let Some(view) = shadow.view() else { return };
            let truth = story.truth[(view.at_s * 1e3) as usize];
            nominal_off.push(view.now.pose.distance(truth));
        });
        let gains = shadow.view().expect("something is known").gains;
        let [left, right] = [0, 1].map(|k| hidden.settled(k, 0.5, 7.4));
        let truth = Parameters::NOMINAL.settled(0.5, 7.4);
        let (left, right) = (left * 0.9 / truth[0], right / truth[1]);
        println!("{seed}: {gains:?} for about {left:.2} {right:.2}");
    }
    let (mine, theirs) = (quantile(&mut off, 0.5), quantile(&mut nominal_off, 0.5));
    assert!(mine < 0.02 && mine < theirs, "{mine} {theirs}");
}

#[test]
fn who_is_held_is_stuck_on_any_body_and_free_again() {
    for (seed, to) in [(5_301, 100), (5_302, 100), (5_303, 72), (5_304, 72)] {
        held(seed, 60, to);
    }
}

/// Lets a robot be held from one fix to another.
fn held(seed: u64, from: usize, to: usize) {
    let hidden = Hidden::draw(seed, 0.0);
    let story = drive(&hidden, &anyhow(100.0, &mut Random::new(3)), RATES);
    let there = story.fixes[from];
    let fixes = story.fixes.iter().enumerate().map(|(i, fix)| {
        // Afterwards it goes on from where it was held.
        if (from..to).contains(&i) {
            let Fix { x, y, theta, .. } = there;
            Fix {
                x,
                y,
                theta,
                ..*fix
            }
        } else if i >= to {
            let begun = story.fixes[to];
            let (x, y) = (fix.x - begun.x + there.x, fix.y - begun.y + there.y);
            Fix { x, y, ..*fix }
        } else {
            *fix
        }
    });
    let held = Story {
        fixes: fixes.collect(),
        duties: story.duties.clone(),
        supply: story.supply.clone(),
        truth: Vec::new(),
        way: Vec::new(),
    };
    let mut shadow = Shadow::uncalibrated();
    let mut named = Vec::new();
    follow_any(&mut shadow, &held, |at_s, shadow| {
        if let Some(fault) = shadow.faults().first() {
            assert_eq!(fault.fault, FaultName::Stuck, "{fault:?}");
            named.push(at_s);
        }
    });
    let (first, last) = (named[0], named[named.len() - 1]);
    let end_s = to as f64 * 0.5;
    assert!((30.0..35.0).contains(&first), "{seed}: {first}");
    assert!(
        (end_s - 5.0..end_s + 15.0).contains(&last),
        "{seed}: {last}"
    );
}

/// A story in which something holds a robot up at times: between some seconds it comes as far as `share` says.
fn rubbed(story: &Story, spans: &[(f64, f64)], share: f64) -> Story {
    let mut lost = [0.0; 2];
    let steps = story.fixes.iter().zip(story.fixes.iter().skip(1));
    let moved = steps.map(|(before, fix)| {
        let rubs = spans
            .iter()
            .any(|(from, to)| (*from..*to).contains(&fix.at_s));
        let share = if rubs { share } else { 1.0 };
        for (lost, way) in lost.iter_mut().zip([fix.x - before.x, fix.y - before.y]) {
            *lost += (1.0 - share) * way;
        }
        Fix {
            x: fix.x - lost[0],
            y: fix.y - lost[1],
            ..*fix
        }
    });
    Story {
        fixes: story.fixes[..1].iter().copied().chain(moved).collect(),
        duties: story.duties.clone(),
        supply: story.supply.clone(),
        truth: Vec::new(),
        way: Vec::new(),
    }
}

#[test]
fn what_a_robot_touches_is_no_fault_where_somebody_knows_of_it_and_learns_nothing() {
    let spans = [(40.0, 44.0), (60.0, 63.0), (80.0, 86.0)];
    for seed in 0..4 {
        let hidden = Hidden::draw(5_600 + seed, 0.0);
        let story = drive(&hidden, &anyhow(120.0, &mut Random::new(seed)), RATES);
        let held_up = rubbed(&story, &spans, 0.6);
        let known = shadow(&hidden);
        let follow = |story: &Story, knows: bool| {
            let (mut shadow, mut named) = (known.clone(), Vec::new());
            for row in story.rows() {
                if let Row::Fix(fix) = row {
                    let near = spans
                        .iter()
                        .any(|(from, to)| (*from..*to).contains(&fix.at_s));
                    shadow.near(knows && near);
                }
                let _ = shadow.take(row);
                named.extend(
                    shadow
                        .faults()
                        .iter()
                        .map(|fault| (fault.fault, row.arrived_s())),
                );
            }
            (shadow, named)
        };
        let (_, named) = follow(&held_up, false);
        assert!(!named.is_empty(), "{seed}");
        let (mut held, named) = follow(&held_up, true);
        assert_eq!(named, [], "{seed}");
        let (mut free, _) = follow(&story, false);
        let gains = [&mut held, &mut free].map(|shadow| shadow.view().expect("known").gains);
        for k in 0..2 {
            assert!(
                (gains[0][k] - gains[1][k]).abs() < 0.02,
                "{seed}: {gains:?}"
            );
        }
        let errors = [&held, &free].map(|shadow| shadow.gap().measure().errors[0]);
        let [held, free] = errors.map(|errors| errors.value.expect("enough").own.median_m);
        assert!(held < 1.3 * free, "{seed}: {held} {free}");
    }
}

#[test]
fn who_stands_against_something_is_stuck_there_too() {
    let hidden = Hidden::draw(5_610, 0.0);
    let story = drive(&hidden, &anyhow(60.0, &mut Random::new(1)), RATES);
    let held_up = rubbed(&story, &[(30.0, 60.0)], 0.0);
    // Wheels that turn it round on the spot do not turn it either.
    let theta = story
        .fixes
        .iter()
        .rfind(|fix| fix.at_s < 30.0)
        .expect("a fix")
        .theta;
    let mut shadow = shadow(&hidden);
    let mut named = Vec::new();
    for row in held_up.rows() {
        let row = match row {
            Row::Fix(fix) if fix.at_s >= 30.0 => {
                shadow.near(true);
                Row::Fix(Fix { theta, ..fix })
            }
            row => row,
        };
        let _ = shadow.take(row);
        let faults = shadow.faults();
        named.extend(faults.iter().map(|fault| (fault.fault, row.arrived_s())));
    }
    // What held it is left behind, and nothing else is wrong with it.
    shadow.near(false);
    let free = drive(&hidden, &anyhow(80.0, &mut Random::new(1)), RATES);
    for row in free
        .rows()
        .into_iter()
        .filter(|row| row.arrived_s() > Some(60.0))
    {
        let _ = shadow.take(row);
        named.extend(
            shadow
                .faults()
                .iter()
                .filter(|fault| fault.fault != FaultName::Stuck)
                .map(|fault| (fault.fault, row.arrived_s())),
        );
    }
    assert_eq!(shadow.faults(), []);
    let (fault, at_s) = named[0];
    assert_eq!(fault, FaultName::Stuck);
    assert!(
        (30.0..38.0).contains(&at_s.expect("an arrival")),
        "{at_s:?}"
    );
    assert!(
        named.iter().all(|(fault, _)| *fault == FaultName::Stuck),
        "{named:?}"
    );
}

#[test]
fn what_no_sample_tells_of_is_seen_once_and_is_no_fault() {
    let mut learned = Vec::new();
    for seed in 0..6 {
        let hidden = Hidden::draw(5_620 + seed, 0.0);
        let rates = Rates {
            telemetry: 5,
            fixes: 10,
        };
        let mut story = drive(&hidden, &anyhow(120.0, &mut Random::new(seed)), rates);
        // Wheels that paused between two samples: from then on it looks elsewhere, and is 2 cm behind.
        for (i, at_s) in [20.0, 41.0, 63.0, 82.0, 100.0].into_iter().enumerate() {
            let turn = if i % 2 == 0 { 0.17 } else { -0.17 };
            let (sin, cos) = f64::sin_cos(turn);
            let about = *story
                .fixes
                .iter()
                .find(|fix| fix.at_s >= at_s)
                .expect("a fix");
            for fix in story.fixes.iter_mut().filter(|fix| fix.at_s >= at_s) {
                let (dx, dy) = (fix.x - about.x, fix.y - about.y);
                fix.x = about.x + cos * dx - sin * dy - 0.02 * about.theta.cos();
                fix.y = about.y + sin * dx + cos * dy - 0.02 * about.theta.sin();
                fix.theta += turn;
            }
        }
        let mut shadow = shadow(&hidden);
        follow_any(&mut shadow, &story, |at_s, shadow| {
            assert_eq!(shadow.faults(), [], "{seed}: {at_s}");
        });
        learned.extend(shadow.view().expect("known").gains);
    }
    assert!(
        learned.iter().all(|gain| (gain - 1.0).abs() < 0.03),
        "{learned:?}"
    );
}

#[test]
fn fixes_that_come_too_late_are_of_no_use_and_do_no_harm() {
    let hidden = Hidden::draw(5_630, 0.0);
    let mut story = drive(&hidden, &anyhow(90.0, &mut Random::new(4)), RATES);
    // A network holds fixes up for some seconds, twice, and hands them over all at once.
    for fix in &mut story.fixes {
        for (from, to) in [(30.0, 32.5), (60.0, 64.5)] {
            if (from..to).contains(&fix.at_s) {
                fix.arrived_s = Some(to);
            }
        }
    }
    let mut shadow = shadow(&hidden);
    follow_any(&mut shadow, &story, |at_s, shadow| {
        assert_eq!(shadow.faults(), [], "{at_s}");
        let Some(view) = shadow.view() else { return };
        let truth = story.truth[(view.at_s * 1e3) as usize];
        let off = view.now.pose.distance(truth);
        assert!(
            off < 0.03 + 4.0 * view.now.sigma_m,
            "{at_s}: {off} {view:?}"
        );
    });
}

#[test]
fn a_tracker_whose_clock_was_set_is_believed_again() {
    let hidden = Hidden::draw(5_401, 0.0);
    let story = drive(&hidden, &anyhow(60.0, &mut Random::new(2)), RATES);
    for set_s in [-1_000.0, 1_000.0] {
        let moved = |fix: &Fix| Fix {
            at_s: fix.at_s + if fix.at_s > 30.0 { set_s } else { 0.0 },
            ..*fix
        };
        let other = Story {
            fixes: story.fixes.iter().map(moved).collect(),
            duties: story.duties.clone(),
            supply: story.supply.clone(),
            truth: Vec::new(),
            way: Vec::new(),
        };
        let mut shadow = shadow(&hidden);
        let refused = follow_any(&mut shadow, &other, |_, _| {});
        assert!(refused <= 2, "{refused}");
        let view = shadow.view().expect("something is known");
        assert!(view.gaps == 1 && view.faults.is_empty(), "{view:?}");
        assert!((view.at_s - set_s - 59.0).abs() < 2.0, "{view:?}");
        let truth = story.truth[((view.at_s - set_s) * 1e3) as usize];
        assert!(view.now.pose.distance(truth) < 0.05, "{view:?}");
        assert!((shadow.delay_s() - (0.005 - set_s)).abs() < 0.01);
    }
}

#[test]
fn nothing_is_named_in_hours_of_health() {
    for seed in 0..16 {
        let hidden = Hidden::draw(6_000 + seed, 0.0);
        let story = drive(&hidden, &anyhow(900.0, &mut Random::new(seed)), RATES);
        let mut shadow = shadow(&hidden);
        let found = first_fault(&mut shadow, &story);
        assert_eq!(found, None, "{seed}");
        let view = shadow.view().expect("something is known");
        let drift = view.drift.expect("a certificate");
        assert_eq!(drift.stale_since_s, None, "{seed}: {drift:?}");
    }
}

proptest! {
    #![proptest_config(crawler_properties::cases(64))]

    #[test]
    fn whatever_comes_what_it_says_are_numbers(
        rows in prop::collection::vec((0..3_u8, 0.0..40.0, -0.2..0.5, -2.0..2.0, -2.0..2.0, any::<f64>()), 0..300),
    ) {
        let mut shadow = Shadow::new(Parameters::NOMINAL, 0.0);
        let mut at = 0.0;
        for (kind, jump, late, a, b, odd) in rows {
            // Mostly one after the other, now and then anywhere.
            at = if jump > 39.0 { odd } else { at + jump * 0.01 };
            let arrived_s = Some(at + late);
            let _ = match kind {
                0 => shadow.duty(Duty { at_s: at, arrived_s, duty: [a, b] }),
                1 => shadow.supply(Supply { at_s: at, arrived_s, volts: a * 8.0 }),
                _ => shadow.fix(Fix { at_s: at, arrived_s, x: a, y: b, theta: a + b, sigma_m: 0.01 }),
            };
            if !at.is_finite() {
                at = 0.0;
            }
            if let Some(view) = shadow.view() {
                let pose = view.now.pose;
                let numbers = [pose.x, pose.y, pose.theta, view.now.sigma_m, view.v, view.w, view.gains[0]];
                prop_assert!(numbers.iter().all(|number| number.is_finite()), "{:?}", view);
            }
        }
        for forecast in shadow.forecast() {
            prop_assert!(forecast.at.pose.x.is_finite() && forecast.at.sigma_m.is_finite());
        }
    }
}
