//! Runs that are killed, begun again, and moved to other threads.

use std::fs;

use super::*;

fn options() -> Options {
    Options {
        seed: 5,
        // 12 rounds of 8 worlds.
        steps: 12 * 8 * 3 * 128,
        worlds: 8,
        units: 8,
        privileged: true,
    }
}

fn folder(name: &str) -> PathBuf {
    let folder =
        std::env::temp_dir().join(format!("crawler-learning-{name}-{}", std::process::id()));
    let _ = fs::remove_dir_all(&folder);
    folder
}

fn open(folder: &Path, threads: usize) -> Result<Run, RunError> {
    let threads = NonZeroUsize::new(threads).unwrap();
    Run::open(&options(), folder, Spread::scenario().unwrap(), threads)
}

const FILES: [&str; 5] = [
    "checkpoint",
    "curve.csv",
    "policy",
    "policy.tcpo",
    "run.json",
];

fn files(folder: &Path) -> Vec<Vec<u8>> {
    let read = |name: &&str| fs::read(folder.join(name)).expect("it was written");
    FILES.iter().map(read).collect()
}

#[test]
fn a_run_that_is_killed_comes_to_the_same_bytes_on_any_threads() {
    let (whole, parts) = (folder("whole"), folder("parts"));
    let mut run = open(&whole, 1).unwrap();
    while run.round().unwrap().is_some() {}
    let summary = run.finish().unwrap();
    assert_eq!(run.rounds(), (12, 12));
    assert_eq!(summary.blob, fs::read(whole.join("policy.tcpo")).unwrap());

    // Dropped after the eleventh round: the checkpoint is of the tenth.
    let mut run = open(&parts, 2).unwrap();
    for _ in 0..11 {
        assert!(run.round().unwrap().is_some());
    }
    drop(run);
    // As if it had been killed between the two files of a later checkpoint.
    let curve = parts.join("curve.csv");
    let text = fs::read_to_string(&curve).unwrap();
    fs::write(&curve, text + "11,1,2,3,4,5,6,7,8,9\n").unwrap();
    let mut run = open(&parts, 2).unwrap();
    assert_eq!(run.rounds(), (10, 12));
    while run.round().unwrap().is_some() {}
    run.finish().unwrap();
    assert_eq!(files(&whole), files(&parts));

    let curve = fs::read_to_string(whole.join("curve.csv")).unwrap();
    assert_eq!(curve.lines().count(), 13);
    assert!(curve.lines().all(|line| line.split(',').count() == 10));

    // Other options are another run.
    let other = Options {
        seed: 6,
        ..options()
    };
    let refused = Run::open(
        &other,
        &whole,
        Spread::scenario().unwrap(),
        NonZeroUsize::MIN,
    );
    assert!(matches!(refused, Err(RunError::Checkpoint(..))));
    for folder in [whole, parts] {
        let _ = fs::remove_dir_all(folder);
    }
}
