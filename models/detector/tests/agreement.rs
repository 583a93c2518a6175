//! The model as it is committed: the blob is the ONNX file, and another engine, which computes in
//! f32, gives the very same bytes.

use std::fs;
use std::path::Path;

use crawler_convert::{Options, convert};
use crawler_detector::{BLOB, LABELS};
use crawler_micromodel::{Model, Runner, Shape};
use tract_onnx::prelude::*;

fn onnx() -> Vec<u8> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("detector.onnx");
    fs::read(path).expect("the model is committed")
}

/// Frames of every kind: noise of several grains, ramps, black, white.
fn frames() -> Vec<Vec<u8>> {
    let mut state = 1_u64;
    let mut noise = move || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (state >> 56) as u8
    };
    let mut frames = vec![vec![0; 96 * 96 * 3], vec![255; 96 * 96 * 3]];
    for grain in [1, 2, 4, 8, 16, 32] {
        let across = 96 / grain;
        let blocks: Vec<[u8; 3]> = (0..across * across)
            .map(|_| [noise(), noise(), noise()])
            .collect();
        let pixel = |at: usize| blocks[at / 96 / grain * across + at % 96 / grain];
        frames.push((0..96 * 96).flat_map(pixel).collect());
    }
    let ramp = |at: usize| [(at % 96 * 2) as u8, (at / 96 * 2) as u8, (at / 48) as u8];
    frames.push((0..96 * 96).flat_map(ramp).collect());
    frames
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
fn another_engine_gives_the_same_bytes() {
    let model = tract_onnx::onnx()
        .model_for_read(&mut &onnx()[..])
        .and_then(InferenceModelExt::into_optimized)
        .and_then(IntoRunnable::into_runnable)
        .expect("loads");
    let own = Model::new(BLOB).expect("a model");
    let step = f32::from(own.output_exponent()).exp2();
    let mut arena = vec![0; own.arena_bytes()];
    let mut runner = Runner::new(own, &mut arena).expect("room");
    let mut values = [0_u32; 256];
    for frame in frames() {
        let planes =
            |[_, c, y, x]: [usize; 4]| (f32::from(frame[(y * 96 + x) * 3 + c]) - 128.0) / 128.0;
        let input = tract_ndarray::Array4::from_shape_fn((1, 3, 96, 96), |(n, c, y, x)| {
            planes([n, c, y, x])
        });
        let outputs = model.run(tvec!(input.into_tensor().into())).expect("runs");
        let theirs = outputs[0].to_plain_array_view::<f32>().expect("f32");
        let ours = runner.run(|row, out| {
            let pixels = &frame[row * 288..][..288];
            for (out, pixel) in out.iter_mut().zip(pixels) {
                *out = (i16::from(*pixel) - 128) as i8;
            }
        });
        for y in 0..12 {
            for x in 0..12 {
                for c in 0..4 {
                    let ours = ours[(y * 12 + x) * 4 + c];
                    assert_eq!(f32::from(ours) * step, theirs[[0, c, y, x]], "{y} {x} {c}");
                    values[ours as u8 as usize] += 1;
                }
            }
        }
    }
    let different = values.iter().filter(|count| **count > 0).count();
    assert!(
        different > 50,
        "only {different} different logits were compared"
    );
}
