//! The corpus of the fuzz targets is replayed.

// The same bodies as under the fuzzer; there they are public.
#[allow(unreachable_pub)]
#[path = "../../../fuzz/src/federated.rs"]
mod federated;

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use crawler_federated::quantise::Quantised;
use crawler_federated::{Announcement, Report, Update};

fn corpus() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/corpus")
}

#[test]
fn the_corpus_is_replayed() {
    for (name, body) in federated::TARGETS {
        let mut replayed = 0;
        for entry in fs::read_dir(corpus().join(name)).expect("a corpus") {
            body(&fs::read(entry.expect("an entry").path()).expect("readable"));
            replayed += 1;
        }
        assert!(replayed > 3, "{name} has a corpus of {replayed}");
    }
}

/// What is said and kept today: which target, which file, which bytes.
fn seeds() -> Vec<(&'static str, String, Vec<u8>)> {
    let mut run = federated::begun();
    let mut found = Vec::new();
    for round in 0..=federated::settings().rounds {
        let announced = run.announcement();
        let mut kept = run.checkpoint();
        // The target puts the checksum there.
        kept.truncate(kept.len() - 32);
        let update = Update {
            round,
            base: Announcement::base(&announced),
            report: Report {
                samples: 384,
                episodes: round,
                success: 0.25,
                ..Report::default()
            },
            change: Quantised::of(&vec![0.1 * round as f32; 70]),
        };
        let said = update.to_bytes();
        run.receive("node", &said);
        run.close(Duration::from_secs(60 * u64::from(round + 1)));
        found.extend([
            (
                "federated_announcement",
                format!("round-{round}"),
                announced,
            ),
            ("federated_run", format!("round-{round}"), kept),
            ("federated_update", format!("round-{round}"), said),
        ]);
    }
    found
}

#[test]
fn the_corpus_has_what_is_written_today() {
    for (target, name, bytes) in seeds() {
        let kept = fs::read(corpus().join(target).join(&name)).expect("a seed");
        assert!(kept == bytes, "{target}/{name} is written otherwise today");
    }
}

#[test]
#[ignore = "writes the seeds of the corpus"]
fn seeds_are_written() {
    for (target, name, bytes) in seeds() {
        let folder = corpus().join(target);
        fs::create_dir_all(&folder).expect("a folder");
        fs::write(folder.join(name), bytes).expect("written");
    }
}
