//! Every behaviour in the worlds that ship, while links lose messages, robots break, are halted and sent on: the safety
//! rules hold at every look, for a million seconds of robots in the deep tier.

use std::collections::BTreeSet;

use crate::common::settle;
use crate::common::watch::{LOOK, Watch, action, fault};
use crawler_hal::Duration;
use crawler_protocol::{Action, BehaviourName};
use crawler_sim::faults::Fault;
use crawler_sim::net::lockstep::LinkModel;
use crawler_sim::run::Simulation;
use crawler_sim::scenario::{Scenario, Start, Success};
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};
use serde_json::json;

/// What robots are there for.
#[derive(Debug, Clone, Copy)]
enum Task {
    /// What the scenario tells them.
    Stated,
    /// Going from place to place.
    Goto,
    /// Driving by a trained policy.
    Policy,
}
use Task::{Goto, Policy, Stated};

/// Worlds, robots in each, and their task.
const WORLDS: [(&str, u32, Task); 22] = [
    ("allocate", 12, Stated),
    ("circle", 10, Stated),
    ("consensus", 12, Stated),
    ("cover", 12, Stated),
    ("crowd", 20, Stated),
    ("disperse", 12, Stated),
    ("doorway", 6, Goto),
    ("dynamic-environment", 3, Goto),
    ("flock", 12, Stated),
    ("follow", 12, Stated),
    ("formation", 12, Stated),
    ("gather", 12, Stated),
    ("head-on", 2, Goto),
    ("line", 10, Stated),
    ("long-corridor", 4, Goto),
    ("maze", 4, Goto),
    ("patrol", 10, Stated),
    ("rooms", 6, Goto),
    ("spread", 3, Policy),
    ("u-trap", 2, Goto),
    ("warehouse", 6, Goto),
    ("wedge", 10, Stated),
];

/// Seconds of one world.
const SPAN_S: u32 = 40;
/// Something happens to a robot in less than twice so many looks: every four seconds, on average.
const LOOKS_BETWEEN: u32 = 200;
const LOOKS_A_SECOND: u32 = (1_000_000 / LOOK.as_micros()) as u32;
/// Robot-seconds of the deep tier.
const MILLION: u64 = 1_000_000;

/// What happens to a robot.
#[derive(Debug, Clone)]
enum Event {
    Break(Fault, u64),
    Heal,
    Tell(Box<Action>),
    /// To what it is there for, at a place in so many halves of the arena.
    SendOn([f32; 2]),
}

/// What happens next to a robot, and in how many looks.
fn next() -> impl Strategy<Value = (u32, Event)> {
    let what = prop_oneof![
        3 => (fault(), 10..6_000_u64).prop_map(|(fault, ms)| Event::Break(fault, ms)),
        1 => Just(Event::Heal),
        3 => action().prop_map(|action| Event::Tell(Box::new(action))),
        3 => [-1.0..1.0_f32, -1.0..1.0_f32].prop_map(Event::SendOn),
    ];
    (1..2 * LOOKS_BETWEEN, what)
}

/// A world of this kind, and what its robots are there for: in it there is nothing to do but that.
fn world(name: &str, robots: u32) -> (Scenario, Option<Start>) {
    let mut scenario = Scenario::built_in(name).unwrap().with_robots(robots);
    let stated = scenario.command.take();
    scenario.commands.clear();
    scenario.goals.clear();
    scenario.faults.clear();
    scenario.thresholds.clear();
    scenario.success = Success::default();
    scenario.difficulty = None;
    scenario.link = Some(LinkModel {
        loss: 0.05,
        ..LinkModel::default()
    });
    (scenario, stated)
}

fn order(task: Task, stated: Option<&Start>, [x, y]: [f32; 2]) -> Action {
    let order = match task {
        Stated => {
            let Start {
                command,
                parameters,
            } = stated.expect("a scenario with a command");
            json!({"command": command, "parameters": parameters})
        }
        Goto => json!({"command": "goto", "parameters": {"x": x, "y": y}}),
        Policy => {
            json!({"command": "behave", "parameters": {"behaviour": "policy", "policy": "spread"}})
        }
    };
    Action::parse(order.to_string().as_bytes()).unwrap()
}

/// What was seen of robots so far.
#[derive(Debug, Default)]
struct Seen {
    behaviours: BTreeSet<&'static str>,
    /// Looks at robots, and those at which one of them drove.
    looks: u64,
    driven: u64,
}

impl Seen {
    /// Lets it all happen in one world.
    fn live_through(&mut self, (name, robots, task): (&str, u32, Task), seed: u64) {
        let (scenario, stated) = world(name, robots);
        let mut simulation = Simulation::lockstep(scenario, seed).unwrap();
        simulation.network().unwrap().record(200_000);
        settle(&mut simulation);
        let arena = simulation.world().arena();
        let half = [arena.width / 2.0, arena.height / 2.0];
        let mut bytes = [0; 32];
        bytes[..8].copy_from_slice(&seed.to_le_bytes());
        let rng = TestRng::from_seed(RngAlgorithm::ChaCha, &bytes);
        let mut runner = TestRunner::new_with_rng(Config::default(), rng);
        let next = next();
        let mut due = vec![(0, Event::SendOn([0.5, 0.5])); robots as usize];
        let mut watch = Watch::new(&simulation);
        for look in 0..SPAN_S * LOOKS_A_SECOND {
            for (robot, due) in due.iter_mut().enumerate() {
                if due.0 > look {
                    continue;
                }
                let (looks, event) = next.new_tree(&mut runner).unwrap().current();
                match std::mem::replace(due, (look + looks, event)).1 {
                    Event::Break(fault, ms) => {
                        let lasting = Some(Duration::from_millis(ms));
                        watch.break_it(&mut simulation, robot, fault, lasting);
                    }
                    Event::Heal => watch.heal(&mut simulation, robot),
                    Event::Tell(action) => watch.tell(&mut simulation, robot, &action),
                    Event::SendOn([x, y]) => {
                        let place = [x * half[0], y * half[1]];
                        watch.tell(&mut simulation, robot, &Action::Reset);
                        let action = order(task, stated.as_ref(), place);
                        watch.tell(&mut simulation, robot, &action);
                    }
                }
            }
            watch.pass(&mut simulation);
            for robot in 0..robots as usize {
                let moves = simulation.observe(robot).unwrap().duty != [0, 0];
                let behaviour = simulation.robot(robot).unwrap().snapshot().behaviour;
                self.looks += 1;
                self.driven += u64::from(moves);
                if moves {
                    self.behaviours.insert(behaviour.name());
                }
            }
        }
        for robot in 0..robots as usize {
            assert_eq!(simulation.observe(robot).unwrap().flash_violations, 0);
        }
    }

    /// Rules that nobody drives by are not tried.
    fn judge(&self) {
        for behaviour in BehaviourName::ALL {
            let name = behaviour.name();
            assert!(self.behaviours.contains(name), "nobody drove by {name}");
        }
        assert!(self.driven * 4 > self.looks, "{self:?}");
    }
}

#[test]
fn the_rules_hold_under_every_behaviour() {
    let mut seen = Seen::default();
    for world in WORLDS {
        seen.live_through(world, 1);
    }
    seen.judge();
}

#[test]
#[ignore = "minutes: `cargo xtask test --deep` runs it"]
fn the_rules_hold_for_a_million_robot_seconds() {
    let drawn = std::env::var("PROPTEST_RNG_SEED").map(|seed| seed.parse().unwrap());
    let mut seed: u64 = drawn.unwrap_or(1);
    let mut seen = Seen::default();
    while seen.looks < MILLION * u64::from(LOOKS_A_SECOND) {
        for world in WORLDS {
            println!("{world:?}, seed {seed}");
            seen.live_through(world, seed);
        }
        seed = seed.wrapping_add(1);
    }
    println!("{seen:?}");
    seen.judge();
}
