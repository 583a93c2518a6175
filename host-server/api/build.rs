//! Says whether the control room is there to be embedded. Building it is `npm`'s business, and
//! starting `npm` is nobody's here.

use std::path::Path;

fn main() {
    let index = Path::new("../ui/dist/index.html");
    println!("cargo::rerun-if-changed=../ui/dist");
    println!("cargo::rerun-if-env-changed=REQUIRE_UI");
    let required = std::env::var("REQUIRE_UI").is_ok_and(|value| value == "1");
    if required && !index.is_file() {
        println!(
            "cargo::error=REQUIRE_UI=1 and no control room: run `npm ci && npm run build` in \
             host-server/ui first"
        );
    }
}
