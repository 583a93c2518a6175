//! Echoes that are wrong, and sensors that differ.

use crawler_drivers::us100::{FARTHEST, NEAREST, RangeError, Us100};
use crawler_hal::{Adc, Celsius, Millimeters};

use super::*;
use crate::world::Wiring;

const AIR: Celsius = Celsius(22);

/// So many measurements of a post two metres ahead.
fn measure(parameters: Parameters, seed: u64, count: u32) -> Vec<Result<Millimeters, RangeError>> {
    let mut bench = TestBody::facing(2.0, parameters, seed);
    let parts = bench.parts();
    let mut driver = Us100::new(parts.ranger);
    (0..count)
        .map(|_| bench.run(driver.measure(&parts.clock, AIR)))
        .collect()
}

#[test]
fn outliers_come_as_often_as_the_world_says_and_from_where_they_can() {
    let mut parameters = exact();
    parameters.ranger.multipath = 0.1;
    parameters.ranger.ghost = 0.05;
    for seed in [3, 4, 5] {
        let readings = measure(parameters, seed, 2_000);
        let told: Vec<u16> = readings.iter().map(|r| r.expect("an echo").0).collect();
        let longer = told.iter().filter(|mm| **mm > 2_001).count();
        let shorter = told.iter().filter(|mm| **mm < 1_999).count();
        // Three standard deviations of a binomial distribution.
        assert!((160..=240).contains(&longer), "{longer}");
        assert!((70..=130).contains(&shorter), "{shorter}");
        let most = told.iter().max().expect("many");
        let least = told.iter().min().expect("many");
        assert!((2_800..=3_000).contains(most), "half the way more: {most}");
        assert!((NEAREST.0..400).contains(least), "anywhere before: {least}");
    }
}

#[test]
fn a_detour_beyond_the_reach_is_no_echo() {
    let mut parameters = exact();
    parameters.ranger.multipath = 1.0;
    parameters.ranger.detour = 4.0;
    let readings = measure(parameters, 3, 400);
    let lost = readings
        .iter()
        .filter(|r| matches!(r, Err(RangeError::NoEcho(mm)) if *mm > FARTHEST))
        .count();
    // Detours go up to four times the two metres; those beyond 2.5 m are lost.
    assert!((240..310).contains(&lost), "{lost}");
    let told = readings.iter().filter_map(|r| r.ok());
    assert!(told.clone().count() + lost == 400);
    assert!(told.into_iter().all(|mm| mm.0 >= 2_000));
}

#[test]
fn an_outlier_does_not_shift_the_draws_of_what_follows() {
    let mut parameters = exact();
    parameters.ranger.noise_mm = 5.0;
    let plain = measure(parameters, 6, 60);
    parameters.ranger.ghost = 0.2;
    let odd = measure(parameters, 6, 60);
    let same = plain.iter().zip(&odd).filter(|(a, b)| a == b).count();
    assert!((35..60).contains(&same), "{same}");
}

#[test]
fn ranges_come_in_steps() {
    let mut parameters = exact();
    parameters.ranger.noise_mm = 30.0;
    parameters.ranger.step_mm = 8.0;
    let readings = measure(parameters, 1, 100);
    assert!(readings.iter().all(|r| r.is_ok_and(|mm| mm.0 % 8 == 0)));
}

#[test]
fn a_thermometer_that_is_off_makes_ranges_wrong_over_the_line_and_not_in_the_pulse() {
    let mut parameters = exact();
    parameters.spread.thermometer_c = 5.0;
    let mut errors = Vec::new();
    for seed in 0..40 {
        let mut bench = TestBody::facing(4.0, parameters, seed);
        let parts = bench.parts();
        let mut driver = Us100::new(parts.ranger);
        let told = bench
            .run(driver.measure(&parts.clock, AIR))
            .expect("in reach");
        let warm = bench
            .run(driver.temperature(&parts.clock))
            .expect("it answers");
        let off_c = f32::from(warm.0 - 22);
        // 0.606 m/s of 344.6 m/s for each degree.
        let want = 4_000.0 * (1.0 + 0.606 / 344.6 * off_c);
        // The thermometer tells whole degrees, which are 7 mm there.
        assert!((f32::from(told.0) - want).abs() < 4.5, "{told:?} {warm:?}");
        errors.push(off_c);
        let mut pulse = parameters;
        pulse.ranger.wiring = Wiring::Pulse;
        let mut bench = TestBody::facing(4.0, pulse, seed);
        let parts = bench.parts();
        let mut driver = Us100::new(parts.ranger);
        let told = bench
            .run(driver.measure(&parts.clock, AIR))
            .expect("in reach");
        assert!(told.0.abs_diff(4_000) <= 2, "{told:?}");
    }
    let spread = (errors.iter().map(|e| e * e).sum::<f32>() / 40.0).sqrt();
    assert!((3.5..6.5).contains(&spread), "{spread}");
}

#[test]
fn converters_differ_and_count_in_steps() {
    let mut parameters = exact();
    parameters.gauge.noise_mv = 0.0;
    parameters.gauge.step_mv = 20.0;
    parameters.spread.gauge_gain = 0.01;
    parameters.spread.gauge_offset_mv = 10.0;
    let read = |parameters: Parameters, seed| {
        let mut bench = TestBody::facing(3.0, parameters, seed);
        let mut parts = bench.parts();
        bench.run(parts.battery.read()).expect("powered").0
    };
    let truth = read(
        Parameters {
            spread: Spread::NONE,
            ..parameters
        },
        0,
    );
    let told: Vec<u16> = (0..60).map(|seed| read(parameters, seed)).collect();
    assert!(told.iter().all(|mv| mv % 20 == 0), "{told:?}");
    let off = |mv: &u16| f32::from(*mv) - f32::from(truth);
    let spread = (told.iter().map(|mv| off(mv) * off(mv)).sum::<f32>() / 60.0).sqrt();
    // 1 % of 2.6 V and 10 mV together are 28 mV, and the steps add 6 mV.
    assert!((18.0..40.0).contains(&spread), "{spread}");
    assert_eq!(
        read(parameters, 7),
        read(parameters, 7),
        "once for each robot"
    );
}
