//! What comes of the rules when everybody follows them, and that no neighbour, however absurd,
//! makes a wish beyond what is permitted.

mod fleet;

use std::vec::Vec;

use crawler_protocol::Pose;
use proptest::prelude::*;

use super::{APART, LATTICE, VAGUE, swarm_twist};
use crate::goal::Swarm;
use crate::motion::Twist;
use crate::neighbours::{MOST, Neighbour};

use fleet::{Fleet, SPEED, TURN, clusters};

const GATHER: Swarm = Swarm::Gather { x: 0.0, y: 0.0 };
const STEP: f32 = 0.02;

fn pose(x: f32, y: f32, theta: f32) -> Pose {
    Pose {
        x,
        y,
        theta,
        sigma: 0.02,
    }
}

/// Lets everybody follow `swarm` for so many seconds, and knows all the others as the cells would
/// tell them: twice a second.
fn run(swarm: Swarm, poses: &mut [Pose], seconds: u32) {
    let mut speeds = std::vec![0.0_f32; poses.len()];
    let mut told: Vec<Neighbour> = Vec::new();
    for step in 0..seconds * 50 {
        if step % 25 == 0 {
            told = poses
                .iter()
                .zip(&speeds)
                .map(|(pose, v)| Neighbour {
                    x: pose.x,
                    y: pose.y,
                    velocity: [v * pose.theta.cos(), v * pose.theta.sin()],
                })
                .collect();
        }
        let age = (step % 25) as f32 * STEP;
        for (own, pose) in poses.iter_mut().enumerate() {
            let near: Vec<Neighbour> = told
                .iter()
                .enumerate()
                .filter(|(other, _)| *other != own)
                .map(|(_, n)| Neighbour {
                    x: n.x + n.velocity[0] * age,
                    y: n.y + n.velocity[1] * age,
                    ..*n
                })
                .collect();
            let twist = swarm_twist(swarm, pose, &near, SPEED, TURN);
            speeds[own] = twist.v;
            pose.x += twist.v * pose.theta.cos() * STEP;
            pose.y += twist.v * pose.theta.sin() * STEP;
            pose.theta = crate::motion::wrap(pose.theta + twist.w * STEP);
        }
    }
}

fn distances(poses: &[Pose]) -> Vec<f32> {
    let mut all = Vec::new();
    for (index, a) in poses.iter().enumerate() {
        for b in &poses[index + 1..] {
            all.push((a.x - b.x).hypot(a.y - b.y));
        }
    }
    all.sort_by(f32::total_cmp);
    all
}

fn scattered(spread: f32) -> Vec<Pose> {
    (0..9_u8)
        .map(|n| {
            let (column, row) = (f32::from(n % 3), f32::from(n / 3));
            let angle = f32::from(n) * 0.7;
            pose(
                column * spread + 0.05 * angle.sin(),
                row * spread + 0.05 * angle.cos(),
                angle,
            )
        })
        .collect()
}

#[test]
fn who_disperses_ends_apart_and_rests() {
    let mut poses = scattered(0.4);
    run(Swarm::Disperse, &mut poses, 60);
    let least = distances(&poses)[0];
    assert!(least > APART - 0.1, "{least}");
    let before = poses.clone();
    run(Swarm::Disperse, &mut poses, 5);
    for (a, b) in poses.iter().zip(&before) {
        assert!((a.x - b.x).hypot(a.y - b.y) < 0.05, "at rest");
    }
}

#[test]
fn a_fleet_gathers_in_one_cluster_and_stays() {
    for (robots, area, within) in [(3, 4.0, 60), (50, 2.0, 120), (50, 6.0, 120)] {
        let mut fleet = Fleet::new(robots, area, 7);
        let mut together = 0;
        fleet.run_with(GATHER, within, |fleet| {
            let all = clusters(&fleet.poses(), 1.2)[0] * 20 >= robots * 19;
            together = if all { together + 1 } else { 0 };
        });
        assert!(
            together > 20,
            "{robots} robots have been together for {together} s"
        );
        let before = fleet.poses();
        fleet.run(GATHER, 10);
        let after = fleet.poses();
        let moved = |(a, b): (&[f32; 3], &[f32; 3])| (a[0] - b[0]).hypot(a[1] - b[1]) > 0.1;
        let moving = before
            .iter()
            .zip(&after)
            .filter(|pair| moved(*pair))
            .count();
        assert!(moving * 20 <= robots, "{moving} of {robots} move");
        assert!(fleet.contacts() <= 0.05, "{}", fleet.contacts());
    }
}

#[test]
fn who_gathers_rests_behind_one_that_rests_nearer_to_the_place_and_behind_no_other() {
    let own = pose(2.0, 0.0, 3.1);
    let other = |x, y, velocity| Neighbour { x, y, velocity };
    let goes = |near: &[Neighbour]| swarm_twist(GATHER, &own, near, SPEED, TURN).v > 0.1;
    assert!(goes(&[]), "nobody is there yet");
    assert!(!goes(&[other(1.5, 0.1, [0.0; 2])]));
    assert!(goes(&[other(1.5, 0.1, [-0.2, 0.0])]), "it moves on");
    assert!(goes(&[other(2.5, 0.0, [0.0; 2])]), "it is behind");
    assert!(goes(&[other(2.0, 0.5, [0.0; 2])]), "it is beside");
    assert!(goes(&[other(1.3, 0.0, [0.0; 2])]), "it is far");
    // Ahead, and yet farther from the place.
    let own = pose(0.35, 0.0, 3.1);
    let beyond = other(0.05, 0.45, [0.0; 2]);
    assert!(swarm_twist(GATHER, &own, &[beyond], SPEED, TURN).v > 0.05);
    // The place is where it was told to be.
    let there = Swarm::Gather { x: 2.1, y: 0.1 };
    assert_eq!(
        swarm_twist(there, &pose(2.0, 0.0, 0.0), &[], SPEED, TURN),
        Twist::ZERO
    );
}

#[test]
fn a_flock_moves_on_and_points_one_way() {
    let mut poses = scattered(0.8);
    run(Swarm::Flock, &mut poses, 40);
    let (sin, cos) = poses.iter().fold((0.0, 0.0), |(sin, cos), pose| {
        (sin + pose.theta.sin(), cos + pose.theta.cos())
    });
    let order = f32::hypot(sin, cos) / poses.len() as f32;
    assert!(order > 0.9, "{order}");
    assert!(distances(&poses)[0] > 0.2);
    let before = poses[4];
    run(Swarm::Flock, &mut poses, 10);
    assert!(
        (poses[4].x - before.x).hypot(poses[4].y - before.y) > 1.0,
        "moves on"
    );
}

#[test]
fn a_formation_is_a_lattice() {
    let mut poses = scattered(0.5);
    run(Swarm::Formation, &mut poses, 60);
    let apart = distances(&poses);
    assert!(apart[0] > 0.75 * LATTICE, "{apart:?}");
    for pose in &poses {
        let beside = poses
            .iter()
            .map(|other| (pose.x - other.x).hypot(pose.y - other.y))
            .filter(|distance| *distance > 0.0 && (distance - LATTICE).abs() < 0.2 * LATTICE)
            .count();
        assert!(beside >= 2, "{beside} neighbours in place: {apart:?}");
    }
}

#[test]
fn who_is_alone_or_lost_rests_but_a_flock_goes_on() {
    for swarm in [Swarm::Disperse, Swarm::Formation] {
        let twist = swarm_twist(swarm, &pose(0.0, 0.0, 0.0), &[], SPEED, TURN);
        assert_eq!((twist.v, twist.w), (0.0, 0.0), "{swarm:?}");
    }
    assert!(swarm_twist(Swarm::Flock, &pose(0.0, 0.0, 0.3), &[], SPEED, TURN).v > 0.1);
    let lost = Pose {
        sigma: VAGUE + 0.1,
        ..pose(0.0, 0.0, 0.0)
    };
    assert_eq!(swarm_twist(Swarm::Flock, &lost, &[], SPEED, TURN).v, 0.0);
}

proptest! {
    #[test]
    fn no_wish_is_beyond_what_is_permitted(
        own in (any::<f32>(), any::<f32>(), -7.0_f32..7.0),
        near in prop::collection::vec(any::<[f32; 4]>(), 0..MOST),
        swarm in prop_oneof![
            Just(Swarm::Disperse), Just(Swarm::Flock), Just(Swarm::Formation),
            any::<[f32; 2]>().prop_map(|[x, y]| Swarm::Gather { x, y }),
        ],
    ) {
        let near: Vec<Neighbour> = near
            .iter()
            .map(|[x, y, vx, vy]| Neighbour { x: *x, y: *y, velocity: [*vx, *vy] })
            .collect();
        let twist = swarm_twist(swarm, &pose(own.0, own.1, own.2), &near, SPEED, TURN);
        prop_assert!(twist.v.is_finite() && twist.v.abs() <= SPEED, "{twist:?}");
        prop_assert!(twist.w.is_finite() && twist.w.abs() <= TURN, "{twist:?}");
    }
}
