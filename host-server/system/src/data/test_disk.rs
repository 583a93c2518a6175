//! A disk that tests hold, break and watch.

use std::io;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use super::Disk;

/// How long a test waits for something that is to happen, however slow the machine is.
pub const LIMIT: Duration = Duration::from_mins(1);

#[derive(Debug, Default)]
struct State {
    held: bool,
    broken: bool,
    /// Syncs that have begun.
    begun: usize,
    /// Those that wait for the disk to be released.
    waiting: usize,
}

/// See the [module](self). A clone is another handle of the same.
#[derive(Clone, Default)]
pub struct TestDisk(Arc<(Mutex<State>, Condvar)>);

impl TestDisk {
    fn state(&self) -> MutexGuard<'_, State> {
        self.0.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn set(&self, change: impl FnOnce(&mut State)) {
        change(&mut self.state());
        self.0.1.notify_all();
    }

    /// It, as a server has it.
    pub fn handle(&self) -> Disk {
        let disk = self.clone();
        Disk::behind(move || disk.sync())
    }

    fn sync(&self) -> io::Result<()> {
        self.set(|state| {
            state.begun += 1;
            state.waiting += 1;
        });
        let waited = self.0.1.wait_while(self.state(), |state| state.held);
        let mut state = waited.unwrap_or_else(PoisonError::into_inner);
        state.waiting -= 1;
        if state.broken {
            return Err(io::Error::from(io::ErrorKind::StorageFull));
        }
        Ok(())
    }

    /// Whatever is synced waits for [`TestDisk::release`].
    pub fn hold(&self) {
        self.set(|state| state.held = true);
    }

    /// The disk goes on.
    pub fn release(&self) {
        self.set(|state| state.held = false);
    }

    /// Whether the disk is full.
    pub fn set_full(&self, full: bool) {
        self.set(|state| state.broken = full);
    }

    /// Syncs that have begun.
    pub fn begun(&self) -> usize {
        self.state().begun
    }

    /// Returns when somebody waits for the disk.
    ///
    /// # Panics
    /// When nobody does within [`LIMIT`].
    pub fn wait_for_sync(&self) {
        let idle = |state: &mut State| state.waiting == 0;
        let waited = self.0.1.wait_timeout_while(self.state(), LIMIT, idle);
        let state = waited.unwrap_or_else(PoisonError::into_inner).0;
        assert!(state.waiting > 0, "nothing is synced: {state:?}");
    }
}
