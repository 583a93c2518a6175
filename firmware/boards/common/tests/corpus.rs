//! The fuzz targets of this crate on their whole corpus.

use std::path::Path;

// The same bodies as under the fuzzer; there they are public.
#[allow(unreachable_pub)]
#[path = "../../../../fuzz/src/board.rs"]
mod board;

#[test]
fn the_corpus_is_replayed() {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../fuzz/corpus");
    for (name, body) in board::TARGETS {
        let folder = corpus.join(name);
        let mut count = 0;
        for entry in std::fs::read_dir(&folder).expect(name) {
            let path = entry.expect(name).path();
            body(&std::fs::read(&path).expect(name));
            count += 1;
        }
        assert!(count >= 5, "{}: {count}", folder.display());
    }
}
