//! Neither threads nor vectors nor interruptions change a byte.

use std::num::NonZeroUsize;

use crawler_policy::{CheckpointError, Choice, Compute, Policy};

use crate::environments::cartpole::CartPole;
use crate::runs::{RUNS, threads};

#[test]
fn threads_and_vectors_change_nothing() {
    for (name, begin) in RUNS {
        let mut first = None;
        for compute in [
            threads(1),
            threads(2),
            threads(4),
            Compute::without_vectors(NonZeroUsize::MIN),
        ] {
            let mut run = begin(compute);
            let reports: Vec<String> = (0..4).map(|_| run.round()).collect();
            let result = (reports, run.policy(), run.checkpoint());
            let first = first.get_or_insert_with(|| result.clone());
            assert!(*first == result, "{name} on {compute:?}");
        }
    }
}

#[test]
fn a_run_that_is_interrupted_comes_to_the_same() {
    for (name, begin) in RUNS {
        let mut whole = begin(threads(2));
        let mut interrupted = begin(threads(2));
        for round in 0..6 {
            let report = whole.round();
            // Another process goes on, on another number of threads.
            let kept = interrupted.checkpoint();
            interrupted = begin(threads(1 + round % 3));
            interrupted.resume(&kept).expect("a checkpoint");
            assert_eq!(interrupted.checkpoint(), kept, "{name}");
            let again = interrupted.round();
            // Episodes that were running carry on with their rewards.
            assert_eq!(again, report, "{name}");
        }
        assert_eq!(interrupted.policy(), whole.policy(), "{name}");
        assert_eq!(interrupted.checkpoint(), whole.checkpoint(), "{name}");
    }
}

#[test]
fn seeds_make_a_difference_and_policies_survive_being_written() {
    let mut policies: Vec<Vec<u8>> = RUNS
        .iter()
        .map(|(_, begin)| begin(threads(1)).policy())
        .collect();
    for bytes in &policies {
        let read = Policy::from_bytes(bytes).expect("a policy");
        assert_eq!(&read.to_bytes(), bytes);
    }
    policies.dedup();
    assert_eq!(policies.len(), RUNS.len());
}

#[test]
fn checkpoints_of_other_runs_are_told_apart() {
    let kept: Vec<Vec<u8>> = RUNS
        .iter()
        .map(|(_, begin)| begin(threads(1)).checkpoint())
        .collect();
    for (own, (_, begin)) in RUNS.iter().enumerate() {
        for (other, kept) in kept.iter().enumerate() {
            let result = begin(threads(1)).resume(kept);
            let expected = if own == other {
                Ok(())
            } else {
                Err(CheckpointError::OtherConfiguration)
            };
            assert_eq!(result, expected);
        }
    }
}

#[test]
fn evaluation_does_not_depend_on_threads_nor_on_what_was_evaluated_before() {
    let (_, begin) = RUNS[0];
    let policy = Policy::from_bytes(&begin(threads(1)).policy()).expect("a policy");
    for choice in [Choice::Best, Choice::Sampled] {
        let all = policy.evaluate(choice, &threads(1), 0..20, CartPole::default);
        assert_eq!(all.len(), 20);
        assert_eq!(
            policy.evaluate(choice, &threads(3), 0..20, CartPole::default),
            all
        );
        let later = policy.evaluate(choice, &threads(1), 10..20, CartPole::default);
        assert_eq!(later, all[10..]);
    }
}
