//! Fuzz targets of federated learning. The fuzzer and the replay of its corpus in the tests of `crawler-federated` include
//! this file.

use std::time::Duration;

use crawler_federated::coordinator::Answer;
use crawler_federated::{Aggregation, Announcement, Coordinator, Plan, Settings, Update};
use sha2::{Digest, Sha256};

/// The body of a target. Panics when it finds a fault.
pub type Target = fn(&[u8]);

/// Name and body of every target.
pub const TARGETS: [(&str, Target); 3] = [
    ("federated_announcement", announcement),
    ("federated_run", run),
    ("federated_update", update),
];

/// Of the run that is fuzzed.
#[must_use]
pub const fn settings() -> Settings {
    Settings {
        rounds: 4,
        nodes: 3,
        quorum: 1,
        deadline: Duration::from_secs(10),
        aggregation: Aggregation::TrimmedMean,
        momentum: 0.5,
        plan: Plan {
            seed: 1,
            worlds: 1,
            rounds: 1,
            minibatch: 64,
            units: 8,
            central: false,
            proximal: 0.0,
        },
    }
}

/// The run that is fuzzed, at its beginning.
///
/// # Panics
/// Never: its settings are sound.
#[must_use]
pub fn begun() -> Coordinator {
    Coordinator::new(settings(), vec![0.5; 70], Duration::ZERO).expect("sound")
}

/// Whatever is accepted is finite, and written as it was read.
fn announcement(data: &[u8]) {
    if let Ok(read) = Announcement::from_bytes(data) {
        assert!(read.weights.iter().all(|weight| weight.is_finite()));
        assert_eq!(read.to_bytes(), data);
    }
}

/// Whatever is accepted is finite, and written as it was read; whatever a node sends, the run stays sound.
fn update(data: &[u8]) {
    let read = Update::from_bytes(data);
    if let Ok(read) = &read {
        assert!(read.change.values().all(f32::is_finite));
        assert_eq!(read.to_bytes(), data);
    }
    let mut run = begun();
    let answer = run.receive("node", data);
    assert_eq!(read.is_err(), matches!(answer, Answer::Invalid(_)));
    // What nobody could know is made right, or nothing would get any further.
    if let Ok(mut read) = read {
        read.round = 0;
        read.base = Announcement::base(&run.announcement());
        run.receive("node", &read.to_bytes());
    }
    run.close(Duration::from_mins(1));
    assert!(run.weights().iter().all(|weight| weight.is_finite()));
}

/// Whatever is gone on from goes on.
fn run(data: &[u8]) {
    let resume = |bytes: &[u8]| Coordinator::resume(settings(), bytes, Duration::ZERO);
    let _ = resume(data);
    let mut bytes = data.to_vec();
    bytes.extend_from_slice(&Sha256::digest(data));
    if let Ok(run) = resume(&bytes) {
        assert_eq!(run.checkpoint(), bytes);
        assert!(run.weights().iter().all(|weight| weight.is_finite()));
    }
}
