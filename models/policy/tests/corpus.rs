//! The corpus of the fuzz targets is replayed.

// The same bodies as under the fuzzer; there they are public.
#[allow(unreachable_pub)]
#[path = "../../../fuzz/src/policies.rs"]
mod policies;

use std::fs;
use std::path::Path;

use crawler_policy::gym::VERSION;

use crate::client::{Order, advance, frame, hello};

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

/// Sessions over a pipe, with and without hello.
fn sessions() -> Vec<(String, Vec<u8>)> {
    let all = |order: &Order| advance(&vec![order.clone(); 9], 1);
    let begin = all(&Order::Train(1, 2, 3));
    let act = all(&Order::Act(vec![1]));
    let mixed = [
        Order::Act(vec![0]),
        Order::Rest,
        Order::Evaluate(7),
        Order::Act(vec![1]),
        Order::Train(u64::MAX, 0, 1),
        Order::Rest,
        Order::Rest,
        Order::Act(vec![0]),
        Order::Evaluate(0),
    ];
    let sessions = [
        ("begin", begin.clone()),
        ("begin-evaluation", all(&Order::Evaluate(4))),
        ("rest", all(&Order::Rest)),
        ("act", [&begin[..], &act].concat()),
        ("act-before-begin", act.clone()),
        ("act-to-the-end", [begin.clone(), act.repeat(12)].concat()),
        ("mixed", [begin.clone(), advance(&mixed, 1)].concat()),
        ("hello", hello(VERSION, 0)),
        ("hello-of-another-version", hello(VERSION + 1, 1)),
        ("close", [begin, frame(3, &[])].concat()),
        ("action-that-is-none", all(&Order::Act(vec![2]))),
        ("unknown-kind", frame(9, b"?")),
    ];
    let named = sessions.into_iter();
    named
        .map(|(name, bytes)| (name.to_owned(), bytes))
        .collect()
}

/// What runs are kept as today, without the checksum, and sessions: which target, which file, which bytes.
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
    let sessions = sessions().into_iter();
    found.extend(sessions.map(|(name, bytes)| ("policy_gym", name, bytes)));
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
