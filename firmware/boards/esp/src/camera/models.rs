//! Memory for models that updates bring, in PSRAM.
//!
//! The board has 8 MB of it, behind the cache of the flash (data sheet of the ESP32-S3R8; octal). The program needs it for
//! nothing else. A model is 44 KB, of which each look reads every weight many times: most of that is served by the cache.

use core::slice;

use crawler_board::models::{self, BUFFERS};
use crawler_hal::ModelRegion;
use crawler_protocol::ModelName;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use esp_hal::peripherals::PSRAM;
use esp_hal::psram::{Psram, PsramConfig, PsramMode};
use static_cell::StaticCell;

use super::eyes::ARENA_BYTES;
use crate::flash::SECTOR;

/// What the model of the detector is called, as in the simulator.
const NAME: &str = "eyes";

/// The models of this board, between its two cores.
pub(crate) type Models = models::Models<'static, CriticalSectionRawMutex>;
/// What loads them.
pub(crate) type ModelLoader = models::ModelLoader<'static, 'static, CriticalSectionRawMutex>;

/// The models, and what loads them when flash and PSRAM have room. To be called once, for the memory is a static.
pub(crate) fn models(
    psram: PSRAM<'static>,
    region: Option<ModelRegion>,
) -> (&'static Models, Option<ModelLoader>) {
    static MODELS: StaticCell<Models> = StaticCell::new();

    let placed = region.and_then(|region| Some((region, buffers(psram, region)?)));
    match (placed, ModelName::new(NAME)) {
        (Some((region, buffers)), Ok(name)) => {
            let models: &'static Models = MODELS.init(Models::new(buffers));
            let loader = ModelLoader::new(models, name, region, ARENA_BYTES);
            (models, Some(loader))
        }
        _ => (
            MODELS.init(Models::new([(); BUFFERS].map(|()| &mut [][..]))),
            None,
        ),
    }
}

/// A buffer for each model in PSRAM; `None` when there is not so much of it.
fn buffers(psram: PSRAM<'static>, region: ModelRegion) -> Option<[&'static mut [u8]; BUFFERS]> {
    // The last sector of a place is its journal.
    let room = (region.places[0].length - SECTOR) as usize;
    let psram = Psram::new(
        psram,
        PsramConfig {
            mode: PsramMode::OctalSpi,
            ..PsramConfig::default()
        },
    );
    let (start, length) = psram.raw_parts();
    if length < BUFFERS * room {
        defmt::error!("PSRAM: {} bytes are too few for models", length);
        return None;
    }
    // SAFETY: so much memory is mapped there for ever; the peripheral was handed in, so nobody else has it.
    let memory: &'static mut [u8] = unsafe { slice::from_raw_parts_mut(start, BUFFERS * room) };
    let (first, rest) = memory.split_at_mut(room);
    let (second, third) = rest.split_at_mut(room);
    Some([first, second, third])
}
