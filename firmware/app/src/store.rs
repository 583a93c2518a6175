//! The store activity: parameters, the count of boots, and what a restart interrupts, in flash.
//!
//! Three items in a map of `sequential-storage`: all persistent parameters as one, so that a power
//! cut leaves either the old set or the new one, the count of boots, and the behaviour that the robot was
//! at when it was told to restart. A corrupt flash is
//! erased once and starts anew; one that refuses costs persistence, never the boot.

mod goal;
mod guard;
#[cfg(test)]
mod tests;

use core::convert::Infallible;
use core::ops::Deref;

use crawler_hal::{Clock, Duration, Elapsed, with_deadline};
use crawler_protocol::{Level, Reason, ResponseStatus};
use embassy_futures::select::{Either, select};
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_storage_async::nor_flash::NorFlash;
use sequential_storage::Error;
use sequential_storage::cache::{Cache, Uncached};
use sequential_storage::map::{MapConfig, MapStorage};

use crate::context::Robot;
use crate::context::handles::StoreHandle;
use crate::goal::Goal;
use crate::hold::{Hold, Inline};
use crate::order::SetRequest;
use crate::parameters::{Changes, ENCODED_MAX, Parameters};

use guard::{GuardError, Guarded};

/// Key of the parameters.
const PARAMETERS: u8 = 1;
/// Key of the count of boots.
const BOOTS: u8 = 2;
/// Key of the behaviour that a restart interrupts.
const UNFINISHED: u8 = 3;
/// Longest item with its key, rounded up to any word of flash.
const BUFFER: usize = (ENCODED_MAX + 1).next_multiple_of(32);
/// How long the start waits for the first word on the battery before it touches the flash.
const BATTERY_PATIENCE: Duration = Duration::from_millis(300);
/// Erasing a page takes up to 400 ms on a worn NOR flash, and one write may need to move a page.
const FLASH_PATIENCE: Duration = Duration::from_millis(1_500);

/// Loads parameters and the count of boots, then persists what `set` commands ask for, and what a restart
/// interrupts.
///
/// # Cancellation Safety
/// As safe as a power cut, which the flash format survives at any byte.
pub fn store<M: RawMutex, F: NorFlash, C: Clock>(
    robot: impl Deref<Target = Robot<M>>,
    flash: F,
    clock: C,
) -> impl Future<Output = Infallible> {
    store_held::<Inline, M, F, C>(robot, flash, clock)
}

/// As [`store()`], with its rare steps kept as `H` keeps them.
///
/// # Cancellation Safety
/// As [`store()`].
// Not an `async fn`, which would keep its arguments twice: as they came and as they are used.
#[allow(clippy::manual_async_fn)]
pub fn store_held<H: Hold, M: RawMutex, F: NorFlash, C: Clock>(
    robot: impl Deref<Target = Robot<M>>,
    flash: F,
    clock: C,
) -> impl Future<Output = Infallible> {
    async move {
        let robot = robot.store_handle();
        // The guard has to know the voltage before anything is repaired or written.
        let patience = clock.now() + BATTERY_PATIENCE;
        let _: Result<(), Elapsed> =
            with_deadline(&clock, patience, robot.battery_measured()).await;
        let mut shelf = Shelf::new(Guarded::new(flash, robot.shared()));
        H::hold(load(robot, &mut shelf, &clock)).await;
        loop {
            let asked = select(robot.next_set(), robot.goal_to_keep()).await;
            let SetRequest { changes, sender } = match asked {
                Either::First(request) => request,
                Either::Second(goal) => {
                    H::hold(put_unfinished(&robot, &mut shelf, &clock, &goal)).await;
                    continue;
                }
            };
            let (status, reason) = match H::hold(set(robot, &mut shelf, &clock, changes)).await {
                Ok(()) => (ResponseStatus::Completed, None),
                Err(Refusal::Invalid(reason)) => (ResponseStatus::Rejected, Some(reason)),
                Err(Refusal::NotStored(reason)) => (ResponseStatus::Failed, Some(reason)),
            };
            let now = clock.now();
            robot.respond(&sender.source, sender.seq, status, reason, now);
        }
    }
}

/// Why a `set` did not take place. Nothing has changed then.
enum Refusal {
    /// The values are not acceptable.
    Invalid(Reason),
    /// The flash did not take them.
    NotStored(Reason),
}

async fn set<M: RawMutex, F: NorFlash, C: Clock>(
    robot: StoreHandle<'_, M>,
    shelf: &mut Shelf<'_, M, F>,
    clock: &C,
    changes: Result<Changes, Reason>,
) -> Result<(), Refusal> {
    let changes = changes.map_err(Refusal::Invalid)?;
    let (next, differs) = robot
        .with_parameters(|present| {
            present
                .changed(&changes)
                .map(|next| (next.clone(), next.differs_in_flash(present)))
        })
        .map_err(Refusal::Invalid)?;
    if differs {
        let deadline = clock.now() + FLASH_PATIENCE;
        let stored = with_deadline(clock, deadline, shelf.put_parameters(&next)).await;
        if let Err(error) = stored.unwrap_or(Err(ShelfError::Refused)) {
            robot.log(
                Level::Error,
                "flash",
                format_args!("{}", error.name()),
                clock.now(),
            );
            return Err(Refusal::NotStored(match error {
                ShelfError::LowVoltage => Reason::LowBattery,
                ShelfError::Refused | ShelfError::Corrupt | ShelfError::Unfit => {
                    Reason::StorageFailed
                }
            }));
        }
    }
    robot.set_parameters(next);
    robot.tell_parameters();
    Ok(())
}

async fn load<M: RawMutex, F: NorFlash, C: Clock>(
    robot: StoreHandle<'_, M>,
    shelf: &mut Shelf<'_, M, F>,
    clock: &C,
) {
    let mut buffer = [0; BUFFER];
    let deadline = clock.now() + FLASH_PATIENCE;
    let found = with_deadline(clock, deadline, shelf.get(PARAMETERS, &mut buffer)).await;
    let nothing_to_lose = matches!(found, Ok(Ok(None)));
    tell_erasure(&robot, shelf, clock);
    match found {
        Ok(Ok(Some(item))) => {
            let (loaded, dropped) = Parameters::decode(item);
            if dropped > 0 {
                let text = format_args!("{dropped} stored parameters are not usable");
                robot.log(Level::Warn, "flash", text, clock.now());
            }
            robot.set_parameters(loaded);
        }
        Ok(Ok(None)) => {}
        Ok(Err(error)) => {
            let text = format_args!("{}: parameters are at their defaults", error.name());
            robot.log(Level::Error, "flash", text, clock.now());
        }
        Err(Elapsed) => {
            let text = format_args!("no answer: parameters are at their defaults");
            robot.log(Level::Error, "flash", text, clock.now());
        }
    }
    // The robot need not wait for the count.
    robot.set_loaded();
    robot.tell_parameters();

    let deadline = clock.now() + FLASH_PATIENCE;
    let counted = with_deadline(clock, deadline, count_boot(shelf)).await;
    let mut counted = counted.unwrap_or(Err(ShelfError::Refused));
    // Noise may pass for an empty map, or for a full one, until something is to be written. It may
    // even have a map written where the flash is not erased, which the flash refuses.
    if nothing_to_lose
        && matches!(
            counted,
            Err(ShelfError::Corrupt | ShelfError::Unfit | ShelfError::Refused)
        )
    {
        let deadline = clock.now() + FLASH_PATIENCE;
        let renewed = with_deadline(clock, deadline, shelf.renew()).await;
        if let Ok(Ok(())) = renewed {
            tell_erasure(&robot, shelf, clock);
            let deadline = clock.now() + FLASH_PATIENCE;
            let again = with_deadline(clock, deadline, count_boot(shelf)).await;
            counted = again.unwrap_or(Err(ShelfError::Refused));
        }
    }
    match counted {
        Ok(count) => robot.set_boot_count(count),
        Err(error) => {
            let text = format_args!("{}: this boot is not counted", error.name());
            robot.log(Level::Error, "flash", text, clock.now());
        }
    }
    let deadline = clock.now() + FLASH_PATIENCE;
    let unfinished = with_deadline(clock, deadline, take_unfinished(shelf)).await;
    // What is wrong with the flash has just been told.
    let unfinished = unfinished.ok().and_then(Result::ok).flatten();
    robot.set_goal_before_restart(unfinished);
}

/// Keeps a behaviour over the restart that is about to come. One that cannot be kept is not taken up
/// again, which costs no more.
async fn put_unfinished<M: RawMutex, F: NorFlash, C: Clock>(
    robot: &Robot<M>,
    shelf: &mut Shelf<'_, M, F>,
    clock: &C,
    goal: &Goal,
) {
    let item = goal::encode(goal);
    let deadline = clock.now() + FLASH_PATIENCE;
    let stored = with_deadline(clock, deadline, shelf.put(UNFINISHED, &item)).await;
    if let Err(error) = stored.unwrap_or(Err(ShelfError::Refused)) {
        let text = format_args!("{}: the restart ends what it does", error.name());
        robot.log(Level::Warn, "flash", text, clock.now());
    }
}

/// The behaviour that the robot was at when it was told to restart. It is told once: a robot that does
/// not get over what it does shall not do it again.
async fn take_unfinished<M: RawMutex, F: NorFlash>(
    shelf: &mut Shelf<'_, M, F>,
) -> Result<Option<Goal>, ShelfError> {
    let mut buffer = [0; BUFFER];
    let goal = shelf.get(UNFINISHED, &mut buffer).await?;
    let goal = goal.and_then(goal::decode);
    if goal.is_some() {
        shelf.put(UNFINISHED, &goal::NOTHING).await?;
    }
    Ok(goal)
}

/// Logs an erasure that nobody was told of yet.
fn tell_erasure<M: RawMutex, F: NorFlash, C: Clock>(
    robot: &Robot<M>,
    shelf: &mut Shelf<'_, M, F>,
    clock: &C,
) {
    if core::mem::take(&mut shelf.erased) {
        let text = format_args!("made no sense and was erased: parameters are at their defaults");
        robot.log(Level::Warn, "flash", text, clock.now());
    }
}

async fn count_boot<M: RawMutex, F: NorFlash>(
    shelf: &mut Shelf<'_, M, F>,
) -> Result<u32, ShelfError> {
    let mut buffer = [0; BUFFER];
    let before = match shelf.get(BOOTS, &mut buffer).await? {
        Some(item) => item.try_into().map_or(0, u32::from_le_bytes),
        None => 0,
    };
    let count = before.saturating_add(1);
    shelf.put(BOOTS, &count.to_le_bytes()).await?;
    Ok(count)
}

/// Why the flash did not serve. Each variant calls for a different next step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ShelfError {
    /// Not writing now, so as not to be cut off in the middle: charge the battery.
    LowVoltage,
    /// The flash does not do what it is told: it is worn or broken.
    Refused,
    /// Content that makes no sense, although it was erased: as above.
    Corrupt,
    /// The region is too small, or its pages have an unusable shape: configuration of the board.
    Unfit,
}

impl ShelfError {
    const fn name(self) -> &'static str {
        match self {
            Self::LowVoltage => "voltage too low to write",
            Self::Refused => "flash refused",
            Self::Corrupt => "flash is corrupt",
            Self::Unfit => "flash region is unfit",
        }
    }
}

type Map<'a, M, F> = MapStorage<u8, Guarded<'a, M, F>, Cache<Uncached, Uncached, Uncached, u8>>;

/// The map in flash; `None` where the region has no usable shape.
struct Shelf<'a, M: RawMutex, F: NorFlash> {
    map: Option<Map<'a, M, F>>,
    /// Corrupt content was erased, and nobody was told yet.
    erased: bool,
}

impl<'a, M: RawMutex, F: NorFlash> Shelf<'a, M, F> {
    fn new(flash: Guarded<'a, M, F>) -> Self {
        let end = embedded_storage_async::nor_flash::ReadNorFlash::capacity(&flash);
        let config = u32::try_from(end)
            .ok()
            .and_then(|end| MapConfig::try_new(0..end).ok());
        Self {
            map: config.map(|config| MapStorage::new(flash, config, Cache::new_uncached())),
            erased: false,
        }
    }

    /// Reads an item. Corrupt content is erased, once: it is lost in any case, and the next boot
    /// shall not meet it again.
    async fn get<'b>(
        &mut self,
        key: u8,
        buffer: &'b mut [u8; BUFFER],
    ) -> Result<Option<&'b [u8]>, ShelfError> {
        let map = self.map.as_mut().ok_or(ShelfError::Unfit)?;
        let mut scratch = [0; BUFFER];
        match map.fetch_item::<&[u8]>(&mut scratch, &key).await {
            Ok(Some(item)) => {
                let (copy, _) = buffer
                    .split_at_mut_checked(item.len())
                    .ok_or(ShelfError::Corrupt)?;
                copy.copy_from_slice(item);
                Ok(Some(copy))
            }
            Ok(None) => Ok(None),
            Err(error) => {
                let error = classify(&error);
                if error == ShelfError::Corrupt {
                    self.renew().await?;
                    return Ok(None);
                }
                Err(error)
            }
        }
    }

    /// Erases everything.
    async fn renew(&mut self) -> Result<(), ShelfError> {
        let map = self.map.as_mut().ok_or(ShelfError::Unfit)?;
        map.erase_all().await.map_err(|error| classify(&error))?;
        self.erased = true;
        Ok(())
    }

    /// Writes the parameters over those that are there, of which it keeps what another version of the program
    /// has stored.
    async fn put_parameters(&mut self, parameters: &Parameters) -> Result<(), ShelfError> {
        let mut buffer = [0; ENCODED_MAX];
        let item = {
            let mut before = [0; BUFFER];
            // What cannot be read cannot be kept.
            let before = self.get(PARAMETERS, &mut before).await.ok().flatten();
            parameters.encode(before.unwrap_or(&[]), &mut buffer)
        };
        self.put(PARAMETERS, item).await
    }

    /// Writes an item and reads it back: a flash whose cells have gone bad takes a write and
    /// keeps something else.
    async fn put(&mut self, key: u8, item: &[u8]) -> Result<(), ShelfError> {
        let map = self.map.as_mut().ok_or(ShelfError::Unfit)?;
        let mut buffer = [0; BUFFER];
        let stored = map.store_item(&mut buffer, &key, &item).await;
        stored.map_err(|error| classify(&error))?;
        match map.fetch_item::<&[u8]>(&mut buffer, &key).await {
            Ok(Some(kept)) if kept == item => Ok(()),
            Ok(_) => Err(ShelfError::Corrupt),
            Err(error) => Err(classify(&error)),
        }
    }
}

fn classify<E>(error: &Error<GuardError<E>>) -> ShelfError {
    match error {
        Error::Storage {
            value: GuardError::LowVoltage,
            ..
        } => ShelfError::LowVoltage,
        Error::Storage {
            value: GuardError::Flash(_),
            ..
        } => ShelfError::Refused,
        Error::FullStorage | Error::ItemTooBig | Error::BufferTooSmall(_) | Error::BufferTooBig => {
            ShelfError::Unfit
        }
        _ => ShelfError::Corrupt,
    }
}
