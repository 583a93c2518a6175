//! Motor pins, battery gauge, camera.

use crawler_drivers::battery::Config;
use crawler_hal::{Adc, Camera};
use embedded_hal::digital::OutputPin;
use embedded_hal::pwm::SetDutyCycle;

use super::*;
use crate::faults::Fault;

#[test]
fn a_duty_beyond_the_maximum_is_refused_and_the_old_one_stays() {
    let mut bench = TestBody::facing(3.0, exact(), 1);
    let robot = bench.robot;
    let mut parts = bench.parts();
    parts.left.in1.set_high().expect("infallible");
    parts.left.enable.set_duty_cycle(77).expect("a duty");
    assert_eq!(parts.left.enable.set_duty_cycle(256), Err(DutyError));
    assert_eq!(bench.world.observe(robot).expect("it exists").duty, [77, 0]);
    assert_eq!(parts.left.enable.max_duty_cycle(), 255);
}

#[test]
fn the_gauge_and_the_driver_agree_on_the_pack() {
    for charge in [0.05, 0.3, 0.7, 1.0] {
        let mut bench = TestBody::facing(3.0, exact(), 1);
        let robot = bench.robot;
        bench
            .world
            .inject(robot, Fault::BatteryAt { charge })
            .expect("a charge");
        bench.world.step();
        let truth = bench.world.observe(robot).expect("it exists").battery.0;
        let mut parts = bench.parts();
        let divider = Config::STANDARD.divider;
        let readings: Vec<u16> = (0..200)
            .map(|_| {
                let pin = bench.run(parts.battery.read()).expect("powered");
                divider.pack(pin).0
            })
            .collect();
        let mean = readings.iter().map(|&mv| u32::from(mv)).sum::<u32>() / 200;
        assert!(mean.abs_diff(u32::from(truth)) < 10, "{mean} {truth}");
        assert!(readings.iter().all(|mv| mv.abs_diff(truth) < 60));
        assert!(
            readings.windows(2).any(|two| two[0] != two[1]),
            "it has noise"
        );
    }
}

fn frame(bench: &mut TestBody) -> Vec<u8> {
    let mut parts = bench.parts();
    let side = usize::from(CAMERA_SIDE);
    let mut frame = vec![0; 2 * side * side];
    assert_eq!(parts.camera.size(), (CAMERA_SIDE, CAMERA_SIDE));
    assert_eq!(
        bench.run(parts.camera.capture(&mut frame[1..])),
        Err(LensError::Length)
    );
    bench
        .run(parts.camera.capture(&mut frame))
        .expect("a whole frame");
    assert!(parts.clock.now() >= Instant::from_millis(33));
    // The six bits of green, as eight.
    let green = |pixel: &[u8]| (pixel[0] & 0x07) << 5 | (pixel[1] & 0xE0) >> 3;
    frame.chunks_exact(2).map(green).collect()
}

/// Rows of a column that differ from the empty arena's picture.
fn changed(frame: &[u8], empty: &[u8], column: usize) -> usize {
    let side = usize::from(CAMERA_SIDE);
    (0..side)
        .filter(|row| frame[row * side + column].abs_diff(empty[row * side + column]) > 10)
        .count()
}

#[test]
fn a_still_is_a_jpeg_of_what_stands_before_the_camera() {
    let look = |obstacles: Vec<Obstacle>| {
        let arena = Arena {
            obstacles,
            ..Arena::empty(8.0, 8.0)
        };
        let mut bench = TestBody::new(arena, exact(), 1, Pose::default());
        let mut parts = bench.parts();
        let mut buffer = vec![0; 16 * 1024];
        let len = bench
            .run(parts.camera.still(&mut buffer))
            .expect("a whole still");
        let least = len - 1;
        assert_eq!(
            bench.run(parts.camera.still(&mut buffer[..least / 2])),
            Err(LensError::TooLarge)
        );
        let mut decoder = jpeg_decoder::Decoder::new(&buffer[..len]);
        let pixels = decoder.decode().expect("a JPEG");
        let info = decoder.info().expect("a header");
        assert_eq!((info.width, info.height), STILL_SIZE);
        assert_eq!(info.pixel_format, jpeg_decoder::PixelFormat::RGB24);
        pixels
            .chunks_exact(3)
            .map(|pixel| pixel[1])
            .collect::<Vec<u8>>()
    };
    let empty = look(Vec::new());
    let post = look(vec![Obstacle::Circle {
        x: 0.7,
        y: 0.2,
        r: 0.1,
    }]);
    let width = usize::from(STILL_SIZE.0);
    let columns: Vec<usize> = (0..width)
        .filter(|column| {
            let rows = 0..usize::from(STILL_SIZE.1);
            let differ = |row: &usize| {
                let at = row * width + column;
                empty[at].abs_diff(post[at]) > 25
            };
            rows.filter(differ).count() > 40
        })
        .collect();
    // It stands 0.2 m to the left at 0.7 m: 79 pixels left of the middle, half as much wide.
    let seen = (columns.first().copied(), columns.last().copied());
    assert!(columns.len() > 50, "{seen:?}");
    assert!(columns.iter().all(|c| (20..140).contains(c)), "{seen:?}");
}

#[test]
fn the_camera_shows_what_stands_before_it_where_it_stands() {
    let look = |obstacles: Vec<Obstacle>| {
        let arena = Arena {
            obstacles,
            ..Arena::empty(8.0, 8.0)
        };
        frame(&mut TestBody::new(arena, exact(), 1, Pose::default()))
    };
    let post = |x, y| Obstacle::Circle { x, y, r: 0.1 };
    let empty = look(Vec::new());
    let near = look(vec![post(0.7, 0.0)]);
    let far = look(vec![post(2.5, 0.0)]);
    assert!(
        changed(&near, &empty, 48) > 25,
        "{}",
        changed(&near, &empty, 48)
    );
    let small = changed(&far, &empty, 48);
    assert!((4..20).contains(&small), "{small}");
    assert_eq!(changed(&near, &empty, 5), 0, "it does not fill the picture");
    let left = look(vec![post(0.7, 0.3)]);
    let columns: Vec<usize> = (0..96)
        .filter(|&column| changed(&left, &empty, column) > 20)
        .collect();
    assert!(
        columns.iter().all(|&column| column < 40) && columns.len() > 10,
        "what stands left is seen left: {columns:?}"
    );
    let behind = look(vec![post(-0.7, 0.0)]);
    assert_eq!(
        (0..96).map(|c| changed(&behind, &empty, c)).sum::<usize>(),
        0
    );
}
