//! The judgement of the ranger.

use crawler_drivers::us100::{LinkError, RangeError};
use crawler_hal::{Duration, Instant, Millimeters};
use proptest::prelude::*;

use super::{Jitter, PERIOD, RangeFilter};
use crate::perception::{Reading, SensorHealth, Sight};

type Measured = Result<Millimeters, RangeError>;

const SILENT: Measured = Err(RangeError::Link(LinkError::Timeout));
const NO_ECHO: Measured = Err(RangeError::NoEcho(Millimeters(9_999)));

struct Bench {
    filter: RangeFilter,
    heading: f32,
    now: Instant,
}

impl Bench {
    fn new() -> Self {
        Self {
            filter: RangeFilter::new(Instant::BOOT),
            heading: 0.0,
            now: Instant::BOOT,
        }
    }

    fn feed(&mut self, measured: Measured, moving: bool, times: usize) -> Reading {
        for _ in 0..times {
            self.now += PERIOD;
            self.filter
                .observe(measured, moving, self.heading, self.now);
        }
        self.filter.reading()
    }

    fn feed_all(&mut self, ranges: impl IntoIterator<Item = u16>, moving: bool) -> Reading {
        for mm in ranges {
            self.feed(Ok(Millimeters(mm)), moving, 1);
        }
        self.filter.reading()
    }
}

#[test]
fn a_sensor_proves_itself_before_it_is_believed() {
    let mut bench = Bench::new();
    assert_eq!(
        bench.feed_all([800, 801], false).health,
        SensorHealth::Unproven
    );
    let reading = bench.feed_all([802], false);
    assert_eq!(reading.health, SensorHealth::Good);
    assert_eq!(
        reading.fresh(bench.now),
        Some(Sight::Range(Millimeters(802)))
    );
}

#[test]
fn one_outlier_is_not_seen_and_a_real_obstacle_is() {
    let mut bench = Bench::new();
    bench.feed_all([800; 4], false);
    let reading = bench.feed_all([100], false);
    assert_eq!(reading.range_mm(bench.now), Some(800));
    let reading = bench.feed_all([100], false);
    assert_eq!(reading.range_mm(bench.now), Some(100), "two of three");
}

#[test]
fn nothing_in_reach_is_clear_and_touching_is_near() {
    let mut bench = Bench::new();
    let reading = bench.feed(NO_ECHO, true, 200);
    assert_eq!(
        reading.fresh(bench.now),
        Some(Sight::Clear),
        "in the open for long"
    );
    assert_eq!(reading.range_mm(bench.now), None);
    let touching = Err(RangeError::TooNear(Millimeters(12)));
    let reading = bench.feed(touching, true, 3);
    assert_eq!(reading.fresh(bench.now), Some(Sight::Touching));
}

#[test]
fn silence_makes_it_stale_then_dead_and_replies_bring_it_back() {
    let mut bench = Bench::new();
    bench.feed_all([800; 4], false);
    let reading = bench.feed(SILENT, false, 4);
    assert_eq!(reading.health, SensorHealth::Good, "not dead yet");
    assert_eq!(reading.fresh(bench.now), None, "but too old to move on");
    let reading = bench.feed(SILENT, false, 9);
    assert_eq!(reading.health, SensorHealth::Dead);
    // What it saw before the gap is forgotten: two old values must not outvote a new one.
    let reading = bench.feed_all([300], false);
    assert_eq!(reading.health, SensorHealth::Dead);
    let reading = bench.feed_all([300, 300], false);
    assert_eq!(reading.health, SensorHealth::Good);
    assert_eq!(reading.range_mm(bench.now), Some(300));
}

#[test]
fn a_sensor_that_never_answers_is_dead() {
    let mut bench = Bench::new();
    assert_eq!(bench.feed(SILENT, false, 13).health, SensorHealth::Dead);
}

#[test]
fn the_same_number_is_stuck_only_while_the_robot_moves() {
    let mut bench = Bench::new();
    assert_eq!(bench.feed_all([777; 500], false).health, SensorHealth::Good);
    assert_eq!(bench.feed_all([777; 55], true).health, SensorHealth::Stuck);
    let reading = bench.feed_all([778, 779, 780], true);
    assert_eq!(reading.health, SensorHealth::Good, "it moves again");
}

/// Of a sensor that is broken: never twice the same.
const WILD: [u16; 12] = [
    4_000, 100, 2_200, 3_700, 900, 2_800, 400, 4_300, 1_500, 3_100, 250, 1_900,
];

#[test]
fn jumping_about_is_absurd_and_a_corner_is_not() {
    let mut bench = Bench::new();
    let corner = [500, 502, 3_000, 3_004, 3_001, 900, 902, 904, 903, 905];
    assert_eq!(bench.feed_all(corner, true).health, SensorHealth::Good);
    let reading = bench.feed_all(WILD, true);
    assert_eq!(reading.health, SensorHealth::Absurd);
    assert_eq!(reading.fresh(bench.now), None);
    let reading = bench.feed_all([800; 16], false);
    assert_eq!(reading.health, SensorHealth::Good);
}

/// What a crowd looks like to a robot that turns: now the next one, now the wall behind it.
#[test]
fn jumping_about_is_the_world_while_the_robot_turns_and_the_sensor_while_it_does_not() {
    let crowd = WILD.map(Millimeters);
    for turned in [0.17, -0.17] {
        let mut bench = Bench::new();
        bench.heading = core::f32::consts::PI - 0.5;
        bench.feed_all([800; 3], true);
        for range in crowd.iter().cycle().take(30) {
            bench.heading = crate::motion::wrap(bench.heading + turned);
            let reading = bench.feed(Ok(*range), true, 1);
            assert_eq!(reading.health, SensorHealth::Good, "turning by {turned}");
        }
    }
    // Driving a slight curve it looks at the same things.
    let mut bench = Bench::new();
    bench.feed_all([800; 3], true);
    for range in crowd {
        bench.heading += 0.02;
        bench.feed(Ok(range), true, 1);
    }
    assert_eq!(bench.filter.reading().health, SensorHealth::Absurd);
    // And turning does not clear a sensor of what it said before.
    for range in crowd {
        bench.heading += 0.17;
        let reading = bench.feed(Ok(range), true, 1);
        assert_eq!(reading.fresh(bench.now), None);
    }
}

/// A burst that comes too early is another one each time.
#[test]
fn bursts_of_another_robot_are_not_seen() {
    for (wall, name) in [(4_000, 1), (1_500, 2), (600, 3)] {
        let mut bench = Bench::new();
        bench.feed_all([wall; 4], true);
        let mut jitter = Jitter::new(name);
        let mut burst = || jitter.draw().as_micros() as u16 / 16;
        for round in 0..300_u16 {
            let tremble = round % 3;
            let looks = [burst().min(wall), wall + tremble, wall - tremble];
            // One or two of three see what is there.
            let reading = bench.feed_all(looks, true);
            assert_eq!(reading.health, SensorHealth::Good, "round {round}");
            let Some(Sight::Range(Millimeters(seen))) = reading.fresh(bench.now) else {
                panic!("nothing is seen");
            };
            assert!(seen.abs_diff(wall) <= 2, "{seen} in round {round}");
            assert!(bench.filter.is_confirmed());
        }
    }
}

#[test]
fn what_nothing_confirms_is_not_seen_at_once_nor_for_the_map() {
    let mut bench = Bench::new();
    bench.feed_all([2_000; 4], true);
    let reading = bench.feed_all([500], true);
    assert_eq!(reading.range_mm(bench.now), Some(2_000));
    assert!(!bench.filter.is_confirmed());
    // Where nothing is agreed on twice in a row, the median counts, and the map goes without.
    let reading = bench.feed_all([900], true);
    assert_eq!(reading.range_mm(bench.now), Some(2_000));
    let reading = bench.feed_all([1_300], true);
    assert_eq!(reading.range_mm(bench.now), Some(900));
    assert!(!bench.filter.is_confirmed());
    let reading = bench.feed_all([300], true);
    assert!(reading.range_mm(bench.now).is_some());
    assert_eq!(reading.health, SensorHealth::Good);
    let reading = bench.feed_all([1_700, 1_750], true);
    assert_eq!(reading.range_mm(bench.now), Some(1_750));
    assert!(bench.filter.is_confirmed());
    // Who turns looks at another thing each time.
    bench.heading += 0.1;
    bench.feed_all([800], true);
    assert!(bench.filter.is_confirmed());
}

/// Along a wall at a slant each measurement is another one, and a robot that turns slowly is not blind meanwhile.
#[test]
fn who_turns_slowly_sees_a_slanted_wall() {
    for turn in [0.012, 0.02, 0.045] {
        let mut bench = Bench::new();
        bench.feed_all([900; 4], true);
        let mut slant = 0.6_f32;
        while slant < 1.3 {
            slant += turn;
            bench.heading += turn;
            let range = (800.0 / slant.cos()) as u16;
            let reading = bench.feed_all([range], true);
            let seen = reading.range_mm(bench.now).expect("a range");
            assert!(seen <= range, "{seen} of {range}");
        }
    }
}

#[test]
fn pauses_are_short_uneven_and_another_robots_are_others() {
    let [one, two] = [0, 0xcafe].map(|name| {
        let mut jitter = Jitter::new(name);
        core::array::from_fn::<u64, 1_000, _>(|_| jitter.draw().as_micros())
    });
    for pauses in [one, two] {
        assert!(pauses.iter().all(|us| *us < 32_000));
        let mean = pauses.iter().sum::<u64>() / 1_000;
        assert!((15_000..17_000).contains(&mean), "{mean}");
        let alike = pauses
            .windows(2)
            .filter(|two| two[0].abs_diff(two[1]) < 1_000);
        assert!(alike.count() < 100);
    }
    let together = one
        .iter()
        .zip(&two)
        .filter(|(a, b)| a.abs_diff(**b) < 1_000);
    assert!(together.count() < 100);
}

proptest! {
    /// A robot that looks one way is told what two measurements have shown, or what lies amid the last three.
    #[test]
    fn two_measurements_have_shown_what_is_seen(
        ranges in prop::collection::vec(20_u16..=4_500, 3..100),
    ) {
        let mut bench = Bench::new();
        for (number, range) in ranges.iter().enumerate() {
            let reading = bench.feed_all([*range], true);
            if number < 3 {
                continue;
            }
            if let Some(seen) = reading.range_mm(bench.now) {
                let near = |one: &u16| one.abs_diff(seen) <= 100;
                let recent = || ranges.iter().take(number + 1).rev();
                // The last ones, or those at the time of the last word, one measurement ago.
                let is_amid = (0..2).any(|ago| {
                    let mut three: std::vec::Vec<_> = recent().skip(ago).take(3).collect();
                    three.sort_unstable();
                    three.get(1) == Some(&&seen)
                });
                let shown = recent().take(6).filter(|one| near(one)).count();
                prop_assert!(shown >= 2 || is_amid, "{} mm", seen);
            }
        }
    }

    /// Whatever the sensor says, what may be acted upon was said by a sensor in good health, and
    /// recently.
    #[test]
    fn nothing_is_fresh_that_is_old_or_doubted(
        replies in prop::collection::vec(
            (
                prop_oneof![
                    (20_u16..=4_500).prop_map(|mm| Ok(Millimeters(mm))),
                    Just(SILENT),
                    Just(NO_ECHO),
                ],
                any::<bool>(),
                1_u64..500,
            ),
            1..200,
        ),
    ) {
        let mut filter = RangeFilter::new(Instant::BOOT);
        let mut now = Instant::BOOT;
        let mut heard = now;
        for (measured, moving, ms) in replies {
            now += Duration::from_millis(ms);
            let reading = filter.observe(measured, moving, 0.0, now);
            if measured != SILENT {
                heard = now;
            }
            if reading.fresh(now).is_some() {
                prop_assert!(now - heard <= Duration::from_millis(300));
                prop_assert_eq!(reading.health, SensorHealth::Good);
            }
        }
    }
}
