//! Reset, its cause, and the last panic.
//!
//! The machine resets in place: the emulator goes on, RAM keeps its content. A record in a corner
//! of RAM that neither the loader nor the runtime touches tells the next program how this one
//! ended. An emulator that is started anew has zeros there: power-on.

use core::cell::Cell;
use core::convert::Infallible;
use core::fmt::Write;
use core::panic::PanicInfo;

use crawler_board::boot_record::{BootRecord, End};
use crawler_hal::{ResetCause, System};
use critical_section::Mutex;

use crate::log::Text;
use crate::machine::{self, ExitCode};
use crate::time;

unsafe extern "C" {
    /// Start of the memory that is kept, from `memory.x`.
    static mut _kept: BootRecord;
}

/// What this program found when it started.
static FOUND: Mutex<Cell<Option<BootRecord>>> = Mutex::new(Cell::new(None));
static END_ON_PANIC: Mutex<Cell<bool>> = Mutex::new(Cell::new(false));
/// Panics in a row after which the next one waits before it resets.
const PANICS_IN_A_ROW: u32 = 3;
/// How long it waits, in microseconds: a program that panics as it starts would keep a core busy.
const REST_US: u64 = 1_000_000;

fn kept() -> *mut BootRecord {
    &raw mut _kept
}

fn leave(record: BootRecord) {
    // SAFETY: the linker script reserves the place; callers run with interrupts masked or are the
    // only ones that are left.
    unsafe { kept().write_volatile(record) };
}

/// Takes over what the program before left, and leaves that this one runs.
pub fn init() {
    // SAFETY: the linker script reserves the place, and every bit pattern is a record.
    let found = unsafe { kept().read_volatile() }.checked();
    critical_section::with(|cs| FOUND.borrow(cs).set(found));
    leave(BootRecord::running());
}

fn found() -> Option<BootRecord> {
    critical_section::with(|cs| FOUND.borrow(cs).get())
}

/// From now on a panic ends the emulator, for programs that nobody restarts.
pub fn end_on_panic() {
    critical_section::with(|cs| END_ON_PANIC.borrow(cs).set(true));
}

/// The watchdog was not fed.
pub(crate) fn starve() -> ! {
    defmt::error!("watchdog: control was not heard of for 2 s");
    leave(BootRecord::ending(End::Watchdog, found().as_ref()));
    machine::reset()
}

/// Resets the machine, as asked for.
pub(crate) fn restart() -> ! {
    critical_section::with(|_| {
        leave(BootRecord::ending(End::Reset, found().as_ref()));
        machine::reset()
    })
}

/// The microcontroller.
#[derive(Debug)]
pub struct VirtSystem {
    found: Option<BootRecord>,
}

impl VirtSystem {
    /// As it was found by [`init`].
    pub fn new() -> Self {
        Self { found: found() }
    }
}

impl Default for VirtSystem {
    fn default() -> Self {
        Self::new()
    }
}

impl System for VirtSystem {
    fn reset_cause(&self) -> ResetCause {
        BootRecord::cause(self.found.as_ref())
    }

    fn last_panic(&self) -> Option<&str> {
        self.found.as_ref().and_then(BootRecord::panic_text)
    }

    fn feed_watchdog(&mut self) {
        time::feed();
    }

    async fn reset(&mut self) -> Infallible {
        defmt::info!("reset, as asked for");
        restart()
    }
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    riscv::interrupt::disable();
    let (file, line) = info
        .location()
        .map_or(("?", 0), |place| (place.file(), place.line()));
    let record = BootRecord::panic(file, line, &info.message(), found().as_ref());
    leave(record);
    defmt::error!("panic at {}", record.panic_text().unwrap_or_default());
    if critical_section::with(|cs| END_ON_PANIC.borrow(cs).get()) {
        // Plain text, for whoever expects nothing else; there is nowhere to tell of a failure.
        let text = record.panic_text().unwrap_or_default();
        let _ = writeln!(Text, "failed: panic at {text}");
        machine::exit(ExitCode::Measurement);
    }
    if record.repeated() >= PANICS_IN_A_ROW {
        let until = time::now_us() + REST_US;
        while time::now_us() < until {}
    }
    machine::reset()
}

#[unsafe(export_name = "ExceptionHandler")]
fn exception(_frame: &riscv_rt::TrapFrame) -> ! {
    let cause = riscv::register::mcause::read().code();
    let at = riscv::register::mepc::read();
    let address = riscv::register::mtval::read();
    panic!("exception {cause} at {at:#x}, address {address:#x}");
}

#[unsafe(export_name = "DefaultHandler")]
fn stray_interrupt() {
    panic!("stray interrupt {}", riscv::register::mcause::read().code());
}
