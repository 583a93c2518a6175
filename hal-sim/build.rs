//! Writes down which sources of robot program and simulator are compiled in: what a result comes from.

use std::path::Path;

#[path = "../firmware/boards/image/src/sources.rs"]
mod sources;

fn main() {
    println!("cargo::rerun-if-changed=../firmware/boards/image/src/sources.rs");
    let mut crates = sources::CRATES.to_vec();
    crates.push("hal-sim");
    for name in &crates {
        println!("cargo::rerun-if-changed=../{name}/Cargo.toml");
        println!("cargo::rerun-if-changed=../{name}/src");
    }
    match sources::hash(Path::new(".."), &crates) {
        Ok(hash) => println!("cargo::rustc-env=SIMULATOR_SOURCES={hash}"),
        Err(error) => println!("cargo::error=the sources of the simulator: {error}"),
    }
}
