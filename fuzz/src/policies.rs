//! Fuzz targets of what is read as a policy, gone on from as a run, or asked over a pipe. The fuzzer and the replay of its corpus in the
//! tests of `crawler-policy` include this file.

use std::num::NonZeroUsize;

use crawler_policy::dqn::{self, Dqn};
use crawler_policy::gym::{self, ServeError};
use crawler_policy::ppo::{self, Ppo};
use crawler_policy::{Compute, Environment, Hidden, Interface, Policy, Seed, Status};
use sha2::{Digest, Sha256};

/// The body of a target. Panics when it finds a fault.
pub type Target = fn(&[u8]);

/// Name and body of every target.
pub const TARGETS: [(&str, Target); 3] = [
    ("policy", policy),
    ("policy_gym", asked),
    ("policy_run", run),
];

/// Makes the checksum right, or nothing would get past it.
fn signed(data: &[u8]) -> Vec<u8> {
    let mut bytes = data.to_vec();
    bytes.extend_from_slice(&Sha256::digest(data));
    bytes
}

/// Whatever is accepted is written as it was read.
fn policy(data: &[u8]) {
    let _ = Policy::from_bytes(data);
    let bytes = signed(data);
    if let Ok(policy) = Policy::from_bytes(&bytes) {
        assert_eq!(policy.to_bytes(), bytes);
    }
}

/// An agent that counts to ten.
#[derive(Debug, Default)]
pub struct Count(u8);

impl Environment for Count {
    fn interface(&self) -> Interface {
        Interface {
            agents: 1,
            observation: 1,
            state: 0,
            actions: 2,
        }
    }

    fn reset(&mut self, seed: Seed) {
        self.0 = (seed.get() % 5) as u8;
    }

    fn observe(&self, _agent: usize, out: &mut [f32]) {
        out[0] = f32::from(self.0) / 10.0;
    }

    fn state(&self, _agent: usize, _out: &mut [f32]) {}

    fn step(&mut self, actions: &[u8], rewards: &mut [f32]) -> Status {
        self.0 += actions[0];
        rewards[0] = f32::from(actions[0]);
        if self.0 >= 10 {
            Status::Terminated
        } else {
            Status::Running
        }
    }

    fn succeeded(&self) -> bool {
        self.0 >= 10
    }
}

fn hidden() -> Hidden {
    Hidden {
        units: vec![2],
        ..Hidden::default()
    }
}

/// A small run of PPO.
pub fn ppo() -> Ppo<Count> {
    let config = ppo::Config {
        hidden: hidden(),
        steps: 4,
        ..ppo::Config::default()
    };
    let compute = Compute::new(NonZeroUsize::MIN);
    Ppo::new(config, compute, vec![Count::default()]).expect("a configuration")
}

/// A small run of DQN.
pub fn dqn() -> Dqn<Count> {
    let config = dqn::Config {
        hidden: hidden(),
        steps: 4,
        updates: 1,
        minibatch: 4,
        memory: 8,
        warm_up: 1,
        ..dqn::Config::default()
    };
    let compute = Compute::new(NonZeroUsize::MIN);
    Dqn::new(config, compute, vec![Count::default()]).expect("a configuration")
}

/// What a run goes on from it keeps as it was, and it goes on: weights may be such that learning fails, and no worse.
fn run(data: &[u8]) {
    let bytes = signed(data);
    let mut run = ppo();
    if run.resume(&bytes).is_ok() {
        assert_eq!(run.checkpoint(), bytes);
        let _ = run.round();
    }
    let mut run = dqn();
    if run.resume(&bytes).is_ok() {
        assert_eq!(run.checkpoint(), bytes);
        let _ = run.round();
    }
}

/// What begins a session, so that fuzzing does not have to find it.
pub const HELLO: &[u8] = b"\x08\0\0\0\x01TCGY\x01\0\x01";

/// What nine worlds answer to these bytes.
fn answers(threads: usize, data: &[u8]) -> (Vec<u8>, bool) {
    let count = |number| NonZeroUsize::new(number).unwrap_or(NonZeroUsize::MIN);
    let mut out = Vec::new();
    let ended = gym::serve(
        "count",
        count(9),
        Count::default,
        count(threads),
        data,
        &mut out,
    );
    assert!(matches!(ended, Ok(()) | Err(ServeError::Refused(_))));
    (out, ended.is_err())
}

/// Whole frames are answered, each as long as it has to be, the same ones by any number of threads.
fn asked(data: &[u8]) {
    let greeted = [HELLO, data].concat();
    for data in [data, &greeted] {
        let (answered, refused) = answers(1, data);
        assert_eq!(answers(2, data), (answered.clone(), refused));
        let mut rest = &answered[..];
        let mut last = 0;
        while let Some((length, behind)) = rest.split_first_chunk() {
            let (frame, behind) = behind.split_at(u32::from_le_bytes(*length) as usize);
            assert_ne!(last, 3, "something follows a refusal");
            last = frame[0];
            let room = match last {
                1 => 1 + 26 + 5..=1 + 26 + 5,
                2 => 1 + 9 * 9..=1 + 9 * 9,
                _ => 10..=200,
            };
            assert!(room.contains(&frame.len()), "{last}: {} bytes", frame.len());
            rest = behind;
        }
        assert_eq!(last == 3, refused);
    }
}
