//! The chip itself: why it started, its watchdogs, its reset.

use core::convert::Infallible;

use crawler_board::boot_record::{BootRecord, End};
use crawler_hal::{ResetCause, System};
use esp_hal::peripherals::{RTC_TIMER, TIMG1};
use esp_hal::rtc_cntl::{Rtc, RwdtStage, RwdtStageAction, SocResetReason};
use esp_hal::time::Duration;
use esp_hal::timer::timg::{MwdtStage, MwdtStageAction, TimerGroup, Wdt};

use crate::kept;

/// How long the watchdog of the main clock waits: more than twice the erasing of a sector of worn
/// flash (400 ms), fifty periods of control.
const PATIENCE: Duration = Duration::from_millis(1_000);
/// How long the watchdog of the slow clock waits. It is there for a main clock that stands still,
/// and its own clock is off by some percent.
const LAST_PATIENCE: Duration = Duration::from_millis(3_000);

/// What is known of this start.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Start {
    cause: ResetCause,
    found: Option<BootRecord>,
}

impl defmt::Format for Start {
    fn format(&self, f: defmt::Formatter<'_>) {
        defmt::write!(f, "started after {}", defmt::Debug2Format(&self.cause));
        if let Some(text) = self.panic() {
            defmt::write!(f, ": {=str}", text);
        }
    }
}

impl Start {
    /// Asks the chip and the record of the program before, and begins a record of its own.
    pub(crate) fn now() -> Self {
        let found = kept::take();
        let told = BootRecord::cause(found.as_ref());
        let cause = match esp_hal::system::reset_reason() {
            // The reset button, too: the chip does not tell them apart.
            Some(SocResetReason::ChipPowerOn) => ResetCause::PowerOn,
            Some(reason) if is_brown_out(reason) => ResetCause::BrownOut,
            Some(reason) if is_watchdog(reason) => ResetCause::Watchdog,
            // The program before has written down why. A record that says it ran on means that
            // something else than this program reset the chip.
            Some(SocResetReason::CoreSw) => told,
            _ => ResetCause::External,
        };
        Self { cause, found }
    }

    /// Why the program started.
    pub(crate) const fn cause(&self) -> ResetCause {
        self.cause
    }

    /// How it panicked before.
    pub(crate) fn panic(&self) -> Option<&str> {
        match self.cause {
            ResetCause::Panic => self.found.as_ref().and_then(BootRecord::panic_text),
            _ => None,
        }
    }
}

const fn is_brown_out(reason: SocResetReason) -> bool {
    #[cfg(not(feature = "esp32c6"))]
    if matches!(reason, SocResetReason::CorePwrGlitch) {
        return true;
    }
    matches!(reason, SocResetReason::SysBrownOut)
}

const fn is_watchdog(reason: SocResetReason) -> bool {
    use SocResetReason as Reason;

    #[cfg(feature = "esp32s3")]
    if matches!(
        reason,
        Reason::CpuMwdt0 | Reason::CpuMwdt1 | Reason::CpuRtcWdt
    ) {
        return true;
    }
    #[cfg(not(feature = "esp32s3"))]
    if matches!(
        reason,
        Reason::Cpu0Mwdt0 | Reason::Cpu0Mwdt1 | Reason::Cpu0RtcWdt
    ) {
        return true;
    }
    matches!(
        reason,
        Reason::CoreMwdt0
            | Reason::CoreMwdt1
            | Reason::CoreRtcWdt
            | Reason::SysRtcWdt
            | Reason::SysSuperWdt
    )
}

/// Resets the chip. The motors stand from here on, and the pins let go in the reset.
pub(crate) fn restart() -> ! {
    crate::motors::cut();
    esp_hal::system::software_reset()
}

/// The chip, in the hands of control.
pub(crate) struct Chip {
    start: Start,
    watchdog: Wdt<TIMG1<'static>>,
    rtc: Rtc<'static>,
}

impl Chip {
    /// Starts both watchdogs: from here on control has to feed them.
    pub(crate) fn watched(start: Start, timer: TIMG1<'static>, rtc: RTC_TIMER<'static>) -> Self {
        let mut watchdog = TimerGroup::new(timer).wdt;
        watchdog.set_stage_action(MwdtStage::Stage0, MwdtStageAction::ResetSystem);
        watchdog.set_timeout(MwdtStage::Stage0, PATIENCE);
        watchdog.enable();
        let mut rtc = Rtc::new(rtc);
        rtc.rwdt.enable();
        rtc.rwdt
            .set_stage_action(RwdtStage::Stage0, RwdtStageAction::ResetSystem);
        rtc.rwdt.set_timeout(RwdtStage::Stage0, LAST_PATIENCE);
        Self {
            start,
            watchdog,
            rtc,
        }
    }
}

impl System for Chip {
    fn reset_cause(&self) -> ResetCause {
        self.start.cause()
    }

    fn last_panic(&self) -> Option<&str> {
        self.start.panic()
    }

    fn feed_watchdog(&mut self) {
        self.watchdog.feed();
        self.rtc.rwdt.feed();
    }

    async fn reset(&mut self) -> Infallible {
        kept::put(BootRecord::ending(End::Reset, self.start.found.as_ref()));
        restart()
    }
}
