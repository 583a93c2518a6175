//! Terracrawler on an ESP32.
#![no_std]
#![no_main]

use esp_println as _;

#[cfg(feature = "esp32s3")]
mod camera;
mod wifi;

esp_bootloader_esp_idf::esp_app_desc!();

#[esp_rtos::main]
async fn main(_spawner: embassy_executor::Spawner) {
    let peripherals = esp_hal::init(esp_hal::Config::default());
    esp_alloc::heap_allocator!(size: 72 * 1024);
    let timers = esp_hal::timer::timg::TimerGroup::new(peripherals.TIMG0);
    esp_rtos::start(timers.timer0, peripherals.FROM_CPU_INTR0);
    defmt::info!("terracrawler {=str}", env!("CARGO_PKG_VERSION"));
}

#[panic_handler]
fn panic(_info: &core::panic::PanicInfo<'_>) -> ! {
    esp_hal::system::software_reset()
}
