//! Bytes that are no checkpoint, or no policy: an error, and nothing else.

use crawler_policy::{CheckpointError, ConfigError, Policy, ppo};
use proptest::prelude::*;
use sha2::{Digest, Sha256};

use crate::environments::cartpole::CartPole;
use crate::runs::{RUNS, threads};

/// Makes the checksum right again, or nothing would get past it.
fn signed(mut bytes: Vec<u8>) -> Vec<u8> {
    let end = bytes.len().saturating_sub(32);
    let hash = Sha256::digest(&bytes[..end]);
    bytes.truncate(end);
    bytes.extend_from_slice(&hash);
    bytes
}

proptest! {
    #![proptest_config(crawler_properties::cases(64))]

    /// Whatever is changed: an error, or a run that goes on.
    #[test]
    fn changed_checkpoints_are_refused_or_gone_on_from(
        run in 0..RUNS.len(),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
        cut in prop::option::weighted(0.2, any::<prop::sample::Index>()),
        sign in prop::bool::weighted(0.9),
    ) {
        let (_, begin) = RUNS[run];
        let mut run = begin(threads(1));
        run.round();
        let kept = run.checkpoint();
        let mut bytes = kept.clone();
        for (place, value) in changes {
            let place = place.index(bytes.len());
            bytes[place] = value;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        if sign {
            bytes = signed(bytes);
        }
        let mut other = begin(threads(1));
        match other.resume(&bytes) {
            // Weights may be any; learning from them may fail, and must not do more than that.
            Ok(()) => prop_assert_eq!(&other.checkpoint(), &bytes),
            Err(error) => prop_assert!(!error.to_string().is_empty()),
        }
        prop_assert!(bytes == kept || sign || other.resume(&bytes).is_err());
    }

    #[test]
    fn changed_policies_are_refused_or_read_as_they_are(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
    ) {
        let mut bytes = RUNS[0].1(threads(1)).policy();
        for (place, value) in changes {
            let place = place.index(bytes.len());
            bytes[place] = value;
        }
        if let Ok(policy) = Policy::from_bytes(&signed(bytes.clone())) {
            prop_assert_eq!(policy.to_bytes(), signed(bytes));
        }
    }

    #[test]
    fn any_bytes_are_refused(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        prop_assert!(Policy::from_bytes(&bytes).is_err());
        prop_assert!(RUNS[0].1(threads(1)).resume(&bytes).is_err());
    }
}

#[test]
fn each_error_says_what_is_wrong() {
    let kept = RUNS[0].1(threads(1)).checkpoint();
    let result = |bytes: &[u8]| RUNS[0].1(threads(1)).resume(bytes);
    assert_eq!(result(b"PNG"), Err(CheckpointError::Foreign));
    let mut newer = kept.clone();
    newer[4] = 9;
    assert_eq!(result(&newer), Err(CheckpointError::Version(9)));
    assert_eq!(
        result(&kept[..kept.len() - 1]),
        Err(CheckpointError::Damaged)
    );
    let mut weights = kept.clone();
    // After head, fingerprint and rounds come weights.
    weights[47..51].copy_from_slice(&f32::NAN.to_le_bytes());
    assert_eq!(
        result(&signed(weights)),
        Err(CheckpointError::Invalid("weights"))
    );
    let mut rounds = kept;
    rounds[39..47].copy_from_slice(&u64::MAX.to_le_bytes());
    assert_eq!(
        result(&signed(rounds)),
        Err(CheckpointError::Invalid("a count"))
    );
}

#[test]
fn what_cannot_be_learned_with_is_refused() {
    let begin = |config, environments| {
        let environments = (0..environments).map(|_| CartPole::default()).collect();
        ppo::Ppo::new(config, threads(1), environments)
            .map(|_| ())
            .map_err(|ConfigError { field, .. }| field)
    };
    let usual = ppo::Config::default;
    assert_eq!(begin(usual(), 1), Ok(()));
    assert_eq!(begin(usual(), 0), Err("environments"));
    assert_eq!(
        begin(
            ppo::Config {
                rate: f64::NAN,
                ..usual()
            },
            1
        ),
        Err("rate")
    );
    assert_eq!(
        begin(
            ppo::Config {
                clip: 0.0,
                ..usual()
            },
            1
        ),
        Err("clip")
    );
    for hold in [0.5, f32::NAN, f32::INFINITY] {
        assert_eq!(begin(ppo::Config { hold, ..usual() }, 1), Err("hold"));
    }
    for held_until in [0.0, 1.5, f32::NAN] {
        assert_eq!(
            begin(
                ppo::Config {
                    held_until,
                    ..usual()
                },
                1
            ),
            Err("held_until")
        );
    }
    assert_eq!(
        begin(
            ppo::Config {
                steps: usize::MAX,
                ..usual()
            },
            2
        ),
        Err("steps")
    );
    assert_eq!(
        begin(
            ppo::Config {
                minibatch: 0,
                ..usual()
            },
            1
        ),
        Err("minibatch")
    );
}
