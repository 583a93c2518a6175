//! What the detector sees in the frames of `crawler_board::sight`, on this machine: what an
//! emulated board has to see as well (`cargo xtask counts`).

use crawler_app::vision::Detector;
use crawler_board::sight::{BYTES, Frame, MADE, look};
use crawler_detector::{BLOB, FRAMES};
use embassy_futures::block_on;

fn main() {
    let detector = Detector::new(BLOB).expect("the model is a detector");
    let mut arena = vec![0; detector.arena_bytes()];
    let mut finder = detector.run_in(&mut arena).expect("as long as it asks for");
    let taken = FRAMES.iter().map(|(name, bytes)| Frame::Taken(name, bytes));
    let mut bytes: Box<[u8; BYTES]> = vec![0; BYTES].try_into().expect("as many");
    for frame in MADE.into_iter().chain(taken) {
        frame.write(&mut bytes);
        let sight =
            block_on(look(&mut finder, frame.name(), &bytes[..])).expect("a frame's length");
        println!("{sight}");
    }
}
