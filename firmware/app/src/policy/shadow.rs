//! How a policy that does not drive compares with the one that does, on the same observations.
//!
//! There is one candidate, of a name, from the command that asks for it to the next one or to a restart. What is counted is
//! of two contents of policies: with another one at the wheel, and when a release has replaced the one that came before,
//! counting begins anew.

use core::cell::RefCell;

use crawler_protocol::{PolicyName, Shadow};
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::RawMutex;

use super::action::Action;
use super::decisions::named;
use super::shield::{Around, shield};

/// What both have decided for one observation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Compared {
    pub(crate) agree: bool,
    pub(crate) vetoed: bool,
    pub(crate) driving_vetoed: bool,
}

impl Compared {
    pub(crate) fn new(driving: Action, candidate: Action, around: Around) -> Self {
        let vetoed = |action| shield(action, around).1;
        Self {
            agree: driving == candidate,
            vetoed: vetoed(candidate),
            driving_vetoed: vetoed(driving),
        }
    }
}

/// Which candidate is meant, since when.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Candidate {
    /// Stands for its name.
    pub(crate) name: u32,
    begun: u16,
}

/// A comparison.
struct Comparison {
    told: Shadow,
    /// Of the candidate.
    name: u32,
    /// Of the policy that drives, once one has.
    driving: Option<u32>,
    begun: u16,
}

impl Comparison {
    fn clear(&mut self) {
        let Shadow {
            decisions,
            agreed,
            vetoes,
            driving_vetoes,
            ..
        } = &mut self.told;
        for count in [decisions, agreed, vetoes, driving_vetoes] {
            *count = 0;
        }
    }
}

/// The comparison that was asked for: intake and update begin it, the activity that decides counts, the link tells.
pub(crate) struct Shadows<M: RawMutex> {
    comparison: Mutex<M, RefCell<Option<Comparison>>>,
}

impl<M: RawMutex> Shadows<M> {
    pub(crate) const fn new() -> Self {
        Self {
            comparison: Mutex::new(RefCell::new(None)),
        }
    }

    fn with<T>(&self, what: impl FnOnce(&mut Option<Comparison>) -> T) -> T {
        self.comparison
            .lock(|comparison| what(&mut comparison.borrow_mut()))
    }

    /// Begins, or ends what there is.
    pub(crate) fn begin(&self, policy: Option<&PolicyName>) {
        self.with(|comparison| {
            let begun = comparison.as_ref().map_or(0, |before| before.begun);
            *comparison = policy.map(|policy| Comparison {
                told: Shadow {
                    policy: policy.clone(),
                    decisions: 0,
                    agreed: 0,
                    vetoes: 0,
                    driving_vetoes: 0,
                },
                name: named(policy.as_str()),
                driving: None,
                begun: begun.wrapping_add(1),
            });
        });
    }

    /// Begins anew, if there is something: what a name stands for may have changed.
    pub(crate) fn begin_anew(&self) {
        self.with(|comparison| {
            if let Some(comparison) = comparison {
                comparison.begun = comparison.begun.wrapping_add(1);
                comparison.driving = None;
                comparison.clear();
            }
        });
    }

    /// Who is to decide beside the policy that drives, if anyone.
    pub(crate) fn candidate(&self, driving: u32) -> Option<Candidate> {
        self.with(|comparison| {
            let comparison = comparison.as_ref()?;
            (comparison.name != driving).then_some(Candidate {
                name: comparison.name,
                begun: comparison.begun,
            })
        })
    }

    /// Counts what the candidate has decided beside the policy that drives. What has begun since counts nothing from before.
    pub(crate) fn count(&self, candidate: Candidate, driving: u32, compared: Compared) {
        self.with(|comparison| {
            let Some(comparison) = comparison else {
                return;
            };
            let Candidate { name, begun } = candidate;
            if (comparison.name, comparison.begun) != (name, begun) {
                return;
            }
            if comparison.driving != Some(driving) {
                comparison.driving = Some(driving);
                comparison.clear();
            }
            let told = &mut comparison.told;
            if told.decisions == u32::MAX {
                // Shares of it stay what they were.
                return;
            }
            told.decisions += 1;
            told.agreed += u32::from(compared.agree);
            told.vetoes += u32::from(compared.vetoed);
            told.driving_vetoes += u32::from(compared.driving_vetoed);
        });
    }

    /// What it has come to.
    pub(crate) fn told(&self) -> Option<Shadow> {
        self.with(|comparison| Some(comparison.as_ref()?.told.clone()))
    }
}

#[cfg(test)]
mod tests;
