//! The OV2640 of the XIAO ESP32S3 Sense, on the second core.
//!
//! The sensor's driver is `crawler_drivers::ov2640`; this is its bus, its port (see [`port`]) and
//! its place. The second core runs nothing else: looking at the port every millisecond, copying
//! pixels, and finding things in frames (see [`eyes`]) delay neither control nor the radio. Models
//! that updates bring come from the first core (see [`models`](mod@models)).
//!
//! Memory: 20 KB that the port gathers into, 16 KB for the still that travels to the broker, 18 KB
//! for a frame, what the detector runs in, and the stack of the second core. Models that updates bring
//! are in PSRAM.

mod eyes;
mod models;
mod port;

use crawler_app::ImageSlot;
use crawler_board::EmbassyClock;
use crawler_drivers::ov2640::Ov2640;
use crawler_hal::{FrameFormat, NoCamera};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::once_lock::OnceLock;
use esp_hal::Async;
use esp_hal::i2c::master::{Config, I2c};
use esp_hal::peripherals::{DMA_CH0, I2C0, LCD_CAM};
use esp_hal::system::Stack;
use esp_hal::time::Rate;
use esp_rtos::embassy::Executor;
use static_cell::{ConstStaticCell, StaticCell};

use crate::activities::Context;
use crate::board::{CameraPins, VisionChip};
pub(crate) use eyes::LENS;
use models::Models;
pub(crate) use models::{ModelLoader, models};
use port::Port;

/// Bytes for a still. The sensor is set to make 6 to 14 KB of it.
const IMAGE_BUFFER: usize = 16 * 1024;
/// Stack of the second core: an executor, one activity that is a static, the loops of the detector
/// (2.5 KB on RISC-V), and interrupts.
const STACK: usize = 8 * 1024;
/// Control bus. The sensor takes 400 kHz; the ribbon's pull-ups are weak.
const BUS_KHZ: u32 = 100;

/// The still on its way from the camera to the link.
pub(crate) type Images = ImageSlot<CriticalSectionRawMutex, &'static mut [u8]>;

type Sensor = Ov2640<I2c<'static, Async>, Port, EmbassyClock>;

/// The slot between camera and link, with its buffer.
pub(crate) fn images() -> &'static Images {
    static BUFFER: ConstStaticCell<[u8; IMAGE_BUFFER]> = ConstStaticCell::new([0; IMAGE_BUFFER]);
    static SLOT: OnceLock<Images> = OnceLock::new();
    SLOT.get_or_init(|| ImageSlot::new(BUFFER.take()))
}

/// Starts the second core with the camera activity on it. To be called once, after the scheduler
/// has been started.
///
/// What goes wrong with the sensor is the activity's to tell. Should the bus or the interface
/// refuse its configuration, a mistake of this crate, the console says so and the robot goes on
/// as one whose sensor is absent.
pub(crate) fn start(
    robot: &'static Context,
    pins: CameraPins,
    models: &'static Models,
    chip: VisionChip,
) {
    static CORE_STACK: StaticCell<Stack<STACK>> = StaticCell::new();
    let stack = CORE_STACK.init_with(Stack::new);
    let (cores, switch) = (chip.cores, chip.switch);
    let (interface, dma, bus) = (chip.interface, chip.dma, chip.bus);
    // Built on the second core, because interrupts belong to the core that asks for them.
    esp_rtos::start_second_core(cores, switch, stack, move || {
        static EXECUTOR: StaticCell<Executor> = StaticCell::new();
        EXECUTOR.init_with(Executor::new).run(move |spawner| {
            let spawned = match sensor(pins, interface, dma, bus) {
                Some(sensor) => camera(robot, sensor, models).map(|task| spawner.spawn(task)),
                None => no_camera(robot).map(|task| spawner.spawn(task)),
            };
            if spawned.is_err() {
                defmt::error!("the camera activity runs already");
            }
        });
    });
}

fn sensor(
    pins: CameraPins,
    interface: LCD_CAM<'static>,
    dma: DMA_CH0<'static>,
    bus: I2C0<'static>,
) -> Option<Sensor> {
    let config = Config::default().with_frequency(Rate::from_khz(BUS_KHZ));
    let bus = I2c::new(bus, config)
        .inspect_err(|error| defmt::error!("camera bus: {}", error))
        .ok()?
        .with_sda(pins.sda)
        .with_scl(pins.scl)
        .into_async();
    let pixels = port::Pins {
        clock: pins.clock.into(),
        pixel_clock: pins.pixel_clock.into(),
        vsync: pins.vsync.into(),
        href: pins.href.into(),
        data: [
            pins.y2.into(),
            pins.y3.into(),
            pins.y4.into(),
            pins.y5.into(),
            pins.y6.into(),
            pins.y7.into(),
            pins.y8.into(),
            pins.y9.into(),
        ],
    };
    let port = Port::new(interface, dma, pixels)
        .inspect_err(|error| defmt::error!("camera interface: {}", error))
        .ok()?;
    let format = FrameFormat::Rgb565;
    Some(Ov2640::new(bus, port, EmbassyClock, format))
}

#[embassy_executor::task]
async fn camera(robot: &'static Context, sensor: Sensor, models: &'static Models) {
    let eyes = eyes::open(models);
    match crawler_app::camera_with_eyes(robot, sensor, images(), eyes, EmbassyClock).await {}
}

#[embassy_executor::task]
async fn no_camera(robot: &'static Context) {
    match crawler_app::camera(robot, NoCamera, images(), EmbassyClock).await {}
}
