//! Writes down which sources of the robot program are compiled in, for reports on releases.

use std::path::Path;

#[path = "../firmware/boards/image/src/sources.rs"]
mod sources;

fn main() {
    let root = Path::new("..");
    println!("cargo::rerun-if-changed=../firmware/boards/image/src/sources.rs");
    for name in sources::CRATES {
        println!("cargo::rerun-if-changed=../{name}/Cargo.toml");
        println!("cargo::rerun-if-changed=../{name}/src");
    }
    match sources::hash(root, &sources::CRATES) {
        Ok(hash) => println!("cargo::rustc-env=ROBOT_PROGRAM={hash}"),
        Err(error) => println!("cargo::error=the sources of the robot program: {error}"),
    }
}
