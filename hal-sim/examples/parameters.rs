//! Prints `docs/parameters.md`.
//!
//! ```text
//! cargo run -p crawler-sim --example parameters > docs/parameters.md
//! ```

fn main() {
    print!("{}", crawler_sim::world::parameters_page());
}
