//! What there is to drive by, and the hand-over between control and the activity that runs a network.

use core::cell::Cell;

use crawler_protocol::Reason;
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_sync::signal::Signal;

use super::pilot::{Asked, Decision};
use crate::neighbours::hash;

/// What there is to drive by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Installed {
    /// Nothing.
    #[default]
    None,
    /// Bytes that are no policy.
    Bad,
    /// A policy for another kind of observation.
    Other,
    /// The policy whose name this stands for: see `named`.
    Policy(u32),
}

impl Installed {
    /// Whether the policy of this name is there.
    ///
    /// # Errors
    /// The reason for which the behaviour is refused.
    pub const fn check(self, name: u32) -> Result<(), Reason> {
        match self {
            Self::Policy(own) if own == name => Ok(()),
            Self::None | Self::Policy(_) => Err(Reason::NoPolicy),
            Self::Bad => Err(Reason::BadPolicy),
            Self::Other => Err(Reason::OtherObservation),
        }
    }
}

/// Stands for a name where only sameness counts.
pub(crate) fn named(name: &str) -> u32 {
    hash(name.bytes())
}

/// The hand-over between control and the activity.
pub(crate) struct Decisions<M: RawMutex> {
    /// Control → activity: the newest observation.
    asked: Signal<M, Asked>,
    /// Activity → control.
    decided: Mutex<M, Cell<Option<Decision>>>,
    /// Activity → control.
    installed: Mutex<M, Cell<Installed>>,
}

impl<M: RawMutex> Decisions<M> {
    pub(crate) const fn new() -> Self {
        Self {
            asked: Signal::new(),
            decided: Mutex::new(Cell::new(None)),
            installed: Mutex::new(Cell::new(Installed::None)),
        }
    }

    pub(crate) fn installed(&self) -> Installed {
        self.installed.lock(Cell::get)
    }

    pub(crate) fn install(&self, installed: Installed) {
        self.installed.lock(|cell| cell.set(installed));
    }

    pub(crate) fn ask(&self, asked: Asked) {
        self.asked.signal(asked);
    }

    pub(crate) fn take(&self) -> Option<Decision> {
        self.decided.lock(Cell::take)
    }

    pub(crate) fn decide(&self, decision: Decision) {
        self.decided.lock(|cell| cell.set(Some(decision)));
    }

    /// Waits for an observation.
    ///
    /// # Cancellation Safety
    /// A dropped call misses nothing.
    pub(crate) fn asked(&self) -> impl Future<Output = Asked> + use<'_, M> {
        self.asked.wait()
    }

    /// The observation that waits.
    #[cfg(test)]
    pub(crate) fn waiting(&self) -> Option<Asked> {
        self.asked.try_take()
    }
}
