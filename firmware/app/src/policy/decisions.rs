//! What there is to drive by, and the hand-over between control and the activity that runs a network.

use core::cell::Cell;

use crawler_protocol::Reason;
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_sync::signal::Signal;

use super::pilot::{Asked, Decision};
use crate::neighbours::hash;

/// A policy that is there, or that should be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Installed {
    /// There is none.
    #[default]
    None,
    /// What is there under the name that this stands for (see `named`) is none.
    Bad(u32),
    /// What is there under it is for another kind of observation.
    Other(u32),
    /// The policy whose name this stands for.
    Policy(u32),
}

/// What there is to drive by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Policies {
    /// What comes with the program.
    pub own: Installed,
    /// What a release has brought.
    pub brought: Installed,
    /// What a release has brought and is not driven by.
    pub unfit: Installed,
}

impl Policies {
    /// Nothing.
    pub const NONE: Self = Self {
        own: Installed::None,
        brought: Installed::None,
        unfit: Installed::None,
    };

    /// Whether the policy of this name is there.
    ///
    /// # Errors
    /// The reason for which the behaviour is refused.
    pub fn check(self, name: u32) -> Result<(), Reason> {
        let all = [self.own, self.brought, self.unfit];
        if all.contains(&Installed::Policy(name)) {
            Ok(())
        } else if all.contains(&Installed::Bad(name)) {
            Err(Reason::BadPolicy)
        } else if all.contains(&Installed::Other(name)) {
            Err(Reason::OtherObservation)
        } else {
            Err(Reason::NoPolicy)
        }
    }
}

/// Stands for a name where only sameness counts.
pub(crate) fn named(name: &str) -> u32 {
    hash(name.bytes())
}

/// The hand-over between control and the activity.
pub(crate) struct Decisions<M: RawMutex> {
    /// Control → activity: the newest observation, and the name that stands for the policy.
    asked: Signal<M, (Asked, u32)>,
    /// Activity → control.
    decided: Mutex<M, Cell<Option<Decision>>>,
    /// Activities → control.
    installed: Mutex<M, Cell<Policies>>,
}

impl<M: RawMutex> Decisions<M> {
    pub(crate) const fn new() -> Self {
        Self {
            asked: Signal::new(),
            decided: Mutex::new(Cell::new(None)),
            installed: Mutex::new(Cell::new(Policies::NONE)),
        }
    }

    pub(crate) fn installed(&self) -> Policies {
        self.installed.lock(Cell::get)
    }

    pub(crate) fn install(&self, own: Installed) {
        self.installed
            .lock(|cell| cell.set(Policies { own, ..cell.get() }));
    }

    pub(crate) fn bring(&self, brought: Installed, unfit: Installed) {
        self.installed.lock(|cell| {
            let Policies { own, .. } = cell.get();
            cell.set(Policies {
                own,
                brought,
                unfit,
            });
        });
    }

    pub(crate) fn ask(&self, asked: Asked, name: u32) {
        self.asked.signal((asked, name));
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
    pub(crate) fn asked(&self) -> impl Future<Output = (Asked, u32)> + use<'_, M> {
        self.asked.wait()
    }

    /// Whether an observation waits.
    pub(crate) fn is_asked(&self) -> bool {
        self.asked.signaled()
    }

    /// The observation that waits.
    #[cfg(test)]
    pub(crate) fn waiting(&self) -> Option<Asked> {
        self.asked.try_take().map(|(asked, _)| asked)
    }
}
