//! Time driver over the machine timer, and the watchdog it carries.
//!
//! The machine has no watchdog. The timer interrupt stands in for one: it looks every
//! [`LOOK_EVERY_US`] whether control fed the watchdog since, and resets the machine after
//! [`PATIENCE`] looks in a row without. Looks are counted rather than time, so that an emulator
//! that was held up by its host for seconds is not taken for a program that hangs. A program that
//! hangs with interrupts masked is not found.

use core::cell::{Cell, RefCell};
use core::task::Waker;

use critical_section::{CriticalSection, Mutex};
use embassy_time_driver::Driver;
use embassy_time_queue_utils::Queue;
use riscv::interrupt::Interrupt;

use crate::machine::{MTIME, MTIMECMP};

/// Ticks of the machine timer in a microsecond.
const TICKS: u64 = 10;
/// Microseconds from one look at the watchdog to the next.
pub const LOOK_EVERY_US: u64 = 250_000;
/// Looks without feeding, after which the machine is reset: two seconds.
pub const PATIENCE: u8 = 8;

struct Timer {
    queue: Mutex<RefCell<Queue>>,
    alarm_us: Mutex<Cell<u64>>,
    watchdog: Mutex<Cell<Watchdog>>,
    /// When the timer started: this machine's clock is not reset with it.
    boot_ticks: Mutex<Cell<u64>>,
}

/// `None` until it is fed for the first time.
#[derive(Clone, Copy, Default)]
struct Watchdog {
    next_look_us: Option<u64>,
    unfed: u8,
}

embassy_time_driver::time_driver_impl!(static TIMER: Timer = Timer {
    queue: Mutex::new(RefCell::new(Queue::new())),
    alarm_us: Mutex::new(Cell::new(u64::MAX)),
    watchdog: Mutex::new(Cell::new(Watchdog { next_look_us: None, unfed: 0 })),
    boot_ticks: Mutex::new(Cell::new(0)),
});

fn ticks() -> u64 {
    loop {
        // SAFETY: registers of the timer. The high word is read twice, in case the low one
        // overflows in between.
        let (high, low, again) = unsafe {
            (
                MTIME.add(1).read_volatile(),
                MTIME.read_volatile(),
                MTIME.add(1).read_volatile(),
            )
        };
        if high == again {
            return u64::from(high) << 32 | u64::from(low);
        }
    }
}

fn compare(at: u64) {
    // SAFETY: registers of the timer. The high word is out of reach while the low one changes, so
    // that no moment in between fires.
    unsafe {
        MTIMECMP.add(1).write_volatile(u32::MAX);
        MTIMECMP.write_volatile(at as u32);
        MTIMECMP.add(1).write_volatile((at >> 32) as u32);
    }
}

/// Microseconds since boot.
pub fn now_us() -> u64 {
    let boot = critical_section::with(|cs| TIMER.boot_ticks.borrow(cs).get());
    (ticks() - boot) / TICKS
}

/// The counter itself, which goes on over resets.
pub fn raw_ticks() -> u64 {
    ticks()
}

/// Starts counting from zero.
pub fn init() {
    compare(u64::MAX);
    critical_section::with(|cs| TIMER.boot_ticks.borrow(cs).set(ticks()));
}

/// Tells the watchdog that the control loop is healthy. The first time arms it.
pub fn feed() {
    critical_section::with(|cs| {
        let cell = TIMER.watchdog.borrow(cs);
        let next_look_us = cell.get().next_look_us;
        let armed = next_look_us.is_some();
        cell.set(Watchdog {
            next_look_us: Some(next_look_us.unwrap_or_else(|| now_us() + LOOK_EVERY_US)),
            unfed: 0,
        });
        if !armed {
            TIMER.rearm(cs);
        }
    });
}

impl Timer {
    /// Sets the compare register to whatever comes first.
    fn rearm(&self, cs: CriticalSection<'_>) {
        let look = self.watchdog.borrow(cs).get().next_look_us;
        let at = self.alarm_us.borrow(cs).get().min(look.unwrap_or(u64::MAX));
        let boot = self.boot_ticks.borrow(cs).get();
        compare(at.saturating_mul(TICKS).saturating_add(boot));
    }

    fn serve(&self, cs: CriticalSection<'_>) {
        let now = now_us();
        let next = self.queue.borrow_ref_mut(cs).next_expiration(now);
        self.alarm_us.borrow(cs).set(next);
    }
}

impl Driver for Timer {
    fn now(&self) -> u64 {
        now_us()
    }

    fn schedule_wake(&self, at: u64, waker: &Waker) {
        critical_section::with(|cs| {
            if self.queue.borrow_ref_mut(cs).schedule_wake(at, waker) {
                self.serve(cs);
                self.rearm(cs);
            }
        });
    }
}

#[riscv_rt::core_interrupt(Interrupt::MachineTimer)]
fn machine_timer() {
    let starved = critical_section::with(|cs| {
        TIMER.serve(cs);
        let cell = TIMER.watchdog.borrow(cs);
        let mut watchdog = cell.get();
        let now = now_us();
        if watchdog.next_look_us.is_some_and(|at| at <= now) {
            // From now on, not from when it was due: see the module.
            watchdog.next_look_us = Some(now + LOOK_EVERY_US);
            watchdog.unfed += 1;
            cell.set(watchdog);
        }
        TIMER.rearm(cs);
        watchdog.unfed > PATIENCE
    });
    if starved {
        crate::system::starve();
    }
}
