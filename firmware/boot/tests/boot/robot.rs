//! A robot that starts from a [`Chip`], updates itself as `crawler-boot` says, and knows the truth.

use crawler_boot::RollbackReason;
use crawler_boot::flash::FlashError;
use crawler_boot::guard::{Decision, decide};
use crawler_boot::otadata::{Goal, Otadata, Slots, Standing};
use crawler_boot::trailer::{Record, Trailer};
use crawler_boot::trial::Sensors;
use crawler_hal::ResetCause;

use super::chip::{Chip, PowerLost, TRAILERS};
use super::loader;

/// What a new program is like.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Nature {
    Good,
    /// Restarts itself a few times on purpose, then proves itself.
    Restarting,
    /// Is cut off so often before it proves itself.
    CutOff(u32),
    Panics,
    Hangs,
    NoLink,
    /// The image was intact when it was checked, and is not when it is started.
    Rots,
}

impl Nature {
    pub(crate) fn is_good(self) -> bool {
        match self {
            Self::Good | Self::Restarting => true,
            Self::CutOff(times) => times <= 3,
            Self::Panics | Self::Hangs | Self::NoLink | Self::Rots => false,
        }
    }
}

type Result<T> = std::result::Result<T, PowerLost>;

/// The only error that these tests know is that the power went.
fn lost<T, R: std::fmt::Debug>(
    result: std::result::Result<T, FlashError<PowerLost, R>>,
) -> Result<T> {
    match result {
        Ok(value) => Ok(value),
        Err(FlashError::Flash(PowerLost)) => Err(PowerLost),
        Err(FlashError::Refused(reason)) => panic!("refused: {reason:?}"),
        Err(FlashError::Worn) => panic!("worn"),
    }
}

fn reach(chip: &mut Chip, goal: Goal) -> Result<Otadata> {
    lost(Otadata::reach(chip, 0, Slots::TWO, goal))
}

fn record(chip: &mut Chip, slot: u8, record: Record) -> Result<()> {
    match Trailer::record(chip, TRAILERS[usize::from(slot)], record) {
        // Without an envelope there is nothing to append to: the next update begins it anew.
        Err(FlashError::Refused(_)) => Ok(()),
        other => lost(other).map(drop),
    }
}

/// Powers up, or restarts, until a program runs: its slot, and whether it is on trial. Checks what must
/// hold at every start.
pub(crate) fn start(chip: &mut Chip, mut cause: ResetCause) -> Result<(u8, bool)> {
    for _ in 0..4 {
        let (index, initial) = loader::plain(chip.entries(), 2);
        let order = loader::order(index, 2);
        let running = order.into_iter().find(|&slot| chip.images[slot].is_some());
        let running = running.expect("some image starts") as u8;
        let version = chip.images[usize::from(running)].expect("intact");
        let proven = chip.truth.proven.contains(&version);
        assert!(
            proven || chip.truth.staged == Some(version),
            "version {version} was neither proven nor staged"
        );
        if initial && chip.bytes[..32].iter().any(|&byte| byte != 0xFF) {
            assert!(
                proven,
                "an entry of the bootloader's own proves an unproven program"
            );
        }

        let otadata = Otadata::read(chip, 0, Slots::TWO)?;
        let standing = otadata.standing(running);
        let unproven = matches!(standing, Standing::OnTrial(_));
        assert!(proven || unproven, "{standing:?} for version {version}");
        let trailer = Trailer::read(chip, TRAILERS[usize::from(running)])?;
        match decide(cause, standing, trailer.rolled_back()) {
            Decision::Confirmed => return Ok((running, false)),
            Decision::Returned(reason) => {
                record(chip, 1 - running, Record::RolledBack(reason))?;
                reach(chip, Goal::Keep { running })?;
                return Ok((running, false));
            }
            Decision::Run(counter) => {
                if let Some(operation) = otadata.count(running, counter) {
                    operation.execute(chip, 0)?;
                }
                return Ok((running, true));
            }
            Decision::RollBack(reason) => {
                record(chip, running, Record::RolledBack(reason))?;
                reach(chip, Goal::GiveUp { running })?;
                cause = ResetCause::Software;
            }
        }
    }
    panic!("restarts for ever");
}

/// Lets a program on trial be what it is, until the trial has ended.
pub(crate) fn settle(chip: &mut Chip, mut running: u8, nature: Nature) -> Result<u8> {
    for turn in 0.. {
        let version = chip.images[usize::from(running)];
        let cause = match nature {
            Nature::Panics => ResetCause::Panic,
            Nature::Hangs => ResetCause::Watchdog,
            Nature::Restarting if turn < 5 => ResetCause::Software,
            Nature::CutOff(times) if turn < times => ResetCause::BrownOut,
            Nature::NoLink => {
                let reason = RollbackReason::NoLink;
                record(chip, running, Record::RolledBack(reason))?;
                reach(chip, Goal::GiveUp { running })?;
                ResetCause::Software
            }
            Nature::Good | Nature::Restarting | Nature::CutOff(_) | Nature::Rots => {
                chip.truth.proven.extend(version);
                reach(chip, Goal::Confirm { running })?;
                record(chip, running, Record::Confirmed)?;
                return Ok(running);
            }
        };
        let (now, on_trial) = start(chip, cause)?;
        running = now;
        if !on_trial {
            return Ok(running);
        }
        assert!(turn < 40, "on trial for ever");
    }
    unreachable!()
}

/// A whole update from the program in the slot `running`, which is proven, to `version`.
pub(crate) fn update(
    chip: &mut Chip,
    running: u8,
    version: u32,
    nature: Nature,
    envelope: &[u8],
) -> Result<u8> {
    let spare = 1 - running;
    let trailer = TRAILERS[usize::from(spare)];
    reach(chip, Goal::Keep { running })?;
    chip.truth.staged = None;
    lost(Trailer::begin(chip, trailer, envelope))?;
    chip.images[usize::from(spare)] = None;
    for block in 0..3 {
        record(chip, spare, Record::Block(block))?;
    }
    chip.images[usize::from(spare)] = Some(version);
    chip.truth.staged = Some(version);
    record(chip, spare, Record::Staged(Sensors::RANGER))?;
    let staged = Trailer::read(chip, trailer)?;
    assert_eq!(
        (staged.blocks(), staged.staged()),
        (3, Some(Sensors::RANGER))
    );
    record(chip, spare, Record::Activated)?;
    let activate = Goal::Activate {
        slot: spare,
        running,
    };
    reach(chip, activate)?;
    if nature == Nature::Rots {
        chip.images[usize::from(spare)] = None;
    }
    match start(chip, ResetCause::Software)? {
        (running, true) => settle(chip, running, nature),
        (running, false) => Ok(running),
    }
}

/// Powers up after a cut, and ends what was begun.
pub(crate) fn resume(chip: &mut Chip, version: u32, nature: Nature) -> Result<u8> {
    let (running, on_trial) = start(chip, ResetCause::PowerOn)?;
    let running = if on_trial {
        settle(chip, running, nature)?
    } else {
        running
    };
    let there = chip.images[usize::from(running)] == Some(version);
    if there || !nature.is_good() {
        return Ok(running);
    }
    update(chip, running, version, nature, b"again")
}
