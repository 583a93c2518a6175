//! The model as it is committed: the blob is the ONNX file, and gives the very bytes that another engine,
//! which computes in f32, gave.

mod frames;

use std::fs;
use std::path::Path;

use crawler_convert::{Options, convert};
use crawler_detector::{BLOB, LABELS};
use crawler_micromodel::{Model, Runner, Shape};
use frames::logits;

/// What `cargo xtask detector compare --write` wrote: logits of another engine.
const LOGITS: &[u8] = include_bytes!("logits.bin");

fn onnx() -> Vec<u8> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("detector.onnx");
    fs::read(path).expect("the model is committed")
}

#[test]
fn the_blob_is_the_onnx_file() {
    let converted = convert(&onnx(), &Options::default()).expect("converts");
    assert!(
        converted == BLOB,
        "`cargo xtask detector convert` writes it anew"
    );
    let model = Model::new(BLOB).expect("a model");
    assert_eq!(model.labels().collect::<Vec<_>>(), LABELS);
    let input = Shape {
        height: 96,
        width: 96,
        channels: 3,
    };
    let output = Shape {
        height: 12,
        width: 12,
        channels: 4,
    };
    assert_eq!((model.input(), model.output()), (input, output));
}

#[test]
fn it_fits_a_small_chip() {
    let model = Model::new(BLOB).expect("a model");
    assert!(
        model.bytes() <= 80 * 1024,
        "{} bytes of flash",
        model.bytes()
    );
    let arena = model.arena_bytes();
    assert!(arena <= 64 * 1024, "{arena} bytes of arena");
    // A frame of the camera has two bytes a pixel.
    assert!(
        arena + 96 * 96 * 2 <= 100 * 1024,
        "{arena} bytes beside the frame"
    );
}

#[test]
fn another_engine_gave_the_same_bytes() {
    let model = Model::new(BLOB).expect("a model");
    let mut arena = vec![0; model.arena_bytes()];
    let mut runner = Runner::new(model, &mut arena).expect("room");
    let ours: Vec<u8> = logits(&mut runner)
        .into_iter()
        .map(i8::cast_unsigned)
        .collect();
    let differs = (0..LOGITS.len()).find(|&at| ours.get(at) != LOGITS.get(at));
    assert_eq!((differs, ours.len()), (None, LOGITS.len()));
}
