//! The body under the shipped drivers.

use crawler_drivers::us100::{RangeError, Us100};
use crawler_hal::{Adc, Celsius, Clock, Instant, RangerPort};
use embassy_futures::block_on;
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embedded_hal::digital::OutputPin;
use embedded_hal::pwm::SetDutyCycle;
use proptest::prelude::*;

use super::*;
use crate::clock::testing::TestClock;

type Body = Bench<NoopRawMutex>;
type Ranger<'b> = Us100<ModelUart<'b, NoopRawMutex, TestClock>, ModelEcho, ModelEcho>;

fn ranger<'b>(body: &'b Body, clock: &TestClock) -> Ranger<'b> {
    Us100::new(RangerPort::Uart(body.uart(clock.clone())))
}

fn forward(body: &Body, duty: u16) {
    for side in [Side::Left, Side::Right] {
        body.pwm(side).set_duty_cycle(duty).expect("in range");
        body.pin(Line::In1(side)).set_high().expect("a pin");
        body.pin(Line::In2(side)).set_low().expect("a pin");
    }
}

#[test]
fn names_place_robots_apart_and_again() {
    let place = |name| Body::new(name, LineFault::None).truth().pose;
    assert_eq!(place("virt-01"), place("virt-01"));
    assert_ne!(place("virt-01"), place("virt-02"));
}

#[test]
fn it_drives_as_fast_as_its_geometry_says() {
    let body = Body::new("a", LineFault::None);
    forward(&body, 255);
    body.advance(Instant::from_millis(600));
    let speeds = body.with_world(|world| world.drive.speeds());
    let pack = crawler_hal::Millivolts(body.truth().pack_mv);
    let expected = GEOMETRY.at(pack).top_speed_mps;
    for speed in speeds {
        assert!(
            (speed / expected - 1.0).abs() < 0.08,
            "{speed} of {expected}"
        );
    }
}

#[test]
fn the_pack_sags_under_load_and_the_gauge_sees_it() {
    let body = Body::new("a", LineFault::None);
    body.advance(Instant::from_millis(100));
    let rest = body.truth().pack_mv;
    forward(&body, 255);
    body.advance(Instant::from_millis(150));
    let loaded = body.truth().pack_mv;
    assert!(rest - loaded > 50, "{rest} then {loaded}");
    let told = block_on(body.gauge().read()).expect("always");
    let pack = f32::from(told.0) * 147.0 / 47.0;
    assert!(
        (pack - f32::from(loaded)).abs() < 60.0,
        "{pack} for {loaded}"
    );
}

#[test]
fn the_ranger_tells_the_wall_ahead_and_the_air() {
    let body = Body::new("virt-01", LineFault::None);
    body.with_world(|world| world.drive = Drive::at(0.5, 0.0, 0.0));
    let clock = TestClock::default();
    let mut ranger = ranger(&body, &clock);
    clock.run(async {
        let mut best = u16::MAX;
        // One echo in two hundred is lost.
        for _ in 0..3 {
            if let Ok(range) = ranger.measure(&clock, Celsius(20)).await {
                best = best.min(range.0);
            }
        }
        assert!(best.abs_diff(1_440) < 20, "{best} mm");
        assert_eq!(ranger.temperature(&clock).await, Ok(Celsius(22)));
    });
}

#[test]
fn an_absent_ranger_and_a_stuck_line_are_told_as_such() {
    use crawler_drivers::us100::LinkError;
    for (fault, error) in [
        (LineFault::Absent, LinkError::Timeout),
        (LineFault::Stuck, LinkError::Noise),
    ] {
        let body = Body::new("a", fault);
        let clock = TestClock::default();
        let mut ranger = ranger(&body, &clock);
        let told = clock.run(ranger.measure(&clock, Celsius(20)));
        assert_eq!(told, Err(RangeError::Link(error)), "{fault:?}");
        assert!(clock.now() < Instant::from_millis(100), "{fault:?}");
    }
}

#[test]
fn time_lost_by_the_board_is_not_made_up_for_without_end() {
    let body = Body::new("a", LineFault::None);
    forward(&body, 60);
    body.advance(Instant::from_millis(3_600_000));
    assert_eq!(
        body.with_world(|world| world.at),
        Instant::from_millis(3_600_000)
    );
}

proptest! {
    #![proptest_config(crawler_properties::cases(64))]
    #[test]
    fn whatever_is_driven_it_stays_in_its_room(
        name in "[a-z]{1,8}",
        levels in prop::collection::vec((any::<[u8; 2]>(), any::<[bool; 4]>()), 1..40),
    ) {
        let body = Body::new(&name, LineFault::None);
        let mut now = Instant::BOOT;
        for ([left, right], pins) in levels {
            body.drive_pins(|levels| {
                levels.bridges = [
                    Bridge { duty: left, in1: pins[0], in2: pins[1] },
                    Bridge { duty: right, in1: pins[2], in2: pins[3] },
                ];
            });
            now += Duration::from_millis(200);
            body.advance(now);
            let [x, y, theta] = body.truth().pose;
            prop_assert!(x.abs() <= ROOM_M[0] * 0.5 && y.abs() <= ROOM_M[1] * 0.5);
            prop_assert!(theta.is_finite() && theta.abs() <= core::f32::consts::PI + 1e-3);
            let (distance, _) = body.with_world(|world| world.drive.wall(0.06, 0.0));
            prop_assert!((0.0..6.0).contains(&distance));
        }
    }
}
