//! Two engines on the same model and the same frames, in turns, on one thread: `cargo xtask bench
//! vision`.
//!
//! ```text
//! cargo bench --manifest-path models/compare/Cargo.toml --bench engines -- FRAMES.bin
//! ```
//!
//! `FRAMES.bin` has frames of 96 × 96 pixels of red, green, blue, as `cargo xtask dataset` writes
//! them. Prints lines of a name and a number.

use std::env;
use std::error::Error;
use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use crawler_detector::BLOB;
use crawler_micromodel::{Model, Runner};
use tract_onnx::prelude::*;

const SIDE: usize = 96;
const FRAME: usize = SIDE * SIDE * 3;
/// Frames that one engine computes before it is the other's turn: what else the machine does falls
/// on both.
const TURN: usize = 20;

/// A look at a frame. A closure in its place may get the vectors of the least processor alone: the compiler puts a
/// function between it and its caller.
struct Run<'r, 'm, 'a> {
    runner: &'r mut Runner<'m, 'a>,
    frame: &'r [u8],
}

impl Run<'_, '_, '_> {
    // With all vectors of the processor everything has to be inlined into who dispatches.
    #[allow(clippy::inline_always)]
    #[inline(always)]
    fn logits(self) -> Vec<i8> {
        let frame = self.frame;
        let fill = |row: usize, out: &mut [i8]| {
            let pixels = &frame[row * out.len()..][..out.len()];
            for (out, pixel) in out.iter_mut().zip(pixels) {
                *out = (i16::from(*pixel) - 128) as i8;
            }
        };
        self.runner.run(fill).to_vec()
    }
}

impl pulp::NullaryFnOnce for Run<'_, '_, '_> {
    type Output = Vec<i8>;

    #[allow(clippy::inline_always)]
    #[inline(always)]
    fn call(self) -> Vec<i8> {
        self.logits()
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    // Cargo adds `--bench`; `cargo test` runs this without a file, and nothing is to be measured.
    let file = env::args()
        .skip(1)
        .find(|argument| !argument.starts_with("--"));
    let Some(file) = file else {
        eprintln!("nothing measured: name a file with frames");
        return Ok(());
    };
    let bytes = fs::read(&file).map_err(|error| format!("{file}: {error}"))?;
    let frames: Vec<&[u8]> = bytes.chunks_exact(FRAME).collect();
    if frames.is_empty() {
        return Err(format!("{file} has no frame").into());
    }
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../detector/detector.onnx");
    let theirs = tract_onnx::onnx()
        .model_for_path(path)
        .and_then(InferenceModelExt::into_optimized)
        .and_then(IntoRunnable::into_runnable)
        .map_err(|error| error.to_string())?;
    let own = Model::new(BLOB)?;
    let (shape, step) = (own.output(), f32::from(own.output_exponent()).exp2());
    let (rows, columns, classes) = (
        usize::from(shape.height),
        usize::from(shape.width),
        usize::from(shape.channels),
    );
    let mut arena = vec![0; own.arena_bytes()];
    let mut runner = Runner::new(own, &mut arena)?;
    let mut spent = [Duration::ZERO; 2];
    let (mut equal, mut logits) = (0_u64, 0_u64);
    for turn in frames.chunks(TURN) {
        let began = Instant::now();
        let ours: Vec<Vec<i8>> = turn
            .iter()
            .map(|frame| {
                // As the simulator does.
                pulp::Arch::new().dispatch(Run {
                    runner: &mut runner,
                    frame,
                })
            })
            .collect();
        spent[0] += began.elapsed();
        let began = Instant::now();
        let mut outputs = Vec::new();
        for frame in turn {
            let at = |(_, c, y, x): (usize, usize, usize, usize)| {
                (f32::from(frame[(y * SIDE + x) * 3 + c]) - 128.0) / 128.0
            };
            let input = tract_ndarray::Array4::from_shape_fn((1, 3, SIDE, SIDE), at);
            let output = theirs
                .run(tvec!(input.into_tensor().into()))
                .map_err(|error| error.to_string())?;
            outputs.push(output);
        }
        spent[1] += began.elapsed();
        for (ours, output) in ours.iter().zip(&outputs) {
            let theirs = output[0]
                .to_plain_array_view::<f32>()
                .map_err(|error| error.to_string())?;
            for y in 0..rows {
                for x in 0..columns {
                    for c in 0..classes {
                        let logit = ours[(y * columns + x) * classes + c];
                        equal += u64::from(f32::from(logit) * step == theirs[[0, c, y, x]]);
                        logits += 1;
                    }
                }
            }
        }
    }
    let per_second = |spent: Duration| frames.len() as f64 / spent.as_secs_f64();
    println!("frames {}", frames.len());
    println!("micromodel_frames_per_s {:.0}", per_second(spent[0]));
    println!("tract_frames_per_s {:.0}", per_second(spent[1]));
    println!("logits {logits}");
    println!("equal {equal}");
    Ok(())
}
