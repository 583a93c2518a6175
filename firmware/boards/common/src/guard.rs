//! The first lines of `main` on a board with two slots: run, or go back to the program before.
//!
//! The decision is that of [`crawler_boot::guard`]; this carries it out. It comes before the radio and everything
//! else of the program that could fail.

use crawler_boot::RollbackReason;
use crawler_boot::flash::{FlashError, SECTOR};
use crawler_boot::guard::{Decision, decide};
use crawler_boot::otadata::{Goal, Otadata, Slots, Standing};
use crawler_boot::trailer::{Record, Trailer};
use crawler_hal::{ResetCause, SlotPort};
use embedded_storage_async::nor_flash::MultiwriteNorFlash;

#[cfg(test)]
mod tests;

/// What the board does next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Next {
    /// It runs the program, which is proven.
    Run,
    /// It runs the program, which is on trial: this start was counted.
    Try,
    /// It runs the program, which is proven: the one that was to be tried does not start, for this reason.
    RunAgain(RollbackReason),
    /// It restarts, into the program before: this one was given up for this reason.
    Restart(RollbackReason),
}

/// Decides whether the program in the slot `running` runs, and writes that down.
///
/// # Errors
/// That of the flash, and `None` when the flash does not keep what it is told. The program runs then: whatever is
/// wrong with the flash, another start cures nothing.
///
/// # Cancellation Safety
/// As safe as a power cut: the next start decides again.
pub async fn guard<F: MultiwriteNorFlash>(
    port: &mut SlotPort<F>,
    cause: ResetCause,
) -> Result<Next, Option<F::Error>> {
    let SlotPort {
        flash,
        otadata: base,
        slots,
        running,
        ..
    } = port;
    let (base, running) = (*base, *running);
    let [own, other] = match running {
        0 => [0, 1],
        _ => [1, 0],
    }
    .map(|index: usize| slots[index].start + slots[index].length - SECTOR);
    let otadata = Otadata::read_async(flash, base, Slots::TWO).await?;
    let standing = otadata.standing(running);
    let recorded = match standing {
        Standing::OnTrial(_) => Trailer::read_async(flash, own).await?.rolled_back(),
        Standing::Proven | Standing::Returned => None,
    };
    match decide(cause, standing, recorded) {
        Decision::Confirmed => Ok(Next::Run),
        Decision::Returned(reason) => {
            note(flash, other, reason).await?;
            reach(flash, base, Goal::Keep { running }).await?;
            Ok(Next::RunAgain(reason))
        }
        Decision::Run(counter) => {
            if let Some(operation) = otadata.count(running, counter) {
                operation.execute_async(flash, base).await?;
            }
            Ok(Next::Try)
        }
        Decision::RollBack(reason) => {
            note(flash, own, reason).await?;
            if reach(flash, base, Goal::GiveUp { running }).await? {
                Ok(Next::Restart(reason))
            } else {
                Ok(Next::Try)
            }
        }
    }
}

/// Writes down why the program in a slot was given up. A trailer that has no room, or is none, goes without:
/// whether to go back does not depend on it.
async fn note<F: MultiwriteNorFlash>(
    flash: &mut F,
    trailer: u32,
    reason: RollbackReason,
) -> Result<(), Option<F::Error>> {
    match Trailer::record_async(flash, trailer, Record::RolledBack(reason)).await {
        Err(FlashError::Flash(error)) => Err(Some(error)),
        Ok(_) | Err(FlashError::Refused(_) | FlashError::Worn) => Ok(()),
    }
}

/// Whether there is a way to `goal`, which is gone then.
async fn reach<F: MultiwriteNorFlash>(
    flash: &mut F,
    base: u32,
    goal: Goal,
) -> Result<bool, Option<F::Error>> {
    match Otadata::reach_async(flash, base, Slots::TWO, goal).await {
        Ok(_) => Ok(true),
        Err(FlashError::Refused(_)) => Ok(false),
        Err(FlashError::Flash(error)) => Err(Some(error)),
        Err(FlashError::Worn) => Err(None),
    }
}
