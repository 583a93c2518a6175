//! The serial line and the pins under abuse.

use embedded_hal::digital::{InputPin, OutputPin};
use embedded_hal_async::digital::Wait;
use embedded_io_async::{Read, Write};

use super::*;
use crate::world::Wiring;

fn uart(bench: &mut TestBody) -> (SimUart, SimClock) {
    let parts = bench.parts();
    match parts.ranger {
        RangerPort::Uart(uart) => (uart, parts.clock),
        RangerPort::Pulse { .. } => panic!("wired for serial"),
    }
}

/// A robot 1 m in front of a post, its ranger wired for pulses.
fn pins() -> (TestBody, SimTrigger, SimEcho, SimClock) {
    let mut parameters = exact();
    parameters.ranger.wiring = Wiring::Pulse;
    let mut bench = TestBody::facing(1.0, parameters, 1);
    let parts = bench.parts();
    match parts.ranger {
        RangerPort::Pulse { trigger, echo } => (bench, trigger, echo, parts.clock),
        RangerPort::Uart(_) => panic!("wired for pulses"),
    }
}

/// All that arrives within `ms`.
async fn gather(uart: &mut SimUart, clock: &SimClock, ms: u64) -> Vec<u8> {
    let until = clock.now() + Duration::from_millis(ms);
    let mut all = Vec::new();
    let mut some = [0; 8];
    while let Ok(read) = crawler_hal::with_deadline(clock, until, uart.read(&mut some)).await {
        all.extend_from_slice(&some[..read.expect("connected")]);
    }
    all
}

#[test]
fn the_sensor_ignores_what_it_does_not_know() {
    let mut bench = TestBody::facing(1.0, exact(), 1);
    let (mut uart, clock) = uart(&mut bench);
    bench.run(async {
        let garbage: Vec<u8> = (0..=255).filter(|b| ![0x55, 0x50].contains(b)).collect();
        uart.write_all(&garbage).await.expect("connected");
        assert!(gather(&mut uart, &clock, 400).await.is_empty());
        uart.write_all(&[0x50]).await.expect("connected");
        assert_eq!(gather(&mut uart, &clock, 50).await, [22 + 45]);
    });
}

#[test]
fn requests_during_a_measurement_are_not_answered() {
    let mut bench = TestBody::facing(1.0, exact(), 1);
    let (mut uart, clock) = uart(&mut bench);
    bench.run(async {
        uart.write_all(&[0x55, 0x55, 0x50, 0x55])
            .await
            .expect("connected");
        assert_eq!(
            gather(&mut uart, &clock, 100).await,
            1_000_u16.to_be_bytes(),
            "one answer to four requests"
        );
    });
}

#[test]
fn bytes_take_their_time_and_the_transmitter_has_an_end() {
    let mut bench = TestBody::facing(1.0, exact(), 1);
    let (mut uart, clock) = uart(&mut bench);
    bench.run(async {
        let some = uart.write(&[0; 4_000]).await.expect("connected");
        assert!((128..=129).contains(&some), "{some}");
        assert_eq!(clock.now(), Instant::BOOT, "into the FIFO at once");
        uart.flush().await.expect("connected");
        assert_eq!(clock.now().as_micros(), some as u64 * 1_042);
        let before = clock.now();
        uart.write_all(&[0; 400]).await.expect("connected");
        uart.flush().await.expect("connected");
        assert_eq!((clock.now() - before).as_micros(), 400 * 1_042);
    });
}

#[test]
fn a_dropped_read_takes_no_byte_and_an_unread_line_does_not_grow() {
    let mut bench = TestBody::facing(0.5, exact(), 1);
    let (mut uart, clock) = uart(&mut bench);
    let kept = bench.run(async {
        for _ in 0..200 {
            uart.write_all(&[0x55]).await.expect("connected");
            let soon = clock.now() + Duration::from_micros(10);
            assert!(
                crawler_hal::with_deadline(&clock, soon, uart.flush())
                    .await
                    .is_err()
            );
            clock.sleep(Duration::from_millis(20)).await;
        }
        gather(&mut uart, &clock, 100).await
    });
    assert_eq!(kept.len(), 128, "as many as the FIFO holds");
    for pair in kept.chunks(2) {
        assert_eq!(pair, 500_u16.to_be_bytes());
    }
    let (mut uart, clock) = (uart, clock);
    bench.run(async {
        uart.write_all(&[0x55]).await.expect("connected");
        for _ in 0..10 {
            let soon = clock.now() + Duration::from_micros(300);
            let cut = crawler_hal::with_deadline(&clock, soon, uart.read(&mut [0; 2])).await;
            assert!(cut.is_err(), "nothing yet");
        }
        assert_eq!(
            gather(&mut uart, &clock, 20).await,
            500_u16.to_be_bytes(),
            "the cut reads took nothing"
        );
    });
}

#[test]
fn a_reset_body_is_disconnected_and_its_line_empty() {
    let mut bench = TestBody::facing(1.0, exact(), 1);
    let (mut old, _) = uart(&mut bench);
    bench
        .run(async { old.write_all(&[0x55]).await })
        .expect("connected");
    let robot = bench.robot;
    bench.parts = bench.world.boot(robot, crawler_hal::ResetCause::External);
    let (mut uart, clock) = uart(&mut bench);
    bench.run(async {
        assert!(old.write(&[0x55]).await.is_err());
        assert!(old.read(&mut [0]).await.is_err());
        assert_eq!(clock.now(), Instant::BOOT);
        assert!(gather(&mut uart, &clock, 100).await.is_empty());
    });
}

#[test]
fn a_trigger_too_short_or_too_early_starts_nothing() {
    let (mut bench, mut trigger, mut echo, clock) = pins();
    bench.run(async {
        let pulse = async |trigger: &mut SimTrigger, us: u64| {
            trigger.set_high().expect("infallible");
            clock.sleep(Duration::from_micros(us)).await;
            trigger.set_low().expect("infallible");
        };
        pulse(&mut trigger, 9).await;
        let soon = clock.now() + Duration::from_millis(100);
        let none = crawler_hal::with_deadline(&clock, soon, echo.wait_for_high()).await;
        assert!(none.is_err(), "too short");

        pulse(&mut trigger, 10).await;
        assert!(echo.is_low().expect("infallible"));
        echo.wait_for_rising_edge().await.expect("infallible");
        assert!(echo.is_high().expect("infallible"));
        let rise = clock.now();
        // While it measures, another trigger is not heard.
        pulse(&mut trigger, 20).await;
        echo.wait_for_falling_edge().await.expect("infallible");
        let width = clock.now() - rise;
        // 2 m of sound at 344.6 m/s.
        assert!(width.as_micros().abs_diff(5_803) <= 2, "{width:?}");
        let soon = clock.now() + Duration::from_millis(100);
        let none = crawler_hal::with_deadline(&clock, soon, echo.wait_for_any_edge()).await;
        assert!(none.is_err(), "one pulse for each trigger heard");
    });
}

#[test]
fn a_waiter_that_came_before_the_trigger_is_woken() {
    let (mut bench, mut trigger, mut echo, clock) = pins();
    bench.scheduler.spawn(async move {
        clock.sleep(Duration::from_millis(5)).await;
        trigger.set_high().expect("infallible");
        clock.sleep(Duration::from_micros(10)).await;
        trigger.set_low().expect("infallible");
    });
    bench
        .run(async { echo.wait_for_high().await })
        .expect("infallible");
    assert_eq!(bench.scheduler.now().as_micros(), 5_000 + 10 + 200);
}

#[test]
fn a_reader_wakes_once_for_a_whole_reply_and_at_once_for_what_is_there() {
    let mut bench = TestBody::facing(1.0, exact(), 1);
    let (mut uart, clock) = uart(&mut bench);
    bench.run(async {
        let mut reply = [0; 8];
        uart.write_all(&[0x55]).await.expect("connected");
        assert_eq!(
            uart.read(&mut reply[..2]).await,
            Ok(2),
            "both bytes at once"
        );
        let whole = clock.now();
        assert_eq!(reply[..2], 1_000_u16.to_be_bytes());

        clock.sleep(Duration::from_millis(100)).await;
        let asked = clock.now();
        uart.write_all(&[0x55]).await.expect("connected");
        assert_eq!(uart.read(&mut reply[..1]).await, Ok(1));
        let first = clock.now() - asked;
        assert_eq!(uart.read(&mut reply[1..2]).await, Ok(1));
        assert_eq!(clock.now() - asked, first + uart::BYTE_TIME);
        assert_eq!(
            clock.now() - asked,
            whole - Instant::BOOT,
            "as early as the last byte"
        );

        clock.sleep(Duration::from_millis(100)).await;
        uart.write_all(&[0x55]).await.expect("connected");
        clock.sleep(first).await;
        assert_eq!(
            uart.read(&mut reply).await,
            Ok(1),
            "no waiting for the second"
        );
    });
}
