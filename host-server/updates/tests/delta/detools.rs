//! Held against detools, which nobody here wrote.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::process::Command;

use crawler_updates::delta::{apply, make};
use proptest::prelude::*;
use proptest::strategy::ValueTree as _;
use proptest::test_runner::TestRunner;

use crate::images::{golden, pairs};

/// Applies every patch of ours in a folder, and makes some of its own of the same images.
const SCRIPT: &str = "
import sys
from pathlib import Path
import detools
folder = Path(sys.argv[1])
for old in sorted(folder.glob('*.old')):
    with open(old, 'rb') as a, open(old.with_suffix('.ours'), 'rb') as p, open(old.with_suffix('.made'), 'wb') as b:
        detools.apply_patch(a, p, b)
    for window, length in [(4, 3), (8, 7), (10, 5), (10, 9)]:
        new, out = old.with_suffix('.new'), old.with_suffix(f'.{window}-{length}')
        with open(old, 'rb') as a, open(new, 'rb') as b, open(out, 'wb') as p:
            detools.create_patch(a, b, p, compression='heatshrink',
                heatshrink_window_sz2=window, heatshrink_lookahead_sz2=length)
";

/// The Python that has detools, or why there is none.
fn python() -> Result<String, String> {
    let python = std::env::var("DETOOLS_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let output = Command::new(&python)
        .args(["-c", "import detools"])
        .output();
    match output {
        Ok(output) if output.status.success() => Ok(python),
        Ok(_) => Err(format!("{python} has no detools")),
        Err(error) => Err(format!("{python} cannot be run: {error}")),
    }
}

#[test]
fn detools_makes_of_our_patches_what_we_make_of_its() {
    let python = match python() {
        Ok(python) => python,
        Err(why) => {
            eprintln!("skipped: {why}; `pip install detools`, and DETOOLS_PYTHON names its Python");
            return;
        }
    };
    let folder = tempfile::tempdir().expect("a folder");
    let file = |case: usize, kind: &str| folder.path().join(format!("{case:03}.{kind}"));
    let mut runner = TestRunner::deterministic();
    let mut images = vec![(golden("old.bin"), golden("new.bin"))];
    images.extend((0..60).map(|_| pairs().new_tree(&mut runner).expect("images").current()));
    for (case, (old, new)) in images.iter().enumerate() {
        for (kind, bytes) in [("old", old), ("new", new), ("ours", &make(old, new))] {
            fs::write(file(case, kind), bytes).expect("a file");
        }
    }
    let output = Command::new(python)
        .args(["-c", SCRIPT])
        .arg(folder.path())
        .output();
    let output = output.expect("it ran before");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    let read = |path: &Path| fs::read(path).expect("detools made it");
    let mut sizes = String::new();
    for (case, (old, new)) in images.iter().enumerate() {
        assert!(read(&file(case, "made")) == *new, "{case}");
        let ours = read(&file(case, "ours")).len();
        for parameters in ["4-3", "8-7", "10-5", "10-9"] {
            let patch = read(&file(case, parameters));
            let made = apply(old, new.len() as u32, &patch);
            assert!(
                made.as_ref() == Ok(new),
                "{case} {parameters}: {:?}",
                made.err()
            );
            let _ = write!(sizes, "{ours} {} ", patch.len());
        }
    }
    println!("sizes of ours and theirs: {sizes}");
}
