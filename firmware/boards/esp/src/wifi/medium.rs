//! What the link and the task of the radio say to each other.

use core::cell::Cell;

use crawler_board::network::{Medium, Signal as Strength};
use crawler_hal::NetError;
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;

/// Between the link and the task of the radio.
pub(super) struct Shared {
    /// Radio → link: joined, with this strength.
    joined: Mutex<CriticalSectionRawMutex, Cell<bool>>,
    rssi_dbm: Mutex<CriticalSectionRawMutex, Cell<Option<i8>>>,
    /// Link → radio: join.
    ask: Signal<CriticalSectionRawMutex, ()>,
    /// Radio → link: what came of it.
    answer: Signal<CriticalSectionRawMutex, Result<(), NetError>>,
}

impl Shared {
    pub(super) const fn new() -> Self {
        Self {
            joined: Mutex::new(Cell::new(false)),
            rssi_dbm: Mutex::new(Cell::new(None)),
            ask: Signal::new(),
            answer: Signal::new(),
        }
    }

    /// Waits until the link wants to join.
    ///
    /// # Cancellation Safety
    /// A dropped call forgets nothing.
    pub(super) async fn asked(&self) {
        self.ask.wait().await;
    }

    /// Tells the link what came of joining.
    pub(super) fn answer(&self, outcome: Result<(), NetError>) {
        self.answer.signal(outcome);
    }

    /// Tells the link that the network is joined, or is not.
    pub(super) fn set_joined(&self, joined: bool) {
        self.joined.lock(|cell| cell.set(joined));
        if !joined {
            self.set_rssi(None);
        }
    }

    pub(super) fn set_rssi(&self, rssi_dbm: Option<i8>) {
        self.rssi_dbm.lock(|cell| cell.set(rssi_dbm));
    }
}

/// The radio, as the network stack sees it.
pub(super) struct Antenna(&'static Shared);

impl Antenna {
    pub(super) const fn new(shared: &'static Shared) -> Self {
        Self(shared)
    }
}

impl Medium for Antenna {
    type Signal = Meter;

    fn signal(&self) -> Meter {
        Meter(self.0)
    }

    async fn bring_up(&mut self) -> Result<(), NetError> {
        if self.0.joined.lock(Cell::get) {
            return Ok(());
        }
        // The answer to a call that was dropped is not the answer to this one.
        self.0.answer.reset();
        self.0.ask.signal(());
        self.0.answer.wait().await
    }
}

/// Strength of the signal.
#[derive(Clone)]
pub(super) struct Meter(&'static Shared);

impl Strength for Meter {
    fn rssi_dbm(&self) -> Option<i8> {
        self.0.rssi_dbm.lock(Cell::get)
    }
}
