//! The brown-out detector: a supply that falls too low resets the chip, rather than letting it
//! write nonsense to its flash.

/// Cycles of the slow clock that the supply has to be low: about 7 ms, so that the start of a
/// motor alone does not reset the robot.
const WAIT: u16 = 0x3FF;

/// Has the detector power the radio and the flash down and reset the chip.
///
/// Its threshold stays that of the chip's loader. Registers: technical reference manuals,
/// `RTC_CNTL_BROWN_OUT_REG` (ESP32-S3, ESP32-C3) and `LP_ANA_BOD_MODE0_CNTL_REG` (ESP32-C6).
pub(crate) fn guard() {
    #[cfg(not(feature = "esp32c6"))]
    esp_hal::peripherals::LPWR::regs()
        .brown_out()
        .modify(|_, w| {
            // SAFETY: ten bits, as the field has.
            unsafe { w.brown_out_rst_wait().bits(WAIT) }
                .brown_out_close_flash_ena()
                .set_bit()
                .brown_out_pd_rf_ena()
                .set_bit()
                .brown_out_rst_sel()
                .set_bit()
                .brown_out_rst_ena()
                .set_bit()
                .brown_out_ena()
                .set_bit()
        });
    #[cfg(feature = "esp32c6")]
    esp_hal::peripherals::LP_ANA::regs()
        .bod_mode0_cntl()
        .modify(|_, w| {
            // SAFETY: ten bits, as the field has.
            unsafe { w.bod_mode0_reset_wait().bits(WAIT) }
                .bod_mode0_close_flash_ena()
                .set_bit()
                .bod_mode0_pd_rf_ena()
                .set_bit()
                .bod_mode0_reset_sel()
                .set_bit()
                .bod_mode0_reset_ena()
                .set_bit()
                // Switches the detector on; the interrupt itself stays masked.
                .bod_mode0_intr_ena()
                .set_bit()
        });
}
