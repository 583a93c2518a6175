//! A live world does what it is told while it runs. No broker is needed for that: its robots look
//! for one all the time.
#![cfg(feature = "live")]

use std::future::Future;
use std::time::Duration;

use crawler_protocol::{Fleet, RobotId, SimulatorCommand, SnapshotName};
use crawler_sim::run::live::{ControlError, LiveConfig, LiveDone, LiveHandle, start};
use crawler_sim::scenario::Scenario;
use crawler_sim::world::PHYSICS_STEP;

fn world() -> LiveHandle {
    // A port that nobody listens at any more.
    let port = std::net::TcpListener::bind("127.0.0.1:0")
        .and_then(|listener| listener.local_addr())
        .expect("a port")
        .port();
    let scenario = Scenario::built_in("empty").expect("there").with_robots(3);
    start(LiveConfig {
        fleet: Fleet::default(),
        broker_host: "127.0.0.1".to_owned(),
        broker_port: port,
        credentials: None,
        scenario,
        seed: 4,
        radio_proxy: None,
        authority: None,
    })
    .expect("a world")
}

fn wait<T>(future: impl Future<Output = T>) -> T {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_time()
        .build()
        .expect("a runtime");
    runtime.block_on(async {
        let limited = tokio::time::timeout(Duration::from_secs(20), future);
        limited.await.expect("an answer")
    })
}

fn tell(world: &LiveHandle, command: SimulatorCommand) -> Result<LiveDone, ControlError> {
    wait(world.control(command))
}

fn robot(name: &str) -> RobotId {
    RobotId::new(name).expect("a name")
}

#[test]
fn a_live_world_stands_steps_and_keeps_the_pace_asked_for() {
    let world = world();
    let paused = tell(&world, SimulatorCommand::Pause).expect("paused").state;
    assert!(paused.paused);
    std::thread::sleep(Duration::from_millis(300));
    let later = world.state().expect("running");
    assert_eq!(later.time, paused.time);
    let step = PHYSICS_STEP.as_micros();
    let stepped = tell(&world, SimulatorCommand::Step { steps: 5 }).expect("stepped");
    let steps = paused.time.as_micros() / step + 5;
    assert_eq!(stepped.state.time.as_micros(), steps * step);
    assert!(stepped.state.paused);
    tell(&world, SimulatorCommand::Speed { factor: 4.0 }).expect("usable");
    tell(&world, SimulatorCommand::Resume).expect("running");
    std::thread::sleep(Duration::from_millis(1_500));
    let run = tell(&world, SimulatorCommand::Pause).expect("paused").state;
    let passed = run.time.as_micros() - stepped.state.time.as_micros();
    // Six seconds; a busy machine gives some of them up.
    assert!(passed > 1_600_000 && passed < 12_000_000, "{passed}");
    assert_eq!(run.factor, 4.0);
    let report = world
        .stop(Duration::from_secs(2))
        .expect("it ends, though paused");
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
    std::thread::sleep(Duration::from_millis(1_200));
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
    let name = || SnapshotName::new("here").expect("a name");
    for command in [
        SimulatorCommand::Snapshot { name: name() },
        SimulatorCommand::Restore { name: name() },
    ] {
        let Err(ControlError::Refused(text)) = tell(&world, command) else {
            panic!("a live world cannot be kept");
        };
        assert!(text.contains("broker"), "{text}");
    }
    world.stop(Duration::from_secs(2)).expect("it ends");
}
