//! The boards: which pin is what, and what is used of the chip.
//!
//! One table per board, in [`s3`], [`c3`] and [`c6`]; a feature chooses.

use esp_hal::peripherals;

#[macro_use]
mod table;

#[cfg(feature = "esp32c3")]
mod c3;
#[cfg(feature = "esp32c6")]
mod c6;
#[cfg(feature = "esp32s3")]
mod s3;

#[cfg(feature = "esp32c3")]
pub(crate) use c3::*;
#[cfg(feature = "esp32c6")]
pub(crate) use c6::*;
#[cfg(feature = "esp32s3")]
pub(crate) use s3::*;

/// What is used of the chip besides its pins.
pub(crate) struct Chip {
    /// Timers of the scheduler.
    pub(crate) timers: peripherals::TIMG0<'static>,
    /// Watchdog of the main clock.
    pub(crate) watchdog: peripherals::TIMG1<'static>,
    /// Watchdog of the slow clock.
    pub(crate) rtc: peripherals::RTC_TIMER<'static>,
    /// Switches tasks.
    pub(crate) switch: peripherals::FROM_CPU_INTR0<'static>,
    /// Runs the control loop.
    pub(crate) control: peripherals::FROM_CPU_INTR2<'static>,
    /// Duty of the motors.
    pub(crate) ledc: peripherals::LEDC<'static>,
    /// Serial line of the ranger.
    pub(crate) uart: peripherals::UART1<'static>,
    /// Converter of the battery voltage.
    pub(crate) adc: peripherals::ADC1<'static>,
    /// Randomness.
    pub(crate) rng: peripherals::RNG<'static>,
    /// Flash.
    pub(crate) flash: peripherals::FLASH<'static>,
    /// Radio.
    pub(crate) wifi: peripherals::WIFI<'static>,
    /// Memory outside of the chip.
    #[cfg(feature = "esp32s3")]
    pub(crate) psram: peripherals::PSRAM<'static>,
    /// What only the chip with a camera has.
    #[cfg(feature = "esp32s3")]
    pub(crate) vision: VisionChip,
}

/// What serves vision, on the chip that has it.
#[cfg(feature = "esp32s3")]
pub(crate) struct VisionChip {
    /// Starts the second core.
    pub(crate) cores: peripherals::CPU_CTRL<'static>,
    /// Switches tasks of the second core.
    pub(crate) switch: peripherals::FROM_CPU_INTR1<'static>,
    /// Takes the pixels in.
    pub(crate) interface: peripherals::LCD_CAM<'static>,
    /// Moves them to memory.
    pub(crate) dma: peripherals::DMA_CH0<'static>,
    /// Control bus of the sensor.
    pub(crate) bus: peripherals::I2C0<'static>,
}

/// Takes what is used out of the peripherals.
macro_rules! chip {
    ($p:ident) => {
        super::Chip {
            timers: $p.TIMG0,
            watchdog: $p.TIMG1,
            rtc: $p.RTC_TIMER,
            switch: $p.FROM_CPU_INTR0,
            control: $p.FROM_CPU_INTR2,
            ledc: $p.LEDC,
            uart: $p.UART1,
            adc: $p.ADC1,
            rng: $p.RNG,
            flash: $p.FLASH,
            wifi: $p.WIFI,
            #[cfg(feature = "esp32s3")]
            psram: $p.PSRAM,
            #[cfg(feature = "esp32s3")]
            vision: super::VisionChip {
                cores: $p.CPU_CTRL,
                switch: $p.FROM_CPU_INTR1,
                interface: $p.LCD_CAM,
                dma: $p.DMA_CH0,
                bus: $p.I2C0,
            },
        }
    };
}
use chip;

/// Roles of the pins that drive the L298N.
const MOTOR_ROLES: [&str; 6] = [
    "left_enable",
    "right_enable",
    "left_in1",
    "left_in2",
    "right_in1",
    "right_in2",
];

/// Finds the pins of the L298N in a table.
const fn motor_pins(table: &[(&str, u8)]) -> [u8; 6] {
    let mut found = [u8::MAX; 6];
    let mut role = 0;
    while role < MOTOR_ROLES.len() {
        let mut row = 0;
        while row < table.len() {
            if same(table[row].0, MOTOR_ROLES[role]) {
                found[role] = table[row].1;
            }
            row += 1;
        }
        // One register holds the first 32 pins; stopping them takes one write each.
        assert!(
            found[role] < 32,
            "a motor pin is missing, or beyond the first register"
        );
        role += 1;
    }
    found
}

/// The number in `GPIO12`.
const fn gpio_number(name: &str) -> u8 {
    let name = name.as_bytes();
    let mut number = 0;
    let mut at = "GPIO".len();
    while at < name.len() {
        number = number * 10 + (name[at] - b'0');
        at += 1;
    }
    number
}

const fn same(a: &str, b: &str) -> bool {
    let (a, b) = (a.as_bytes(), b.as_bytes());
    if a.len() != b.len() {
        return false;
    }
    let mut at = 0;
    while at < a.len() {
        if a[at] != b[at] {
            return false;
        }
        at += 1;
    }
    true
}
