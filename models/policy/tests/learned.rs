//! What everybody knows is learned.

use crawler_policy::ppo::{Config, Critic, Ppo};
use crawler_policy::{Choice, Environment, Episode, Policy};
use sha2::{Digest, Sha256};

use crate::environments::acrobot::Acrobot;
use crate::environments::cartpole::CartPole;
use crate::environments::lock::Lock;
use crate::environments::pair::Pair;
use crate::runs::threads;
use crate::tasks;

fn mean(episodes: &[Episode]) -> f32 {
    episodes.iter().map(|episode| episode.reward).sum::<f32>() / episodes.len() as f32
}

/// The mean reward on episodes that were not learned from.
fn unseen<E: Environment + Default>(policy: &Policy) -> f32 {
    mean(&policy.evaluate(Choice::Best, &threads(2), 0..100, E::default))
}

/// The smoke training: if these bytes change, learning does, everywhere and for everybody.
#[test]
fn a_pole_is_balanced_and_every_byte_is_known() {
    let config = tasks::ppo_cartpole(1);
    let mut run = tasks::ppo::<CartPole>(config.clone(), threads(2)).expect("a configuration");
    while run.rounds() < config.rounds {
        run.round().expect("finite");
    }
    let policy = run.policy();
    let reward = unseen::<CartPole>(&policy);
    assert!(reward >= 475.0, "{reward}");
    let hash = Sha256::digest(policy.to_bytes());
    let words: Vec<u64> = hash
        .chunks_exact(8)
        .map(|bytes| {
            bytes
                .iter()
                .fold(0, |word, byte| (word << 8) | u64::from(*byte))
        })
        .collect();
    let known = [
        0x0c12_cd55_551d_828f,
        0x944c_53c3_b3b4_8dd9,
        0x3bac_85a3_db98_fda3,
        0x0a11_7818_3263_583d,
    ];
    assert_eq!(words, known, "{words:x?}");
}

/// Two agents that see little find each other, with a critic that sees both.
#[test]
fn a_pair_meets() {
    let config = Config {
        critic: Critic::Central,
        rounds: 30,
        steps: 64,
        minibatch: 512,
        rate: 3e-3,
        ..Config::default()
    };
    let environments = (0..16).map(|_| Pair::default()).collect();
    let mut run = Ppo::new(config.clone(), threads(2), environments).expect("a configuration");
    while run.rounds() < config.rounds {
        run.round().expect("finite");
    }
    let episodes = run
        .policy()
        .evaluate(Choice::Sampled, &threads(2), 0..200, Pair::default);
    let met = episodes.iter().filter(|episode| episode.succeeded).count();
    let longest = episodes.iter().map(|episode| episode.length).max();
    assert!(met == 200 && longest < Some(30), "{met} {longest:?}");
}

/// How many of 100 locks are opened after learning with each of four seeds, keeping to actions for so long at first.
fn opened(hold: f32) -> Vec<usize> {
    let learn = |seed| {
        let config = Config {
            seed,
            rounds: 40,
            steps: 64,
            minibatch: 256,
            rate: 1e-3,
            hold,
            ..Config::default()
        };
        let environments = (0..16).map(|_| Lock::default()).collect();
        let mut run = Ppo::new(config.clone(), threads(2), environments).expect("a configuration");
        while run.rounds() < config.rounds {
            run.round().expect("finite");
        }
        let policy = run.policy();
        let episodes = policy.evaluate(Choice::Sampled, &threads(2), 0..100, Lock::default);
        episodes.iter().filter(|episode| episode.succeeded).count()
    };
    (1..=4).map(learn).collect()
}

/// What takes the same action many times over is hardly found by who chooses anew at each step, and by who keeps to an
/// action every time.
#[test]
fn a_lock_is_opened_by_who_keeps_to_an_action() {
    let (anew, kept) = (opened(1.0), opened(8.0));
    let without = anew.iter().filter(|opened| **opened < 5).count();
    assert!(without >= 3, "{anew:?}");
    assert!(kept.iter().all(|opened| *opened >= 95), "{kept:?}");
}

#[test]
#[ignore = "of the deep tier"]
fn ppo_swings_up() {
    for seed in 1..=3 {
        let config = tasks::ppo_acrobot(seed);
        let mut run = tasks::ppo::<Acrobot>(config.clone(), threads(2)).expect("a configuration");
        while run.rounds() < config.rounds {
            run.round().expect("finite");
        }
        let reward = unseen::<Acrobot>(&run.policy());
        assert!(reward >= -100.0, "seed {seed}: {reward}");
    }
}

#[test]
#[ignore = "of the deep tier"]
fn dqn_balances_a_pole() {
    for seed in 1..=3 {
        let config = tasks::dqn_cartpole(seed);
        let mut run = tasks::dqn::<CartPole>(config.clone(), threads(2)).expect("a configuration");
        while run.rounds() < config.rounds {
            run.round().expect("finite");
        }
        let reward = unseen::<CartPole>(&run.policy());
        assert!(reward >= 475.0, "seed {seed}: {reward}");
    }
}

#[test]
#[ignore = "of the deep tier"]
fn dqn_swings_up() {
    for seed in 1..=3 {
        let config = tasks::dqn_acrobot(seed);
        let mut run = tasks::dqn::<Acrobot>(config.clone(), threads(2)).expect("a configuration");
        while run.rounds() < config.rounds {
            run.round().expect("finite");
        }
        let reward = unseen::<Acrobot>(&run.policy());
        assert!(reward >= -100.0, "seed {seed}: {reward}");
    }
}
