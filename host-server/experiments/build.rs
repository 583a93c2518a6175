//! Writes down which program this is, as far as what a trial comes to may depend on it.

use std::path::Path;

#[path = "../../firmware/boards/image/src/sources.rs"]
mod sources;

/// What makes a trial, beside the robot program: files, and folders with all that is in them.
const SIMULATOR: [&str; 10] = [
    "Cargo.lock",
    "hal-sim/Cargo.toml",
    "hal-sim/scenarios",
    "hal-sim/src",
    "hal-sim/bundle/src",
    "hal-sim/protocol/src",
    "host-server/cells/src",
    "host-server/experiments/src",
    "models/detector/detector.tcmm",
    "models/detector/src",
];
/// What learns, beside both of these.
const LEARNING: [&str; 2] = ["host-server/learning/src", "models/policy/src"];
/// So many digits of a hash tell programs apart.
const DIGITS: usize = 12;

fn main() {
    let root = Path::new("../..");
    println!("cargo::rerun-if-changed=../../firmware/boards/image/src/sources.rs");
    for name in sources::CRATES {
        println!("cargo::rerun-if-changed=../../{name}/Cargo.toml");
        println!("cargo::rerun-if-changed=../../{name}/src");
    }
    for name in SIMULATOR.into_iter().chain(LEARNING) {
        println!("cargo::rerun-if-changed=../../{name}");
    }
    let of = |names: &[&str]| sources::hash_of(root, names.iter().map(|name| (*name).to_owned()));
    match (
        sources::hash(root, &sources::CRATES),
        of(&SIMULATOR),
        of(&LEARNING),
    ) {
        (Ok(program), Ok(simulator), Ok(learning)) => {
            let (program, simulator) = (&program[..DIGITS], &simulator[..DIGITS]);
            println!("cargo::rustc-env=EXPERIMENT_BUILD={program}-{simulator}");
            println!("cargo::rustc-env=TRAINING_BUILD={}", &learning[..DIGITS]);
        }
        (Err(error), ..) | (_, Err(error), _) | (.., Err(error)) => {
            println!("cargo::error=the sources of robot program, simulator and learning: {error}");
        }
    }
}
