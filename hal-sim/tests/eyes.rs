//! Looks of the real robot program through simulated cameras, in virtual time.

use crate::common::{scenario, settle, wander};
use crawler_detector::{BLOB, FRAMES};
use crawler_hal::Duration;
use crawler_protocol::{Action, Capability, Detections, StatusMessage, Telemetry, Topic};
use crawler_sim::devices::World;
use crawler_sim::render::Frame;
use crawler_sim::run::Simulation;
use crawler_sim::scenario::Scenario;
use crawler_sim::sched::SimClock;
use crawler_sim::tools::dataset::{Split, picture};
use crawler_sim::world::Pose;

const SECOND: Duration = Duration::from_secs(1);

fn with_eyes(robots: u32, share: f32, seed: u64) -> Simulation {
    let mut scenario = scenario("arena", robots);
    scenario.command = None;
    scenario.spawn.camera_share = share;
    scenario.detector = Some(BLOB);
    let simulation = Simulation::lockstep(scenario, seed).expect("a world");
    simulation.network().expect("lockstep").record(200_000);
    simulation
}

fn messages(simulation: &Simulation) -> (Vec<Detections>, Vec<StatusMessage>) {
    let (mut seen, mut status) = (Vec::new(), Vec::new());
    for message in simulation.network().expect("lockstep").take_record() {
        match Topic::parse(simulation.fleet(), &message.topic).expect("a topic") {
            Topic::Vision(id) => {
                let told = Detections::from_json(&message.payload).expect("detections");
                assert_eq!(told.robot, id);
                assert!(!message.at_least_once && !message.retain);
                seen.push(told);
            }
            Topic::Status(_) => {
                status.extend(StatusMessage::from_json(&message.payload));
            }
            _ => {}
        }
    }
    (seen, status)
}

#[test]
fn looks_cost_nothing_when_off_and_little_when_on() {
    let mut simulation = with_eyes(10, 0.5, 3);
    settle(&mut simulation);
    simulation.run_for(SECOND * 10);
    let looks = simulation.looks();
    assert_eq!(
        (looks.taken, looks.open, looks.most),
        (0, 0, 0),
        "nobody wants to know"
    );
    let (seen, status) = messages(&simulation);
    assert!(seen.is_empty());
    let sees = |status: &&StatusMessage| status.capabilities.contains(&Capability::Vision);
    let robots: std::collections::BTreeSet<_> = status
        .iter()
        .filter(sees)
        .map(|status| status.robot.clone())
        .collect();
    assert_eq!(robots.len(), 5, "those that have a camera");

    let _ = simulation.submit_all(wander());
    simulation.run_for(SECOND * 10);
    let looks = simulation.looks();
    // Two a second for each of five.
    assert!((95..=105).contains(&looks.taken), "{looks:?}");
    assert!(looks.most <= 5, "{looks:?}");
    let (seen, _) = messages(&simulation);
    let robots: std::collections::BTreeSet<_> =
        seen.iter().map(|told| told.robot.clone()).collect();
    assert_eq!(robots.len(), 5, "at least what it sees first");
    assert!(seen.len() as u64 <= looks.taken);

    let _ = simulation.submit_all(Action::Stop);
    simulation.run_for(SECOND);
    let before = simulation.looks();
    simulation.run_for(SECOND * 10);
    assert_eq!(simulation.looks(), before);
    assert_eq!(before.open, 0);
}

#[test]
fn the_same_seed_sees_the_same() {
    let run = || {
        let mut simulation = with_eyes(3, 1.0, 9);
        settle(&mut simulation);
        let _ = simulation.submit_all(wander());
        simulation.run_for(SECOND * 20);
        (messages(&simulation).0, simulation.history_hash())
    };
    let (seen, hash) = run();
    assert!(!seen.is_empty());
    assert_eq!(run(), (seen, hash));
}

/// Where the red cylinder of the scenario `search` stands.
const CYLINDER: [f32; 2] = [-0.15, -0.2];

/// Turns on the spot; where the robot says it was and what it says it saw in which direction of the
/// arena, out of its own messages.
fn look_around(simulation: &mut Simulation) -> ([f32; 2], Vec<(String, f32)>) {
    let network = simulation.network().expect("lockstep").clone();
    let _ = network.take_record();
    let _ = simulation.submit_all(Action::Scan);
    let (mut headings, mut seen) = (Vec::new(), Vec::new());
    let mut place = [0.0; 2];
    let begun = simulation.now();
    while simulation.now() < begun + SECOND * 12 {
        simulation.run_for(Duration::from_millis(100));
        for message in network.take_record() {
            match Topic::parse(simulation.fleet(), &message.topic).expect("a topic") {
                Topic::Telemetry(_) => {
                    let told = Telemetry::from_json(&message.payload).expect("telemetry");
                    headings.push((told.timestamp, told.pose.theta));
                    place = [told.pose.x, told.pose.y];
                }
                Topic::Vision(_) => {
                    seen.push(Detections::from_json(&message.payload).expect("detections"));
                }
                _ => {}
            }
        }
    }
    let directions = seen.iter().flat_map(|told| {
        let heading = heading_at(&headings, told.timestamp);
        let of = move |object: &crawler_protocol::Detection| {
            (object.class.as_str().to_owned(), heading + object.bearing)
        };
        told.objects.iter().map(of)
    });
    (place, directions.collect())
}

/// The heading at a moment, between the two that were told around it.
fn heading_at(headings: &[(u64, f32)], at: u64) -> f32 {
    let after = headings.partition_point(|&(time, _)| time < at);
    let after = after.clamp(1, headings.len() - 1);
    let [(t0, a), (t1, b)] = [headings[after - 1], headings[after]];
    let turn = (b - a + 3.0 * core::f32::consts::PI).rem_euclid(2.0 * core::f32::consts::PI)
        - core::f32::consts::PI;
    a + turn * (at as i64 - t0 as i64) as f32 / (t1 - t0).max(1) as f32
}

/// Where two lines of sight meet.
fn crossing(one: ([f32; 2], f32), two: ([f32; 2], f32)) -> [f32; 2] {
    let ((a, alpha), (b, beta)) = (one, two);
    let ((sa, ca), (sb, cb)) = (alpha.sin_cos(), beta.sin_cos());
    let across = ca * sb - sa * cb;
    let along = ((b[0] - a[0]) * sb - (b[1] - a[1]) * cb) / across;
    [a[0] + along * ca, a[1] + along * sa]
}

/// From one direction to another, the shorter way round.
fn between(from: f32, to: f32) -> f32 {
    f32::atan2((to - from).sin(), (to - from).cos())
}

/// Directions that are near to the one that most others are near to.
fn majority(directions: &[f32]) -> Vec<f32> {
    let near = |of: f32| {
        let with = directions.iter().copied();
        with.filter(move |&other| between(of, other).abs() < 0.15)
    };
    let centre = directions.iter().max_by_key(|&&of| near(of).count());
    centre.map_or_else(Vec::new, |&centre| near(centre).collect())
}

/// The middle of directions that are close to each other.
fn mean(directions: &[f32]) -> f32 {
    let sine: f32 = directions.iter().map(|angle| angle.sin()).sum();
    let cosine: f32 = directions.iter().map(|angle| angle.cos()).sum();
    f32::atan2(sine, cosine)
}

#[test]
fn a_robot_finds_the_red_cylinder_among_blue_boxes() {
    let scenario = Scenario {
        detector: Some(BLOB),
        ..Scenario::built_in("search").expect("there")
    };
    let mut simulation = Simulation::lockstep(scenario, 1).expect("a world");
    simulation.network().expect("lockstep").record(200_000);
    settle(&mut simulation);
    let mut lines = Vec::new();
    for stop in [None, Some([-0.6, -0.7])] {
        if let Some([x, y]) = stop {
            let _ = simulation.submit_all(Action::Goto { x, y });
            simulation.run_for(SECOND * 15);
        }
        let (place, seen) = look_around(&mut simulation);
        let truth = f32::atan2(CYLINDER[1] - place[1], CYLINDER[0] - place[0]);
        let objects: Vec<f32> = seen
            .iter()
            .filter(|(class, _)| class == "object")
            .map(|&(_, direction)| direction)
            .collect();
        // One look at a box from close by may take it for an object; two in three do not.
        let agreed = majority(&objects);
        assert!(
            agreed.len() >= 2 && agreed.len() * 2 > objects.len(),
            "from {place:?}: {seen:?}"
        );
        let off = between(truth, mean(&agreed));
        assert!(off.abs() < 0.1, "{off} from {place:?}: {seen:?}");
        assert!(
            seen.iter().any(|(class, _)| class == "obstacle"),
            "the boxes are seen as well: {seen:?}"
        );
        lines.push((place, mean(&agreed)));
    }
    let found = crossing(lines[0], lines[1]);
    let off = f32::hypot(found[0] - CYLINDER[0], found[1] - CYLINDER[1]);
    assert!(off < 0.15, "found at {found:?}, {off} m from where it is");
}

/// The frames that boards are shown are what simulated robots see: where the robot of `search`
/// begins, and a picture that the detector is judged by.
#[test]
fn boards_are_shown_what_simulated_robots_see() {
    let arena = Scenario::built_in("search")
        .expect("there")
        .arena(1)
        .expect("room");
    let mut world = World::new(arena, 1, &SimClock::new()).expect("sound");
    let (robot, _parts) = world.add_robot(Pose::new(-1.1, 0.0, 0.0)).expect("free");
    let mut search = Frame::square();
    assert!(world.render(robot, &mut search));
    let mut wild = Frame::square();
    let _ = picture(1, Split::Test, 3, &mut wild);
    for (name, frame) in [("search", search), ("wild", wild)] {
        let mut bytes = vec![0; 96 * 96 * 2];
        frame.rgb565(&mut bytes);
        let kept = FRAMES.iter().find(|(known, _)| *known == name);
        if kept.is_none_or(|(_, kept)| kept[..] != bytes[..]) {
            let file = format!("{}/{name}.rgb565", env!("CARGO_TARGET_TMPDIR"));
            std::fs::write(&file, &bytes).expect("a file");
            panic!("copy {file} to models/detector/frames");
        }
    }
}

#[test]
fn what_is_no_detector_is_refused() {
    let mut scenario = scenario("arena", 1);
    scenario.detector = Some(&BLOB[..100]);
    let error = Simulation::lockstep(scenario, 1).expect_err("refused");
    assert!(error.to_string().starts_with("the detector: "), "{error}");
}
