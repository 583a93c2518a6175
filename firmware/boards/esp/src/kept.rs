//! The record of how the program ended, in memory that a reset keeps.

use core::cell::UnsafeCell;
use core::mem::MaybeUninit;

use crawler_board::boot_record::BootRecord;
use esp_hal::{Persistable, ram};

/// Memory of the real-time clock: neither the loader nor the runtime writes it, but at power-on.
#[ram(unstable(rtc_fast, persistent))]
static KEPT: Kept = Kept(UnsafeCell::new(MaybeUninit::zeroed()));

#[repr(transparent)]
struct Kept(UnsafeCell<MaybeUninit<BootRecord>>);

// SAFETY: a record consists of words and bytes alone, so every content of its memory is one, and
// it says of itself whether it is sound.
unsafe impl Persistable for Kept {}

// SAFETY: it is read once, before anything else runs, and written there and by whoever ends the
// program. Two that end it at once leave a record whose checksum tells.
unsafe impl Sync for Kept {}

/// What the program before left, if anything; the record then says that this one runs. Called once,
/// first of all.
pub(crate) fn take() -> Option<BootRecord> {
    // SAFETY: the pointer is that of a static, aligned and valid.
    let found = unsafe { KEPT.0.get().read_volatile() };
    put(BootRecord::running());
    // SAFETY: the memory was initialised: by the runtime at power-on, and since then by `put`; any
    // content is a record.
    unsafe { found.assume_init() }.checked()
}

/// Leaves `record` to the next program.
pub(crate) fn put(record: BootRecord) {
    // SAFETY: the pointer is that of a static, aligned and valid; nobody else holds a reference.
    unsafe { KEPT.0.get().write_volatile(MaybeUninit::new(record)) };
}
