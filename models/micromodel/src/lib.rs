//! Small neural networks on a microcontroller, and the same on the host, bit for bit.
//!
//! A network is a *blob*: one block of bytes with layers and weights, read where it lies, in flash
//! ([`blob`] has its format, [`Model`] reads it, [`Writer`] writes it). It runs row by row
//! ([`Runner`]): a layer computes one row of its output as soon as the rows that it looks at are
//! there, and rows that nobody looks at any more are overwritten. The memory for that is a tenth
//! of what whole layers would take; [`arena_bytes`] says how much it is, at build time.
//!
//! All arithmetic is in integers, and every operation is exact or rounds half to even, so host and
//! board give the same bytes. For each output channel
//!
//! ```text
//! acc = bias' + Σ w·x          i32, with bias' = bias − zx·Σw; outside of the picture x = zx
//! p   = acc·m                  m = 1..255
//! y   = clamp(zy + RHE(p / 2^s), lowest, highest)
//! ```
//!
//! with `zx`, `zy` the zero points of input and output and `RHE` rounding half to even. A sum of
//! two tensors is `clamp(zy + RHE(((a − za)·2^sa + (b − zb)·2^sb) / 2^s))`. With |p| < 2²⁴, which
//! the converter sees to, engines that compute in f32 agree to the last bit too.
//!
//! On a host, `pulp::Arch::new().dispatch(#[inline(always)] || runner.run(fill))` or the like runs a
//! model with all the vectors that the processor has: everything is inlined there, and compiled for
//! it.
//!
//! No heap, no `unsafe`, no panic for any blob and any input.
//!
//! Reading order: `blob`, `layer` and `model`, which read; `plan`, which places rows; `run` with its `kernels`,
//! and `output`. `vector` has layers for what is no picture. `write` is for whoever makes blobs, `error` says what can be wrong.
#![no_std]
#![forbid(unsafe_code)]
// On hosts all is inlined into whoever calls, with the vectors that the caller is compiled for.
#![cfg_attr(target_pointer_width = "64", allow(clippy::inline_always))]

#[cfg(test)]
extern crate std;

pub mod blob;
mod error;
mod kernels;
mod layer;
mod model;
mod output;
mod plan;
mod run;
pub mod vector;
mod write;

pub use error::ModelError;
pub use layer::{Operation, Shape};
pub use model::Model;
pub use output::{Best, argmax, best, softmax};
pub use plan::arena_bytes;
pub use run::{Runner, Step};
pub use write::{Convolution, Sum, Writer};
