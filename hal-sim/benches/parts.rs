//! What the parts of the simulator cost, each alone.
//!
//! `cargo bench -p crawler-sim --bench parts [FILTER]`. For whole worlds see `cargo xtask bench sim`.

use std::hint::black_box;
use std::time::Duration as Wall;

use crawler_app::Geometry;
use crawler_app::behaviour::Leeway;
use crawler_app::controller::{Controller, Inputs, PERIOD, Tuning};
use crawler_app::order::{Order, Sender, Task, UpdateWish};
use crawler_app::parameters::Parameters;
use crawler_app::perception::{Charge, LinkHealth, Reading, SensorHealth, Sight};
use crawler_app::policy::Policies;
use crawler_hal::{Clock, Duration, Instant, Millimeters, Millivolts};
use crawler_protocol::{
    Battery, BehaviourName, Command, Pose as Estimate, RobotId, RobotState, Source, Telemetry,
    Wheels,
};
use crawler_sim::devices::World;
use crawler_sim::render::{Frame, Motion};
use crawler_sim::run::Simulation;
use crawler_sim::scenario::Scenario;
use crawler_sim::sched::{Scheduler, SimClock};
use crawler_sim::tools::dataset::{Split, picture};
use crawler_sim::world::{self, Pose, Profile, RobotIndex};
use criterion::{BenchmarkId, Criterion, Throughput};
use rand_pcg::Pcg32;

/// A world like that of the scenario `arena`, with bodies that stand.
fn world(robots: u32) -> World {
    let scenario = Scenario::built_in("arena")
        .expect("built in")
        .with_robots(robots);
    let arena = scenario.arena(1).expect("sound");
    let mut spawner = scenario.spawner(&arena, 1);
    let mut world = World::new(arena, 1, &SimClock::new()).expect("sound");
    for robot in 0..robots as usize {
        let pose = spawner
            .find(robot, |pose| world.clearance(pose.x, pose.y, 0.3) >= 0.15)
            .expect("room");
        world.add_robot(pose).expect("free");
    }
    world
}

fn bodies(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("world");
    for robots in [100, 1_000, 10_000] {
        let mut world = world(robots);
        group.throughput(Throughput::Elements(u64::from(robots)));
        group.bench_function(BenchmarkId::new("step", robots), |b| {
            b.iter(|| world.step());
        });
        let mut next = 0;
        group.throughput(Throughput::Elements(1));
        group.bench_function(BenchmarkId::new("cone", robots), |b| {
            b.iter(|| {
                next = (next + 1) % robots;
                world.true_range(RobotIndex::new(next))
            });
        });
    }
    group.finish();
}

fn scheduler(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("scheduler");
    for tasks in [100_u64, 10_000] {
        let clock = SimClock::new();
        let mut sched = Scheduler::new(&clock);
        for task in 0..tasks {
            let clock = clock.clone();
            sched.spawn(async move {
                loop {
                    clock
                        .sleep(Duration::from_micros(20_000 + task % 100))
                        .await;
                }
            });
        }
        let period = Duration::from_millis(20);
        group.throughput(Throughput::Elements(tasks));
        group.bench_function(BenchmarkId::new("sleepers", tasks), |b| {
            b.iter(|| {
                let end = sched.now() + period;
                sched.run_until(end, |_| ());
            });
        });
    }
    group.finish();
}

fn messages(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("message");
    let telemetry = Telemetry {
        robot: RobotId::new("sim-0001").expect("an id"),
        seq: 4_711,
        timestamp: 1_767_225_600_123,
        state: RobotState::Moving,
        behaviour: BehaviourName::Wander,
        pose: Estimate {
            x: 1.234_567,
            y: -0.987_654,
            theta: 0.5,
            sigma: 0.012_5,
        },
        range_mm: Some(1_234),
        temperature_c: Some(21.0),
        wheels: Wheels {
            left: 0.375,
            right: 0.412_5,
        },
        battery: Battery {
            mv: 7_812,
            percent: 67,
        },
        rssi_dbm: Some(-55),
        says: None,
    };
    let mut buffer = [0; 1_024];
    group.bench_function("telemetry, written", |b| {
        b.iter(|| black_box(&telemetry).to_json(&mut buffer).expect("fits"));
    });
    let command = br#"{"seq":17,"source":"operator","timestamp":1767225600123,"command":"move","parameters":{"direction":"forward","speed":50,"duration_ms":1000}}"#;
    group.bench_function("command, read", |b| {
        b.iter(|| Command::parse(black_box(command)).is_ok());
    });
    group.finish();
}

fn control_step(criterion: &mut Criterion) {
    let geometry = Geometry {
        wheel_base_m: 0.13,
        top_speed_mps: 0.5,
        time_constant_s: 0.1,
        stiction_duty: 0.15,
        nominal_v: 7.4,
        bridge_drop_v: 1.8,
    };
    let mut controller = Controller::new(Tuning::new(&Parameters::default(), &geometry));
    let mut rng = Pcg32::new(1, 1);
    let order = Order {
        task: Task::Wander { speed: 50 },
        sender: Sender {
            source: Source::new("bench").expect("a source"),
            seq: 1,
        },
        arrived: Instant::BOOT,
    };
    let mut now = Instant::BOOT;
    let mut step = move |order: Option<&Order>| {
        now += PERIOD;
        let inputs = Inputs {
            near: &[],
            own: 0,
            guide: None,
            leeway: Leeway::ALL,
            reading: Reading {
                sight: Some((Sight::Range(Millimeters(1_500)), now)),
                health: SensorHealth::Good,
                temperature: None,
            },
            charge: Charge::Good,
            voltage: Some(Millivolts(7_600)),
            fix: None,
            view: None,
            link: LinkHealth::Up,
            loaded: true,
            motor_fault: false,
            halt: None,
            order,
            update: UpdateWish::None,
            policies: Policies::NONE,
            decision: None,
        };
        controller.step(&inputs, &mut rng, now).duties
    };
    step(None);
    step(Some(&order));
    criterion.bench_function("control step, wandering", |b| b.iter(|| step(None)));
}

/// Pictures of 96 × 96 pixels in colour, by one thread.
fn pictures(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("picture");
    group.throughput(Throughput::Elements(1));
    for profile in Profile::ALL {
        let scenario = Scenario::built_in("arena").expect("built in");
        let arena = scenario.arena(1).expect("sound");
        let parameters = world::Parameters::default().randomised(profile, 1);
        let clock = SimClock::new();
        let mut world = World::with_parameters(arena, parameters, 1, &clock).expect("sound");
        let mut spawner = scenario.spawner(&world.arena(), 1);
        for robot in 0..10 {
            let found = spawner.find(robot, |pose| world.clearance(pose.x, pose.y, 0.3) >= 0.15);
            let pose: Pose = found.expect("room");
            world.add_robot(pose).expect("free");
        }
        let mut frame = Frame::square();
        let motion = Motion { v: 0.3, w: 0.8 };
        let mut next = 0;
        group.bench_function(BenchmarkId::new("of a world", profile), |b| {
            b.iter(|| {
                next = (next + 1) % 10;
                world.render_moving(RobotIndex::new(next), motion, &mut frame)
            });
        });
    }
    let (mut frame, mut number) = (Frame::square(), 0);
    group.bench_function("of a data set, with the truth", |b| {
        b.iter(|| {
            number += 1;
            picture(1, Split::Train, number, &mut frame)
        });
    });
    group.finish();
}

fn whole(criterion: &mut Criterion) {
    let scenario = Scenario::built_in("arena")
        .expect("built in")
        .with_robots(100);
    let mut simulation = Simulation::lockstep(scenario, 1).expect("sound");
    simulation.run_for(Duration::from_secs(6));
    let mut group = criterion.benchmark_group("lockstep");
    // Control steps of 100 robots in a fifth of a second.
    group.throughput(Throughput::Elements(1_000));
    group.bench_function("100 robots", |b| {
        b.iter(|| simulation.run_for(Duration::from_millis(200)));
    });
    group.finish();
}

fn main() {
    let mut criterion = Criterion::default()
        .warm_up_time(Wall::from_millis(500))
        .measurement_time(Wall::from_secs(2))
        .sample_size(20)
        .configure_from_args();
    bodies(&mut criterion);
    scheduler(&mut criterion);
    messages(&mut criterion);
    control_step(&mut criterion);
    pictures(&mut criterion);
    whole(&mut criterion);
    criterion.final_summary();
}
