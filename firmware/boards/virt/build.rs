//! Tells the linker where memory is: a program's, or the boot stage's.

use std::path::PathBuf;
use std::{env, fs};

const PROGRAMS: [&str; 3] = ["crawler-virt", "counts", "sight"];
const BOOT_STAGE: &str = "crawler-virt-boot";

fn main() {
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    fs::write(out.join("memory.x"), include_bytes!("memory.x")).expect("OUT_DIR is writable");
    fs::write(out.join("boot.x"), include_bytes!("boot.x")).expect("OUT_DIR is writable");
    println!("cargo:rustc-link-search={}", out.display());
    println!("cargo:rerun-if-changed=memory.x");
    println!("cargo:rerun-if-changed=boot.x");
    for program in PROGRAMS {
        for argument in ["-Tmemory.x", "-Tlink.x", "-Tdefmt.x", "--gc-sections"] {
            println!("cargo:rustc-link-arg-bin={program}={argument}");
        }
    }
    for argument in ["-Tboot.x", "--gc-sections"] {
        println!("cargo:rustc-link-arg-bin={BOOT_STAGE}={argument}");
    }
}
