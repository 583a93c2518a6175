//! The fuzz target of this crate on its whole corpus.

// The same body as under the fuzzer; there it is public.
#[allow(unreachable_pub)]
#[path = "../../../fuzz/src/delta.rs"]
mod targets;

use std::fs;
use std::path::Path;

#[test]
fn the_corpus_is_replayed() {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/corpus");
    for (name, body) in targets::TARGETS {
        let mut replayed = 0;
        for entry in fs::read_dir(corpus.join(name)).expect("a corpus") {
            let seed = fs::read(entry.expect("an entry").path()).expect("readable");
            body(&seed);
            // And what is like it.
            for at in 0..seed.len() {
                for flip in [1, 0x10, 0x80, 0xFF] {
                    let mut changed = seed.clone();
                    changed[at] ^= flip;
                    body(&changed);
                }
                body(&seed[..at]);
            }
            replayed += 1;
        }
        assert!(replayed > 10, "{name} has a corpus of {replayed}");
    }
}
