//! The logits that another engine, which computes in f32, gives for the frames that the detector's tests
//! look at, held against those of ours, and against the file that ours are held against in every test.
//!
//! `cargo xtask detector compare`; with `--write` the file is written anew.

#[path = "../../detector/tests/frames/mod.rs"]
mod frames;

use std::env;
use std::error::Error;
use std::fs;
use std::path::Path;

use crawler_detector::BLOB;
use crawler_micromodel::{Model, Runner};
use frames::{SIDE, frames, logits};
use tract_onnx::prelude::*;

/// Pixels of a cell's side.
const CELL: usize = 8;
/// Classes of a cell.
const CLASSES: usize = 4;
/// No more different values than these would compare little.
const DIFFERENT: usize = 50;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let write = match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        [] => false,
        ["--write"] => true,
        _ => return Err("cargo xtask detector compare [--write]".into()),
    };
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../detector");
    let theirs = theirs(&folder.join("detector.onnx"))?;
    let ours = ours()?;
    if let Some(at) = (0..theirs.len()).find(|&at| ours.get(at) != theirs.get(at)) {
        return Err(format!(
            "byte {at}: ours is {:?}, theirs {}",
            ours.get(at),
            theirs[at]
        )
        .into());
    }
    let mut seen = theirs.clone();
    seen.sort_unstable();
    seen.dedup();
    if seen.len() <= DIFFERENT {
        return Err(format!("only {} different logits were compared", seen.len()).into());
    }
    println!("{} logits, the same in both engines", theirs.len());
    let file = folder.join("tests/logits.bin");
    let bytes: Vec<u8> = theirs.iter().map(|logit| logit.cast_unsigned()).collect();
    if write {
        return Ok(fs::write(file, bytes)?);
    }
    if fs::read(&file)? == bytes {
        Ok(())
    } else {
        Err(format!("{} has others: --write", file.display()).into())
    }
}

fn ours() -> Result<Vec<i8>, Box<dyn Error>> {
    let model = Model::new(BLOB)?;
    let mut arena = vec![0; model.arena_bytes()];
    let mut runner = Runner::new(model, &mut arena)?;
    Ok(logits(&mut runner))
}

fn theirs(onnx: &Path) -> Result<Vec<i8>, Box<dyn Error>> {
    let failed = |error: TractError| error.to_string();
    let model = tract_onnx::onnx()
        .model_for_path(onnx)
        .and_then(InferenceModelExt::into_optimized)
        .and_then(IntoRunnable::into_runnable)
        .map_err(failed)?;
    let step = f32::from(Model::new(BLOB)?.output_exponent()).exp2();
    let mut logits = Vec::new();
    for frame in frames() {
        let at = |(_, c, y, x): (usize, usize, usize, usize)| {
            (f32::from(frame[(y * SIDE + x) * 3 + c]) - 128.0) / 128.0
        };
        let input = tract_ndarray::Array4::from_shape_fn((1, 3, SIDE, SIDE), at);
        let outputs = model
            .run(tvec!(input.into_tensor().into()))
            .map_err(failed)?;
        let planes = outputs[0].to_plain_array_view::<f32>().map_err(failed)?;
        let cells = SIDE / CELL;
        for y in 0..cells {
            for x in 0..cells {
                for c in 0..CLASSES {
                    let steps = planes[[0, c, y, x]] / step;
                    let logit = steps as i8;
                    if f32::from(logit) != steps {
                        return Err(format!("{y} {x} {c}: {steps} is no logit of int8").into());
                    }
                    logits.push(logit);
                }
            }
        }
    }
    Ok(logits)
}
