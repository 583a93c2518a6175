//! The detector and its memory.

use crawler_app::vision::{Lens, arena_bytes};
use crawler_board::EmbassyClock;
use crawler_board::models::ChangingEyes;
use crawler_detector::BLOB;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use static_cell::ConstStaticCell;

use super::models::Models;

/// How the camera sits, as long as nobody has measured it: a lens that sees 65° over the whole
/// width of the sensor, of which frames for vision take 288 of 400 columns (half of theirs is
/// atan(0.72 · tan 32.5°)), level, on a board that stands at the front of the chassis.
pub(crate) const LENS: Lens = Lens {
    half_view: 0.43,
    pitch: 0.0,
    height_m: 0.07,
    forward_m: 0.06,
};
/// Bytes of a frame for vision: 96 × 96 pixels of RGB565.
const FRAME_BYTES: usize = 96 * 96 * 2;
/// Bytes that a model runs in, which are what that of the program needs.
pub(super) const ARENA_BYTES: usize = match arena_bytes(BLOB) {
    Ok(bytes) => bytes,
    Err(_) => panic!("the detector is no model"),
};

/// The eyes of this board.
type Eyes = ChangingEyes<'static, 'static, CriticalSectionRawMutex, EmbassyClock>;

/// Places the detector, which looks with what `models` says. A model of the program that is none is a mistake of this
/// crate: the console says so, and the robot goes on as one that does not look. To be called once, for the memory is
/// a static.
pub(super) fn open(models: &'static Models) -> Option<Eyes> {
    static ARENA: ConstStaticCell<[i8; ARENA_BYTES]> = ConstStaticCell::new([0; ARENA_BYTES]);
    static FRAME: ConstStaticCell<[u8; FRAME_BYTES]> = ConstStaticCell::new([0; FRAME_BYTES]);
    ChangingEyes::new(models, BLOB, ARENA.take(), FRAME.take(), EmbassyClock)
        .inspect_err(|error| defmt::error!("detector: {}", defmt::Debug2Format(error)))
        .ok()
}
