//! Tells the linker where memory is.

use std::path::PathBuf;
use std::{env, fs};

fn main() {
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    fs::write(out.join("memory.x"), include_bytes!("memory.x")).expect("OUT_DIR is writable");
    println!("cargo:rustc-link-search={}", out.display());
    println!("cargo:rerun-if-changed=memory.x");
    for argument in ["-Tmemory.x", "-Tlink.x", "-Tdefmt.x", "--gc-sections"] {
        println!("cargo:rustc-link-arg-bins={argument}");
    }
}
