//! The camera half of LCD_CAM, and its DMA.
//!
//! The interface gives the sensor its clock, takes a byte at each PCLK while HREF is high, and
//! tells the DMA at VSYNC that a frame ends (ESP32-S3 technical reference manual, chapter "LCD and
//! Camera Controller"). The DMA fills a chain of blocks, which is longer than one frame of vision;
//! nothing is lost while somebody looks once in the time of a frame.

use crawler_drivers::ov2640::{Overrun, PixelPort};
use esp_hal::dma::DmaRxStreamBuf;
use esp_hal::dma_rx_stream_buffer;
use esp_hal::gpio::AnyPin;
use esp_hal::lcd_cam::LcdCam;
use esp_hal::lcd_cam::cam::{Camera, CameraTransfer, Config, ConfigError, EofMode, VhdeMode};
use esp_hal::peripherals::{DMA_CH0, LCD_CAM};
use esp_hal::time::Rate;

/// A frame of 96 × 96 pixels of two bytes is 18 KB.
const MEMORY: usize = 20 * 1024;
const BLOCK: usize = 1024;
/// Clock to the sensor: within 6 to 24 MHz (OV2640 data sheet, electrical characteristics), and
/// 160 MHz divided by a whole number.
const CLOCK_MHZ: u32 = 20;

/// The ribbon, but for the control bus.
pub(super) struct Pins {
    /// XMCLK, to the sensor.
    pub(super) clock: AnyPin<'static>,
    /// PCLK.
    pub(super) pixel_clock: AnyPin<'static>,
    /// VSYNC.
    pub(super) vsync: AnyPin<'static>,
    /// HREF.
    pub(super) href: AnyPin<'static>,
    /// Y2 to Y9: bits 0 to 7.
    pub(super) data: [AnyPin<'static>; 8],
}

/// The port of a sensor.
pub(super) struct Port {
    state: State,
}

enum State {
    Resting(Camera<'static>, DmaRxStreamBuf),
    Gathering(CameraTransfer<'static, DmaRxStreamBuf>),
    /// Between two of the others, inside of one call.
    Moving,
}

impl Port {
    /// Sets the interface up; the sensor has its clock from now on. To be called once, for the
    /// memory is a static.
    ///
    /// # Errors
    /// When the clock cannot be made.
    pub(super) fn new(
        interface: LCD_CAM<'static>,
        dma: DMA_CH0<'static>,
        pins: Pins,
    ) -> Result<Self, ConfigError> {
        let config = Config::default()
            .with_frequency(Rate::from_mhz(CLOCK_MHZ))
            .with_vh_de_mode(VhdeMode::De)
            .with_eof_mode(EofMode::VsyncSignal);
        let [y2, y3, y4, y5, y6, y7, y8, y9] = pins.data;
        let camera = Camera::new(LcdCam::new(interface).cam, dma, config)?
            .with_master_clock(pins.clock)
            .with_pixel_clock(pins.pixel_clock)
            .with_vsync(pins.vsync)
            .with_h_enable(pins.href)
            .with_data0(y2)
            .with_data1(y3)
            .with_data2(y4)
            .with_data3(y5)
            .with_data4(y6)
            .with_data5(y7)
            .with_data6(y8)
            .with_data7(y9);
        let memory = dma_rx_stream_buffer!(MEMORY, BLOCK);
        Ok(Self {
            state: State::Resting(camera, memory),
        })
    }
}

impl PixelPort for Port {
    fn start(&mut self) {
        self.stop();
        self.state = match core::mem::replace(&mut self.state, State::Moving) {
            State::Resting(camera, memory) => match camera.receive(memory) {
                Ok(transfer) => State::Gathering(transfer),
                // Nothing will arrive, and the driver gives up in its time.
                Err((error, camera, memory)) => {
                    defmt::error!("camera DMA: {}", error);
                    State::Resting(camera, memory)
                }
            },
            other => other,
        };
    }

    fn drain(&mut self, take: &mut dyn FnMut(&[u8], bool)) -> Result<(), Overrun> {
        let State::Gathering(transfer) = &mut self.state else {
            return Ok(());
        };
        // Asked first: what has arrived by then is still in order.
        let ended = transfer.is_done();
        // Never more than the memory holds, however fast the sensor is.
        for _ in 0..=MEMORY / BLOCK {
            let (bytes, frame_ends) = transfer.peek_until_eof();
            let count = bytes.len();
            if count == 0 && !frame_ends {
                break;
            }
            take(bytes, frame_ends);
            transfer.consume(count);
        }
        // The interface stops when the DMA has run out of blocks.
        if ended { Err(Overrun) } else { Ok(()) }
    }

    fn stop(&mut self) {
        self.state = match core::mem::replace(&mut self.state, State::Moving) {
            State::Gathering(transfer) => {
                let (camera, memory) = transfer.stop();
                State::Resting(camera, memory)
            }
            other => other,
        };
    }
}
