//! The fuzz target of this crate on its whole corpus.

// The same body as under the fuzzer; there it is public.
#[allow(unreachable_pub)]
#[path = "../../../fuzz/src/simulator.rs"]
pub(crate) mod simulator;

use std::fs;
use std::path::Path;

#[test]
fn the_corpus_is_replayed() {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/corpus");
    for (name, body) in simulator::TARGETS {
        let mut replayed = 0;
        for entry in fs::read_dir(corpus.join(name)).expect("a corpus") {
            let data = fs::read(entry.expect("an entry").path()).expect("readable");
            for length in 0..=data.len() {
                body(&data[..length]);
            }
            replayed += 1;
        }
        assert!(replayed > 5, "{name} has a corpus of {replayed}");
    }
}
