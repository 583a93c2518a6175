//! The shipped US-100 driver against the model.

use crawler_drivers::us100::{FARTHEST, LinkError, NEAREST, REPLY_TIMEOUT, RangeError, Us100};
use crawler_hal::{Celsius, Millimeters};

use super::*;
use crate::faults::Fault;
use crate::world::Wiring;

const AIR: Celsius = Celsius(22);

fn wired(wiring: Wiring, mut parameters: Parameters) -> Parameters {
    parameters.ranger.wiring = wiring;
    parameters
}

fn measure(bench: &mut TestBody) -> Result<Millimeters, RangeError> {
    let parts = bench.parts();
    let mut driver = Us100::new(parts.ranger);
    let clock = parts.clock;
    bench.run(async { driver.measure(&clock, AIR).await })
}

#[test]
fn both_wirings_tell_every_distance_to_the_millimetre() {
    for wiring in [Wiring::Uart, Wiring::Pulse] {
        let mut mm = 26.0_f32;
        while mm < 4_500.0 {
            let mut bench = TestBody::facing(mm * 1e-3, wired(wiring, exact()), 1);
            let told = measure(&mut bench).expect("something is there");
            assert!(
                (f32::from(told.0) - mm).abs() <= 1.5,
                "{wiring:?}: {told:?} at {mm} mm"
            );
            mm += 43.7;
        }
    }
}

#[test]
fn errors_have_the_size_the_world_says() {
    for (distance_mm, deviation) in [(300.0, 2.6), (1_500.0, 5.0), (4_000.0, 10.0)] {
        let mut parameters = exact();
        parameters.ranger.noise_mm = 2.0;
        parameters.ranger.noise_share = 0.002;
        let mut bench = TestBody::facing(distance_mm * 1e-3, parameters, 11);
        let parts = bench.parts();
        let mut driver = Us100::new(parts.ranger);
        let clock = parts.clock;
        let count = 400_u16;
        let mut errors = Vec::new();
        for _ in 0..count {
            let told = bench.run(driver.measure(&clock, AIR)).expect("in reach");
            errors.push(f32::from(told.0) - distance_mm);
        }
        let mean = errors.iter().sum::<f32>() / f32::from(count);
        let spread =
            (errors.iter().map(|e| (e - mean) * (e - mean)).sum::<f32>() / f32::from(count)).sqrt();
        assert!(mean.abs() < 0.2 * deviation, "{mean} at {distance_mm}");
        assert!(
            (spread / deviation - 1.0).abs() < 0.15,
            "{spread} at {distance_mm}"
        );
        assert!(errors.iter().all(|e| e.abs() < 5.0 * deviation));
    }
}

#[test]
fn nothing_in_reach_is_told_late_and_as_nothing() {
    for wiring in [Wiring::Uart, Wiring::Pulse] {
        let mut bench = TestBody::facing(6.0, wired(wiring, exact()), 1);
        let error = measure(&mut bench).expect_err("nothing in reach");
        assert!(
            matches!(error, RangeError::NoEcho(mm) if mm > FARTHEST),
            "{wiring:?}: {error:?}"
        );
        let now = bench.scheduler.now();
        assert!(now > Instant::from_millis(50), "the window passes first");
        assert!(now < Instant::BOOT + REPLY_TIMEOUT);
    }
}

#[test]
fn an_echo_takes_its_time() {
    // 2 m: the request, 11.6 ms of flight at 344.6 m/s, and two bytes.
    let mut bench = TestBody::facing(2.0, exact(), 1);
    let parts = bench.parts();
    let RangerPort::Uart(mut uart) = parts.ranger else {
        panic!("wired for serial")
    };
    bench.run(async {
        use embedded_io_async::{Read, Write};
        uart.write_all(&[0x55]).await.expect("connected");
        let mut first = [0];
        uart.read_exact(&mut first).await.expect("connected");
        assert_eq!(parts.clock.now().as_micros(), 1_042 + 11_607 + 1_042);
        let mut second = [0];
        uart.read_exact(&mut second).await.expect("connected");
        assert_eq!(parts.clock.now().as_micros(), 1_042 + 11_607 + 2_084);
        assert_eq!(u16::from_be_bytes([first[0], second[0]]), 2_000);
    });
}

#[test]
fn the_temperature_is_that_of_the_air() {
    for air in [-20.0_f32, -0.4, 22.0, 70.0] {
        let mut parameters = exact();
        parameters.surroundings.air_c = air;
        let mut bench = TestBody::facing(1.0, parameters, 1);
        let parts = bench.parts();
        let mut driver = Us100::new(parts.ranger);
        let told = bench
            .run(driver.temperature(&parts.clock))
            .expect("it answers");
        assert_eq!(told, Celsius(libm::roundf(air) as i16));
    }
}

#[test]
fn pulses_depend_on_the_air_and_the_driver_corrects_for_it() {
    let mut parameters = wired(Wiring::Pulse, exact());
    parameters.surroundings.air_c = -10.0;
    let told = |air: Celsius| {
        let mut bench = TestBody::facing(2.0, parameters, 1);
        let parts = bench.parts();
        let mut driver = Us100::new(parts.ranger);
        bench
            .run(driver.measure(&parts.clock, air))
            .expect("in reach")
            .0
    };
    assert!(told(Celsius(-10)).abs_diff(2_000) <= 1);
    assert!(told(Celsius(22)) > 2_080, "uncorrected it is 6 % too far");
}

#[test]
fn a_dead_ranger_says_nothing_and_a_stuck_one_always_the_same() {
    for wiring in [Wiring::Uart, Wiring::Pulse] {
        let mut bench = TestBody::facing(1.0, wired(wiring, Parameters::default()), 1);
        let robot = bench.robot;
        let parts = bench.parts();
        let mut driver = Us100::new(parts.ranger);
        let clock = parts.clock;
        bench
            .world
            .inject(robot, Fault::RangerDead)
            .expect("no number in it");
        let dead = bench.run(driver.measure(&clock, AIR));
        assert_eq!(dead, Err(RangeError::Link(LinkError::Timeout)));
        let stuck = Fault::RangerStuck { mm: 777 };
        bench.world.inject(robot, stuck).expect("any distance");
        for _ in 0..5 {
            let told = bench.run(driver.measure(&clock, AIR)).expect("it answers");
            assert!(told.0.abs_diff(777) <= 1, "{wiring:?}: {told:?}");
        }
        bench.world.heal(robot);
        let well = bench.run(driver.measure(&clock, AIR)).expect("it answers");
        assert!(well.0.abs_diff(1_000) < 30, "{wiring:?}: {well:?}");
    }
}

#[test]
fn what_touches_the_front_is_still_told() {
    // The transducers sit behind the rim, so contact is beyond the blind zone.
    let parameters = exact();
    let gap = parameters.chassis.radius_m - parameters.ranger.mount_m + 1e-4;
    let mut bench = TestBody::facing(gap, parameters, 1);
    let told = measure(&mut bench).expect("not in the blind zone");
    assert!(told >= NEAREST && told <= Millimeters(26), "{told:?}");
}

#[test]
fn lost_echoes_come_as_often_as_the_world_says_and_never_break_the_driver() {
    let mut parameters = exact();
    parameters.ranger.dropout = 0.25;
    let mut bench = TestBody::facing(1.0, parameters, 5);
    let parts = bench.parts();
    let mut driver = Us100::new(parts.ranger);
    let mut lost = 0;
    for _ in 0..400 {
        match bench.run(driver.measure(&parts.clock, AIR)) {
            Ok(told) => assert!(told.0.abs_diff(1_000) <= 1),
            Err(RangeError::NoEcho(_)) => lost += 1,
            Err(other) => panic!("{other:?}"),
        }
    }
    assert!((70..130).contains(&lost), "{lost}");
}

#[test]
fn a_noisy_line_costs_readings_and_recovers() {
    let mut bench = TestBody::facing(1.0, exact(), 9);
    let robot = bench.robot;
    let noise = Fault::LineNoise { flips: 0.05 };
    bench.world.inject(robot, noise).expect("a share");
    let parts = bench.parts();
    let mut driver = Us100::new(parts.ranger);
    let readings: Vec<_> = (0..200)
        .map(|_| bench.run(driver.measure(&parts.clock, AIR)))
        .collect();
    let good =
        |r: &Result<Millimeters, RangeError>| matches!(r, Ok(mm) if mm.0.abs_diff(1_000) <= 1);
    let right = readings.iter().filter(|r| good(r)).count();
    // (1 − 0.05)^24 = 29 % of exchanges pass unharmed.
    assert!((30..100).contains(&right), "{right}");
    bench.world.heal(robot);
    // One reply may still be under way.
    let _ = bench.run(driver.measure(&parts.clock, AIR));
    for _ in 0..20 {
        let told = bench.run(driver.measure(&parts.clock, AIR));
        assert!(good(&told), "{told:?}");
    }
}

#[test]
fn a_measurement_does_not_disturb_those_of_another_robot() {
    let ranges = |other_measures: bool| {
        let clock = SimClock::new();
        let mut scheduler = Scheduler::new(&clock);
        let arena = Arena::empty(6.0, 6.0);
        let mut world =
            World::with_parameters(arena, Parameters::default(), 4, &clock).expect("sound");
        let (_, a) = world.add_robot(Pose::new(0.0, 1.0, 0.0)).expect("free");
        let (_, b) = world.add_robot(Pose::new(0.0, -1.0, 0.0)).expect("free");
        let (mut a, mut b) = (Us100::new(a.ranger), Us100::new(b.ranger));
        (0..20)
            .map(|_| {
                let limit = scheduler.now() + Duration::from_secs(1);
                if other_measures {
                    let _ = scheduler.block_on(b.measure(&clock, AIR), limit);
                }
                let limit = scheduler.now() + Duration::from_secs(1);
                scheduler.block_on(a.measure(&clock, AIR), limit)
            })
            .collect::<Vec<_>>()
    };
    assert_eq!(ranges(false), ranges(true));
}
