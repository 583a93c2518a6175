//! Nodes and a coordinator in one process.

use std::fs;
use std::path::PathBuf;

use super::*;
use crate::federated::{self, Node};
use crate::spread::Spread;

const SECOND: Duration = Duration::from_secs(1);
const NAMES: [&str; 3] = ["attic", "barn", "cellar"];

fn together() -> FederatedOptions {
    FederatedOptions {
        options: Options {
            seed: 3,
            // Three rounds of three nodes with two worlds each.
            steps: 3 * 3 * 2 * 3 * STEPS,
            worlds: 2,
            units: 8,
            privileged: true,
        },
        nodes: 3,
        quorum: 2,
        ..FederatedOptions::default()
    }
}

fn folder(name: &str) -> PathBuf {
    let name = format!("crawler-federated-{name}-{}", std::process::id());
    let folder = std::env::temp_dir().join(name);
    let _ = fs::remove_dir_all(&folder);
    folder
}

fn open(folder: &Path, now: Duration) -> Result<Coordination, RunError> {
    let scenario = Spread::scenario().expect("built in");
    Coordination::open(&together(), folder, scenario, NonZeroUsize::MIN, now)
}

fn nodes() -> Vec<Node> {
    let node = |name: &&str| {
        let scenario = Spread::scenario().expect("built in");
        Node::new(name, scenario, NonZeroUsize::MIN)
    };
    NAMES.iter().map(node).collect()
}

fn told(node: &mut Node, announced: &[u8]) -> Vec<u8> {
    match node.answer(announced) {
        Ok(federated::Answer::Update(bytes)) => bytes,
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_run_whose_coordinator_is_killed_comes_to_the_same_bytes() {
    let (whole, killed) = (folder("whole"), folder("killed"));
    let mut weights = Vec::new();
    for (folder, dies) in [(&whole, false), (&killed, true)] {
        let mut run = open(folder, Duration::ZERO).expect("a run");
        let mut nodes = nodes();
        for round in 1..=3 {
            let now = SECOND * round;
            let announced = run.coordinator().announcement();
            for (node, name) in nodes.iter_mut().zip(NAMES) {
                assert_eq!(run.receive(name, &told(node, &announced)), Answer::Taken);
            }
            if dies && round == 2 {
                // What it had heard is gone, and is said again without learning again.
                run = open(folder, now).expect("its files");
                assert_eq!(run.coordinator().announcement(), announced);
                for (node, name) in nodes.iter_mut().zip(NAMES) {
                    assert_eq!(run.receive(name, &told(node, &announced)), Answer::Taken);
                }
            }
            let line = run.close(now).expect("kept").expect("all have answered");
            assert_eq!(line.round, u64::from(round));
            assert_eq!(line.steps, u64::from(round) * 3 * 2 * 3 * STEPS);
            assert!(
                (0.0..=1.0).contains(&line.vetoes) && line.entropy > 0.0,
                "{line:?}"
            );
        }
        assert!(run.coordinator().is_over());
        let last = run.coordinator().announcement();
        for node in &mut nodes {
            let over = federated::Answer::Over(run.coordinator().weights().to_vec());
            assert_eq!(node.answer(&last), Ok(over));
        }
        let curve = fs::read_to_string(folder.join("curve.csv")).expect("written");
        assert_eq!(curve, run.curve());
        assert_eq!(curve.lines().count(), 4);
        weights.push(run.coordinator().weights().to_vec());
    }
    assert_eq!(weights[0], weights[1]);
    let read = |folder: &Path| fs::read(folder.join("checkpoint")).expect("written");
    assert_eq!(read(&whole), read(&killed));
    // It changed, and other options do not go on with it.
    let settings = together().settings(3);
    assert_ne!(weights[0], initial(&settings.plan).expect("a plan"));
    let scenario = Spread::scenario().expect("built in");
    let other = FederatedOptions {
        options: Options {
            seed: 4,
            ..together().options
        },
        ..together()
    };
    let refused = Coordination::open(&other, &whole, scenario, NonZeroUsize::MIN, SECOND);
    assert!(matches!(refused, Err(RunError::Rounds(..))));
    for folder in [whole, killed] {
        fs::remove_dir_all(folder).expect("removed");
    }
}

#[test]
fn a_node_answers_by_its_name_alone_and_the_same_again() {
    let plan = together().settings(3).plan;
    let announced = |weights: Vec<f32>| {
        let announcement = crawler_federated::Announcement {
            round: 0,
            rounds: 3,
            deadline_ms: 1_000,
            plan,
            weights,
        };
        announcement.to_bytes()
    };
    let first = announced(initial(&plan).expect("a plan"));
    let [mut attic, mut again, mut barn] = ["attic", "attic", "barn"].map(|name| {
        let scenario = Spread::scenario().expect("built in");
        Node::new(name, scenario, NonZeroUsize::MIN)
    });
    let said = told(&mut attic, &first);
    assert_eq!(told(&mut attic, &first), said);
    assert_eq!(told(&mut again, &first), said);
    assert_ne!(told(&mut barn, &first), said);
    // Other networks than those of the plan, and no message at all; then it goes on.
    let short = announced(vec![0.0; 10]);
    assert!(matches!(
        attic.answer(&short),
        Err(federated::NodeError::Weights(_))
    ));
    assert!(matches!(
        attic.answer(b"x"),
        Err(federated::NodeError::Message(_))
    ));
    let update = crawler_federated::Update::from_bytes(&said).expect("an update");
    assert_eq!(u64::from(update.report.samples), 2 * 3 * STEPS);
    let second = announced(vec![0.01; update.change.len()]);
    assert_ne!(told(&mut attic, &second), said);
}

#[test]
fn the_plan_fits_whatever_the_number_of_nodes() {
    for nodes in [1, 8, 64] {
        let own = FederatedOptions {
            nodes,
            quorum: 1,
            ..FederatedOptions::default()
        };
        let settings = own.settings(3);
        settings.validate().expect("a run");
        let weights = initial(&settings.plan).expect("a plan");
        let run = Coordinator::new(settings, weights, Duration::ZERO).expect("a run");
        let policy = policy(&settings.plan, run.weights()).expect("a policy");
        assert_eq!(policy.network().shape().outputs, 7);
    }
    assert_eq!(FederatedOptions::default().rounds(3), 163);
}
