//! The clock filter against servers, delays and drift it cannot see.

use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use proptest::prelude::*;
use std::vec::Vec;

use super::*;

type Sync = TimeSync<NoopRawMutex>;

/// Unix ms at which the robot booted, by a perfect clock.
const EPOCH_MS: u64 = 1_800_000_000_000;

fn at_ms(ms: u64) -> Instant {
    Instant::from_millis(ms)
}

/// How far the robot's clock is ahead of `EPOCH_MS` + monotonic time, in ms.
fn error(sync: &Sync, now_ms: u64) -> i64 {
    let unix = sync.unix_ms(at_ms(now_ms)).expect("synchronised");
    unix as i64 - (EPOCH_MS + now_ms) as i64
}

#[test]
fn knows_nothing_until_told_and_again_when_not_told_for_long() {
    let sync = Sync::new();
    assert_eq!(sync.unix_ms(at_ms(5)), None);
    assert_eq!(sync.observe(EPOCH_MS, at_ms(0)), Observation::Adopted);
    assert_eq!(sync.unix_ms(at_ms(1_234)), Some(EPOCH_MS + 1_234));
    let last = VALID_FOR.as_millis();
    assert!(sync.unix_ms(at_ms(last)).is_some());
    assert_eq!(sync.unix_ms(at_ms(last + 1)), None);
    // And whatever comes then is believed, like the first.
    let later = EPOCH_MS - 500_000;
    assert_eq!(sync.observe(later, at_ms(last + 1)), Observation::Adopted);
    assert_eq!(sync.unix_ms(at_ms(last + 1)), Some(later));
}

#[test]
fn what_is_no_date_is_not_believed() {
    let sync = Sync::new();
    for nonsense in [0, 1, 1_577_836_799_999, 7_258_118_400_000, u64::MAX] {
        assert_eq!(sync.observe(nonsense, at_ms(7)), Observation::Implausible);
    }
    assert_eq!(sync.unix_ms(at_ms(7)), None);
}

#[test]
fn a_late_message_does_not_drag_the_clock_back() {
    let sync = Sync::new();
    sync.observe(EPOCH_MS, at_ms(0));
    assert_eq!(
        sync.observe(EPOCH_MS + 5_000, at_ms(5_900)),
        Observation::Confirmed
    );
    assert_eq!(error(&sync, 6_000), 0);
    assert_eq!(
        sync.observe(EPOCH_MS + 10_000, at_ms(13_000)),
        Observation::Doubted
    );
    assert_eq!(error(&sync, 13_000), 0);
}

#[test]
fn a_burst_after_a_stall_is_no_new_clock() {
    let sync = Sync::new();
    for sent in (0..60).step_by(5) {
        sync.observe(EPOCH_MS + sent * 1_000, at_ms(sent * 1_000));
    }
    // Six messages stuck for half a minute arrive in one moment.
    for sent in (60..90).step_by(5) {
        sync.observe(EPOCH_MS + sent * 1_000, at_ms(95_000));
    }
    assert_eq!(error(&sync, 95_000), 0);
}

#[test]
fn a_first_message_that_was_late_is_corrected_by_the_next() {
    let sync = Sync::new();
    sync.observe(EPOCH_MS, at_ms(4_000));
    assert_eq!(error(&sync, 4_000), -4_000);
    assert_eq!(
        sync.observe(EPOCH_MS + 5_000, at_ms(5_010)),
        Observation::Adopted
    );
    assert_eq!(error(&sync, 5_010), -10);
}

fn settled() -> Sync {
    let sync = Sync::new();
    for sent in (0..30).step_by(5) {
        sync.observe(EPOCH_MS + sent * 1_000, at_ms(sent * 1_000));
    }
    sync
}

#[test]
fn a_clock_that_was_set_is_followed_after_three_messages_either_way() {
    for step in [-3_600_000_i64, -1_500, 1_500, 86_400_000] {
        let sync = settled();
        let server = |ms: u64| (EPOCH_MS + ms).saturating_add_signed(step);
        assert_eq!(
            sync.observe(server(30_000), at_ms(30_000)),
            Observation::Doubted
        );
        assert_eq!(
            sync.observe(server(35_000), at_ms(35_000)),
            Observation::Doubted
        );
        assert_eq!(error(&sync, 35_000), 0, "step {step}");
        assert_eq!(
            sync.observe(server(40_000), at_ms(40_000)),
            Observation::Stepped
        );
        assert_eq!(error(&sync, 40_000), step);
    }
}

#[test]
fn one_message_from_the_future_changes_nothing() {
    let sync = settled();
    for odd in [60_000, 600_000, 6_000_000] {
        assert_eq!(
            sync.observe(EPOCH_MS + odd, at_ms(30_000)),
            Observation::Doubted
        );
    }
    assert_eq!(
        sync.observe(EPOCH_MS + 35_000, at_ms(35_000)),
        Observation::Adopted
    );
    assert_eq!(error(&sync, 35_000), 0);
}

proptest! {
    /// Whatever the delays: never ahead of the server, and behind by no more than the least
    /// delay so far and what drift was granted since.
    #[test]
    fn the_clock_is_behind_by_the_least_delay_and_no_more(
        delays in proptest::collection::vec(0_u64..900, 1..200),
    ) {
        let sync = Sync::new();
        let mut least_at = (u64::MAX, 0);
        for (index, delay) in delays.iter().enumerate() {
            let sent = index as u64 * 5_000;
            let arrived = sent + delay;
            sync.observe(EPOCH_MS + sent, at_ms(arrived));
            if *delay <= least_at.0 {
                least_at = (*delay, arrived);
            }
            let granted = (arrived - least_at.1) * DRIFT_PPM / 1_000_000 + 1;
            let error = error(&sync, arrived);
            prop_assert!(error <= 0, "ahead by {error} ms");
            prop_assert!(
                -error <= (least_at.0 + granted) as i64,
                "behind by {} ms, least delay {}", -error, least_at.0
            );
        }
    }

    /// A robot whose crystal is wrong by up to the assumed drift stays within the delays.
    #[test]
    fn drift_is_followed(
        ppm in -150_i64..=150,
        delays in proptest::collection::vec(0_u64..20, 400..500),
    ) {
        let sync = Sync::new();
        let mut errors = Vec::new();
        for (index, delay) in delays.iter().enumerate() {
            let arrived = index as u64 * 5_000 + delay;
            let monotonic = arrived.saturating_add_signed(arrived as i64 * ppm / 1_000_000);
            sync.observe(EPOCH_MS + index as u64 * 5_000, at_ms(monotonic));
            let unix = sync.unix_ms(at_ms(monotonic)).expect("synchronised");
            errors.push(unix as i64 - (EPOCH_MS + arrived) as i64);
        }
        let worst = errors.iter().map(|error| error.abs()).max().unwrap_or(0);
        prop_assert!(worst <= 45, "off by {worst} ms at {ppm} ppm");
    }

    #[test]
    fn nothing_panics(
        messages in proptest::collection::vec((any::<u64>(), any::<u64>()), 0..50),
    ) {
        let sync = Sync::new();
        for (server_ms, now_us) in messages {
            sync.observe(server_ms, Instant::from_micros(now_us));
            sync.unix_ms(Instant::from_micros(now_us));
        }
    }
}
