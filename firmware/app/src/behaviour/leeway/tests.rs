//! Points with a heading that turn where they like, told of each other twice a second.

use std::vec::Vec;

use crawler_hal::Instant;
use crawler_protocol::Pose;
use proptest::prelude::*;

use super::Leeway;
use crate::motion::angle::{PoseMm, millimetres};
use crate::motion::wrap;
use crate::neighbours::{MOST, Neighbour};
use crate::state::Side;

/// Metres per second.
const SPEED: f32 = 0.3;
/// Seconds of a step, and by how much the speed changes in it.
const STEP: f32 = 0.02;
const RAMP: f32 = 0.025;
/// Two bodies touch from here on, in metres.
const TOUCH: f32 = 0.17;

#[derive(Debug, Clone, Copy)]
struct Robot {
    pose: Pose,
    v: f32,
    /// How it turns, and how fast it wants to be.
    w: f32,
    speed: f32,
}

fn robot([x, y, theta]: [f32; 3], w: f32, speed: f32) -> Robot {
    let pose = Pose {
        x,
        y,
        theta,
        sigma: 0.02,
    };
    Robot {
        pose,
        v: 0.0,
        w,
        speed,
    }
}

fn near_of(told: &[Neighbour], who: u32, now: Instant) -> Vec<Neighbour> {
    let others = told.iter().filter(|other| other.who != who);
    let mut near: Vec<Neighbour> = others.copied().collect();
    near.retain_mut(|other| other.advance(now));
    near.truncate(MOST);
    near
}

fn least_gap(robots: &[Robot]) -> f32 {
    let mut least = f32::INFINITY;
    for (index, a) in robots.iter().enumerate() {
        for b in &robots[index + 1..] {
            least = least.min((a.pose.x - b.pose.x).hypot(a.pose.y - b.pose.y));
        }
    }
    least - TOUCH
}

/// Lets all of them drive for so many seconds: the least gap between two of them, and how far they drove.
fn run(robots: &mut [Robot], seconds: u32, keeps_off: bool) -> (f32, f32) {
    let mut told: Vec<Neighbour> = Vec::new();
    let (mut least, mut driven) = (f32::INFINITY, 0.0);
    for step in 0..seconds * 50 {
        let now = Instant::from_millis(u64::from(step) * 20);
        if step % 25 == 0 {
            let tell = |(who, robot): (u32, &Robot)| {
                let Pose { x, y, theta, .. } = robot.pose;
                Neighbour {
                    who,
                    ..Neighbour::new([x, y], theta, robot.v, robot.w).seen(now)
                }
            };
            told = (0..).zip(&*robots).map(tell).collect();
        }
        for (who, robot) in (0_u32..).zip(&mut *robots) {
            let mut wanted = robot.speed;
            if keeps_off {
                let near = near_of(&told, who, now);
                let sigma = millimetres(robot.pose.sigma);
                let here = PoseMm::new(&robot.pose);
                let most = Leeway::of(&here, sigma, millimetres(wanted), &near).speed;
                let most = most as f32 / 1_000.0;
                wanted = wanted.clamp(-most, most);
            }
            robot.v += (wanted - robot.v).clamp(-RAMP, RAMP);
            robot.pose.x += STEP * robot.v * robot.pose.theta.cos();
            robot.pose.y += STEP * robot.v * robot.pose.theta.sin();
            robot.pose.theta = wrap(robot.pose.theta + STEP * robot.w);
            driven += STEP * robot.v.abs();
        }
        least = least.min(least_gap(robots));
    }
    (least, driven)
}

/// Of two thousand pairs that start anywhere and turn as they like, also backwards.
#[test]
fn two_who_keep_to_it_do_not_touch_however_they_meet() {
    let mut random = 1_u32;
    let mut draw = |low: f32, high: f32| {
        random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        low + (high - low) * ((random >> 8) as f32 / (1 << 24) as f32)
    };
    let (mut touched, mut would) = (0, 0);
    for _ in 0..2_000 {
        let mut drawn = |at: f32| {
            let speed = if draw(0.0, 1.0) < 0.2 { -0.15 } else { SPEED };
            let turn = draw(-1.0, 1.0);
            robot([at, draw(-0.4, 0.4), draw(-3.1, 3.1)], turn, speed)
        };
        let mut pair = [drawn(0.0), drawn(0.5)];
        if least_gap(&pair) < 0.1 {
            continue;
        }
        would += u32::from(run(&mut pair.clone(), 8, false).0 < 0.0);
        touched += u32::from(run(&mut pair, 8, true).0 < 0.0);
    }
    assert!(would > 200, "{would}");
    assert!(touched * 40 <= would, "{touched} of {would}");
}

#[test]
fn who_drives_behind_another_is_not_slowed_and_who_passes_is_not_stopped() {
    let mut column = [
        robot([0.0, 0.0, 0.0], 0.0, SPEED),
        robot([0.45, 0.0, 0.0], 0.0, SPEED),
    ];
    let (least, driven) = run(&mut column, 10, true);
    assert!(least > 0.1 && driven > 5.5, "{least} {driven}");
    let mut meeting = [
        robot([0.0, 0.0, 0.0], 0.0, SPEED),
        robot([2.0, 0.3, core::f32::consts::PI], 0.0, SPEED),
    ];
    let (least, driven) = run(&mut meeting, 10, true);
    assert!(least > 0.1 && driven > 4.5, "{least} {driven}");
}

#[test]
fn it_says_on_which_side_who_is_in_the_way_is() {
    let here = PoseMm::new(&Pose::default());
    let of = |wanted, x, y| {
        let other = Neighbour::new([x, y], 0.0, 0.0, 0.0);
        Leeway::of(&here, 0, wanted, &[other])
    };
    let left = of(300, 0.3, 0.05);
    assert!(left.speed < 150 && left.side == Side::Left, "{left:?}");
    assert_eq!(of(300, 0.3, -0.05).side, Side::Right);
    // Behind, beside, far away, passed by, and where nobody can be.
    for [x, y] in [
        [-0.3, 0.0],
        [0.0, 0.25],
        [0.9, 0.0],
        [0.5, 0.3],
        [0.05, 0.05],
    ] {
        assert_eq!(of(300, x, y), Leeway::ALL, "{x} {y}");
    }
    assert!(of(-150, -0.3, 0.05).speed < 150);
    assert_eq!(of(-150, 0.3, 0.05), Leeway::ALL);
}

proptest! {
    #[test]
    fn any_neighbours_leave_a_speed(
        theta in -4.0_f32..4.0,
        sigma in 0_i32..1_000_000,
        wanted in any::<i16>(),
        near in prop::collection::vec(prop::array::uniform5(-1.0_f32..1.0), 0..=MOST),
        wild in prop::collection::vec(any::<[f32; 5]>(), 0..3),
    ) {
        let near: Vec<Neighbour> = near
            .iter()
            .chain(&wild)
            .map(|[x, y, theta, v, w]| Neighbour::new([*x, *y], *theta, *v, *w))
            .collect();
        let here = PoseMm::new(&Pose { theta, ..Pose::default() });
        let leeway = Leeway::of(&here, sigma, i32::from(wanted), &near);
        prop_assert!((0..=Leeway::ALL.speed).contains(&leeway.speed), "{leeway:?}");
    }
}
