//! The driver against a sensor made of registers and frames.

mod bench;
mod streams;

use std::vec;

use crawler_hal::{Camera, CameraError, CameraErrorKind, Clock, FrameFormat};

use super::registers::{self, BANK, Mode, Window, Write};
use super::*;
use bench::{Bench, JPEG, Scene};

const PIXELS: usize = 96 * 96;

#[test]
fn a_grey_frame_is_the_luma_of_a_whole_frame() {
    let bench = Bench::new(Scene::Good);
    let mut camera = bench.camera(FrameFormat::Grey8);
    assert_eq!(camera.size(), (96, 96));
    let mut frame = vec![0; PIXELS];
    for _ in 0..2 {
        frame.fill(0);
        bench.run(camera.capture(&mut frame)).expect("a frame");
        let right = frame.iter().enumerate().all(|(i, &y)| y == (i % 251) as u8);
        assert!(right, "{:?}", &frame[..16]);
    }
}

#[test]
fn a_colour_frame_is_taken_as_it_comes() {
    let bench = Bench::new(Scene::Good);
    let mut camera = bench.camera(FrameFormat::Rgb565);
    assert_eq!(camera.format(), FrameFormat::Rgb565);
    let mut frame = vec![0; 2 * PIXELS];
    bench.run(camera.capture(&mut frame)).expect("a frame");
    assert!(frame.iter().enumerate().all(|(i, &b)| b == (i % 241) as u8));
    assert_eq!(
        bench.run(camera.capture(&mut frame[1..])),
        Err(Error::Length)
    );
}

#[test]
fn a_still_is_the_jpeg_without_its_padding() {
    let bench = Bench::new(Scene::Good);
    let mut camera = bench.camera(FrameFormat::Grey8);
    let mut jpeg = [0; 64];
    let len = bench.run(camera.still(&mut jpeg)).expect("a still");
    assert_eq!(&jpeg[..len], JPEG);
    let mut tight = [0; JPEG.len()];
    assert_eq!(bench.run(camera.still(&mut tight)), Ok(JPEG.len()));
    let mut short = [0xA5; JPEG.len()];
    let least = JPEG.len() - 1;
    let result = bench.run(camera.still(&mut short[..least]));
    assert_eq!(result, Err(Error::TooLarge));
    assert_eq!(short[least], 0xA5, "written beyond the buffer");
    // Too large is no fault: the next still needs no new set-up.
    let resets = bench.resets();
    assert_eq!(bench.run(camera.still(&mut jpeg)), Ok(JPEG.len()));
    assert_eq!(bench.resets(), resets);
}

#[test]
fn a_mode_is_set_once_and_settles_before_it_counts() {
    let bench = Bench::new(Scene::Good);
    let mut camera = bench.camera(FrameFormat::Grey8);
    let mut frame = vec![0; PIXELS];
    let mut jpeg = [0; 64];
    bench.run(camera.capture(&mut frame)).expect("a frame");
    let (writes, resets) = (bench.writes().len(), bench.resets());
    assert_eq!(resets, 1);
    let settled = bench.frames();
    assert!(settled > u32::from(SETTLE_AT_START), "{settled}");
    bench.run(camera.capture(&mut frame)).expect("a frame");
    assert_eq!(bench.writes().len(), writes, "nothing to set");
    assert_eq!(bench.frames() - settled, 2, "the one under way, and one");
    let before = bench.frames();
    bench.run(camera.still(&mut jpeg)).expect("a still");
    assert_eq!(bench.frames() - before, 2 + u32::from(SETTLE_AT_SWITCH));
    assert_eq!(bench.resets(), 1);
    assert!(!bench.is_listening(), "the port rests between pictures");
}

#[test]
fn an_absent_sensor_is_told_at_once_and_found_again() {
    let bench = Bench::new(Scene::Absent);
    let mut camera = bench.camera(FrameFormat::Grey8);
    let mut jpeg = [0; 64];
    let error = bench.run(camera.still(&mut jpeg)).expect_err("no sensor");
    assert_eq!(error, Error::Absent);
    assert_eq!(error.kind(), CameraErrorKind::Absent);
    assert_eq!(bench.run(camera.probe()), Err(Error::Absent));
    bench.set(Scene::Good);
    assert_eq!(bench.run(camera.probe()), Ok((0x26, 0x42)));
    assert_eq!(bench.run(camera.still(&mut jpeg)), Ok(JPEG.len()));
    bench.set(Scene::Stranger);
    bench.forget();
    let mut stranger = bench.camera(FrameFormat::Grey8);
    let error = bench.run(stranger.still(&mut jpeg));
    assert_eq!(error, Err(Error::Unknown(0x77)));
    assert!(bench.writes().len() <= 1, "a stranger is left alone");
}

#[test]
fn a_sensor_that_stalls_is_given_up_in_time_and_set_up_anew() {
    let bench = Bench::new(Scene::Good);
    let mut camera = bench.camera(FrameFormat::Grey8);
    let mut frame = vec![0; PIXELS];
    bench.run(camera.capture(&mut frame)).expect("a frame");
    for (scene, error) in [
        (Scene::Silent, Error::Stalled),
        // Pixels without end.
        (Scene::Endless, Error::Stalled),
        // Frames that are never whole.
        (Scene::Torn, Error::Garbled),
        (Scene::Overlong, Error::Garbled),
        (Scene::Overrun, Error::Stalled),
        // The bus hangs.
        (Scene::Stuck, Error::Stalled),
    ] {
        bench.set(scene);
        let start = bench.clock.now();
        if scene == Scene::Stuck {
            // Only a set-up needs the bus.
            camera = bench.camera(FrameFormat::Grey8);
        }
        assert_eq!(
            bench.run(camera.capture(&mut frame)),
            Err(error),
            "{scene:?}"
        );
        let took = bench.clock.now() - start;
        assert!(took <= PICTURE_WITHIN, "{scene:?} took {took:?}");
        bench.set(Scene::Good);
        let resets = bench.resets();
        bench.run(camera.capture(&mut frame)).expect("well again");
        assert_eq!(bench.resets(), resets + 1);
    }
}

#[test]
fn a_torn_frame_costs_a_frame_and_no_more() {
    let bench = Bench::new(Scene::EveryOtherTorn);
    let mut camera = bench.camera(FrameFormat::Grey8);
    let mut frame = vec![0; PIXELS];
    for _ in 0..4 {
        bench.run(camera.capture(&mut frame)).expect("a frame");
        assert!(frame.iter().enumerate().all(|(i, &y)| y == (i % 251) as u8));
    }
    let mut jpeg = [0; 64];
    let len = bench.run(camera.still(&mut jpeg)).expect("a still");
    assert_eq!(&jpeg[..len], JPEG);
}

#[test]
fn a_dropped_call_leaves_a_camera_that_works() {
    let bench = Bench::new(Scene::Good);
    let mut camera = bench.camera(FrameFormat::Grey8);
    let mut frame = vec![0; PIXELS];
    for polls in [0, 1, 3, 20, 100, 200] {
        bench.poll_and_drop(camera.capture(&mut frame), polls);
        bench.run(camera.capture(&mut frame)).expect("a frame");
        assert!(frame.iter().enumerate().all(|(i, &y)| y == (i % 251) as u8));
    }
}

#[test]
fn windows_become_the_registers_of_the_data_sheet() {
    let value = |window: &Window, register| {
        let all = window.registers();
        let found = all.iter().find(|write| write.0 == register);
        found.expect("a register of the window").1
    };
    let still = Window::STILL;
    for (register, expected) in [
        (0x51, 96),
        (0x52, 72),
        (0x53, 8),
        (0x54, 4),
        (0x55, 0),
        (0x57, 0),
        (0x5A, 80),
        (0x5B, 60),
        (0x5C, 0),
    ] {
        assert_eq!(value(&still, register), expected, "0x{register:02x}");
    }
    // All upper bits at once: no sensor is that large, the arithmetic is.
    let huge = Window {
        x: 0x7FF,
        y: 0x7FF,
        width: 0x3FF * 4,
        height: 0x1FF * 4,
        out_width: 0x3FF * 4,
        out_height: 0x1FF * 4,
    };
    assert_eq!(value(&huge, 0x55), 0xFF);
    assert_eq!(value(&huge, 0x57), 0x80);
    assert_eq!(value(&huge, 0x5C), 0x07);
    assert!(!huge.is_possible());
    for impossible in [
        Window { x: 20, ..still },
        Window { y: 12, ..still },
        Window {
            out_width: 388,
            ..still
        },
        Window {
            out_width: 0,
            ..still
        },
        Window {
            width: 382,
            ..still
        },
    ] {
        assert!(!impossible.is_possible(), "{impossible:?}");
    }
}

#[test]
fn every_write_is_to_a_documented_register_of_the_bank_it_belongs_to() {
    // Data sheet, tables 12 and 13, as far as this driver uses them.
    let dsp = [
        0x05, 0x44, 0x51, 0x52, 0x53, 0x54, 0x55, 0x57, 0x5A, 0x5B, 0x5C, 0x86, 0x87, 0x8C, 0xC0,
        0xC1, 0xC2, 0xC3, 0xD3, 0xDA, 0xE0,
    ];
    let sensor = [
        0x03, 0x09, 0x11, 0x12, 0x13, 0x15, 0x17, 0x18, 0x19, 0x1A, 0x32,
    ];
    for mode in [Mode::Jpeg, Mode::Grey, Mode::Rgb565] {
        let mut bank = None;
        let mut held = false;
        for Write(register, value) in registers::common().chain(registers::mode(mode)) {
            match (register, bank) {
                (BANK, _) => bank = Some(value),
                (_, Some(registers::BANK_DSP)) => assert!(dsp.contains(&register)),
                (_, Some(registers::BANK_SENSOR)) => assert!(sensor.contains(&register)),
                _ => panic!("0x{register:02x} written before a bank was chosen"),
            }
            if register == 0xE0 && bank == Some(registers::BANK_DSP) {
                held = value != 0;
            }
        }
        assert!(!held, "{mode:?} leaves the DSP in reset");
    }
}
