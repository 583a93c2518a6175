//! Robots on missions: the whole program, and what neighbours say passed on by the broker.

use crate::common::{lockstep, settle};
use crawler_hal::Duration;
use crawler_protocol::{
    Action, BehaviourName, BehaviourSpec, Formation, Measure, Places, RobotId, RobotState, Shape,
};
use crawler_sim::net::lockstep::Cut;
use crawler_sim::run::Simulation;

fn place(simulation: &Simulation, robot: usize) -> [f32; 2] {
    let pose = simulation.pose(robot).expect("is there");
    [pose.x, pose.y]
}

fn apart(a: [f32; 2], b: [f32; 2]) -> f32 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// What a robot says beside the number of its behaviour.
fn says(simulation: &Simulation, robot: usize, behaviour: BehaviourName) -> Vec<i32> {
    let snapshot = simulation.robot(robot).expect("is there").snapshot();
    let said = snapshot.says.as_ref().and_then(|says| says.by(behaviour));
    said.unwrap_or_default().to_vec()
}

/// So many robots, which have kept away from each other for so long.
fn gathered(robots: u32, seconds: u64) -> Simulation {
    let mut simulation = lockstep("empty", robots, 5);
    settle(&mut simulation);
    simulation.submit_all(Action::Behave(BehaviourSpec::Disperse));
    simulation.run_for(Duration::from_secs(seconds));
    simulation
}

fn follow(leader: usize, simulation: &Simulation) -> Action {
    Action::Behave(BehaviourSpec::Follow {
        leader: RobotId::clone(simulation.id(leader).expect("is there")),
        distance: 0.6,
    })
}

/// How many robots follow the first one, directly or over others.
fn following(simulation: &Simulation) -> usize {
    let robots = 1..simulation.robots();
    robots
        .filter(|robot| says(simulation, *robot, BehaviourName::Follow).get(1) > Some(&0))
        .count()
}

#[test]
fn a_leader_is_followed_by_ten() {
    let robots = 10;
    let mut simulation = gathered(robots, 20);
    let action = follow(0, &simulation);
    simulation.submit_all(action);
    simulation.submit(0, Action::Goto { x: 0.0, y: 0.0 });
    simulation.run_for(Duration::from_secs(60));
    let least = (robots - 1) * 9 / 10;
    assert!(
        following(&simulation) as u32 >= least,
        "{}",
        following(&simulation)
    );
    // It goes away, and they come along.
    let from = place(&simulation, 0);
    let to = [if from[0] > 0.0 { -2.0 } else { 2.0 }, from[1]];
    simulation.submit(0, Action::Goto { x: to[0], y: to[1] });
    simulation.run_for(Duration::from_secs(90));
    let leader = place(&simulation, 0);
    assert!(apart(leader, from) > 1.0, "the leader has gone");
    assert!(
        following(&simulation) as u32 >= least,
        "{}",
        following(&simulation)
    );
    let mut ways: Vec<f32> = (1..simulation.robots())
        .map(|robot| apart(leader, place(&simulation, robot)))
        .collect();
    ways.sort_by(f32::total_cmp);
    let reach = ways[ways.len() * 9 / 10];
    // As many as robots of 0.42 m and more fill a half disc behind it.
    let room = 0.6 + 0.55 * (robots as f32).sqrt();
    assert!(reach < room, "{reach} m of {room}: {ways:?}");
}

#[test]
fn a_leader_is_followed_by_fifty_over_each_other() {
    let mut simulation = gathered(50, 30);
    let action = follow(0, &simulation);
    simulation.submit_all(action);
    let far = |simulation: &Simulation| {
        let leader = place(simulation, 0);
        let ways = (1..simulation.robots()).map(|robot| apart(leader, place(simulation, robot)));
        ways.fold(0.0, f32::max)
    };
    let before = far(&simulation);
    assert!(before > 6.0, "farther than anybody hears: {before}");
    simulation.run_for(Duration::from_secs(90));
    let count = following(&simulation);
    assert!(count >= 45, "{count}");
    // Not all of them hear the leader itself.
    let hops = (1..50).filter_map(|robot| {
        says(&simulation, robot, BehaviourName::Follow)
            .get(1)
            .copied()
    });
    assert!(hops.max() > Some(1));
    let mut ways: Vec<f32> = (1..50)
        .map(|robot| apart(place(&simulation, 0), place(&simulation, robot)))
        .collect();
    ways.sort_by(f32::total_cmp);
    let room = 0.6 + 0.55 * 50_f32.sqrt();
    assert!(ways[44] < room, "{} m of {room}", ways[44]);
}

/// What an honest robot begins with.
fn begins(robot: usize) -> f32 {
    20.0 + robot as f32 * 0.5
}

#[test]
fn robots_agree_although_two_lie_and_one_fails() {
    let (robots, honest) = (14, 12);
    let mut simulation = lockstep("empty", robots, 5);
    settle(&mut simulation);
    simulation.submit_all(Action::Behave(BehaviourSpec::Gather { x: 0.0, y: 0.0 }));
    simulation.run_for(Duration::from_secs(45));
    let agree = |value: f32, f: u8| {
        let measure = Measure::Value(value);
        Action::Behave(BehaviourSpec::Consensus { measure, f })
    };
    for robot in 0..honest {
        simulation.submit(robot, agree(begins(robot), 2));
    }
    let failed = 3;
    for second in 0..60 {
        // One says too much and the other too little, then both change their minds.
        let lie = if second % 7 < 4 { 900.0 } else { -900.0 };
        simulation.submit(honest, agree(lie, 7));
        simulation.submit(honest + 1, agree(-lie, 7));
        if second == 5 {
            simulation.cut(failed, Cut::Radio);
        }
        simulation.run_for(Duration::from_secs(1));
    }
    let said: Vec<Vec<i32>> = (0..honest)
        .filter(|robot| *robot != failed)
        .map(|robot| says(&simulation, robot, BehaviourName::Consensus))
        .collect();
    let values: Vec<i32> = said.iter().map(|said| said[0]).collect();
    let (least, most) = (values.iter().min().unwrap(), values.iter().max().unwrap());
    assert!(most - least <= 20, "{values:?}");
    let range = [begins(0), begins(honest - 1)].map(|value| (value * 1_000.0) as i32);
    assert!(*least >= range[0] && *most <= range[1], "{values:?}");
    assert!(said.iter().all(|said| said[2] == 1), "settled: {said:?}");
}

fn tasks() -> Places {
    Places::new(&[
        [-2.0, -1.5],
        [0.0, -1.5],
        [2.0, -1.5],
        [-2.0, 1.5],
        [0.0, 1.5],
        [2.0, 1.5],
    ])
    .expect("six places")
}

/// The robot that is at each task, where there is one.
fn at_tasks(simulation: &Simulation) -> Vec<Option<usize>> {
    let tasks = tasks();
    let near = |task: [f32; 2]| {
        let mut robots = (0..simulation.robots()).filter(|robot| simulation.pose(*robot).is_some());
        robots.find(|robot| apart(place(simulation, *robot), task) < 0.35)
    };
    tasks.as_slice().iter().map(|task| near(*task)).collect()
}

#[test]
fn tasks_are_shared_out_and_what_a_lost_robot_leaves_is_taken_over() {
    let mut simulation = lockstep("empty", 9, 5);
    settle(&mut simulation);
    simulation.submit_all(Action::Behave(BehaviourSpec::Allocate { tasks: tasks() }));
    simulation.run_for(Duration::from_secs(90));
    let at = at_tasks(&simulation);
    let mut who: Vec<usize> = at.iter().flatten().copied().collect();
    who.sort_unstable();
    who.dedup();
    assert_eq!(who.len(), 6, "{at:?}");
    // Its body is gone, and so is its word.
    let gone = at[4].expect("somebody");
    simulation.remove(gone);
    simulation.run_for(Duration::from_secs(90));
    let after = at_tasks(&simulation);
    assert!(after.iter().all(Option::is_some), "{after:?}");
    assert_ne!(after[4], Some(gone));
}

/// The mean square of the distance from a square of `side` metres to the nearest robot.
fn floor_to_robot(simulation: &Simulation, side: f32) -> f32 {
    let robots: Vec<[f32; 2]> = (0..simulation.robots())
        .filter(|robot| simulation.pose(*robot).is_some())
        .map(|robot| place(simulation, robot))
        .collect();
    let along = |step: i32| side * ((step as f32 + 0.5) / 40.0 - 0.5);
    let squares = (0..1_600).map(|step| {
        let at = [along(step / 40), along(step % 40)];
        let ways = robots.iter().map(|robot| apart(*robot, at).powi(2));
        ways.fold(f32::INFINITY, f32::min)
    });
    squares.sum::<f32>() / 1_600.0
}

#[test]
fn an_area_is_covered_and_what_a_lost_robot_leaves_is_too() {
    let (robots, half) = (9, 2.5);
    let mut simulation = lockstep("empty", robots, 5);
    settle(&mut simulation);
    let area = [[-half, -half], [half, -half], [half, half], [-half, half]];
    let area = Places::new(&area).expect("four corners");
    simulation.submit_all(Action::Behave(BehaviourSpec::Cover { area }));
    simulation.run_for(Duration::from_secs(120));
    // What nine hexagons would have.
    let best = |robots: u32| 0.160_375 * (2.0 * half).powi(2) / robots as f32;
    let covered = floor_to_robot(&simulation, 2.0 * half);
    assert!(covered < 1.25 * best(robots), "{covered}");
    let said = (0..9).map(|robot| says(&simulation, robot, BehaviourName::Cover));
    let rest = said.filter(|said| said[1] == 1).count();
    assert!(rest >= 8, "{rest} are in their middles");
    // Its body is gone, and so is its word.
    simulation.remove(4);
    let lost = floor_to_robot(&simulation, 2.0 * half);
    simulation.run_for(Duration::from_secs(90));
    let after = floor_to_robot(&simulation, 2.0 * half);
    assert!(
        after < lost && after < 1.35 * best(robots - 1),
        "{covered}, {lost}, {after}"
    );
}

/// Where robots are that are there, from left to right.
fn from_left(simulation: &Simulation) -> Vec<[f32; 2]> {
    let robots = 0..simulation.robots();
    let there = robots.filter(|robot| simulation.pose(*robot).is_some());
    let mut places: Vec<_> = there.map(|robot| place(simulation, robot)).collect();
    places.sort_by(|a, b| a[0].total_cmp(&b[0]));
    places
}

/// Whether robots stand in a line across the room at `y`, one next to the other.
fn in_line(places: &[[f32; 2]], y: f32) -> bool {
    let near = |a: f32, b: f32| (a - b).abs() < 0.2;
    let gaps = places.windows(2).map(|two| two[1][0] - two[0][0]);
    places.iter().all(|place| near(place[1], y)) && gaps.into_iter().all(|gap| near(gap, 0.8))
}

#[test]
fn a_line_is_formed_and_moves_on_and_closes_up() {
    let mut simulation = lockstep("empty", 7, 5);
    settle(&mut simulation);
    // They face along the y axis, and go there.
    let path = Places::new(&[[0.0, -1.5], [0.0, 1.5]]).expect("two places");
    simulation.submit_all(Action::Behave(BehaviourSpec::Shaped(Formation {
        shape: Shape::Line,
        size: Formation::DEFAULT_SPACING,
        heading: core::f32::consts::FRAC_PI_2,
        path,
    })));
    let mut on_the_move = 0;
    for _ in 0..120 {
        simulation.run_for(Duration::from_secs(1));
        let along = says(&simulation, 0, BehaviourName::Formation)[1];
        let y = -1.5 + along as f32 * 0.001;
        let moves = (500..2_500).contains(&along);
        on_the_move += usize::from(moves && in_line(&from_left(&simulation), y));
    }
    assert!(on_the_move >= 10, "{on_the_move} seconds in line");
    let places = from_left(&simulation);
    assert!(in_line(&places, 1.5), "{places:?}");
    // One that is neither in the middle nor at an end.
    let gone = (0..7).find(|robot| place(&simulation, *robot) == places[1]);
    simulation.remove(gone.expect("one of them"));
    simulation.run_for(Duration::from_secs(40));
    let places = from_left(&simulation);
    assert!(places.len() == 6 && in_line(&places, 1.5), "{places:?}");
}

#[test]
fn nobody_follows_itself_and_who_hears_nobody_rests() {
    let mut simulation = lockstep("empty", 2, 5);
    settle(&mut simulation);
    let action = follow(0, &simulation);
    simulation.submit(0, action);
    let missing = Action::Behave(BehaviourSpec::Follow {
        leader: RobotId::new("nobody").expect("legal"),
        distance: 0.6,
    });
    simulation.submit(1, missing);
    simulation.run_for(Duration::from_secs(3));
    let behaviour = |robot| {
        simulation
            .robot(robot)
            .expect("is there")
            .snapshot()
            .behaviour
    };
    assert_eq!(behaviour(0), BehaviourName::Manual, "refused");
    assert_eq!(behaviour(1), BehaviourName::Follow);
    assert_eq!(says(&simulation, 1, BehaviourName::Follow)[1], 0);
    let wheels = simulation.robot(1).expect("is there").snapshot().wheels;
    assert_eq!(wheels, [0.0; 2]);
}

fn round() -> Places {
    Places::new(&[[-2.0, -2.0], [2.0, -2.0], [2.0, 2.0], [-2.0, 2.0]]).expect("four places")
}

/// Least distance of two robots along the round, as a share of it.
fn gaps(simulation: &Simulation) -> Vec<i32> {
    let mut along: Vec<i32> = (0..simulation.robots())
        .filter_map(|robot| {
            says(simulation, robot, BehaviourName::Patrol)
                .get(1)
                .copied()
        })
        .collect();
    along.sort_unstable();
    let ends = along.iter().cycle().skip(1);
    let gaps = along.iter().zip(ends);
    gaps.map(|(a, b)| (b - a).rem_euclid(1_000)).collect()
}

fn a_patrol_goes_round(robots: u32, seconds: u64) -> Simulation {
    let mut simulation = lockstep("empty", robots, 5);
    settle(&mut simulation);
    simulation.submit_all(Action::Behave(BehaviourSpec::Patrol {
        waypoints: round(),
        laps: 0,
    }));
    simulation.run_for(Duration::from_secs(seconds));
    let rounds: Vec<i32> = (0..simulation.robots())
        .map(|robot| says(&simulation, robot, BehaviourName::Patrol)[2])
        .collect();
    let some = rounds.iter().filter(|rounds| **rounds > 0).count();
    assert!(some * 10 >= rounds.len() * 9, "{rounds:?}");
    for robot in 0..simulation.robots() {
        let state = simulation.robot(robot).expect("is there").snapshot().state;
        assert_ne!(state, RobotState::Error);
    }
    simulation
}

#[test]
fn ten_on_patrol_go_round_and_spread() {
    let simulation = a_patrol_goes_round(10, 400);
    let gaps = gaps(&simulation);
    // Of 100 thousandths each, when all is even.
    let close = gaps.iter().filter(|gap| **gap < 30).count();
    assert!(close <= 2, "{gaps:?}");
}

#[test]
fn fifty_on_patrol_go_round() {
    a_patrol_goes_round(50, 400);
}

#[test]
fn a_patrol_of_one_lap_ends_where_it_began() {
    let mut simulation = lockstep("empty", 1, 5);
    settle(&mut simulation);
    simulation.submit_all(Action::Behave(BehaviourSpec::Patrol {
        waypoints: round(),
        laps: 1,
    }));
    simulation.run_for(Duration::from_secs(10));
    let snapshot = simulation.robot(0).expect("is there").snapshot();
    assert_eq!(snapshot.behaviour, BehaviourName::Patrol);
    simulation.run_for(Duration::from_secs(230));
    let snapshot = simulation.robot(0).expect("is there").snapshot();
    assert_eq!(snapshot.behaviour, BehaviourName::Manual, "over");
    assert_eq!(snapshot.says, None);
}
