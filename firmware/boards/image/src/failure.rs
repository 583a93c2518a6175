//! One line for the person at the terminal.

use std::fmt::Display;
use std::panic::{self, AssertUnwindSafe};
use std::path::Path;

/// What went wrong, with its cause and what to do about it.
#[derive(Debug)]
pub(crate) struct Failure(pub(crate) String);

/// What a command came to.
pub(crate) type Outcome<T = ()> = Result<T, Failure>;

/// Adds what was being done to an error.
pub(crate) trait Context<T> {
    /// Names the step that failed.
    fn when(self, doing: impl Display) -> Outcome<T>;
}

impl<T, E: Display> Context<T> for Result<T, E> {
    fn when(self, doing: impl Display) -> Outcome<T> {
        self.map_err(|error| Failure(format!("{doing}: {error}")))
    }
}

/// All of a file.
///
/// # Errors
/// Names the file and why it cannot be read.
pub(crate) fn read(path: &Path) -> Outcome<Vec<u8>> {
    std::fs::read(path).when(format_args!("cannot read {}", path.display()))
}

/// Writes a file, and its folder where that is missing.
///
/// # Errors
/// Names the file and why it cannot be written.
pub(crate) fn write(path: &Path, bytes: &[u8]) -> Outcome {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).when(format_args!("cannot make {}", folder.display()))?;
    }
    std::fs::write(path, bytes).when(format_args!("cannot write {}", path.display()))
}

/// Runs `work` of a library; a panic in it becomes an error. Both `espflash` and `esp-idf-part`
/// index and add without checks what their input states.
///
/// # Errors
/// When `work` panics.
pub(crate) fn quietly<T>(library: &str, work: impl FnOnce() -> T) -> Outcome<T> {
    let usual = panic::take_hook();
    panic::set_hook(Box::new(|_| ()));
    let outcome = panic::catch_unwind(AssertUnwindSafe(work));
    panic::set_hook(usual);
    outcome.map_err(|_| {
        Failure(format!(
            "{library} gave up: what it was given contradicts itself"
        ))
    })
}
