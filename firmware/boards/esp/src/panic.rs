//! What happens when the program panics: the motors stop, the reason is kept, the chip restarts.

use core::panic::PanicInfo;
use core::sync::atomic::{AtomicBool, Ordering};

use crawler_board::boot_record::BootRecord;

use crate::{kept, motors, system};

/// A panic on the way down ends it.
static PANICKING: AtomicBool = AtomicBool::new(false);

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    motors::cut();
    // Not one atomic step, which the ESP32-C3 lacks: two cores that panic at once both tell.
    let again = PANICKING.load(Ordering::Relaxed);
    PANICKING.store(true, Ordering::Relaxed);
    if !again {
        let (file, line) = info
            .location()
            .map_or(("?", 0), |at| (at.file(), at.line()));
        kept::put(BootRecord::panic(file, line, &info.message(), None));
        // Last, because a log that was being written when the program panicked refuses.
        defmt::error!("panic at {=str}:{=u32}", file, line);
    }
    system::restart()
}
