//! The detector and its memory.

use crawler_app::vision::{Detector, Lens, OwnEyes, arena_bytes};
use crawler_detector::BLOB;
use static_cell::ConstStaticCell;

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
/// Bytes that the model runs in.
const ARENA_BYTES: usize = match arena_bytes(BLOB) {
    Ok(bytes) => bytes,
    Err(_) => panic!("the detector is no model"),
};

/// Places the detector. A model that is none is a mistake of this crate: the console says so, and
/// the robot goes on as one that does not look. To be called once, for the memory is a static.
pub(super) fn open() -> Option<OwnEyes<'static, 'static>> {
    static ARENA: ConstStaticCell<[i8; ARENA_BYTES]> = ConstStaticCell::new([0; ARENA_BYTES]);
    static FRAME: ConstStaticCell<[u8; FRAME_BYTES]> = ConstStaticCell::new([0; FRAME_BYTES]);
    let finder = Detector::new(BLOB)
        .and_then(|detector| detector.run_in(ARENA.take()))
        .inspect_err(|error| defmt::error!("detector: {}", defmt::Debug2Format(error)))
        .ok()?;
    Some(OwnEyes::new(finder, FRAME.take()))
}
