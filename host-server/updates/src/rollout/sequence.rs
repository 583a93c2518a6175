//! The order of releases: robots take none that is not above what they run, so the way back goes forward.

use std::collections::BTreeMap;

use super::check::PlanError;
use super::names::BoardName;
use super::plan::Plan;

impl Plan {
    /// Whether robots will take the releases, where `newest` has the highest sequence that was rolled out for each
    /// board before, of programs or of the model of the plan. A roll-back to an earlier version is a plan like any
    /// other, of the earlier image signed under a new sequence; the error says so.
    ///
    /// # Errors
    /// [`PlanError::Sequence`] for the first release whose sequence is too low.
    pub fn check_sequences(&self, newest: &BTreeMap<BoardName, u64>) -> Result<(), PlanError> {
        for release in &self.releases {
            let before = newest.get(&release.board).copied().unwrap_or(0);
            if release.sequence <= before {
                return Err(PlanError::Sequence {
                    board: release.board.clone(),
                    sequence: release.sequence,
                    newest: before,
                });
            }
        }
        Ok(())
    }
}
