//! The body of a robot whose devices are taken down, or of one that is played back.
//!
//! A program is compiled for the types of its devices. It is large, so the two share one body.

use core::convert::Infallible;

use crawler_hal::{
    Adc, Body, Camera, FrameFormat, LinkMonitor, LinkState, Millivolts, NetError, Network,
    ResetCause, System,
};
use embedded_hal::digital::{self, InputPin, OutputPin};
use embedded_hal::pwm::{self, SetDutyCycle};
use embedded_hal_async::digital::Wait;
use embedded_io_async::{ErrorType, Read, Write};
use embedded_storage_async::nor_flash::{self, NorFlash, ReadNorFlash};
use rand_pcg::Pcg32;

use crate::devices::{
    SimCamera, SimEcho, SimFlash, SimGauge, SimPin, SimPwm, SimSlots, SimSystem, SimTrigger,
    SimUart,
};
use crate::net::network::SimNetwork;
use crate::run::event_log::played::{Line, Played, PlayedFlash, PlayedSystem};
use crate::run::event_log::tap::{Tap, Wired};
use crate::sched::SimClock;

/// See the [module](self).
#[derive(Debug)]
pub(crate) struct EitherBody;

impl Body for EitherBody {
    type Clock = SimClock;
    type Pwm = Either<Wired<SimPwm>, Played>;
    type Pin = Either<Wired<SimPin>, Played>;
    type Uart = Either<Tap<SimUart>, Line>;
    type Trigger = Either<Tap<SimTrigger>, Line>;
    type Echo = Either<Tap<SimEcho>, Line>;
    type Battery = Either<Tap<SimGauge>, Line>;
    type Camera = Either<Tap<SimCamera>, Line>;
    type Flash = Either<Tap<SimFlash>, PlayedFlash>;
    // A program that is played back takes no updates.
    type Slots = SimSlots;
    type Network = Either<Tap<SimNetwork>, Line>;
    type System = Either<Tap<SimSystem>, PlayedSystem>;
    type Rng = Pcg32;
}

/// A device of a simulated body, or one that is played back. Both fail alike.
#[derive(Debug, Clone)]
pub(crate) enum Either<S, P> {
    /// A simulated one.
    Simulated(S),
    /// One that says what it said once.
    Played(P),
}

/// Does the same with whichever device there is.
macro_rules! with {
    ($either:expr, $device:ident => $work:expr) => {
        match $either {
            Either::Simulated($device) => $work,
            Either::Played($device) => $work,
        }
    };
}

impl<S: pwm::ErrorType, P> pwm::ErrorType for Either<S, P> {
    type Error = S::Error;
}

impl<S: SetDutyCycle, P: SetDutyCycle<Error = S::Error>> SetDutyCycle for Either<S, P> {
    fn max_duty_cycle(&self) -> u16 {
        with!(self, pwm => pwm.max_duty_cycle())
    }

    fn set_duty_cycle(&mut self, duty: u16) -> Result<(), S::Error> {
        with!(self, pwm => pwm.set_duty_cycle(duty))
    }
}

impl<S: digital::ErrorType, P> digital::ErrorType for Either<S, P> {
    type Error = S::Error;
}

impl<S: OutputPin, P: OutputPin<Error = S::Error>> OutputPin for Either<S, P> {
    fn set_low(&mut self) -> Result<(), S::Error> {
        with!(self, pin => pin.set_low())
    }

    fn set_high(&mut self) -> Result<(), S::Error> {
        with!(self, pin => pin.set_high())
    }
}

impl<S: InputPin, P: InputPin<Error = S::Error>> InputPin for Either<S, P> {
    fn is_high(&mut self) -> Result<bool, S::Error> {
        with!(self, pin => pin.is_high())
    }

    fn is_low(&mut self) -> Result<bool, S::Error> {
        with!(self, pin => pin.is_low())
    }
}

impl<S: Wait, P: Wait<Error = S::Error>> Wait for Either<S, P> {
    async fn wait_for_high(&mut self) -> Result<(), S::Error> {
        with!(self, pin => pin.wait_for_high().await)
    }

    async fn wait_for_low(&mut self) -> Result<(), S::Error> {
        with!(self, pin => pin.wait_for_low().await)
    }

    async fn wait_for_rising_edge(&mut self) -> Result<(), S::Error> {
        with!(self, pin => pin.wait_for_rising_edge().await)
    }

    async fn wait_for_falling_edge(&mut self) -> Result<(), S::Error> {
        with!(self, pin => pin.wait_for_falling_edge().await)
    }

    async fn wait_for_any_edge(&mut self) -> Result<(), S::Error> {
        with!(self, pin => pin.wait_for_any_edge().await)
    }
}

impl<S: ErrorType, P> ErrorType for Either<S, P> {
    type Error = S::Error;
}

impl<S: Read, P: Read<Error = S::Error>> Read for Either<S, P> {
    async fn read(&mut self, buf: &mut [u8]) -> Result<usize, S::Error> {
        with!(self, stream => stream.read(buf).await)
    }
}

impl<S: Write, P: Write<Error = S::Error>> Write for Either<S, P> {
    async fn write(&mut self, buf: &[u8]) -> Result<usize, S::Error> {
        with!(self, stream => stream.write(buf).await)
    }

    async fn flush(&mut self) -> Result<(), S::Error> {
        with!(self, stream => stream.flush().await)
    }
}

impl<S: Adc, P: Adc<Error = S::Error>> Adc for Either<S, P> {
    type Error = S::Error;

    async fn read(&mut self) -> Result<Millivolts, S::Error> {
        with!(self, adc => adc.read().await)
    }
}

impl<S: Camera, P: Camera<Error = S::Error>> Camera for Either<S, P> {
    type Error = S::Error;

    fn size(&self) -> (u16, u16) {
        with!(self, camera => camera.size())
    }

    fn format(&self) -> FrameFormat {
        with!(self, camera => camera.format())
    }

    async fn capture(&mut self, frame: &mut [u8]) -> Result<(), S::Error> {
        with!(self, camera => camera.capture(frame).await)
    }

    async fn still(&mut self, jpeg: &mut [u8]) -> Result<usize, S::Error> {
        with!(self, camera => camera.still(jpeg).await)
    }
}

impl<S: nor_flash::ErrorType, P> nor_flash::ErrorType for Either<S, P> {
    type Error = S::Error;
}

impl<S: ReadNorFlash, P: ReadNorFlash<Error = S::Error>> ReadNorFlash for Either<S, P> {
    const READ_SIZE: usize = same(S::READ_SIZE, P::READ_SIZE);

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), S::Error> {
        with!(self, flash => flash.read(offset, bytes).await)
    }

    fn capacity(&self) -> usize {
        with!(self, flash => flash.capacity())
    }
}

impl<S: NorFlash, P: NorFlash<Error = S::Error>> NorFlash for Either<S, P> {
    const WRITE_SIZE: usize = same(S::WRITE_SIZE, P::WRITE_SIZE);
    const ERASE_SIZE: usize = same(S::ERASE_SIZE, P::ERASE_SIZE);

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), S::Error> {
        with!(self, flash => flash.erase(from, to).await)
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), S::Error> {
        with!(self, flash => flash.write(offset, bytes).await)
    }
}

/// A size that both have; two sizes do not compile.
const fn same(simulated: usize, played: usize) -> usize {
    assert!(simulated == played, "one program, so one kind of flash");
    simulated
}

impl<S: System, P: System> System for Either<S, P> {
    fn reset_cause(&self) -> ResetCause {
        with!(self, system => system.reset_cause())
    }

    fn last_panic(&self) -> Option<&str> {
        with!(self, system => system.last_panic())
    }

    fn feed_watchdog(&mut self) {
        with!(self, system => system.feed_watchdog());
    }

    async fn reset(&mut self) -> Infallible {
        with!(self, system => system.reset().await)
    }
}

impl<S: LinkMonitor, P: LinkMonitor> LinkMonitor for Either<S, P> {
    fn state(&self) -> LinkState {
        with!(self, monitor => monitor.state())
    }
}

impl Network for Either<Tap<SimNetwork>, Line> {
    type Stream<'a> =
        Either<<Tap<SimNetwork> as Network>::Stream<'a>, <Line as Network>::Stream<'a>>;
    type Monitor = Either<<Tap<SimNetwork> as Network>::Monitor, <Line as Network>::Monitor>;

    fn monitor(&self) -> Self::Monitor {
        match self {
            Self::Simulated(network) => Either::Simulated(network.monitor()),
            Self::Played(network) => Either::Played(network.monitor()),
        }
    }

    async fn join(&mut self) -> Result<(), NetError> {
        with!(self, network => network.join().await)
    }

    async fn connect(&mut self, host: &str, port: u16) -> Result<Self::Stream<'_>, NetError> {
        match self {
            Self::Simulated(network) => network.connect(host, port).await.map(Either::Simulated),
            Self::Played(network) => network.connect(host, port).await.map(Either::Played),
        }
    }
}
