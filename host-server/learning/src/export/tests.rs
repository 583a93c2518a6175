//! What robots get, beside what was learned.

use std::num::NonZeroUsize;

use crawler_app::policy::{LOGIT_STEPS, Observation, Scratch};
use crawler_policy::ppo::{Config, Ppo};
use crawler_policy::{Compute, Environment, Hidden, Interface, Seed, Status};
use proptest::prelude::*;

use super::*;

/// As large as what robots observe, and with nothing to learn.
struct Still;

impl Environment for Still {
    fn interface(&self) -> Interface {
        Interface {
            agents: 1,
            observation: WIDTH,
            state: 0,
            actions: Action::COUNT,
        }
    }

    fn reset(&mut self, _: Seed) {}

    fn observe(&self, _: usize, out: &mut [f32]) {
        out.fill(0.5);
    }

    fn state(&self, _: usize, _: &mut [f32]) {}

    fn step(&mut self, actions: &[u8], rewards: &mut [f32]) -> Status {
        rewards[0] = f32::from(actions[0]);
        Status::Running
    }

    fn succeeded(&self) -> bool {
        false
    }
}

fn policy(units: usize, activation: Activation, seed: u64) -> Policy {
    let config = Config {
        seed,
        hidden: Hidden {
            units: vec![units; 2],
            activation,
        },
        steps: 64,
        ..Config::default()
    };
    let compute = Compute::new(NonZeroUsize::MIN);
    let mut ppo = Ppo::new(config, compute, vec![Still]).unwrap();
    for _ in 0..3 {
        ppo.round().unwrap();
    }
    ppo.policy()
}

const HEADER: Header = Header {
    mode: Mode::Drawn,
    score: Some(999),
};

/// The network in floats.
fn logits(policy: &Policy, observation: &Observation) -> Vec<f64> {
    let mut values: Vec<f64> = observation
        .numbers()
        .iter()
        .map(|number| f64::from(*number) / 127.0)
        .collect();
    let layers: Vec<_> = policy.network().layers().collect();
    for (number, layer) in layers.iter().enumerate() {
        let next = (0..layer.outputs).map(|output| {
            let products = values.iter().enumerate();
            let sum: f64 = products
                .map(|(input, value)| value * f64::from(layer.weight(input, output)))
                .sum();
            let value = sum + f64::from(layer.bias(output));
            if number + 1 < layers.len() {
                value.tanh()
            } else {
                value
            }
        });
        values = next.collect();
    }
    values
}

proptest! {
    #![proptest_config(crawler_properties::cases(64))]
    #[test]
    fn logits_in_whole_numbers_are_those_of_floats(
        seed in 0..4_u64,
        numbers in prop::collection::vec(-127..=127_i8, WIDTH),
    ) {
        let policy = policy(32, Activation::Tanh, seed);
        let blob = export(&policy, HEADER).unwrap();
        let read = Blob::new(&blob).unwrap();
        let observation = Observation::new(numbers.try_into().unwrap());
        let mut scratch = Scratch::new(&observation);
        for layer in read.layers() {
            scratch.run(layer);
        }
        for (whole, exact) in scratch.logits().iter().zip(logits(&policy, &observation)) {
            let whole = f64::from(*whole) / f64::from(LOGIT_STEPS);
            prop_assert!((whole - exact).abs() < 0.1, "{whole} {exact}");
        }
    }
}

#[test]
fn a_blob_says_what_it_comes_from() {
    let policy = policy(16, Activation::Tanh, 1);
    let blob = export(&policy, HEADER).unwrap();
    let read = Blob::new(&blob).unwrap();
    assert_eq!((read.mode, read.score), (Mode::Drawn, Some(999)));
    assert_eq!(*read.training, training(&policy));
    assert_eq!(export(&policy, HEADER).unwrap(), blob);
}

#[test]
fn what_no_robot_could_run_is_refused() {
    let relu = policy(16, Activation::Relu, 1);
    assert_eq!(export(&relu, HEADER), Err(Unfit::Shape));
    let large = policy(100, Activation::Tanh, 1);
    assert!(matches!(
        export(&large, HEADER),
        Err(Unfit::TooLarge(16_000..))
    ));
}
