//! Terracrawler on an ESP32: ESP32-S3 (XIAO Sense), ESP32-C3 and ESP32-C6.
//!
//! Wires the pins of a board to the robot program, and nothing else. `board` holds the pin tables;
//! each of the other modules is one part of the body. The motors stand from the first lines of
//! `main` on, and again when the program panics.
#![no_std]
#![no_main]

mod activities;
#[cfg(feature = "esp32c6")]
mod antenna;
mod battery;
mod board;
mod brownout;
mod button;
#[cfg(feature = "esp32s3")]
mod camera;
mod flash;
mod identity;
mod kept;
mod lamp;
mod log;
mod motors;
mod panic;
mod randomness;
mod ranger;
mod system;
mod update;
mod wifi;

use crawler_app::{Config, Robot};
use crawler_board::settings::{Kept, RangerMode, Vault};
use embassy_executor::Spawner;
use esp_hal::clock::CpuClock;
use esp_hal::timer::timg::TimerGroup;
use esp_println as _;
use static_cell::StaticCell;

use crate::activities::Context;
use crate::battery::Battery;
use crate::board::Board;
use crate::lamp::Lamp;

esp_bootloader_esp_idf::esp_app_desc!();

#[esp_rtos::main]
async fn main(spawner: Spawner) {
    let peripherals = esp_hal::init(esp_hal::Config::default().with_cpu_clock(CpuClock::max()));
    let mut board = Board::new(peripherals);
    motors::stand(&mut board.robot);
    let start = system::Start::now();
    brownout::guard();
    let Board {
        robot: pins,
        mut chip,
        #[cfg(feature = "esp32s3")]
        camera,
        #[cfg(feature = "esp32c6")]
        antenna,
    } = board;
    let mut regions = flash::regions(chip.flash);
    update::guard(regions.slots.as_mut(), start).await;
    give_heap();
    #[cfg(feature = "esp32c6")]
    antenna::choose(antenna);
    esp_rtos::start(TimerGroup::new(chip.timers).timer0, chip.switch);
    defmt::info!(
        "{=str} {=str}, {}",
        board::ID,
        env!("CARGO_PKG_VERSION"),
        start
    );

    let rng = randomness::control(chip.rng.reborrow(), chip.adc.reborrow());
    let mut vault = Vault::new(regions.settings);
    let kept = vault.load().await.unwrap_or_else(|error| {
        defmt::error!("settings: {}", defmt::Display2Format(&error));
        Kept::default()
    });
    let settings = kept.settings.as_ref();
    let robot = context(identity::config(settings));

    let motor_pins = motors::MotorPins {
        left: [
            pins.left_enable.into(),
            pins.left_in1.into(),
            pins.left_in2.into(),
        ],
        right: [
            pins.right_enable.into(),
            pins.right_in1.into(),
            pins.right_in2.into(),
        ],
    };
    let motors = expect(motors::ports(chip.ledc, motor_pins), "motor PWM");
    let control = activities::control_executor(chip.control);
    let watched = system::Chip::watched(start, chip.watchdog, chip.rtc);
    expect(
        activities::spawn_control(control, robot, motors, watched, rng),
        "control",
    );
    let updates = update::updates();
    #[cfg(feature = "esp32s3")]
    let (models, loader) = camera::models(chip.psram, regions.models);
    let mode = settings.map_or(RangerMode::default(), |settings| settings.ranger);
    let (trigger, echo) = (pins.ranger_tx.into(), pins.ranger_rx.into());
    let parts = activities::Parts {
        ranger: expect(ranger::port(mode, chip.uart, trigger, echo), "ranger UART"),
        battery: Battery::new(chip.adc, pins.battery),
        lamp: Lamp::new(pins.lamp),
        parameters: regions.parameters,
        slots: regions.slots,
        updates,
        #[cfg(feature = "esp32s3")]
        models: loader,
        #[cfg(feature = "esp32s3")]
        policies: regions.policies,
        rng: esp_hal::rng::Rng::new(),
    };
    expect(activities::spawn(spawner, robot, parts), "activities");
    #[cfg(feature = "esp32s3")]
    camera::start(robot, camera, models, chip.vision);
    let asked = button::held(pins.button.into()).await;
    let radio = wifi::Start {
        wifi: chip.wifi,
        robot,
        updates,
        vault,
        kept,
        asked,
    };
    wifi::run(spawner, radio).await;
}

/// Gives the radio its heap: its buffers and the stacks of its tasks. Nothing else allocates.
fn give_heap() {
    // What the loader has left behind.
    esp_alloc::heap_allocator!(#[esp_hal::ram(reclaimed)] size: 64 * 1024);
    esp_alloc::heap_allocator!(size: 36 * 1024);
}

/// Places the context that all activities share.
fn context(config: Config) -> &'static Context {
    static ROBOT: StaticCell<Context> = StaticCell::new();
    ROBOT.init_with(|| {
        let mut robot = Robot::new(config);
        robot.set_echo(log::echo);
        robot
    })
}

/// What can only fail by a mistake of this crate: it stops the robot, and says so.
fn expect<T, E: core::fmt::Debug>(result: Result<T, E>, what: &str) -> T {
    match result {
        Ok(value) => value,
        Err(error) => panic!("{what}: {error:?}"),
    }
}
