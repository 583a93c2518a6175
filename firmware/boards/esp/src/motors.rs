//! The two halves of the L298N: duty from the LEDC, direction on plain pins.

use core::convert::Infallible;

use crawler_hal::MotorPort;
use embedded_hal::pwm::{ErrorType, SetDutyCycle};
use esp_hal::gpio::{AnyPin, DriveMode, Level, Output, OutputConfig, OutputPin};
use esp_hal::ledc::channel::{self, Channel, ChannelHW, ChannelIFace};
use esp_hal::ledc::timer::{self, LSClockSource, Timer, TimerIFace};
use esp_hal::ledc::{LSGlobalClkSource, Ledc, LowSpeed};
use esp_hal::peripherals::{GPIO, LEDC};
use esp_hal::time::Rate;
use static_cell::StaticCell;

use crate::board::{self, RobotPins};

/// Fast enough that the current through a motor is smooth, slow enough that the L298N's switching
/// times of some microseconds (its data sheet, "Electrical characteristics") do not matter.
const FREQUENCY: Rate = Rate::from_khz(5);
/// 8 bits.
const RESOLUTION: timer::config::Duty = timer::config::Duty::Duty8Bit;
/// Steps of the duty: 256 is always on.
const STEPS: u16 = 256;

/// The LEDC would not do what it was asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, defmt::Format)]
pub(crate) enum PwmError {
    /// No divider of its clock gives the frequency.
    Timer,
    /// A channel refused its set-up.
    Channel,
}

/// Duty at one enable input.
pub(crate) struct Pwm(Channel<'static, LowSpeed>);

// SAFETY: what keeps `Channel` from being `Send` are its references to the registers and to the
// timer. Registers are reachable from every context and each channel writes its own; the timer lies
// in a static and is only read once its set-up is done, before the channel exists.
unsafe impl Send for Pwm {}

impl ErrorType for Pwm {
    type Error = Infallible;
}

impl SetDutyCycle for Pwm {
    fn max_duty_cycle(&self) -> u16 {
        STEPS
    }

    fn set_duty_cycle(&mut self, duty: u16) -> Result<(), Infallible> {
        self.0.set_duty_hw(u32::from(duty.min(STEPS)));
        Ok(())
    }
}

/// One motor.
pub(crate) type Motor = MotorPort<Pwm, Output<'static>>;

/// Makes every pin of the motor driver an output that is low. Comes first of all in `main`.
pub(crate) fn stand(pins: &mut RobotPins) {
    // Enables first: with them low the directions do not matter.
    low(pins.left_enable.reborrow());
    low(pins.right_enable.reborrow());
    low(pins.left_in1.reborrow());
    low(pins.left_in2.reborrow());
    low(pins.right_in1.reborrow());
    low(pins.right_in2.reborrow());
}

/// Makes a pin a low output, which it stays when its driver goes.
fn low<'a>(pin: impl OutputPin + 'a) {
    let _driver = Output::new(pin, Level::Low, OutputConfig::default());
}

/// Pins of the motor driver, for [`ports`].
pub(crate) struct MotorPins {
    /// ENA, IN1, IN2.
    pub(crate) left: [AnyPin<'static>; 3],
    /// ENB, IN3, IN4.
    pub(crate) right: [AnyPin<'static>; 3],
}

/// Sets the LEDC up and hands both motors over, standing.
///
/// # Errors
/// [`PwmError`]; the motors stand then.
pub(crate) fn ports(ledc: LEDC<'static>, pins: MotorPins) -> Result<(Motor, Motor), PwmError> {
    static TIMER: StaticCell<Timer<'static, LowSpeed>> = StaticCell::new();

    let mut ledc = Ledc::new(ledc);
    ledc.set_global_slow_clock(LSGlobalClkSource::APBClk);
    let mut timer = ledc.timer::<LowSpeed>(timer::Number::Timer0);
    timer
        .configure(timer::config::Config {
            duty: RESOLUTION,
            clock_source: LSClockSource::APBClk,
            frequency: FREQUENCY,
        })
        .map_err(|_| PwmError::Timer)?;
    let timer: &'static Timer<'static, LowSpeed> = TIMER.init(timer);
    let motor = |number, [enable, in1, in2]: [AnyPin<'static>; 3]| {
        let in1 = Output::new(in1, Level::Low, OutputConfig::default());
        let in2 = Output::new(in2, Level::Low, OutputConfig::default());
        let mut channel = ledc.channel(number, enable);
        channel
            .configure(channel::config::Config {
                timer,
                duty_pct: 0,
                drive_mode: DriveMode::PushPull,
            })
            .map_err(|_| PwmError::Channel)?;
        Ok(MotorPort {
            enable: Pwm(channel),
            in1,
            in2,
        })
    };
    let left = motor(channel::Number::Channel0, pins.left)?;
    let right = motor(channel::Number::Channel1, pins.right)?;
    Ok((left, right))
}

/// Takes every pin of the motor driver from the LEDC and pulls it low.
///
/// Takes no lock and allocates nothing: it is called when the program panics, wherever that is.
pub(crate) fn cut() {
    let gpio = GPIO::regs();
    for pin in board::MOTOR_PINS {
        let mask = 1 << pin;
        // SAFETY: the register clears the outputs whose bits are set, and takes any value.
        gpio.out_w1tc().write(|w| unsafe { w.bits(mask) });
        gpio.func_out_sel_cfg(usize::from(pin)).write(|w| {
            // SAFETY: the value is the one that stands for the plain output register.
            unsafe { w.out_sel().bits(PLAIN_OUTPUT) }
                .oen_sel()
                .set_bit()
        });
        // SAFETY: the register enables the outputs whose bits are set, and takes any value.
        gpio.enable_w1ts().write(|w| unsafe { w.bits(mask) });
    }
}

/// What `GPIO_FUNCn_OUT_SEL` holds when the pin follows `GPIO_OUT` (technical reference manuals,
/// "GPIO Matrix").
#[cfg(feature = "esp32s3")]
const PLAIN_OUTPUT: u16 = 256;
#[cfg(not(feature = "esp32s3"))]
const PLAIN_OUTPUT: u8 = 128;
