//! The bundle of a body's parts.

use embedded_hal::digital::{InputPin, OutputPin};
use embedded_hal::pwm::SetDutyCycle;
use embedded_hal_async::digital::Wait;
use embedded_io_async::{Read, Write};
use embedded_storage_async::nor_flash::{MultiwriteNorFlash, NorFlash};
use rand_core::Rng;

use crate::{Adc, Camera, Clock, Network, SlotPort, System};

/// One half of an L298N: the enable input on PWM, and two direction inputs.
#[derive(Debug, Clone)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MotorPort<Pwm, Pin> {
    /// ENA or ENB.
    pub enable: Pwm,
    /// IN1 or IN3.
    pub in1: Pin,
    /// IN2 or IN4.
    pub in2: Pin,
}

/// How the US-100 is wired. Its jumper decides.
#[derive(Debug)]
pub enum RangerPort<Uart, Trigger, Echo> {
    /// Jumper set: 9600 baud, 8N1.
    Uart(Uart),
    /// Jumper open: a pulse out, a pulse back.
    Pulse {
        /// The Trig input of the sensor.
        trigger: Trigger,
        /// The Echo output of the sensor.
        echo: Echo,
    },
}

/// A robot's body, as types.
///
/// A board or the simulator implements it once and hands its [`Parts`] over at boot; each part
/// then has one owner among the activities of the program.
pub trait Body {
    /// Monotonic clock.
    type Clock: Clock;
    /// Enable inputs of the motor driver.
    type Pwm: SetDutyCycle;
    /// Direction inputs of the motor driver, and the status lamp.
    type Pin: OutputPin;
    /// Serial line to the ranger.
    type Uart: Read + Write;
    /// Trigger of the ranger in pulse mode.
    type Trigger: OutputPin;
    /// Echo of the ranger in pulse mode.
    type Echo: InputPin + Wait;
    /// Battery voltage behind its divider.
    type Battery: Adc;
    /// Camera, or [`crate::NoCamera`].
    type Camera: Camera;
    /// Flash region for parameters. The body maps the region to address 0.
    type Flash: NorFlash;
    /// Flash with the two places for the program, or [`crate::NoSlots`].
    type Slots: MultiwriteNorFlash;
    /// Way to the broker.
    type Network: Network;
    /// The microcontroller.
    type System: System;
    /// Randomness: jitter of reconnects, turns of behaviours.
    type Rng: Rng;
}

/// Everything a body hands over at boot.
pub struct Parts<B: Body + ?Sized> {
    /// Monotonic clock.
    pub clock: B::Clock,
    /// Motor on the left.
    pub left: MotorPort<B::Pwm, B::Pin>,
    /// Motor on the right.
    pub right: MotorPort<B::Pwm, B::Pin>,
    /// The US-100, looking forward.
    pub ranger: RangerPort<B::Uart, B::Trigger, B::Echo>,
    /// Status lamp; high is lit.
    pub lamp: B::Pin,
    /// Battery voltage behind its divider.
    pub battery: B::Battery,
    /// Camera.
    pub camera: B::Camera,
    /// Flash region for parameters.
    pub flash: B::Flash,
    /// The two places for the program; `None` on a body that takes no updates.
    pub slots: Option<SlotPort<B::Slots>>,
    /// Way to the broker.
    pub network: B::Network,
    /// The microcontroller.
    pub system: B::System,
    /// Randomness.
    pub rng: B::Rng,
}
