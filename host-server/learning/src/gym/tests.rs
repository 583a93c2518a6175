//! The numbers that others get are those that `train` learns from, and those that are kept for `python/`.

use std::fmt::Write as _;
use std::io::Cursor;
use std::path::PathBuf;

use crawler_app::policy::Action;
use crawler_policy::gym::VERSION;
use crawler_policy::{Environment, Seed, Status};
use crawler_sim::scenario::Scenario;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

use super::*;

// The same as in the tests of the protocol.
#[path = "../../../../models/policy/tests/client.rs"]
#[allow(dead_code, reason = "those use more of it")]
mod client;

use client::{Client, Order, Worlds, advance, hello};

/// Worlds, steps and run of what is kept.
const WORLDS: usize = 3;
const STEPS: usize = 600;
const RUN: u64 = 7;

/// Actions that anybody can draw.
struct Draws(u32);

impl Draws {
    fn action(&mut self) -> u8 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        ((u64::from(self.0) * Action::COUNT as u64) >> 32) as u8
    }
}

fn scenario() -> Arc<Scenario> {
    Arc::new(Spread::scenario().unwrap())
}

/// What worlds come to that are drawn and driven here, and what is asked for the same over a pipe. Where an episode ends,
/// the next one begins in place of the next step.
fn here<E: Environment>(make: impl Fn() -> E) -> (Vec<u8>, Vec<Worlds>) {
    let mut worlds: Vec<E> = (0..WORLDS).map(|_| make()).collect();
    let interface = worlds[0].interface();
    let (mut asked, mut all) = (hello(VERSION, 1), Vec::new());
    let (mut episodes, mut statuses) = ([0; WORLDS], [3; WORLDS]);
    let mut draws = Draws(1);
    for _ in 0..STEPS {
        let (mut observations, mut rewards, mut states) = (Vec::new(), Vec::new(), Vec::new());
        let mut orders = Vec::new();
        for (number, world) in worlds.iter_mut().enumerate() {
            let mut own = vec![0.0; interface.agents];
            let actions: Vec<u8> = own.iter().map(|_| draws.action()).collect();
            if statuses[number] == 0 {
                statuses[number] = match world.step(&actions, &mut own) {
                    Status::Running => 0,
                    Status::Terminated => 1 + if world.succeeded() { 4 } else { 0 },
                    Status::Truncated => 2,
                };
                orders.push(Order::Act(actions));
            } else {
                world.reset(Seed::training(RUN, number as u32, episodes[number]));
                statuses[number] = 0;
                orders.push(Order::Train(RUN, number as u32, episodes[number]));
                episodes[number] += 1;
            }
            rewards.extend(own);
            for agent in 0..interface.agents {
                let mut out = vec![0.0; interface.observation];
                world.observe(agent, &mut out);
                observations.extend(out);
                let mut out = vec![0.0; interface.state];
                world.state(agent, &mut out);
                states.extend(out);
            }
        }
        asked.extend(advance(&orders, interface.agents));
        all.push(Worlds {
            observations,
            rewards,
            states,
            statuses: statuses.to_vec(),
        });
    }
    assert!(episodes.iter().all(|&begun| begun > 1), "{episodes:?}");
    (asked, all)
}

/// Everything that worlds came to, as one hash: observations, rewards, statuses, step by step.
fn hash(all: &[Worlds]) -> String {
    let mut hash = Sha256::new();
    for worlds in all {
        for value in worlds.observations.iter().chain(&worlds.rewards) {
            hash.update(value.to_le_bytes());
        }
        hash.update(&worlds.statuses);
    }
    let mut text = String::new();
    for byte in hash.finalize() {
        write!(text, "{byte:02x}").unwrap();
    }
    text
}

/// Holds worlds over a pipe against those here; what they came to.
fn held<E: Environment>(make: impl Fn() -> E) -> Value {
    let (asked, expected) = here(&make);
    for threads in [1, 3] {
        let count = |number| NonZeroUsize::new(number).unwrap();
        let mut answered = Vec::new();
        let (worlds, threads) = (count(WORLDS), count(threads));
        serve(NAME, worlds, &make, threads, &asked[..], &mut answered).unwrap();
        let mut client = Client::new(Cursor::new(answered), io::sink(), true);
        assert_eq!(client.hello.name, "spread");
        let rest = vec![Order::Rest; WORLDS];
        for (step, expected) in expected.iter().enumerate() {
            assert!(client.advance(&rest) == *expected, "step {step}");
        }
    }
    let begin = expected[0].observations.iter();
    json!({
        // In whole numbers, as robots have them.
        "first": begin.map(|value| (value * 127.0).round() as i8).collect::<Vec<_>>(),
        "reward": expected.iter().flat_map(|worlds| &worlds.rewards).map(|reward| f64::from(*reward)).sum::<f64>(),
        "sha256": hash(&expected),
    })
}

/// What Python has to come to as well.
fn golden() -> String {
    let all = held(|| Spread::new(scenario()));
    let one = held(|| Teammates::new(scenario(), Blob::new(SPREAD.blob).unwrap()));
    let golden = json!({
        "worlds": WORLDS,
        "steps": STEPS,
        "run": RUN,
        "all learn": all,
        "one learns": one,
    });
    format!("{golden}\n")
}

fn kept() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../python/tests/golden.json")
}

#[test]
fn worlds_over_a_pipe_are_those_of_training() {
    let kept = fs::read_to_string(kept()).unwrap();
    assert_eq!(
        golden(),
        kept,
        "when worlds are meant to change, the ignored test of this module writes them anew"
    );
}

#[test]
#[ignore = "writes what Python is held to"]
fn what_python_is_held_to_is_written() {
    fs::write(kept(), golden()).unwrap();
}

#[test]
fn teammates_drive_and_the_learner_is_told_alone() {
    let policy = Blob::new(SPREAD.blob).unwrap();
    let mut world = Teammates::new(scenario(), policy);
    assert_eq!(world.interface().agents, 1);
    let mut succeeded = 0;
    for number in 0..10 {
        world.reset(Seed::evaluation(number));
        let mut rewards = [f32::NAN];
        // The learner stands: whoever gets apart are the others, where they can.
        while world.step(&[Action::Stand as u8], &mut rewards) == Status::Running {
            assert!(rewards[0].is_finite());
        }
        succeeded += u8::from(world.succeeded());
    }
    assert!(succeeded > 5, "{succeeded} of 10");
}

#[test]
fn policies_of_teammates_are_found_or_it_is_said_why_not() {
    assert_eq!(policy(Path::new("spread")).unwrap(), SPREAD.blob);
    let error = policy(Path::new("/no/such/file")).unwrap_err().to_string();
    assert!(
        error.contains("/no/such/file") && error.contains("spread"),
        "{error}"
    );
}
