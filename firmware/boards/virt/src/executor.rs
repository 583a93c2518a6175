//! Two executors: one for tasks, and one for control, which preempts them.
//!
//! The second one runs in the machine's software interrupt: waking its task raises that
//! interrupt. While control is polled other interrupts wait, which is a fraction of a millisecond.

use core::sync::atomic::Ordering;

use critical_section::Mutex;
use embassy_executor::raw::Executor;
use embassy_executor::{SendSpawner, Spawner};
use portable_atomic::AtomicBool;
use riscv::interrupt::Interrupt;
use riscv::register::mie;
use static_cell::StaticCell;

use crate::machine::MSIP;

/// What the executors hand to the pender.
const TASKS: usize = 1;
const CONTROL: usize = 2;

static WORK: AtomicBool = AtomicBool::new(false);
static TASK_EXECUTOR: StaticCell<Executor> = StaticCell::new();
static CONTROL_EXECUTOR: StaticCell<Executor> = StaticCell::new();
static CONTROL_HANDLE: Mutex<core::cell::Cell<Option<Handle>>> =
    Mutex::new(core::cell::Cell::new(None));

#[derive(Clone, Copy)]
struct Handle(&'static Executor);

// SAFETY: the handle is used for polling, by the software interrupt alone.
unsafe impl Send for Handle {}

#[unsafe(export_name = "__pender")]
fn pender(context: *mut ()) {
    if context.addr() == CONTROL {
        // SAFETY: the register that raises the software interrupt of this hart.
        unsafe { MSIP.write_volatile(1) };
    } else {
        WORK.store(true, Ordering::SeqCst);
    }
}

/// Starts the executor of control. Its tasks run as soon as interrupts are enabled.
///
/// # Panics
/// When called twice.
pub fn start_control() -> SendSpawner {
    let executor = CONTROL_EXECUTOR.init(Executor::new(core::ptr::without_provenance_mut(CONTROL)));
    let executor: &'static Executor = executor;
    critical_section::with(|cs| CONTROL_HANDLE.borrow(cs).set(Some(Handle(executor))));
    // SAFETY: the handler is there, and its executor is in place.
    unsafe { mie::set_msoft() };
    executor.spawner().make_send()
}

#[riscv_rt::core_interrupt(Interrupt::MachineSoft)]
fn machine_soft() {
    // SAFETY: the register that raises the software interrupt. Lowered first: a wake-up while
    // polling raises it again.
    unsafe { MSIP.write_volatile(0) };
    let handle = critical_section::with(|cs| CONTROL_HANDLE.borrow(cs).get());
    if let Some(Handle(executor)) = handle {
        // SAFETY: only this handler polls it, and the handler does not nest.
        unsafe { executor.poll() };
    }
}

/// Makes the executor of tasks. They run once [`run_tasks`] is called.
///
/// # Panics
/// When called twice.
pub fn prepare_tasks() -> Tasks {
    let executor = TASK_EXECUTOR.init(Executor::new(core::ptr::without_provenance_mut(TASKS)));
    Tasks(executor)
}

/// The executor of tasks.
#[derive(Clone, Copy)]
pub struct Tasks(&'static Executor);

impl core::fmt::Debug for Tasks {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("Tasks")
    }
}

impl Tasks {
    /// Spawns tasks.
    pub fn spawner(self) -> Spawner {
        self.0.spawner()
    }
}

/// Enables interrupts and runs the tasks, for good.
pub fn run_tasks(tasks: Tasks) -> ! {
    let Tasks(executor) = tasks;
    // SAFETY: handlers of all three are there; nobody is in a critical section.
    unsafe {
        mie::set_mtimer();
        mie::set_mext();
        riscv::interrupt::enable();
    }
    loop {
        // SAFETY: only this loop polls it.
        unsafe { executor.poll() };
        // With interrupts masked, so that none comes between the look and the sleep; a pending
        // one ends the sleep all the same.
        critical_section::with(|_| {
            if !WORK.swap(false, Ordering::SeqCst) {
                riscv::asm::wfi();
            }
        });
    }
}

/// Masks the software interrupt, as a fault: control is not polled any more, and nobody feeds the
/// watchdog.
pub fn hang_control() {
    // SAFETY: masking an interrupt endangers no memory.
    unsafe { mie::clear_msoft() };
}
