//! Honest robots stay among the values that honest ones began with, and come to one, whatever liars say.

use std::vec::Vec;

use crawler_hal::{Duration, Instant};
use crawler_protocol::{BehaviourName, Measure, Pose, Says};
use proptest::prelude::*;

use super::{AGREED, Consensus, ROUND, keep, mean};
use crate::behaviour::mission::Scene;
use crate::neighbours::Neighbour;
use crate::perception::Reading;

/// Numbers drawn from a seed.
struct Draw(u64);

impl Draw {
    fn below(&mut self, most: usize) -> usize {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (self.0 >> 33) as usize % most
    }
}

/// Who hears whom: a graph that is `r`-robust. A complete one of 2r−1 is, and stays so with each robot more that hears,
/// and is heard by, `r` of those before it (Zhang, Fata and Sundaram, "A notion of robustness in complex
/// networks", IEEE TCNS 2(3), 2015).
fn robust(r: usize, robots: usize, draw: &mut Draw) -> Vec<Vec<usize>> {
    let first = 2 * r - 1;
    let mut hears: Vec<Vec<usize>> = (0..first)
        .map(|own| (0..first).filter(|other| *other != own).collect())
        .collect();
    for new in first..robots.max(first) {
        let mut known = Vec::new();
        while known.len() < r {
            let other = draw.below(new);
            if !known.contains(&other) {
                known.push(other);
            }
        }
        for other in &known {
            hears[*other].push(new);
        }
        hears.push(known);
    }
    hears
}

fn said(value: i32) -> Neighbour {
    Neighbour {
        says: Some(Says::new(BehaviourName::Consensus, &[value, 1, 0])),
        ..Neighbour::default()
    }
}

fn step(robot: &mut Consensus, near: &[Neighbour], reading: &Reading, round: u32) {
    let scene = Scene {
        pose: &Pose::default(),
        near,
        own: 1,
        reading,
        speed: 0.3,
        now: Instant::BOOT + ROUND * round,
    };
    robot.step(&scene);
}

proptest! {
    #![proptest_config(crawler_properties::cases(64))]

    #[test]
    fn a_round_stays_in_the_hull_of_the_honest(
        honest in prop::collection::vec(-1_000_000_000_i32..1_000_000_000, 1..12),
        lies in prop::collection::vec(any::<i32>(), 0..4),
    ) {
        let (own, others) = honest.split_first().expect("one at least");
        let mut heard: Vec<i32> = others.iter().chain(&lies).copied().collect();
        let f = lies.len() as u8;
        let next = mean(keep(&mut heard, *own, f), *own);
        let least = honest.iter().min().expect("one");
        let most = honest.iter().max().expect("one");
        prop_assert!((*least..=*most).contains(&next), "{least}..{most}: {next}");
    }

    #[test]
    fn with_liars_and_losses_the_honest_come_to_one_value(
        f in 1_usize..=2,
        more in 0_usize..6,
        seed in any::<u64>(),
        lost in 0_usize..25,
    ) {
        let mut draw = Draw(seed);
        let first = 2 * (2 * f + 1) - 1;
        let hears = robust(2 * f + 1, first + more, &mut draw);
        let mut liars = Vec::new();
        while liars.len() < f {
            let liar = draw.below(hears.len());
            if !liars.contains(&liar) {
                liars.push(liar);
            }
        }
        let begun: Vec<f32> = hears.iter().map(|_| draw.below(100_000) as f32 / 1_000.0).collect();
        let mut robots: Vec<Consensus> = begun
            .iter()
            .map(|value| Consensus::new(Measure::Value(*value), f as u8))
            .collect();
        let is_honest = |robot: &usize| !liars.contains(robot);
        for robot in &mut robots {
            step(robot, &[], &Reading::default(), 0);
        }
        let value = |robot: &Consensus| robot.value.expect("has one");
        let honest: Vec<i32> = (0..robots.len()).filter(is_honest).map(|n| value(&robots[n])).collect();
        let (least, most) = (*honest.iter().min().expect("one"), *honest.iter().max().expect("one"));
        // What each heard last of each, and when.
        let mut heard: Vec<Vec<(u32, Option<i32>)>> =
            hears.iter().map(|known| known.iter().map(|_| (0, None)).collect()).collect();
        for round in 1..600_u32 {
            let told: Vec<i32> = robots.iter().map(value).collect();
            for (own, robot) in robots.iter_mut().enumerate() {
                for (place, other) in hears[own].iter().enumerate() {
                    if draw.below(100) < lost {
                        continue;
                    }
                    // A liar tells each what it likes: extremes, anything, or nearly what it hears.
                    let word = if is_honest(other) {
                        told[*other]
                    } else {
                        match draw.below(4) {
                            0 => i32::MAX,
                            1 => i32::MIN,
                            2 => draw.below(200_000) as i32 - 50_000,
                            _ => told[own] + draw.below(60) as i32,
                        }
                    };
                    heard[own][place] = (round, Some(word));
                }
                // As long as digests are believed: three rounds.
                let near: Vec<Neighbour> = heard[own]
                    .iter()
                    .filter(|(at, _)| round - at < 3)
                    .filter_map(|(_, word)| word.map(said))
                    .collect();
                step(robot, &near, &Reading::default(), round);
            }
            for robot in (0..robots.len()).filter(is_honest) {
                let value = value(&robots[robot]);
                prop_assert!((least..=most).contains(&value), "left the hull: {value}");
            }
        }
        let values: Vec<i32> = (0..robots.len()).filter(is_honest).map(|n| value(&robots[n])).collect();
        let spread = values.iter().max().expect("one").abs_diff(*values.iter().min().expect("one"));
        prop_assert!(spread <= AGREED, "{values:?}");
    }
}

#[test]
fn one_liar_too_many_is_what_the_bound_is_about() {
    // Two that say the same out of four: with f = 1 one of them counts.
    let mut heard = [0, 10, 1_000_000, 1_000_000];
    assert_eq!(keep(&mut heard, 5, 1), [10, 1_000_000]);
    assert_eq!(keep(&mut heard, 5, 2), [10]);
}

#[test]
fn who_agrees_for_three_seconds_is_settled_and_says_so() {
    let mut robot = Consensus::new(Measure::Value(20.0), 1);
    let near = [20_010, 19_990, 20_000].map(said);
    let settled = |robot: &Consensus| {
        let says = robot.says().expect("has a value");
        says.by(BehaviourName::Consensus).expect("of its own")[2]
    };
    for round in 0..6 {
        step(&mut robot, &near, &Reading::default(), round);
        assert_eq!(settled(&robot), 0, "round {round}");
    }
    step(&mut robot, &near, &Reading::default(), 6);
    assert_eq!(settled(&robot), 1);
    // Two are too few to tell a liar among them, and somebody who has not agreed is heard.
    step(&mut robot, &near[..2], &Reading::default(), 7);
    assert_eq!(settled(&robot), 0);
    for round in 8..20 {
        step(
            &mut robot,
            &[20_000, 20_000, 30_000, 30_000].map(said),
            &Reading::default(),
            round,
        );
    }
    assert_eq!(settled(&robot), 0);
}

#[test]
fn a_value_that_is_measured_is_waited_for() {
    let mut robot = Consensus::new(Measure::Temperature, 0);
    step(&mut robot, &[said(5_000)], &Reading::default(), 0);
    assert_eq!(robot.says(), None, "nothing measured, nothing said");
    let warm = Reading {
        temperature: Some(crawler_hal::Celsius(21)),
        ..Reading::default()
    };
    step(&mut robot, &[said(5_000)], &warm, 1);
    assert_eq!(robot.value, Some(21_000));
    step(&mut robot, &[said(5_000)], &warm, 2);
    assert_eq!(robot.value, Some(13_000), "the mean of two");
    assert_eq!(ROUND, Duration::from_millis(500));
}
