//! Whoever hears whom, robots come to one assignment without conflicts, and it is as good as promised.

use std::vec::Vec;

use crawler_hal::Instant;
use crawler_protocol::{Places, Pose};
use proptest::prelude::*;

use super::{Allocate, ROUND, centimetres};
use crate::behaviour::mission::{Scene, Wish};
use crate::motion::angle::millimetres;
use crate::neighbours::Neighbour;
use crate::perception::Reading;

struct Draw(u64);

impl Draw {
    fn below(&mut self, most: usize) -> usize {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (self.0 >> 33) as usize % most
    }

    fn place(&mut self) -> [f32; 2] {
        [0, 1].map(|_| self.below(600) as f32 / 100.0)
    }
}

/// A robot that stands where it is, and is at its task as far as the auction goes.
struct Robot {
    who: u32,
    at: [f32; 2],
    auction: Allocate,
}

/// Robots, who hears whom, and what gets lost.
struct Fleet {
    robots: Vec<Option<Robot>>,
    hears: Vec<Vec<usize>>,
    tasks: Places,
    lost: usize,
    round: u32,
    draw: Draw,
}

impl Fleet {
    /// So many robots and tasks anywhere, and a random connected graph: each hears one of those before it, and some
    /// more do.
    fn new(robots: usize, tasks: usize, more: usize, lost: usize, seed: u64) -> Self {
        let mut draw = Draw(seed);
        let places: Vec<[f32; 2]> = (0..tasks).map(|_| draw.place()).collect();
        let tasks = Places::new(&places).expect("few and near");
        let mut hears = std::vec![Vec::new(); robots];
        let link = |a: usize, b: usize, hears: &mut Vec<Vec<usize>>| {
            if a != b && !hears[a].contains(&b) {
                hears[a].push(b);
                hears[b].push(a);
            }
        };
        for new in 1..robots {
            link(new, draw.below(new), &mut hears);
        }
        for _ in 0..more {
            link(draw.below(robots), draw.below(robots), &mut hears);
        }
        let robots = (0..robots).map(|n| {
            Some(Robot {
                who: (n as u32 + 1).wrapping_mul(2_654_435_769),
                at: draw.place(),
                auction: Allocate::new(tasks),
            })
        });
        Self {
            robots: robots.collect(),
            hears,
            tasks,
            lost,
            round: 0,
            draw,
        }
    }

    fn run(&mut self, rounds: u32) {
        for _ in 0..rounds {
            self.round += 1;
            let told: Vec<Option<Neighbour>> = self
                .robots
                .iter()
                .map(|robot| {
                    let robot = robot.as_ref()?;
                    Some(Neighbour {
                        who: robot.who,
                        says: Some(robot.auction.says()),
                        ..Neighbour::new(robot.at, 0.0, 0.0, 0.0)
                    })
                })
                .collect();
            for own in 0..self.robots.len() {
                let (draw, lost) = (&mut self.draw, self.lost);
                let near: Vec<Neighbour> = self.hears[own]
                    .iter()
                    .filter(|_| draw.below(100) >= lost)
                    .filter_map(|other| told[*other])
                    .collect();
                if let Some(robot) = &mut self.robots[own] {
                    robot.step(&near, self.round);
                }
            }
        }
    }

    /// The task of each robot.
    fn assigned(&self) -> Vec<Option<u8>> {
        let robots = self.robots.iter();
        robots
            .map(|robot| robot.as_ref().and_then(|robot| robot.auction.mine))
            .collect()
    }

    fn cost(&self, robot: usize, task: usize) -> i64 {
        let [x, y] = self.robots[robot]
            .as_ref()
            .map_or([0.0; 2], |robot| robot.at);
        let [to_x, to_y] = self.tasks.as_slice()[task];
        i64::from(centimetres(millimetres((to_x - x).hypot(to_y - y))))
    }

    /// The best score there is, when each task taken counts `most` less its cost.
    fn best(&self, most: i64, robot: usize, free: &mut Vec<usize>) -> i64 {
        if robot == self.robots.len() {
            return 0;
        }
        let mut best = self.best(most, robot + 1, free);
        for place in 0..free.len() {
            let task = free.swap_remove(place);
            let score = most - self.cost(robot, task) + self.best(most, robot + 1, free);
            best = best.max(score);
            free.push(task);
            let last = free.len() - 1;
            free.swap(place, last);
        }
        best
    }
}

impl Robot {
    fn step(&mut self, near: &[Neighbour], round: u32) {
        let pose = Pose {
            x: self.at[0],
            y: self.at[1],
            ..Pose::default()
        };
        let scene = Scene {
            pose: &pose,
            near,
            own: self.who,
            reading: &Reading::default(),
            speed: 0.3,
            now: Instant::BOOT + ROUND * round,
        };
        if let (Wish::Place(..), _) = self.auction.step(&scene) {
            self.auction.arrived();
        }
    }
}

/// Whether no two have one task.
fn is_free_of_conflicts(assigned: &[Option<u8>]) -> bool {
    let mut taken: Vec<u8> = assigned.iter().flatten().copied().collect();
    let count = taken.len();
    taken.sort_unstable();
    taken.dedup();
    taken.len() == count
}

proptest! {
    #![proptest_config(crawler_properties::cases(96))]

    #[test]
    fn tasks_are_shared_out_without_conflict_and_well(
        robots in 2_usize..=6,
        tasks in 1_usize..=6,
        more in 0_usize..6,
        lost in 0_usize..20,
        seed in any::<u64>(),
    ) {
        let mut fleet = Fleet::new(robots, tasks, more, lost, seed);
        // A rotation of what is known for each hop, and once for each task that changes hands.
        fleet.run(200);
        // While words get lost, somebody far away may take a winner for lost and bid, until it hears of it again.
        fleet.lost = 0;
        fleet.run(40);
        let assigned = fleet.assigned();
        prop_assert!(is_free_of_conflicts(&assigned), "{assigned:?}");
        prop_assert_eq!(assigned.iter().flatten().count(), robots.min(tasks), "{:?}", assigned);
        let costs = (0..robots).flat_map(|robot| (0..tasks).map(move |task| (robot, task)));
        let most = costs.map(|(robot, task)| fleet.cost(robot, task)).max().expect("one");
        let score: i64 = assigned
            .iter()
            .enumerate()
            .filter_map(|(robot, task)| Some(most - fleet.cost(robot, usize::from((*task)?))))
            .sum();
        let best = fleet.best(most, 0, &mut (0..tasks).collect());
        prop_assert!(2 * score >= best, "{score} of {best}: {assigned:?}");
    }
}

#[test]
fn where_words_get_lost_two_seldom_have_one_task() {
    let (mut rounds, mut conflicts) = (0, 0);
    for seed in 0..100 {
        // Every sixth word is lost, and each robot hears few others.
        let mut fleet = Fleet::new(6, 3, 0, 16, seed);
        fleet.run(100);
        for _ in 0..200 {
            fleet.run(1);
            rounds += 1;
            conflicts += u32::from(!is_free_of_conflicts(&fleet.assigned()));
        }
    }
    // 338 of 20,000: a longer patience with the silent would leave the tasks of the lost longer too.
    assert!(40 * conflicts <= rounds, "{conflicts} of {rounds}");
}

#[test]
fn the_task_of_a_lost_robot_is_taken_over_and_stays_so() {
    // A chain of five, three tasks.
    for seed in 0..20 {
        let mut fleet = Fleet::new(5, 3, 0, 10, seed);
        fleet.run(100);
        let before = fleet.assigned();
        assert_eq!(before.iter().flatten().count(), 3);
        // One that is nobody's only way to others.
        let ends = |robot: &usize| fleet.hears[*robot].len() == 1 && before[*robot].is_some();
        let Some(gone) = (0..5).find(ends) else {
            continue;
        };
        fleet.robots[gone] = None;
        // Bids last five rotations of three; then it is bid for anew.
        fleet.run(80);
        let after = fleet.assigned();
        assert!(is_free_of_conflicts(&after), "seed {seed}: {after:?}");
        assert_eq!(after.iter().flatten().count(), 3, "seed {seed}: {after:?}");
        fleet.run(120);
        assert_eq!(
            fleet.assigned(),
            after,
            "seed {seed}: nobody claims it for the dead"
        );
    }
}

#[test]
fn a_robot_that_starts_anew_is_believed_again() {
    let mut fleet = Fleet::new(3, 2, 1, 0, 3);
    fleet.run(300);
    let holder = fleet
        .assigned()
        .iter()
        .position(Option::is_some)
        .expect("one");
    let tasks = fleet.tasks;
    if let Some(robot) = &mut fleet.robots[holder] {
        robot.auction = Allocate::new(tasks);
    }
    fleet.run(60);
    let after = fleet.assigned();
    assert!(is_free_of_conflicts(&after), "{after:?}");
    assert_eq!(after.iter().flatten().count(), 2);
}

#[test]
fn other_tasks_and_words_without_meaning_are_passed_over() {
    let mut fleet = Fleet::new(1, 2, 0, 0, 1);
    fleet.run(1);
    let robot = fleet.robots[0].as_mut().expect("there");
    let had = robot.auction.mine;
    let list = robot.auction.list;
    let said = |numbers: &[i32]| Neighbour {
        who: 9,
        says: Some(crawler_protocol::Says::new(
            crawler_protocol::BehaviourName::Allocate,
            numbers,
        )),
        ..Neighbour::default()
    };
    for numbers in [
        &[list ^ 1, 1, 0, 9][..],
        &[list, 7 << 8, 0, 9],
        &[list, -1, 0, 9],
        &[list, 1, -1, 9],
        &[list, 1, 70_000, 9],
        &[list],
        &[],
    ] {
        robot.step(&[said(numbers)], 2);
        assert_eq!(robot.auction.mine, had, "{numbers:?}");
    }
}

#[test]
fn a_task_out_of_reach_is_left_to_others() {
    let mut fleet = Fleet::new(1, 1, 0, 0, 1);
    let robot = fleet.robots[0].as_mut().expect("there");
    robot.at = [9.0, 9.0];
    let mut news = Vec::new();
    for round in 0..2_000 {
        let pose = Pose {
            x: 9.0,
            y: 9.0,
            ..Pose::default()
        };
        let scene = Scene {
            pose: &pose,
            near: &[],
            own: robot.who,
            reading: &Reading::default(),
            speed: 0.3,
            now: Instant::BOOT + ROUND * round,
        };
        news.extend(robot.auction.step(&scene).1);
    }
    assert_eq!(news, [crate::behaviour::MissionNews::Skipped(1)]);
    assert_eq!(robot.auction.mine, None);
}
