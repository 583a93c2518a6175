//! Turns quantised ONNX models into blobs for `crawler-micromodel`.
//!
//! Models are in QDQ form: between two layers a `QuantizeLinear` and a `DequantizeLinear` say what
//! the int8 tensor is, weights come out of a `DequantizeLinear` with one scale for each output
//! channel. Scales of tensors are powers of two; a scale of weights times that of the input,
//! divided by that of the output, is `m / 2^s` with m from 1 to 255. What does not fit is refused
//! by the name of its node: nothing is approximated.
//!
//! | node | becomes |
//! |---|---|
//! | `Conv` with one group, or as many as channels | convolution |
//! | `Gemm` of a vector | convolution of one pixel |
//! | `Add` of two tensors | sum |
//! | `Relu`, `Clip` | the range of the layer before |
//! | `Identity`, `Flatten` of a vector | nothing |
#![forbid(unsafe_code)]

mod arithmetic;
mod error;
mod graph;
mod layers;
mod onnx;
mod pending;
#[cfg(test)]
mod tests;

pub use error::ConvertError;
pub use layers::{Options, convert};
