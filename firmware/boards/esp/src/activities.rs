//! The activities of the program, each as a task of an executor.
//!
//! Control runs in an interrupt of its own, above everything else; the rest shares the main
//! thread. On the chip with two cores the camera has the second one (see `vision`).

use crawler_app::Robot;
use crawler_app::policy::SPREAD;
#[cfg(feature = "esp32s3")]
use crawler_app::policy::Shelf;
#[cfg(feature = "esp32s3")]
use crawler_app::{Inline, PolicyHost};
use crawler_board::EmbassyClock;
#[cfg(feature = "esp32s3")]
use crawler_hal::ModelRegion;
use crawler_hal::SlotPort;
use crawler_stack::OnOwnStack;
use embassy_executor::{SendSpawner, SpawnError, Spawner};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use esp_hal::interrupt::Priority;
use esp_hal::peripherals::FROM_CPU_INTR2;
use esp_hal::rng::Rng;
use esp_rtos::embassy::InterruptExecutor;
use rand_pcg::Pcg32;
use static_cell::StaticCell;

use crate::battery::Battery;
#[cfg(feature = "esp32s3")]
use crate::camera::ModelLoader;
use crate::flash::Region;
use crate::lamp::Lamp;
use crate::motors::Motor;
use crate::ranger;
use crate::system::Chip;
use crate::update::Updates;

/// The context that all activities share, across interrupts and cores.
pub(crate) type Context = Robot<CriticalSectionRawMutex>;

/// The place of a policy that a release has brought.
#[cfg(feature = "esp32s3")]
static SHELF: Shelf<CriticalSectionRawMutex, Inline> = Shelf::new();

/// Above the scheduler and the drivers, which have priority 1.
const CONTROL_PRIORITY: Priority = Priority::Priority3;

/// Starts the executor of control.
pub(crate) fn control_executor(interrupt: FROM_CPU_INTR2<'static>) -> SendSpawner {
    static EXECUTOR: StaticCell<InterruptExecutor<2>> = StaticCell::new();
    EXECUTOR
        .init(InterruptExecutor::new(interrupt))
        .start(CONTROL_PRIORITY)
}

/// What the activities besides control and the link own.
pub(crate) struct Parts {
    /// The ranger.
    pub(crate) ranger: ranger::Port,
    /// The battery's converter.
    pub(crate) battery: Battery,
    /// The lamp.
    pub(crate) lamp: Lamp,
    /// Where parameters are kept.
    pub(crate) parameters: Region,
    /// The slots for programs, where the partition table has them.
    pub(crate) slots: Option<SlotPort<Region>>,
    /// What the update activity and the link share.
    pub(crate) updates: &'static Updates,
    /// What loads models for the detector, where there is room for them.
    #[cfg(feature = "esp32s3")]
    pub(crate) models: Option<ModelLoader>,
    /// Where policies are, where there is room for them.
    #[cfg(feature = "esp32s3")]
    pub(crate) policies: Option<ModelRegion>,
    /// Randomness of the activities of updates and policies.
    pub(crate) rng: Rng,
}

/// Spawns control.
///
/// # Errors
/// When it runs already.
pub(crate) fn spawn_control(
    spawner: SendSpawner,
    robot: &'static Context,
    motors: (Motor, Motor),
    chip: Chip,
    rng: Pcg32,
) -> Result<(), SpawnError> {
    spawner.spawn(control(robot, motors.0, motors.1, chip, rng)?);
    Ok(())
}

/// Spawns what shares the main thread, but for the link.
///
/// # Errors
/// When one of them runs already.
pub(crate) fn spawn(
    spawner: Spawner,
    robot: &'static Context,
    parts: Parts,
) -> Result<(), SpawnError> {
    spawner.spawn(sense(robot, parts.ranger)?);
    spawner.spawn(power(robot, parts.battery)?);
    spawner.spawn(lamp(robot, parts.lamp)?);
    spawner.spawn(store(robot, parts.parameters)?);
    spawner.spawn(decide(robot, parts.rng)?);
    if let Some(slots) = parts.slots {
        #[cfg(feature = "esp32s3")]
        spawner.spawn(update_with_models(
            robot,
            parts.updates,
            slots,
            (parts.models, parts.policies),
            parts.rng,
        )?);
        #[cfg(not(feature = "esp32s3"))]
        spawner.spawn(update(robot, parts.updates, slots, parts.rng)?);
    }
    Ok(())
}

#[embassy_executor::task]
async fn control(robot: &'static Context, left: Motor, right: Motor, chip: Chip, rng: Pcg32) {
    let control = crawler_app::control(robot, left, right, chip, rng, EmbassyClock);
    match OnOwnStack::new(control).await {}
}

#[embassy_executor::task]
async fn sense(robot: &'static Context, ranger: ranger::Port) {
    match crawler_app::sense(robot, ranger, EmbassyClock).await {}
}

#[embassy_executor::task]
async fn power(robot: &'static Context, battery: Battery) {
    match crawler_app::power(robot, battery, EmbassyClock).await {}
}

#[embassy_executor::task]
async fn lamp(robot: &'static Context, lamp: Lamp) {
    match crawler_app::lamp(robot, lamp, EmbassyClock).await {}
}

#[embassy_executor::task]
async fn store(robot: &'static Context, flash: Region) {
    match crawler_app::store(robot, flash, EmbassyClock).await {}
}

#[embassy_executor::task]
async fn decide(robot: &'static Context, rng: Rng) {
    #[cfg(feature = "esp32s3")]
    match crawler_app::decide_with_shelf(robot, SPREAD, &SHELF, rng).await {}
    #[cfg(not(feature = "esp32s3"))]
    match crawler_app::decide(robot, SPREAD, rng).await {}
}

#[cfg(not(feature = "esp32s3"))]
#[embassy_executor::task]
async fn update(
    robot: &'static Context,
    updates: &'static Updates,
    slots: SlotPort<Region>,
    rng: Rng,
) {
    match crawler_app::update(robot, updates, slots, rng, EmbassyClock).await {}
}

#[cfg(feature = "esp32s3")]
#[embassy_executor::task]
async fn update_with_models(
    robot: &'static Context,
    updates: &'static Updates,
    slots: SlotPort<Region>,
    places: (Option<ModelLoader>, Option<ModelRegion>),
    rng: Rng,
) {
    let (models, policies) = places;
    let update = crawler_app::update_with_policies_held::<Inline, _, _, _, _, _, Inline, 2>;
    let models = (models, PolicyHost::new(&SHELF, policies));
    match update(robot, updates, slots, models, rng, EmbassyClock).await {}
}
