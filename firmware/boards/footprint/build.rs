//! Tells the linker what to leave out.

fn main() {
    println!("cargo:rerun-if-changed=link.x");
    println!("cargo:rustc-link-search={}", env!("CARGO_MANIFEST_DIR"));
    // The other side of the seam is left out of the link: what remains is the program alone.
    for argument in ["--unresolved-symbols=ignore-all", "-Tlink.x"] {
        println!("cargo:rustc-link-arg-bins={argument}");
    }
}
