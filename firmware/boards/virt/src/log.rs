//! defmt records over the serial line, in the encoding `rzcobs`.

use core::cell::UnsafeCell;

use crawler_protocol::Level;
use critical_section::RestoreState;

use crate::machine::UART;

const LINE_CONTROL: usize = 3;
const FIFO_CONTROL: usize = 2;
const LINE_STATUS: usize = 5;
const TRANSMITTER_EMPTY: u8 = 0x20;
/// Looks at the transmitter before a byte is dropped: nobody reads at the other end, which must
/// not stop the robot.
const PATIENCE: u32 = 20_000;

#[defmt::global_logger]
struct Logger;

struct State {
    encoder: defmt::Encoder,
    restore: RestoreState,
    busy: bool,
}

struct Shared(UnsafeCell<State>);

// SAFETY: the state is touched between `acquire` and `release` alone, with interrupts off, on the
// one hart there is.
unsafe impl Sync for Shared {}

static STATE: Shared = Shared(UnsafeCell::new(State {
    encoder: defmt::Encoder::new(),
    restore: RestoreState::invalid(),
    busy: false,
}));

/// Sets the line up: 8 bits, no parity, FIFO on.
pub fn init() {
    // SAFETY: registers of the 16550.
    unsafe {
        UART.add(LINE_CONTROL).write_volatile(0x03);
        UART.add(FIFO_CONTROL).write_volatile(0x01);
    }
}

fn send(bytes: &[u8]) {
    for byte in bytes {
        for _ in 0..PATIENCE {
            // SAFETY: a register of the 16550.
            let status = unsafe { UART.add(LINE_STATUS).read_volatile() };
            if status & TRANSMITTER_EMPTY != 0 {
                // SAFETY: as above.
                unsafe { UART.write_volatile(*byte) };
                break;
            }
        }
    }
}

/// Plain text on the same line, for programs that log nothing.
#[derive(Debug)]
pub struct Text;

impl core::fmt::Write for Text {
    fn write_str(&mut self, text: &str) -> core::fmt::Result {
        send(text.as_bytes());
        Ok(())
    }
}

// SAFETY: `acquire` masks interrupts until `release`, so there is one context at a time.
unsafe impl defmt::Logger for Logger {
    fn acquire() {
        // SAFETY: released in `release`, which defmt calls after every `acquire`.
        let restore = unsafe { critical_section::acquire() };
        // SAFETY: interrupts are off; see `Shared`.
        let state = unsafe { &mut *STATE.0.get() };
        // A record within a record is a mistake of whoever formats; what is under way is given up.
        if state.busy {
            state.encoder.end_frame(send);
        } else {
            state.restore = restore;
        }
        state.busy = true;
        state.encoder.start_frame(send);
    }

    unsafe fn flush() {}

    unsafe fn release() {
        // SAFETY: interrupts are off since `acquire`.
        let state = unsafe { &mut *STATE.0.get() };
        state.encoder.end_frame(send);
        state.busy = false;
        let restore = state.restore;
        // SAFETY: the state that `acquire` got.
        unsafe { critical_section::release(restore) };
    }

    unsafe fn write(bytes: &[u8]) {
        // SAFETY: interrupts are off since `acquire`.
        let state = unsafe { &mut *STATE.0.get() };
        state.encoder.write(bytes, send);
    }
}

defmt::timestamp!("{=u64:us}", crate::time::now_us());

/// A log record of the robot program, as it goes to the broker.
pub fn echo(level: Level, event: &str, text: core::fmt::Arguments<'_>) {
    let text = defmt::Display2Format(&text);
    match level {
        Level::Error => defmt::error!("{=str}: {}", event, text),
        Level::Warn => defmt::warn!("{=str}: {}", event, text),
        Level::Info => defmt::info!("{=str}: {}", event, text),
        Level::Debug => defmt::debug!("{=str}: {}", event, text),
    }
}
