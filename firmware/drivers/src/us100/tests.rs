use proptest::prelude::*;

use super::*;
use crate::testing::TestClock;

mod line;
mod pins;
mod pulse;

use line::{Heard, Line, Uart};
use pins::{Echo, Sensor, Trigger};

const AIR: Celsius = Celsius(20);
/// One byte at 9600 baud.
const BYTE: Duration = Duration::from_micros(1_042);

type Ranger = Us100<Uart, Trigger, Echo>;

fn over_uart(clock: &TestClock) -> (Line, Ranger) {
    let line = Line::new(clock.clone());
    let ranger = Us100::new(RangerPort::Uart(line.uart()));
    (line, ranger)
}

fn with_pulses(clock: &TestClock) -> (Sensor, Ranger) {
    let sensor = Sensor::new(clock.clone());
    let (trigger, echo) = sensor.pins();
    let ranger = Us100::new(RangerPort::Pulse { trigger, echo });
    (sensor, ranger)
}

/// Measures, and checks the promise of every call: it ends in time.
fn measure(clock: &TestClock, ranger: &mut Ranger) -> Result<Millimeters, RangeError> {
    let start = clock.now();
    let outcome = clock.block_on(ranger.measure(clock, AIR));
    assert!(
        clock.now() - start <= REPLY_TIMEOUT + SILENCE,
        "{outcome:?}"
    );
    outcome
}

fn link(error: LinkError) -> Result<Millimeters, RangeError> {
    Err(RangeError::Link(error))
}

fn classified(raw: u16) -> Result<Millimeters, RangeError> {
    let mm = Millimeters(raw);
    match raw {
        0..=19 => Err(RangeError::TooNear(mm)),
        20..=4_500 => Ok(mm),
        4_501.. => Err(RangeError::NoEcho(mm)),
    }
}

#[test]
fn every_range_reply_over_the_wire() {
    let clock = TestClock::default();
    let (line, mut ranger) = over_uart(&clock);
    for raw in 0..=u16::MAX {
        line.answer(0x55, &raw.to_be_bytes());
        assert_eq!(
            measure(&clock, &mut ranger),
            classified(raw),
            "raw {raw:#06x}"
        );
    }
    assert_eq!(line.sent().len(), 65_536);
    assert!(line.sent().iter().all(|&byte| byte == 0x55));
}

#[test]
fn every_temperature_reply_over_the_wire() {
    let clock = TestClock::default();
    let (line, mut ranger) = over_uart(&clock);
    assert!(ranger.tells_temperature());
    for byte in 0..=u8::MAX {
        line.answer(0x50, &[byte]);
        let air = Celsius(i16::from(byte) - 45);
        let want = match byte {
            25..=115 => Ok(air),
            0..=24 | 116.. => Err(TemperatureError::Absurd(air)),
        };
        assert_eq!(
            clock.block_on(ranger.temperature(&clock)),
            want,
            "byte {byte}"
        );
    }
    assert!(line.sent().iter().all(|&byte| byte == 0x50));
}

#[test]
fn the_constructor_touches_nothing() {
    let clock = TestClock::default();
    let (line, ranger) = over_uart(&clock);
    drop(ranger.release());
    assert_eq!((line.sent().len(), line.reads()), (0, 0));
    let (sensor, ranger) = with_pulses(&clock);
    assert!(!ranger.tells_temperature());
    drop(ranger.release());
    assert_eq!(sensor.touched(), 0);
}

#[test]
fn an_absent_sensor_costs_its_deadline_and_no_more() {
    let clock = TestClock::default();
    let (_line, mut ranger) = over_uart(&clock);
    let start = clock.now();
    assert_eq!(measure(&clock, &mut ranger), link(LinkError::Timeout));
    assert_eq!(clock.now() - start, REPLY_TIMEOUT);
    let temperature = clock.block_on(ranger.temperature(&clock));
    assert_eq!(temperature, Err(TemperatureError::Link(LinkError::Timeout)));
    assert_eq!(clock.now() - start, REPLY_TIMEOUT * 2);
}

#[test]
fn a_torn_reply_is_no_reply_and_spoils_nothing() {
    let clock = TestClock::default();
    let (line, mut ranger) = over_uart(&clock);
    line.answer(0x55, &[0x03]);
    assert_eq!(measure(&clock, &mut ranger), link(LinkError::Timeout));
    line.answer(0x55, &[0x03, 0x20]);
    assert_eq!(measure(&clock, &mut ranger), Ok(Millimeters(800)));
}

#[test]
fn a_reply_in_pieces_is_a_reply_until_the_deadline() {
    for (gap_ms, whole) in [(1, true), (20, true), (40, true), (62, false), (90, false)] {
        let clock = TestClock::default();
        let (line, mut ranger) = over_uart(&clock);
        let first = Duration::from_millis(5);
        let second = first + Duration::from_millis(gap_ms);
        line.script(
            0x55,
            &[(first, Heard::Byte(0x03)), (second, Heard::Byte(0x20))],
        );
        let want = if whole {
            Ok(Millimeters(800))
        } else {
            link(LinkError::Timeout)
        };
        assert_eq!(measure(&clock, &mut ranger), want, "gap {gap_ms} ms");
    }
}

/// A reply that missed its deadline waits in the receiver when the next request is made.
#[test]
fn a_late_reply_does_not_answer_the_next_request() {
    for late_ms in 64..=99 {
        let clock = TestClock::default();
        let (line, mut ranger) = over_uart(&clock);
        let late = Duration::from_millis(late_ms);
        line.script(
            0x55,
            &[(late, Heard::Byte(0x0F)), (late + BYTE, Heard::Byte(0xA0))],
        );
        assert_eq!(measure(&clock, &mut ranger), link(LinkError::Timeout));
        clock.pass(Duration::from_millis(100).saturating_sub(REPLY_TIMEOUT) + BYTE);
        line.answer(0x55, &[0x01, 0x2C]);
        let outcome = measure(&clock, &mut ranger);
        assert_eq!(outcome, Ok(Millimeters(300)), "late by {late_ms} ms");
    }
}

#[test]
fn a_late_temperature_is_not_the_high_byte_of_a_range() {
    let clock = TestClock::default();
    let (line, mut ranger) = over_uart(&clock);
    line.script(0x50, &[(Duration::from_millis(70), Heard::Byte(65))]);
    let late = clock.block_on(ranger.temperature(&clock));
    assert_eq!(late, Err(TemperatureError::Link(LinkError::Timeout)));
    clock.pass(Duration::from_millis(20));
    line.answer(0x55, &[0x01, 0x2C]);
    assert_eq!(measure(&clock, &mut ranger), Ok(Millimeters(300)));
}

#[test]
fn extra_bytes_make_a_reply_worthless() {
    for extra in 1..=40 {
        let clock = TestClock::default();
        let (line, mut ranger) = over_uart(&clock);
        let mut reply = std::vec![0x01; 2];
        reply.resize(2 + extra, 0x55);
        line.answer(0x55, &reply);
        assert_eq!(
            measure(&clock, &mut ranger),
            link(LinkError::Noise),
            "{extra}"
        );
        // The rest is still coming in; once it is over, all is well.
        clock.pass(BYTE * 40);
        line.answer(0x55, &[0x01, 0x2C]);
        assert_eq!(
            measure(&clock, &mut ranger),
            Ok(Millimeters(300)),
            "{extra}"
        );
    }
}

#[test]
fn a_babbling_line_is_noise_and_never_a_range() {
    // From a stuck driver that always has bytes to a line that speaks at 9600 baud.
    for period_us in [0, 100, 500, 1_042] {
        let clock = TestClock::default();
        let (line, mut ranger) = over_uart(&clock);
        line.babble(Duration::from_micros(period_us));
        for _ in 0..50 {
            let outcome = measure(&clock, &mut ranger);
            assert_eq!(outcome, link(LinkError::Noise), "every {period_us} µs");
            clock.pass(Duration::from_millis(37));
        }
        assert!(
            line.reads() <= 50 * (uart::DRAIN_READS + 4),
            "unbounded drain"
        );
    }
}

#[test]
fn a_full_receive_buffer_is_drained_and_forgiven() {
    let clock = TestClock::default();
    let (line, mut ranger) = over_uart(&clock);
    line.waiting(&[0x11; 496]);
    line.answer(0x55, &[0x01, 0x2C]);
    assert_eq!(measure(&clock, &mut ranger), Ok(Millimeters(300)));
}

#[test]
fn errors_of_the_uart_are_told_and_pass() {
    let clock = TestClock::default();
    let (line, mut ranger) = over_uart(&clock);
    let at = Duration::from_millis(5);
    // In place of the first byte, of the second, and after the reply.
    for broken in 0..3_usize {
        let mut script = [
            (at, Heard::Byte(1)),
            (at + BYTE, Heard::Byte(2)),
            (at + BYTE * 2, Heard::Error),
        ];
        script[broken].1 = Heard::Error;
        line.script(0x55, &script[..=broken]);
        let want = link(LinkError::Uart(ErrorKind::Other));
        assert_eq!(
            measure(&clock, &mut ranger),
            want,
            "in place of byte {broken}"
        );
    }
    // An overrun from before the request is drained away.
    line.script(
        0x55,
        &[
            (at, Heard::Byte(1)),
            (at + BYTE, Heard::Byte(2)),
            (at + BYTE * 9, Heard::Error),
        ],
    );
    assert_eq!(measure(&clock, &mut ranger), Ok(Millimeters(258)));
    clock.pass(BYTE * 20);
    line.answer(0x55, &[0x01, 0x2C]);
    assert_eq!(measure(&clock, &mut ranger), Ok(Millimeters(300)));
}

#[test]
fn a_uart_that_only_errs_or_is_closed_is_told_apart() {
    let clock = TestClock::default();
    let (line, mut ranger) = over_uart(&clock);
    line.always(Heard::Error);
    let want = link(LinkError::Uart(ErrorKind::Other));
    assert_eq!(measure(&clock, &mut ranger), want);
    line.always(Heard::End);
    assert_eq!(measure(&clock, &mut ranger), link(LinkError::Closed));
    assert!(line.sent().is_empty(), "asked through a broken line");
}

#[test]
fn a_transmitter_that_blocks_closes_or_errs_is_told_apart() {
    let clock = TestClock::default();
    for (write, want) in [
        (line::Writing::Blocks, LinkError::Timeout),
        (line::Writing::Closed, LinkError::Closed),
        (line::Writing::Errs, LinkError::Uart(ErrorKind::Other)),
    ] {
        let (line, mut ranger) = over_uart(&clock);
        line.writing(write);
        assert_eq!(measure(&clock, &mut ranger), link(want));
    }
}

#[test]
fn a_dropped_call_spoils_nothing() {
    let clock = TestClock::default();
    let (line, mut ranger) = over_uart(&clock);
    line.answer(0x55, &[0x0F, 0xA0]);
    let cut = clock.now() + Duration::from_millis(2);
    let cut_off = crawler_hal::with_deadline(&clock, cut, ranger.measure(&clock, AIR));
    assert!(clock.block_on(cut_off).is_err());
    clock.pass(Duration::from_millis(50));
    line.answer(0x55, &[0x01, 0x2C]);
    assert_eq!(measure(&clock, &mut ranger), Ok(Millimeters(300)));
}

fn heard() -> impl Strategy<Value = Heard> {
    prop_oneof![
        8 => any::<u8>().prop_map(Heard::Byte),
        1 => Just(Heard::Error),
        1 => Just(Heard::End),
    ]
}

proptest! {
    /// Whatever the line does, every call ends in time, without a panic, and a range that is told
    /// was really two neighbouring bytes on the line, in this call.
    #[test]
    fn no_line_hangs_the_driver_or_makes_it_invent(
        calls in prop::collection::vec(
            (prop::collection::vec((0..120_000_u64, heard()), 0..12), 0..100_000_u64),
            1..6,
        ),
    ) {
        let clock = TestClock::default();
        let (line, mut ranger) = over_uart(&clock);
        for (mut script, pause_us) in calls {
            script.sort_by_key(|&(at, _)| at);
            let script: std::vec::Vec<_> = script
                .into_iter()
                .map(|(at, heard)| (Duration::from_micros(at), heard))
                .collect();
            line.script(0x55, &script);
            line.forget();
            match measure(&clock, &mut ranger) {
                Ok(range) | Err(RangeError::TooNear(range) | RangeError::NoEcho(range)) => {
                    prop_assert!(line.heard().ends_with(&range.0.to_be_bytes()));
                }
                Err(RangeError::Link(_)) => {}
            }
            clock.pass(Duration::from_micros(pause_us));
        }
    }
}
