//! Why a model cannot be converted.

use core::fmt;

use crawler_micromodel::ModelError;

/// Why a model cannot be converted.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum ConvertError {
    /// The bytes are no ONNX model.
    NotOnnx(String),
    /// The model as a whole: its inputs, outputs, labels.
    Model(String),
    /// A node that cannot be converted.
    Node {
        /// Its name; where it has none, what it makes.
        node: String,
        /// Why not.
        why: String,
    },
    /// What was written is no model.
    Blob(ModelError),
}

impl fmt::Display for ConvertError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotOnnx(why) => write!(f, "this is no ONNX model: {why}"),
            Self::Model(why) => f.write_str(why),
            Self::Node { node, why } => write!(f, "node {node}: {why}"),
            Self::Blob(error) => write!(f, "the converted model is wrong: {error}"),
        }
    }
}

impl core::error::Error for ConvertError {}

impl From<ModelError> for ConvertError {
    fn from(error: ModelError) -> Self {
        Self::Blob(error)
    }
}
