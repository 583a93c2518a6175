//! Why a blob is no model, or a model cannot run.

use core::fmt;

/// Why a blob is no model, or a model cannot run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum ModelError {
    /// The blob ends before something that it says it has.
    Truncated,
    /// It does not begin as a blob does.
    Magic,
    /// A version that this build does not read.
    Version(u16),
    /// Its length is not the one it says.
    Length {
        /// Bytes that it says it has.
        stated: u32,
    },
    /// Bytes have changed since it was written.
    Checksum,
    /// A layer, counted from 1, or the header, 0, holds what it may not.
    Layer(u16),
    /// The output of a layer is never looked at.
    Unused(u16),
    /// Sums of a layer could overflow.
    Overflow(u16),
    /// Labels that are no text, or not as many as there are channels.
    Labels,
    /// The arena is too small.
    Arena {
        /// Bytes that are needed.
        needed: usize,
    },
    /// The buffer for a blob is full.
    Full,
    /// What was given to the writer does not fit together: shapes, or numbers of values.
    Mismatch,
}

impl fmt::Display for ModelError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Truncated => f.write_str("the model ends too early"),
            Self::Magic => f.write_str("these bytes are no model"),
            Self::Version(version) => write!(
                f,
                "version {version} of the model's format is not read by this build, only {}",
                crate::blob::VERSION
            ),
            Self::Length { stated } => write!(f, "the model should have {stated} bytes"),
            Self::Checksum => f.write_str("the model is damaged: its checksum does not fit"),
            Self::Layer(0) => f.write_str("the model's header makes no sense"),
            Self::Layer(layer) => write!(f, "layer {layer} of the model makes no sense"),
            Self::Unused(layer) => write!(f, "nothing looks at the output of layer {layer}"),
            Self::Overflow(layer) => write!(f, "sums of layer {layer} could overflow"),
            Self::Labels => f.write_str("the model's labels make no sense"),
            Self::Arena { needed } => write!(f, "the model needs an arena of {needed} bytes"),
            Self::Full => f.write_str("the model does not fit the buffer"),
            Self::Mismatch => f.write_str("shapes or numbers of values do not fit together"),
        }
    }
}

impl core::error::Error for ModelError {}
