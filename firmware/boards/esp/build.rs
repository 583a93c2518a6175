//! Names the linker scripts of the image, in the order the linker wants them.

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    // Symbols of log messages; before the memory map.
    println!("cargo:rustc-link-arg-bins=-Tdefmt.x");
    // Memory map and sections of the chip.
    println!("cargo:rustc-link-arg-bins=-Tlinkall.x");
}
