//! The corpus of the fuzz targets is replayed.

// The same bodies as under the fuzzer; there they are public.
#[allow(unreachable_pub)]
#[path = "../../../fuzz/src/policies.rs"]
mod policies;

use std::fs;
use std::path::Path;

#[test]
fn the_corpus_is_replayed() {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/corpus");
    for (name, body) in policies::TARGETS {
        let mut replayed = 0;
        for entry in fs::read_dir(corpus.join(name)).expect("a corpus") {
            body(&fs::read(entry.expect("an entry").path()).expect("readable"));
            replayed += 1;
        }
        assert!(replayed > 10, "{name} has a corpus of {replayed}");
    }
}

/// What runs are kept as today, without the checksum: which target, which file, which bytes.
fn seeds() -> Vec<(&'static str, String, Vec<u8>)> {
    let mut found = Vec::new();
    let mut keep = |target, name: String, mut bytes: Vec<u8>| {
        bytes.truncate(bytes.len() - 32);
        found.push((target, name, bytes));
    };
    let (mut ppo, mut dqn) = (policies::ppo(), policies::dqn());
    for round in 0..6 {
        keep("policy_run", format!("ppo-{round}"), ppo.checkpoint());
        keep("policy", format!("ppo-{round}"), ppo.policy().to_bytes());
        keep("policy_run", format!("dqn-{round}"), dqn.checkpoint());
        keep("policy", format!("dqn-{round}"), dqn.policy().to_bytes());
        ppo.round().expect("finite");
        dqn.round().expect("finite");
    }
    found
}

#[test]
fn the_corpus_has_what_is_written_today() {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/corpus");
    for (target, name, bytes) in seeds() {
        let kept = fs::read(corpus.join(target).join(&name)).expect("a seed");
        assert!(kept == bytes, "{target}/{name} is written otherwise today");
    }
}

#[test]
#[ignore = "writes the seeds of the corpus"]
fn seeds_are_written() {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/corpus");
    for (target, name, bytes) in seeds() {
        let folder = corpus.join(target);
        fs::create_dir_all(&folder).expect("a folder");
        fs::write(folder.join(name), bytes).expect("written");
    }
}
