//! The devices of a simulated robot, on the far side of the traits of `crawler-hal`.
//!
//! They are stricter than hardware: what a data sheet forbids fails or is recorded here.
//!
//! Reading order: `world` is a world whose robots have devices; `ports` is what those share with
//! it; `boot` starts a program from the flash; `range_sensor`, `meter` and `motor` are the physics of sensors and drives, the others what a program
//! holds in its hands; `broken` breaks them; `hash` and `checkpoint` are for what comes after.

mod boot;
mod broken;
mod camera;
#[cfg(feature = "live")]
mod checkpoint;
mod flash;
mod gauge;
mod hash;
mod meter;
mod motor;
mod ports;
mod range_sensor;
mod sonar;
mod system;
#[cfg(test)]
mod tests;
mod trigger;
mod uart;
mod world;

use core::marker::PhantomData;
use std::rc::Rc;

use crawler_hal::{Body, Duration, MotorPort, Network, Parts, RangerPort, SlotPort};
use rand_pcg::Pcg32;

pub use boot::Started;
#[cfg(test)]
pub(crate) use boot::install;
pub use camera::{CAMERA_SIDE, LensError, STILL_SIZE, SimCamera};
#[cfg(test)]
pub(crate) use flash::Operation;
pub use flash::{
    Chip, ERASE_BYTES, FlashError, MODELS, OTADATA_AT, POLICIES, SLOTS, SimFlash, SimSlots,
    WRITE_BYTES,
};
pub use gauge::{GaugeError, SimGauge};
pub use motor::{DutyError, MAX_DUTY, SimPin, SimPwm};
pub use ports::BodyEvent;
pub(crate) use system::Resetter;
pub use system::SimSystem;
pub use trigger::{SimEcho, SimTrigger};
pub use uart::{SimUart, UartError};
pub use world::World;

#[cfg(feature = "live")]
pub(crate) use checkpoint::WorldCheckpoint;
#[cfg(feature = "live")]
pub(crate) use flash::Contents;
pub(crate) use flash::Pages;
pub(crate) use meter::Meter;
pub(crate) use ports::senses;
pub(crate) use range_sensor::RangeSensor;
pub(crate) use sonar::Sonar;
pub(crate) use trigger::BURST;
pub(crate) use uart::BYTE_TIME;

use crate::sched::SimClock;
use crate::world::{Purpose, RobotIndex, Wiring, stream, uniform};
use motor::{Line, Side};
use ports::{Ports, Wire};

/// A simulated body whose way to the network is `N`.
#[derive(Debug)]
pub struct SimBody<N>(PhantomData<N>);

impl<N: Network> Body for SimBody<N> {
    type Clock = SimClock;
    type Pwm = SimPwm;
    type Pin = SimPin;
    type Uart = SimUart;
    type Trigger = SimTrigger;
    type Echo = SimEcho;
    type Battery = SimGauge;
    type Camera = SimCamera;
    type Flash = SimFlash;
    type Slots = SimSlots;
    type Network = N;
    type System = SimSystem;
    type Rng = Pcg32;
}

/// What a board without a chip of Espressif says of its chip.
const NO_CHIP: u16 = u16::MAX;

/// How long after its boot a robot begins to measure, at most `latest_ms` milliseconds; `seed` is
/// that of the boot.
pub(crate) fn ranger_after(seed: u64, robot: RobotIndex, latest_ms: f32) -> Duration {
    let share = uniform(&mut stream(seed, robot.get(), Purpose::Start));
    Duration::from_micros((share * latest_ms * 1e3) as u64)
}

/// Everything a simulated body hands over at boot but its network.
#[derive(Debug)]
pub struct BodyParts {
    /// Monotonic clock, zero at this boot.
    pub clock: SimClock,
    /// Motor on the left.
    pub left: MotorPort<SimPwm, SimPin>,
    /// Motor on the right.
    pub right: MotorPort<SimPwm, SimPin>,
    /// The US-100, looking forward.
    pub ranger: RangerPort<SimUart, SimTrigger, SimEcho>,
    /// Status lamp; high is lit.
    pub lamp: SimPin,
    /// Battery voltage behind its divider.
    pub battery: SimGauge,
    /// Camera.
    pub camera: SimCamera,
    /// Flash region for parameters.
    pub flash: SimFlash,
    /// The two slots for programs.
    pub slots: SlotPort<SimSlots>,
    /// The program that was started from them.
    pub started: Started,
    /// The microcontroller.
    pub system: SimSystem,
    /// How long after the boot the ranger is asked first: programs do not start in step.
    pub ranger_after: Duration,
    /// Randomness of the program. Each boot of a robot has its own stream.
    pub rng: Pcg32,
}

impl BodyParts {
    pub(crate) fn new(ports: &Rc<Ports>, started: Started) -> Self {
        let wire = Wire::new(ports);
        let motor = |side| MotorPort {
            enable: SimPwm::new(wire.clone(), side),
            in1: SimPin::new(wire.clone(), Line::In1(side)),
            in2: SimPin::new(wire.clone(), Line::In2(side)),
        };
        let ranger = match ports.wiring {
            Wiring::Uart => RangerPort::Uart(SimUart::new(wire.clone())),
            Wiring::Pulse => RangerPort::Pulse {
                trigger: SimTrigger::new(wire.clone()),
                echo: SimEcho::new(wire.clone()),
            },
        };
        // The boot takes part, so that a robot that keeps resetting does not repeat its jitter.
        let seed = ports.shared.seed ^ u64::from(ports.life.get()) << 32;
        let latest_ms = ports
            .shared
            .space
            .borrow()
            .parameters
            .spread
            .ranger_start_ms;
        Self {
            ranger_after: ranger_after(seed, ports.robot, latest_ms),
            clock: ports.shared.clock.boot_now(),
            left: motor(Side::Left),
            right: motor(Side::Right),
            ranger,
            lamp: SimPin::new(wire.clone(), Line::Lamp),
            battery: SimGauge::new(wire.clone()),
            camera: SimCamera::new(wire.clone()),
            flash: SimFlash::of_body(&wire),
            slots: SlotPort {
                flash: SimSlots::of_body(&wire),
                otadata: OTADATA_AT,
                slots: SLOTS,
                running: started.running,
                chip: NO_CHIP,
            },
            started,
            system: SimSystem::new(wire.clone()),
            rng: stream(seed, ports.robot.get(), Purpose::Program),
        }
    }

    /// The whole body, with `network` as its way out.
    pub fn with_network<N: Network>(self, network: N) -> Parts<SimBody<N>> {
        Parts {
            clock: self.clock,
            left: self.left,
            right: self.right,
            ranger: self.ranger,
            lamp: self.lamp,
            battery: self.battery,
            camera: self.camera,
            flash: self.flash,
            slots: Some(self.slots),
            network,
            system: self.system,
            rng: self.rng,
        }
    }
}
