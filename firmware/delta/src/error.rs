//! What can be wrong with a patch.

use core::fmt;

/// Why bytes are no patch from the old image to the new one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum DeltaError {
    /// It is of another type or compression.
    Type,
    /// It makes an image of another size than was announced.
    Size,
    /// Its window is larger than [`WINDOW`](crate::WINDOW), or its parameters are none of heatshrink.
    Window,
    /// It is made for a data format of detools.
    DataFormat,
    /// A number that does not end, is above 2^31 − 1, or is negative where that has no meaning.
    Number,
    /// Differences to what is not within the old image.
    Outside,
    /// It would make more than the new image.
    TooLong,
    /// It has more records than an image of that size can need.
    Records,
    /// It goes on behind its end.
    Trailing,
    /// It ends before the new image is whole.
    CutOff,
}

impl DeltaError {
    /// Every error.
    pub const ALL: [Self; 10] = [
        Self::Type,
        Self::Size,
        Self::Window,
        Self::DataFormat,
        Self::Number,
        Self::Outside,
        Self::TooLong,
        Self::Records,
        Self::Trailing,
        Self::CutOff,
    ];

    /// A stable name, for messages and records.
    #[must_use]
    pub const fn code(self) -> &'static str {
        match self {
            Self::Type => "delta_type",
            Self::Size => "delta_size",
            Self::Window => "delta_window",
            Self::DataFormat => "delta_data_format",
            Self::Number => "delta_number",
            Self::Outside => "delta_outside",
            Self::TooLong => "delta_too_long",
            Self::Records => "delta_records",
            Self::Trailing => "delta_trailing",
            Self::CutOff => "delta_cut_off",
        }
    }
}

impl fmt::Display for DeltaError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Type => "not a sequential patch in heatshrink",
            Self::Size => "the patch makes an image of another size",
            Self::Window => "the window of the patch is too large, or none of heatshrink",
            Self::DataFormat => "the patch is made for a data format",
            Self::Number => "a number of the patch is out of range",
            Self::Outside => "the patch reads outside of the old image",
            Self::TooLong => "the patch makes more than the new image",
            Self::Records => "the patch has too many records",
            Self::Trailing => "bytes behind the patch",
            Self::CutOff => "the patch is cut off",
        })
    }
}

impl core::error::Error for DeltaError {}
