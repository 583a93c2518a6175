//! What comes of the rules when everybody follows them, and that nothing a neighbour says, however absurd,
//! makes a wish beyond what is permitted.

use std::vec::Vec;

use crawler_hal::{Duration, Instant};
use crawler_protocol::{
    BehaviourName, Formation, MAX_PLACES, MAX_SAYS, Measure, Places, Pose, Says, Shape,
};
use proptest::prelude::*;

use super::{MissionNews, Scene, Underway, Wish};
use crate::behaviour::{goto_twist, steer};
use crate::goal::Mission;
use crate::motion::angle::{PoseMm, length};
use crate::neighbours::{MOST, Neighbour};
use crate::perception::Reading;

const SPEED: f32 = 0.3;
const TURN: f32 = 3.0;
const STEP_MS: u64 = 20;
/// How far a robot hears, in millimetres: the cells around it reach no less.
const HEARS_MM: i32 = 2_000;
const LEADER: u32 = 77;

pub(super) fn pose(x: f32, y: f32, theta: f32) -> Pose {
    Pose {
        x,
        y,
        theta,
        sigma: 0.02,
    }
}

/// A robot without a ranger, on a floor without walls.
pub(super) struct Robot {
    pub(super) who: u32,
    pub(super) pose: Pose,
    v: f32,
    pub(super) mission: Underway,
    over: bool,
    news: Vec<MissionNews>,
}

impl Robot {
    pub(super) fn new(who: u32, pose: Pose, mission: Option<Mission>) -> Self {
        Self {
            who,
            pose,
            v: 0.0,
            mission: mission.map_or(Underway::None, |mission| Underway::begin(&mission, &pose)),
            over: false,
            news: Vec::new(),
        }
    }

    fn seen(&self, at: Instant) -> Neighbour {
        let Pose { x, y, theta, .. } = self.pose;
        Neighbour {
            who: self.who,
            says: self.mission.says(),
            ..Neighbour::new([x, y], theta, self.v, 0.0).seen(at)
        }
    }

    fn drive(&mut self, v: f32, w: f32) {
        let seconds = STEP_MS as f32 / 1_000.0;
        self.v = v;
        self.pose.x += v * self.pose.theta.cos() * seconds;
        self.pose.y += v * self.pose.theta.sin() * seconds;
        self.pose.theta = crate::motion::wrap(self.pose.theta + w * seconds);
    }

    fn step(&mut self, near: &[Neighbour], now: Instant) {
        let scene = Scene {
            pose: &self.pose,
            near,
            own: self.who,
            reading: &Reading::default(),
            speed: SPEED,
            now,
        };
        let (wish, news) = self.mission.step(&scene);
        self.news.extend(news);
        let twist = match wish {
            Wish::Rest => crate::motion::Twist::ZERO,
            Wish::Velocity(wish) => steer(wish, &PoseMm::new(&self.pose), SPEED, TURN),
            Wish::Place(place, pace) => {
                let twist = goto_twist(&self.pose, place, 0.2, SPEED * pace, TURN);
                twist.unwrap_or_else(|| {
                    self.mission.arrived();
                    crate::motion::Twist::ZERO
                })
            }
            Wish::Done => {
                self.over = true;
                crate::motion::Twist::ZERO
            }
        };
        self.drive(twist.v, twist.w);
    }
}

/// Lets `robots` do what they do for so many seconds, told of each other as the cells would tell them:
/// twice a second, and moved on meanwhile. `lead` drives the robots that are on no mission.
pub(super) fn run(
    robots: &mut [Robot],
    begun: u64,
    seconds: u64,
    lead: impl Fn(u64) -> (f32, f32),
) {
    let mut told: Vec<Neighbour> = Vec::new();
    for step in 0..seconds * 1_000 / STEP_MS {
        let ms = begun + step * STEP_MS;
        let now = Instant::BOOT + Duration::from_millis(ms);
        if step % 25 == 0 {
            told = robots.iter().map(|robot| robot.seen(now)).collect();
        }
        for robot in &mut *robots {
            if robot.mission == Underway::None {
                let (v, w) = lead(ms);
                robot.drive(v, w);
                continue;
            }
            let here = PoseMm::new(&robot.pose).at;
            let away = |other: &Neighbour| length([other.at[0] - here[0], other.at[1] - here[1]]);
            let mut near: Vec<Neighbour> = told
                .iter()
                .filter(|other| other.who != robot.who && away(other) <= HEARS_MM)
                .copied()
                .collect();
            near.retain_mut(|other| other.advance(now));
            near.sort_by_key(away);
            near.truncate(MOST);
            robot.step(&near, now);
        }
    }
}

fn apart(a: &Robot, b: &Robot) -> f32 {
    (a.pose.x - b.pose.x).hypot(a.pose.y - b.pose.y)
}

fn hops(robot: &Robot) -> i32 {
    let says = robot.mission.says().expect("says something");
    says.by(BehaviourName::Follow).expect("that it follows")[1]
}

/// A leader in front of a column of so many, each 0.7 m behind the one before.
fn column(count: u16) -> Vec<Robot> {
    let follow = Mission::Follow {
        leader: LEADER,
        distance: 0.5,
    };
    let followers = (1..=count).map(|n| {
        let behind = -0.7 * f32::from(n);
        Robot::new(u32::from(n), pose(behind, 0.0, 0.0), Some(follow))
    });
    core::iter::once(Robot::new(LEADER, pose(0.0, 0.0, 0.0), None))
        .chain(followers)
        .collect()
}

#[test]
fn a_column_follows_its_leader_also_who_does_not_hear_it() {
    let mut robots = column(10);
    // Two metres are heard: the last of ten are four chains away.
    run(&mut robots, 0, 5, |_| (0.0, 0.0));
    assert!(hops(&robots[10]) > 2, "{}", hops(&robots[10]));
    // Along a curve of 2 m radius, for 12 m.
    run(&mut robots, 5_000, 60, |_| (0.2, 0.1));
    for robot in &robots[1..] {
        assert!(hops(robot) > 0, "{} has lost it", robot.who);
        assert!(robot.news.is_empty());
        let nearest = robots.iter().filter(|other| other.who != robot.who);
        let nearest = nearest.map(|other| apart(robot, other));
        let nearest = nearest.fold(f32::INFINITY, f32::min);
        assert!((0.2..1.0).contains(&nearest), "{nearest}");
    }
    let last = robots[1..].iter().map(|robot| apart(robot, &robots[0]));
    let last = last.fold(0.0, f32::max);
    assert!(last < 6.0, "{last} m behind");
}

#[test]
fn whoever_has_lost_the_leader_says_so_and_rests() {
    let mut robots = column(3);
    run(&mut robots, 0, 3, |_| (0.0, 0.0));
    // It is taken away.
    robots.remove(0);
    run(&mut robots, 3_000, 20, |_| (0.0, 0.0));
    for robot in &robots {
        assert_eq!(hops(robot), 0, "each believed the others for so long");
        assert_eq!(robot.news, [MissionNews::LeaderLost]);
        assert_eq!(robot.v, 0.0);
    }
    // And comes back.
    robots.push(Robot::new(LEADER, pose(0.0, 0.5, 0.0), None));
    run(&mut robots, 23_000, 10, |_| (0.0, 0.0));
    for robot in &robots[..3] {
        assert!(hops(robot) > 0);
    }
}

#[test]
fn followers_of_another_leader_are_nobody_to_go_behind() {
    let mut robots = column(1);
    robots[0].who = 5;
    let other = Mission::Follow {
        leader: 5,
        distance: 0.5,
    };
    robots.push(Robot::new(9, pose(-1.2, 0.4, 0.0), Some(other)));
    run(&mut robots, 0, 5, |_| (0.0, 0.0));
    assert_eq!(hops(&robots[1]), 0);
    assert_eq!(hops(&robots[2]), 1);
}

fn square() -> Places {
    Places::new(&[[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]]).expect("four places")
}

fn progress(robot: &Robot) -> i32 {
    let says = robot.mission.says().expect("says something");
    says.by(BehaviourName::Patrol)
        .expect("that it is on patrol")[1]
}

#[test]
fn laps_are_counted_from_the_nearest_place_and_end() {
    let patrol = Mission::Patrol {
        waypoints: square(),
        laps: 2,
    };
    let mut robots = [Robot::new(1, pose(3.5, 0.2, 0.0), Some(patrol))];
    // Two rounds are 32 m at 0.3 m/s, and slower around corners.
    run(&mut robots, 0, 90, |_| (0.0, 0.0));
    assert!(!robots[0].over);
    run(&mut robots, 90_000, 60, |_| (0.0, 0.0));
    assert!(robots[0].over);
    let end = apart(&robots[0], &Robot::new(0, pose(4.0, 0.0, 0.0), None));
    assert!(end < 0.25, "{end} m from where the first round began");
    assert!(robots[0].news.is_empty());
}

#[test]
fn robots_on_one_round_spread_until_they_do_not_hear_each_other() {
    let patrol = Mission::Patrol {
        waypoints: square(),
        laps: 0,
    };
    let mut robots: Vec<Robot> = (0..5_u8)
        .map(|n| {
            let at = pose(0.3 * f32::from(n), -0.1, 0.0);
            Robot::new(u32::from(n), at, Some(patrol))
        })
        .collect();
    run(&mut robots, 0, 400, |_| (0.0, 0.0));
    let mut along: Vec<i32> = robots.iter().map(progress).collect();
    along.sort_unstable();
    let ends = along.iter().cycle().skip(1);
    let gaps: Vec<i32> = along
        .iter()
        .zip(ends)
        .map(|(a, b)| (b - a).rem_euclid(1_000))
        .collect();
    // 16 m for five robots would be 3.2 m each; they hear 2 m, which are 125 thousandths.
    assert!(gaps.iter().all(|gap| *gap > 100), "{gaps:?}");
    for robot in &robots {
        assert!(robot.news.is_empty());
    }
}

#[test]
fn who_meets_on_a_line_keeps_right() {
    let patrol = Mission::Patrol {
        waypoints: Places::new(&[[0.0, 0.0], [6.0, 0.0]]).expect("two places"),
        laps: 0,
    };
    let mut robots = [
        Robot::new(1, pose(0.5, 0.0, 0.0), Some(patrol)),
        Robot::new(2, pose(5.0, 0.0, core::f32::consts::PI), Some(patrol)),
    ];
    let mut least = f32::INFINITY;
    for second in 0..120 {
        run(&mut robots, second * 1_000, 1, |_| (0.0, 0.0));
        least = least.min(apart(&robots[0], &robots[1]));
    }
    assert!(least > 0.3, "{least} m");
}

#[test]
fn a_place_that_cannot_be_reached_is_skipped() {
    let patrol = Mission::Patrol {
        waypoints: square(),
        laps: 1,
    };
    let mut robot = Robot::new(1, pose(0.0, 0.0, 0.0), Some(patrol));
    let mut skipped = Vec::new();
    // It stands, whatever it wants: every place but the one where it is takes its time.
    for second in 0..2_000 {
        let at = robot.pose;
        robot.step(&[], Instant::BOOT + Duration::from_secs(second));
        robot.pose = at;
        skipped.append(&mut robot.news);
    }
    assert!(robot.over);
    assert_eq!(
        skipped,
        [2, 3, 4].map(MissionNews::Skipped),
        "and the last is the one where it stands"
    );
}

fn places() -> impl Strategy<Value = Places> {
    let along = || prop_oneof![4 => -4.0_f32..4.0, 1 => Just(0.0), 1 => -10_000.0_f32..10_000.0];
    let place = (along(), along()).prop_map(|(x, y)| [x, y]);
    prop::collection::vec(place, 2..=MAX_PLACES)
        .prop_map(|places| Places::new(&places).expect("in bounds"))
}

fn formation() -> impl Strategy<Value = Formation> {
    let shape = prop::sample::select(Shape::ALL);
    (shape, 0.0_f32..=1.0, -6.3_f32..6.3, places()).prop_map(|(shape, share, heading, path)| {
        let (_, [least, most], _) = Formation::size_of(shape);
        let size = least + share * (most - least);
        Formation {
            shape,
            size,
            heading,
            path,
        }
    })
}

pub(super) fn mission() -> impl Strategy<Value = Mission> {
    prop_oneof![
        (0_u32..4, 0.3_f32..2.0)
            .prop_map(|(leader, distance)| Mission::Follow { leader, distance }),
        (-9.0_f32..9.0, 0_u8..3).prop_map(|(value, f)| Mission::Consensus {
            measure: Measure::Value(value),
            f,
        }),
        places().prop_map(|tasks| Mission::Allocate { tasks }),
        places().prop_map(|area| Mission::Cover { area }),
        formation().prop_map(Mission::Shaped),
        (places(), 0_u16..3).prop_map(|(waypoints, laps)| Mission::Patrol { waypoints, laps }),
    ]
}

fn says() -> impl Strategy<Value = Says> {
    let number = prop_oneof![4 => -2_i32..20, 2 => 0_i32..1_001, 1 => any::<i32>()];
    let kind = prop_oneof![8 => 8_i32..13, 2 => Just(6_i32), 1 => any::<i32>()];
    (kind, prop::collection::vec(number, 0..MAX_SAYS)).prop_map(|(kind, mut rest)| {
        rest.insert(0, kind);
        Says::of_numbers(&rest).expect("one to six")
    })
}

proptest! {
    #[test]
    fn whatever_is_said_wishes_are_finite_and_the_robot_says_something(
        mission in mission(),
        at in (-9.0_f32..9.0, -9.0_f32..9.0, -3.0_f32..3.0, 0.0_f32..1.0),
        rounds in prop::collection::vec(
            prop::collection::vec(
                (0_u32..6, -5.0_f32..5.0, -5.0_f32..5.0, prop::option::of(says())),
                0..MOST,
            ),
            1..12,
        ),
    ) {
        let (x, y, theta, sigma) = at;
        let pose = Pose { x, y, theta, sigma };
        let mut underway = Underway::begin(&mission, &pose);
        for (round, near) in rounds.iter().enumerate() {
            let near: Vec<Neighbour> = near
                .iter()
                .map(|(who, x, y, says)| Neighbour {
                    who: *who,
                    says: *says,
                    ..Neighbour::new([*x, *y], -0.8, 0.14, 0.0)
                })
                .collect();
            let now = Instant::BOOT + Duration::from_millis(round as u64 * 700);
            let scene = Scene { pose: &pose, near: &near, own: 3, reading: &Reading::default(), speed: SPEED, now };
            match underway.step(&scene).0 {
                Wish::Rest | Wish::Done => {}
                Wish::Velocity([x, y]) => {
                    let twist = steer([x, y], &PoseMm::new(&pose), SPEED, TURN);
                    prop_assert!(twist.v.abs() <= SPEED && twist.w.abs() <= TURN);
                }
                Wish::Place([x, y], pace) => {
                    prop_assert!(x.is_finite() && y.is_finite());
                    prop_assert!((0.0..=1.0).contains(&pace));
                }
            }
            let says = underway.says().expect("says something");
            prop_assert!(says.numbers().len() <= MAX_SAYS);
            if round % 3 == 2 {
                underway.arrived();
            }
        }
    }
}
