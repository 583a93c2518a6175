//! Support for the end-to-end tests and the measurements: real processes on loopback, each ended
//! by its own id, each wait bounded.
//!
//! Reading order: what is started in `server`, `clients`, `engines`, `certificates` and `port`; what is measured
//! in `measure`, `load`, `chaos` and `soak`; `tamper`.

mod certificates;
pub mod chaos;
mod clients;
pub mod engines;
pub mod load;
pub mod measure;
mod port;
mod server;
pub mod soak;
mod tamper;

pub use certificates::TestAuthority;
pub use clients::{Heard, Subscription, publish, subscribe, subscribe_with};
pub use engines::mosquitto::Mosquitto;
pub use port::ReservedPort;
pub use server::{Simulated, Terracrawler, agent, binary};
pub use tamper::Tamper;

use std::fmt::Debug;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// The root of the repository.
///
/// # Panics
/// When this crate lies nowhere.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .expect("the tests lie in the repository")
        .to_owned()
}

/// The binary `terracrawler` that cargo built next to the running test.
///
/// # Panics
/// When it was not built.
pub fn terracrawler() -> PathBuf {
    server::binary()
}

/// Asks `ready` every 50 ms until it gives something.
///
/// # Panics
/// With `what` when `limit` passes first.
pub fn wait_for<T>(what: &str, limit: Duration, mut ready: impl FnMut() -> Option<T>) -> T {
    let began = Instant::now();
    loop {
        if let Some(value) = ready() {
            return value;
        }
        assert!(began.elapsed() < limit, "gave up after {limit:?}: {what}");
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// The same, and says what was seen last when it gives up.
///
/// # Panics
/// With `what` and `last` when `limit` passes first.
pub fn wait_for_with<T, S: Debug>(
    what: &str,
    limit: Duration,
    last: &mut S,
    mut ready: impl FnMut(&mut S) -> Option<T>,
) -> T {
    let began = Instant::now();
    loop {
        if let Some(value) = ready(last) {
            return value;
        }
        assert!(
            began.elapsed() < limit,
            "gave up after {limit:?}: {what}; seen last: {last:?}"
        );
        std::thread::sleep(Duration::from_millis(50));
    }
}
