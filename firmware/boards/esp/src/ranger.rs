//! The US-100 on its four-pin connector: both ways of talking use the same two pins.

use crawler_board::settings::RangerMode;
use crawler_hal::RangerPort;
use esp_hal::Async;
use esp_hal::gpio::{AnyPin, Input, InputConfig, Level, Output, OutputConfig, Pull};
use esp_hal::peripherals::UART1;
use esp_hal::uart::{Config, ConfigError, DataBits, Parity, RxConfig, StopBits, Uart};

/// The ranger as it is wired.
pub(crate) type Port = RangerPort<Uart<'static, Async>, Output<'static>, Input<'static>>;

/// The port for `mode`: `trigger` leads to Trig/TX of the sensor, `echo` to Echo/RX.
///
/// # Errors
/// When the UART cannot make 9600 baud of its clock, which is a mistake of the program.
pub(crate) fn port(
    mode: RangerMode,
    uart: UART1<'static>,
    trigger: AnyPin<'static>,
    echo: AnyPin<'static>,
) -> Result<Port, ConfigError> {
    match mode {
        RangerMode::Uart => {
            // US-100 data sheet: 9600 baud, 8 data bits, no parity, 1 stop bit.
            let config = Config::default()
                .with_baudrate(9_600)
                .with_data_bits(DataBits::_8)
                .with_parity(Parity::None)
                .with_stop_bits(StopBits::_1)
                // A reply has two bytes: each wakes the task, rather than a silence after them.
                .with_rx(RxConfig::default().with_fifo_full_threshold(1));
            let uart = Uart::new(uart, config)?.with_tx(trigger).with_rx(echo);
            Ok(RangerPort::Uart(uart.into_async()))
        }
        RangerMode::Pulse => Ok(RangerPort::Pulse {
            trigger: Output::new(trigger, Level::Low, OutputConfig::default()),
            // An absent sensor leaves the line low: no echo, rather than noise.
            echo: Input::new(echo, InputConfig::default().with_pull(Pull::Down)),
        }),
    }
}
