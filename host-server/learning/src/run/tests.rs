//! Runs that are killed, begun again, and moved to other threads.

use std::fs;
use std::path::PathBuf;

use super::*;
use crate::curve::COLUMNS;
use crate::judge::Judged;
use crate::tensorboard::NAME as EVENTS;
use crate::tensorboard::tests::{shown, wanted};

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
    fs::write(&curve, text.clone() + "11,1,2,3,4,5,6,7,8,9,10,11\n").unwrap();
    let mut run = open(&parts, 2).unwrap();
    assert_eq!(run.rounds(), (10, 12));
    while run.round().unwrap().is_some() {}
    run.finish().unwrap();
    assert_eq!(files(&whole), files(&parts));

    // For TensorBoard no round is there twice either.
    let curve = fs::read_to_string(whole.join("curve.csv")).unwrap();
    let lines: Vec<Line> = curve.lines().filter_map(Line::read).collect();
    for folder in [&whole, &parts] {
        let events = fs::read(folder.join(EVENTS)).unwrap();
        assert_eq!(shown(&events), wanted(&lines));
    }

    assert_eq!(curve.lines().count(), 13);
    assert!(curve.lines().all(|line| line.split(',').count() == 12));
    let lines: Vec<Line> = curve.lines().skip(1).filter_map(Line::read).collect();
    assert_eq!(lines.len(), 12);
    for (line, text) in lines.iter().zip(curve.lines().skip(1)) {
        assert_eq!(line.csv(), format!("{text}\n"));
        assert!((0.0..=1.0).contains(&line.vetoes), "{text}");
    }
    assert!(lines.iter().any(|line| line.vetoes > 0.0), "{curve}");

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

/// Whatever the seed: to stand is what is learned first where robots do not come to anything by chance.
#[test]
#[ignore = "of the deep tier"]
fn a_million_decisions_are_enough_with_every_seed() {
    for seed in 1..=4 {
        let folder = folder(&format!("seed-{seed}"));
        let options = Options {
            seed,
            steps: 1_000_000,
            ..Options::default()
        };
        let threads = NonZeroUsize::new(2).unwrap();
        let mut run = Run::open(&options, &folder, Spread::scenario().unwrap(), threads).unwrap();
        while run.round().unwrap().is_some() {}
        let Judged { success, .. } = run.finish().unwrap().whole;
        assert!(success > 0.75, "seed {seed}: {success}");
        let _ = fs::remove_dir_all(folder);
    }
}

#[test]
fn a_run_that_stands_is_kept_and_what_is_damaged_is_refused() {
    let (whole, parts) = (folder("straight"), folder("standing"));
    let mut run = open(&whole, 1).unwrap();
    while run.round().unwrap().is_some() {}
    // Whoever stands after each round loses none.
    loop {
        let mut run = open(&parts, 1).unwrap();
        if run.round().unwrap().is_none() {
            break;
        }
        run.keep().unwrap();
        assert!(crawler_app::policy::Policy::new(&run.so_far().unwrap()).is_ok());
    }
    for name in ["checkpoint", "curve.csv"] {
        let read = |folder: &Path| fs::read(folder.join(name)).unwrap();
        assert_eq!(read(&whole), read(&parts), "{name}");
    }

    let curve = parts.join("curve.csv");
    let text = fs::read_to_string(&curve).unwrap();
    for damaged in [
        text.replacen("vetoes", "others", 1),
        text.replacen("\n7,", "\n8,", 1),
        text.split_inclusive('\n').take(5).collect(),
        text.replacen(',', ",,", 20),
        text.replacen("\n3,", "\n3,inf,", 1),
    ] {
        fs::write(&curve, damaged).unwrap();
        assert!(matches!(open(&parts, 1), Err(RunError::File(..))));
    }
    fs::write(&curve, &text).unwrap();
    let checkpoint = parts.join("checkpoint");
    let mut bytes = fs::read(&checkpoint).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    for damaged in [&bytes[..], &bytes[..9], &[]] {
        fs::write(&checkpoint, damaged).unwrap();
        assert!(matches!(open(&parts, 1), Err(RunError::Checkpoint(..))));
    }
    for folder in [whole, parts] {
        let _ = fs::remove_dir_all(folder);
    }
}

#[test]
fn no_text_makes_a_line_but_those_of_a_curve() {
    for text in [
        "",
        ",",
        "1",
        COLUMNS,
        "1,2,3,4,5,6,7,8,9,10,11",
        "1,2,3,,,,7,8,9,10,11,NaN",
    ] {
        assert_eq!(Line::read(text), None, "{text}");
    }
    let line = Line::read("1,2,0,,,,7,8,9,10,11,0.5\n").unwrap();
    assert!(line.reward.is_nan() && line.vetoes == 0.5);
}
