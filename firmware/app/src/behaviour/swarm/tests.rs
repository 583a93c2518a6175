//! What comes of the rules when everybody follows them, and that no neighbour, however absurd,
//! makes a wish beyond what is permitted.

mod fleet;

use std::vec::Vec;

use crawler_protocol::Pose;
use proptest::prelude::*;

use super::{APART, LATTICE, Scene, VAGUE, swarm_twist};
use crate::goal::Swarm;
use crate::motion::Twist;
use crate::motion::angle::PoseMm;
use crate::neighbours::{MOST, Neighbour};

use fleet::{Fleet, SPEED, TURN, clusters, lattice, order, pairs};

const GATHER: Swarm = Swarm::Gather { x: 0.0, y: 0.0 };

fn pose(x: f32, y: f32, theta: f32) -> Pose {
    Pose {
        x,
        y,
        theta,
        sigma: 0.02,
    }
}

fn twist(swarm: Swarm, pose: &Pose, near: &[Neighbour]) -> Twist {
    let scene = Scene {
        here: PoseMm::new(pose),
        sigma: pose.sigma,
        near,
        ahead_mm: None,
        speed: SPEED,
        max_turn: TURN,
    };
    swarm_twist(swarm, &scene)
}

/// Share of the robots that are elsewhere after five seconds more.
fn moving(fleet: &mut Fleet, swarm: Swarm) -> f32 {
    let before = fleet.poses();
    fleet.run(swarm, 5);
    let after = fleet.poses();
    let moved = |(a, b): (&[f32; 3], &[f32; 3])| (a[0] - b[0]).hypot(a[1] - b[1]) > 0.1;
    before
        .iter()
        .zip(&after)
        .filter(|pair| moved(*pair))
        .count() as f32
        / before.len() as f32
}

#[test]
fn a_fleet_that_disperses_leaves_each_other_room_and_rests() {
    for (robots, within) in [(10, 60), (50, 60), (200, 90)] {
        let mut fleet = Fleet::new(robots, 3.0, 3);
        fleet.run(Swarm::Disperse, within);
        let least = pairs(&fleet.poses())
            .into_iter()
            .fold(f32::INFINITY, f32::min);
        assert!(least > APART - 0.1, "{robots}: {least}");
        let moving = moving(&mut fleet, Swarm::Disperse);
        assert!(moving <= 0.05, "{robots}: {moving} of them move");
        assert!(fleet.contacts() <= 0.05, "{robots}: {}", fleet.contacts());
    }
}

#[test]
fn a_fleet_gathers_in_one_cluster_and_stays() {
    // Which of two hundred close ranks at last is chance: there several seeds count together.
    let alone = [7].as_slice();
    for (robots, area, within, seeds) in [
        (3, 4.0, 60, alone),
        (50, 3.0, 120, alone),
        (50, 8.0, 120, alone),
        (200, 3.0, 120, &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9]),
    ] {
        let mut moved = 0.0;
        for seed in seeds {
            let mut fleet = Fleet::new(robots, area, *seed);
            let mut together = 0;
            fleet.run_with(GATHER, within, |fleet| {
                let all = clusters(&fleet.poses(), 1.2)[0] * 20 >= robots * 19;
                together = if all { together + 1 } else { 0 };
            });
            assert!(
                together > 20,
                "{robots} robots have been together for {together} s"
            );
            moved += moving(&mut fleet, GATHER);
            assert!(fleet.contacts() <= 0.05, "{}", fleet.contacts());
        }
        let moving = moved / seeds.len() as f32;
        assert!(moving <= 0.05, "{robots}: {moving} of them move");
    }
}

#[test]
fn who_gathers_rests_behind_one_that_rests_nearer_to_the_place_and_behind_no_other() {
    let own = pose(2.0, 0.0, 3.1);
    let other = |x, y, speed| Neighbour::new([x, y], 3.1, speed, 0.0);
    let goes = |near: &[Neighbour]| twist(GATHER, &own, near).v > 0.1;
    assert!(goes(&[]), "nobody is there yet");
    assert!(!goes(&[other(1.5, 0.1, 0.0)]));
    assert!(goes(&[other(1.5, 0.1, 0.2)]), "it moves on");
    assert!(goes(&[other(2.5, 0.0, 0.0)]), "it is behind");
    assert!(goes(&[other(2.0, 0.5, 0.0)]), "it is beside");
    assert!(goes(&[other(1.3, 0.0, 0.0)]), "it is far");
    // Ahead, and yet farther from the place.
    let own = pose(0.35, 0.0, 3.1);
    let beyond = other(0.05, 0.45, 0.0);
    assert!(twist(GATHER, &own, &[beyond]).v > 0.05);
    // The place is where it was told to be.
    let there = Swarm::Gather { x: 2.1, y: 0.1 };
    assert_eq!(twist(there, &pose(2.0, 0.0, 0.0), &[]), Twist::ZERO);
}

#[test]
fn a_flock_stays_together_and_turns_at_walls_as_one() {
    // Order within the last minute, and the share that is in one flock at the end.
    for (robots, seconds, least) in [(10, 120, 0.95), (50, 180, 0.95), (200, 180, 0.85)] {
        let mut fleet = Fleet::new(robots, 3.0, 2);
        let mut orders = Vec::new();
        fleet.run_with(Swarm::Flock, seconds, |fleet| {
            orders.push(order(&fleet.poses()));
        });
        let last = &orders[orders.len() - 60..];
        let mean = last.iter().sum::<f32>() / last.len() as f32;
        assert!(mean >= least, "{robots}: {mean}");
        let together = clusters(&fleet.poses(), 1.2)[0];
        assert!(
            together * 20 >= robots * 19,
            "{robots}: {together} in the largest flock"
        );
        assert!(moving(&mut fleet, Swarm::Flock) > 0.9, "it moves on");
        assert!(fleet.contacts() <= 0.1, "{robots}: {}", fleet.contacts());
    }
}

#[test]
fn a_formation_is_one_lattice_without_holes() {
    for (robots, least) in [(10, 3.4), (50, 4.5), (200, 5.0)] {
        let mut fleet = Fleet::new(robots, 3.0, 1);
        fleet.run(Swarm::Formation, 90);
        let [degree, off] = lattice(&fleet.poses(), LATTICE);
        assert!(degree >= least, "{robots}: {degree} neighbours");
        assert!(off <= 0.04, "{robots}: {off} m off");
        assert_eq!(clusters(&fleet.poses(), 1.3 * LATTICE).len(), 1, "{robots}");
    }
}

#[test]
fn who_is_alone_or_lost_rests_but_a_flock_goes_on() {
    for swarm in [Swarm::Disperse, Swarm::Formation] {
        let twist = twist(swarm, &pose(0.0, 0.0, 0.0), &[]);
        assert_eq!((twist.v, twist.w), (0.0, 0.0), "{swarm:?}");
    }
    assert!(twist(Swarm::Flock, &pose(0.0, 0.0, 0.3), &[]).v > 0.1);
    let lost = Pose {
        sigma: VAGUE + 0.1,
        ..pose(0.0, 0.0, 0.0)
    };
    assert_eq!(twist(Swarm::Flock, &lost, &[]).v, 0.0);
}

proptest! {
    #[test]
    fn no_wish_is_beyond_what_is_permitted(
        own in prop_oneof![
            (-2.0_f32..2.0, -2.0_f32..2.0, -7.0_f32..7.0),
            (any::<f32>(), any::<f32>(), -7.0_f32..7.0),
        ],
        near in prop::collection::vec(any::<[f32; 5]>(), 0..=MOST),
        close in prop::collection::vec(prop::array::uniform5(-2.0_f32..2.0), 0..4),
        ahead_mm in any::<Option<u16>>(),
        swarm in prop_oneof![
            Just(Swarm::Disperse), Just(Swarm::Flock), Just(Swarm::Formation),
            any::<[f32; 2]>().prop_map(|[x, y]| Swarm::Gather { x, y }),
        ],
    ) {
        let near: Vec<Neighbour> = near
            .iter()
            .chain(&close)
            .map(|[x, y, theta, v, turn]| Neighbour::new([*x, *y], *theta, *v, *turn))
            .collect();
        let pose = pose(own.0, own.1, own.2);
        let scene = Scene {
            here: PoseMm::new(&pose),
            sigma: pose.sigma,
            near: &near,
            ahead_mm,
            speed: SPEED,
            max_turn: TURN,
        };
        let twist = swarm_twist(swarm, &scene);
        prop_assert!(twist.v.is_finite() && twist.v.abs() <= SPEED, "{twist:?}");
        prop_assert!(twist.w.is_finite() && twist.w.abs() <= TURN, "{twist:?}");
    }
}
