//! The detector: what a robot with a camera sees, as one class for each cell of its picture.
//!
//! FOMO: the trunk of a `MobileNetV2` cut at one eighth of the resolution, and a classifier for each
//! cell (Sandler et al., 2018; Edge Impulse, 2022). 96 × 96 pixels of red, green and blue come in,
//! each less 128; out come 12 × 12 cells with a logit for each of [`LABELS`].
//!
//! `README.md` tells how it was trained and how well it does.
#![no_std]
#![forbid(unsafe_code)]

/// The model, for `crawler_micromodel::Model::new`.
pub const BLOB: &[u8] = include_bytes!("../detector.tcmm");

/// What the channels of the output stand for; the first is a cell with nothing in it.
pub const LABELS: [&str; 4] = ["nothing", "obstacle", "object", "robot"];

/// Frames of a camera to try the model with, each with its name: 96 × 96 pixels of RGB565, high
/// byte first.
pub const FRAMES: &[(&str, &[u8; 96 * 96 * 2])] = &[
    ("search", include_bytes!("../frames/search.rgb565")),
    ("wild", include_bytes!("../frames/wild.rgb565")),
];
