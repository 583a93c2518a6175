//! A live world does what it is told while it runs. No broker is needed for that: its robots look
//! for one all the time.

use std::future::Future;
use std::ops::Deref;
use std::time::{Duration, Instant};

use crawler_protocol::{Fleet, RobotId};
use crawler_sim::live::{ControlError, LiveConfig, LiveDone, LiveHandle, start};
use crawler_sim::scenario::Scenario;
use crawler_sim::world::PHYSICS_STEP;
use crawler_sim_protocol::{
    Dropped, Obstacle, Place, ScenarioName, SimulatorCommand, SnapshotName,
};

/// For anything that has to happen, on the slowest machine.
const LIMIT: Duration = Duration::from_mins(2);

/// A world whose robots are refused by the broker they look for.
struct World {
    handle: LiveHandle,
    _refusing: tokio::net::TcpSocket,
}

impl Deref for World {
    type Target = LiveHandle;

    fn deref(&self) -> &LiveHandle {
        &self.handle
    }
}

fn world() -> World {
    let (refusing, address) = crate::common::port::refusing();
    let scenario = Scenario::built_in("empty").expect("there").with_robots(3);
    let handle = start(LiveConfig {
        fleet: Fleet::default(),
        broker_host: "127.0.0.1".to_owned(),
        broker_port: address.port(),
        credentials: None,
        scenario,
        seed: 4,
        release_keys: None,
        radio_proxy: None,
        other_ends: 1,
        authority: None,
    })
    .expect("a world");
    World {
        handle,
        _refusing: refusing,
    }
}

fn wait<T>(what: &str, future: impl Future<Output = T>) -> T {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_time()
        .build()
        .expect("a runtime");
    let limited = async { tokio::time::timeout(LIMIT, future).await };
    let answer = runtime.block_on(limited);
    answer.unwrap_or_else(|_| panic!("no answer to {what}"))
}

/// Waits until the clock of a world shows `micros`.
fn until(world: &LiveHandle, micros: u64) {
    let begun = Instant::now();
    loop {
        let state = world.state();
        if state
            .as_ref()
            .is_ok_and(|state| state.time.as_micros() >= micros)
        {
            return;
        }
        let metrics = world.metrics();
        assert!(begun.elapsed() < LIMIT, "{micros}: {state:?}, {metrics:?}");
        std::thread::sleep(Duration::from_millis(10));
    }
}

fn tell(world: &LiveHandle, command: SimulatorCommand) -> Result<LiveDone, ControlError> {
    let what = format!("{command:?}");
    wait(&what, world.control(command))
}

fn robot(name: &str) -> RobotId {
    RobotId::new(name).expect("a name")
}

#[test]
fn a_live_world_stands_steps_and_keeps_the_pace_asked_for() {
    let world = world();
    let paused = tell(&world, SimulatorCommand::Pause).expect("paused").state;
    assert!(paused.paused);
    // The world takes turns, and none of them moves it on.
    for _ in 0..50 {
        let again = tell(&world, SimulatorCommand::Pause).expect("paused").state;
        assert_eq!((again.time, again.paused), (paused.time, true));
    }
    assert_eq!(world.state().expect("running").time, paused.time);
    let step = PHYSICS_STEP.as_micros();
    let stepped = tell(&world, SimulatorCommand::Step { steps: 5 }).expect("stepped");
    let steps = paused.time.as_micros() / step + 5;
    assert_eq!(stepped.state.time.as_micros(), steps * step);
    assert!(stepped.state.paused);
    tell(&world, SimulatorCommand::Speed { factor: 4.0 }).expect("usable");
    let begun = Instant::now();
    tell(&world, SimulatorCommand::Resume).expect("running");
    until(&world, stepped.state.time.as_micros() + 2_000_000);
    let run = tell(&world, SimulatorCommand::Pause).expect("paused").state;
    let passed = run.time.as_micros() - stepped.state.time.as_micros();
    // A busy machine gives some of its time up; none goes faster than it was told.
    let most = 4 * begun.elapsed().as_micros() as u64;
    assert!(passed <= most, "{passed} of {most}");
    assert_eq!(run.factor, 4.0);
    let report = world.stop(LIMIT).expect("it ends, though paused");
    assert_eq!(report.standing, 3);
    assert_eq!(world.state(), Err(ControlError::Ended));
    assert_eq!(
        tell(&world, SimulatorCommand::Pause),
        Err(ControlError::Ended)
    );
}

#[test]
fn a_live_world_begins_again_and_robots_come_and_go() {
    let world = world();
    let added = tell(&world, SimulatorCommand::Add { pose: None }).expect("room");
    assert_eq!(added.robot, Some(robot("sim-0004")));
    assert_eq!(added.state.robots, 4);
    let remove = |name| SimulatorCommand::Remove { robot: robot(name) };
    let removed = tell(&world, remove("sim-0002")).expect("there").state;
    assert_eq!(removed.robots, 3);
    assert_eq!(tell(&world, remove("sim-0002")), Err(ControlError::NoRobot));
    assert_eq!(tell(&world, remove("ada-1")), Err(ControlError::NoRobot));
    // A world has a hash at the end of its first second.
    until(&world, 1_000_000);
    let before = tell(&world, SimulatorCommand::Pause).expect("paused").state;
    assert!(before.hash != 0);
    let begun = tell(&world, SimulatorCommand::Reset { seed: Some(9) })
        .expect("sound")
        .state;
    assert_eq!((begun.seed, begun.robots, begun.paused), (9, 3, true));
    assert!(begun.time < before.time);
    let again = tell(&world, SimulatorCommand::Reset { seed: None })
        .expect("sound")
        .state;
    assert_eq!(again.seed, 9);
    world.stop(LIMIT).expect("it ends");
}

fn refusal(world: &LiveHandle, command: SimulatorCommand) -> String {
    match tell(world, command) {
        Err(ControlError::Refused(text)) => text,
        other => panic!("{other:?}"),
    }
}

fn bookmark(name: &str) -> SnapshotName {
    SnapshotName::new(name).expect("a name")
}

fn keep(name: &str) -> SimulatorCommand {
    SimulatorCommand::Snapshot {
        name: bookmark(name),
    }
}

fn restore(name: &str) -> SimulatorCommand {
    SimulatorCommand::Restore {
        name: bookmark(name),
    }
}

fn post(x: f32, y: f32) -> SimulatorCommand {
    SimulatorCommand::Drop {
        what: Dropped::Obstacle(Obstacle::Circle { x, y, r: 0.1 }),
    }
}

fn load(name: &str, robots: Option<u32>) -> SimulatorCommand {
    SimulatorCommand::Load {
        scenario: ScenarioName::new(name).expect("a name"),
        robots,
        seed: None,
    }
}

#[test]
fn a_live_world_takes_things_and_gives_them_back() {
    let world = world();
    let scenes = world.watch_scene();
    let before = world.arena();
    let pose = Some(Place {
        x: 2.0,
        y: 2.0,
        theta: 0.0,
    });
    let added = tell(&world, SimulatorCommand::Add { pose });
    let added = added
        .expect("free, by this seed")
        .robot
        .expect("it has a name");
    let text = refusal(&world, post(2.05, 2.0));
    assert!(text.contains(added.as_str()), "{text}");
    assert!(refusal(&world, post(3.0, 0.0)).contains("walls"));
    assert!(
        matches!(scenes.has_changed(), Ok(false)),
        "nothing has changed"
    );
    let dropped = tell(&world, post(-2.7, 2.7)).expect("a corner");
    assert_eq!((dropped.item, dropped.robot), (Some(1), None));
    assert!(matches!(scenes.has_changed(), Ok(true)));
    let scene = world.scene();
    assert_eq!(scene.scenario, "empty");
    assert_eq!(scene.dropped.len(), 1);
    assert_eq!(scene.arena.obstacles.len(), before.obstacles.len() + 1);
    let text = refusal(&world, SimulatorCommand::Take { item: 2 });
    assert!(text.contains('2'), "{text}");
    tell(&world, SimulatorCommand::Take { item: 1 }).expect("it lies there");
    assert_eq!(world.arena(), before);
    // Nothing of it is there when the world begins again.
    tell(&world, post(-2.7, 2.7)).expect("free");
    tell(&world, SimulatorCommand::Reset { seed: None }).expect("sound");
    assert_eq!(world.arena(), before);
    assert!(world.scene().dropped.is_empty());
    world.stop(LIMIT).expect("it ends");
}

#[test]
fn another_scenario_is_loaded_into_a_live_world() {
    let world = world();
    tell(&world, SimulatorCommand::Pause).expect("paused");
    tell(&world, SimulatorCommand::Speed { factor: 2.0 }).expect("usable");
    let text = refusal(&world, load("nowhere", None));
    assert!(text.contains("corridor"), "it says which there are: {text}");
    let text = refusal(&world, load("corridor", Some(5_000)));
    assert!(text.contains("room") || text.contains("files"), "{text}");
    assert_eq!(world.scene().scenario, "empty");
    let done = tell(&world, load("corridor", None)).expect("sound").state;
    assert_eq!((done.robots, done.seed), (4, 4));
    assert_eq!((done.paused, done.factor), (true, 2.0));
    assert_eq!(done.time.as_micros(), 0);
    let scene = world.scene();
    assert_eq!(scene.scenario, "corridor");
    assert_eq!((scene.arena.width, scene.arena.obstacles.len()), (8.0, 2));
    let done = SimulatorCommand::Load {
        scenario: ScenarioName::new("arena").expect("a name"),
        robots: Some(2),
        seed: Some(11),
    };
    let done = tell(&world, done).expect("sound").state;
    assert_eq!((done.robots, done.seed), (2, 11));
    let reset = tell(&world, SimulatorCommand::Reset { seed: None }).expect("sound");
    assert_eq!((reset.state.robots, reset.state.seed), (2, 11));
    assert_eq!(world.scene().scenario, "arena");
    world.stop(LIMIT).expect("it ends");
}

#[test]
fn a_live_world_goes_back_to_its_bookmarks() {
    let world = world();
    tell(&world, SimulatorCommand::Pause).expect("paused");
    tell(&world, SimulatorCommand::Step { steps: 150 }).expect("stepped");
    let remove = |name| SimulatorCommand::Remove { robot: robot(name) };
    tell(&world, remove("sim-0002")).expect("there");
    tell(&world, SimulatorCommand::Add { pose: None }).expect("room");
    tell(&world, post(-2.7, 2.7)).expect("free");
    let kept = tell(&world, keep("here")).expect("kept").state;
    assert_eq!(kept.robots, 3);
    tell(&world, SimulatorCommand::Step { steps: 70 }).expect("stepped");
    tell(&world, remove("sim-0001")).expect("there");
    tell(&world, SimulatorCommand::Take { item: 1 }).expect("there");
    tell(&world, load("corridor", None)).expect("sound");
    let marks = world.scene().bookmarks;
    assert_eq!(marks.len(), 1, "a bookmark outlives its world");
    assert_eq!((marks[0].robots, marks[0].scenario.as_str()), (3, "empty"));
    assert_eq!(marks[0].time, kept.time);
    assert!(marks[0].made_at > 1_700_000_000_000);

    let back = tell(&world, restore("here")).expect("it is there").state;
    assert_eq!((back.time, back.robots, back.seed), (kept.time, 3, 4));
    assert!(back.paused);
    let scene = world.scene();
    assert_eq!(scene.scenario, "empty");
    assert_eq!((scene.dropped.len(), scene.arena.obstacles.len()), (1, 1));
    // Under the names that they had.
    assert_eq!(tell(&world, remove("sim-0002")), Err(ControlError::NoRobot));
    tell(&world, remove("sim-0004")).expect("it is back");
    let added = tell(&world, SimulatorCommand::Add { pose: None }).expect("room");
    assert_eq!(added.robot, Some(robot("sim-0005")));
    // Time goes on from there.
    let later = tell(&world, SimulatorCommand::Step { steps: 100 }).expect("stepped");
    let passed = later.state.time - kept.time;
    assert!(
        (990_000..=1_000_000).contains(&passed.as_micros()),
        "{passed:?}"
    );
    assert!(later.state.hash != 0);
    tell(&world, SimulatorCommand::Resume).expect("running");
    until(&world, later.state.time.as_micros() + 1);

    // Sixteen and no more; one of the same name takes the place of the first.
    for number in 1..16 {
        tell(&world, keep(&format!("mark-{number}"))).expect("there is room");
    }
    assert!(refusal(&world, keep("one-too-many")).contains("16"));
    let again = tell(&world, keep("here")).expect("it takes the place of the first");
    let marks = world.scene().bookmarks;
    assert_eq!(marks.len(), 16);
    assert_eq!(marks[15].name, bookmark("here"));
    assert!(marks[15].time <= again.state.time && marks[15].time > kept.time);
    let forget = |name| SimulatorCommand::Forget {
        name: bookmark(name),
    };
    tell(&world, forget("mark-3")).expect("it is there");
    assert!(refusal(&world, forget("mark-3")).contains("mark-3"));
    assert!(refusal(&world, restore("mark-3")).contains("mark-3"));
    tell(&world, keep("one-more")).expect("there is room again");
    world.stop(LIMIT).expect("it ends");
}
