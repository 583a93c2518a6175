//! Pulse mode.

use std::collections::BTreeSet;

use crawler_hal::{Celsius, Clock, Duration, Millimeters};

use super::{AIR, classified, link, measure, with_pulses};
use crate::testing::TestClock;
use crate::us100::{
    COLDEST, CORRECTED, FARTHEST, LinkError, REPLY_TIMEOUT, TemperatureError, WARMEST, echo_range,
    echo_width, speed_of_sound_mm_per_s,
};

#[test]
fn every_range_as_an_echo() {
    for air in COLDEST.0..=WARMEST.0 {
        for range in (0..=FARTHEST.0 + 500).map(Millimeters) {
            assert_eq!(
                echo_range(echo_width(range, Celsius(air)), Celsius(air)),
                range
            );
        }
    }
}

#[test]
fn sound_has_its_speed() {
    // Worked by hand: 2 m at 331.3, 343.42 and 319.18 m/s.
    for (air, us) in [(0, 6_037), (20, 5_824), (-20, 6_266)] {
        assert_eq!(
            echo_range(Duration::from_micros(us), Celsius(air)),
            Millimeters(1_000)
        );
    }
    for air in -20..=70_i16 {
        let exact = 331_300.0 * (1.0 + f64::from(air) / 273.15).sqrt();
        let error = (f64::from(speed_of_sound_mm_per_s(Celsius(air))) / exact - 1.0).abs();
        assert!(
            error < if air <= 35 { 0.002 } else { 0.007 },
            "{air} °C: {error}"
        );
    }
    assert!(speed_of_sound_mm_per_s(CORRECTED).abs_diff(340_000) < 340);
    // No temperature, however absurd, makes it stop or turn round.
    let speeds: BTreeSet<u32> = (i16::MIN..=i16::MAX)
        .map(|air| speed_of_sound_mm_per_s(Celsius(air)))
        .collect();
    assert_eq!(speeds.first(), Some(&319_180));
    assert_eq!(speeds.last(), Some(&373_720));
    assert_eq!(
        echo_range(Duration::from_micros(u64::MAX), AIR),
        Millimeters(u16::MAX)
    );
}

#[test]
fn every_echo_width_over_the_pins() {
    let clock = TestClock::default();
    let (sensor, mut ranger) = with_pulses(&clock);
    // Wider than the farthest by far, in steps finer than a millimetre.
    for width_us in (1..=50_000).step_by(5) {
        let width = Duration::from_micros(width_us);
        sensor.echoes_after(Duration::from_micros(300), width);
        let want = classified(echo_range(width, AIR).0);
        assert_eq!(measure(&clock, &mut ranger), want, "{width_us} µs");
    }
    assert!(sensor.shortest_trigger() >= Duration::from_micros(10));
    let temperature = clock.block_on(ranger.temperature(&clock));
    assert_eq!(temperature, Err(TemperatureError::NotWired));
}

#[test]
fn a_warmer_air_makes_the_same_echo_farther() {
    let clock = TestClock::default();
    let (sensor, mut ranger) = with_pulses(&clock);
    sensor.echoes_after(Duration::from_micros(300), Duration::from_micros(5_824));
    let mut at = |air| clock.block_on(ranger.measure(&clock, Celsius(air)));
    assert_eq!(at(0), Ok(Millimeters(965)));
    assert_eq!(at(20), Ok(Millimeters(1_000)));
    assert_eq!(at(40), Ok(Millimeters(1_035)));
}

#[test]
fn an_echo_that_never_comes_is_a_timeout() {
    let clock = TestClock::default();
    let (_sensor, mut ranger) = with_pulses(&clock);
    let start = clock.now();
    assert_eq!(measure(&clock, &mut ranger), link(LinkError::Timeout));
    assert_eq!(clock.now() - start, REPLY_TIMEOUT);
}

#[test]
fn an_echo_that_never_falls_is_stuck() {
    let clock = TestClock::default();
    let (sensor, mut ranger) = with_pulses(&clock);
    sensor.echoes_after(Duration::from_micros(300), Duration::from_millis(200));
    assert_eq!(measure(&clock, &mut ranger), link(LinkError::EchoStuck));
    // Still high: no use in waiting, or in triggering again.
    let start = clock.now();
    let triggers = sensor.triggers();
    assert_eq!(measure(&clock, &mut ranger), link(LinkError::EchoStuck));
    assert_eq!(
        (clock.now() - start, sensor.triggers()),
        (Duration::ZERO, triggers)
    );
    // It was the sensor's way of saying that there is nothing: it recovers.
    clock.pass(Duration::from_millis(200));
    sensor.echoes_after(Duration::from_micros(300), Duration::from_micros(5_824));
    assert_eq!(measure(&clock, &mut ranger), Ok(Millimeters(1_000)));
}

#[test]
fn a_trigger_left_high_is_lowered_first() {
    let clock = TestClock::default();
    let (sensor, mut ranger) = with_pulses(&clock);
    sensor.echoes_after(Duration::from_micros(300), Duration::from_micros(5_824));
    let cut = clock.now() + Duration::from_micros(3);
    let cut_off = crawler_hal::with_deadline(&clock, cut, ranger.measure(&clock, AIR));
    assert!(clock.block_on(cut_off).is_err());
    // What was left high ends as a trigger of its own; its echo is not the next one's.
    assert_eq!(measure(&clock, &mut ranger), Ok(Millimeters(1_000)));
    assert_eq!(sensor.triggers(), 2);
}

#[test]
fn pins_that_refuse_are_told() {
    for broken in 0..3 {
        let clock = TestClock::default();
        let (sensor, mut ranger) = with_pulses(&clock);
        sensor.echoes_after(Duration::from_micros(300), Duration::from_micros(5_824));
        sensor.break_part(broken);
        assert_eq!(
            measure(&clock, &mut ranger),
            link(LinkError::Pin),
            "part {broken}"
        );
    }
}
