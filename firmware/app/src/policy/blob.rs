//! A policy as bytes, and what it was trained for.
//!
//! Everything is little-endian and may lie at any address.
//!
//! | at | type | |
//! |---:|---|---|
//! | 0 | `[u8; 4]` | `TCPO` |
//! | 4 | u16 | version of the format, 1 |
//! | 6 | u16 | length of the blob, at most [`MAX_BYTES`] |
//! | 8 | u32 | CRC-32 (ISO-HDLC) of all that follows |
//! | 12 | u8 × 3 | version of the observation, of the actions, of the shield |
//! | 15 | u8 | decisions are 0 the best ones, 1 drawn with the probabilities of the logits |
//! | 16 | u8 | control steps from one decision to the next |
//! | 17 | u8 | layers, 1 to [`LAYERS`] |
//! | 18 | u16 | score: thousandths of the episodes of its evaluation that succeeded; [`NO_SCORE`] where there was none |
//! | 20 | `[u8; 32]` | SHA-256 of the weights that training ended with |
//! | 52 | u8 × [`LAYERS`] | outputs of each layer; 0 for layers that are not there |
//! | 56 | | layers, as [`crawler_micromodel::vector`] has them |
//!
//! The first layer looks at the observation, each further one at the hyperbolic tangents of the layer before
//! ([`squeezed`](super::squeezed)); the last one has a logit for each action.

use core::fmt;

use crawler_micromodel::blob::checksum;
use crawler_micromodel::vector::Dense;

use super::{ACTIONS_VERSION, Action, OBSERVATION_VERSION, SHIELD_VERSION, STEPS, WIDTH};

/// What every policy begins with.
pub const MAGIC: [u8; 4] = *b"TCPO";
/// The version of the format.
pub const FORMAT_VERSION: u16 = 1;
/// Most layers.
pub const LAYERS: usize = 4;
/// Most bytes.
pub const MAX_BYTES: usize = 12 * 1_024;
/// Bytes before the first layer.
pub const HEADER: usize = 52 + LAYERS;
/// Of a policy that was not evaluated.
pub const NO_SCORE: u16 = u16::MAX;

/// How an action is chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// The one with the largest logit.
    Best,
    /// With the probabilities that the logits give.
    Drawn,
}

/// Why bytes are no policy that can be driven by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum PolicyError {
    /// They do not begin as a policy does.
    Foreign,
    /// Of a version of the format that is not read here.
    Version(u16),
    /// They are not as many as they say, or too many.
    Length,
    /// They have changed since they were written.
    Checksum,
    /// The header holds what it may not.
    Header,
    /// The network makes no sense, from this layer on, counted from 1.
    Network(u16),
    /// It was trained with another kind of observation, other actions or another shield.
    OtherObservation,
}

impl fmt::Display for PolicyError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Foreign => f.write_str("these bytes are no policy"),
            Self::Version(version) => {
                write!(f, "version {version} of a policy's format is not read here")
            }
            Self::Length => f.write_str("the policy has not the length that it says"),
            Self::Checksum => f.write_str("the policy is damaged: its checksum does not fit"),
            Self::Header => f.write_str("the policy's header makes no sense"),
            Self::Network(layer) => write!(f, "layer {layer} of the policy makes no sense"),
            Self::OtherObservation => {
                f.write_str("the policy was trained for another observation, actions or shield")
            }
        }
    }
}

impl core::error::Error for PolicyError {}

/// A policy, read where it lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Policy<'a> {
    /// How actions are chosen.
    pub mode: Mode,
    /// Thousandths of the episodes of its evaluation that succeeded.
    pub score: Option<u16>,
    /// SHA-256 of the weights that training ended with.
    pub training: &'a [u8; 32],
    layers: [Option<Dense<'a>>; LAYERS],
}

impl<'a> Policy<'a> {
    /// Reads a policy. Bytes of any origin are safe.
    ///
    /// # Errors
    /// See [`PolicyError`].
    pub fn new(blob: &'a [u8]) -> Result<Self, PolicyError> {
        Self::read(blob, Trust::Nothing)
    }

    /// The policy of bytes that [`Self::new`] has read before, for a two-hundredth of the instructions: neither checksum
    /// nor weights are looked at again. With other bytes there is no telling what it decides.
    pub(crate) fn known(blob: &'a [u8]) -> Option<Self> {
        Self::read(blob, Trust::Contents).ok()
    }

    fn read(blob: &'a [u8], trust: Trust) -> Result<Self, PolicyError> {
        let (magic, rest) = blob.split_first_chunk::<4>().ok_or(PolicyError::Foreign)?;
        if *magic != MAGIC {
            return Err(PolicyError::Foreign);
        }
        let (version, rest) = rest.split_first_chunk().ok_or(PolicyError::Length)?;
        let version = u16::from_le_bytes(*version);
        if version != FORMAT_VERSION {
            return Err(PolicyError::Version(version));
        }
        let (length, rest) = rest.split_first_chunk().ok_or(PolicyError::Length)?;
        let length = usize::from(u16::from_le_bytes(*length));
        if length != blob.len() || length > MAX_BYTES {
            return Err(PolicyError::Length);
        }
        let (sum, rest) = rest.split_first_chunk().ok_or(PolicyError::Length)?;
        if trust == Trust::Nothing && checksum(rest) != u32::from_le_bytes(*sum) {
            return Err(PolicyError::Checksum);
        }
        let (versions, rest) = rest.split_first_chunk::<3>().ok_or(PolicyError::Length)?;
        let (how, rest) = rest.split_first_chunk::<3>().ok_or(PolicyError::Length)?;
        let (score, rest) = rest.split_first_chunk().ok_or(PolicyError::Length)?;
        let (training, rest) = rest.split_first_chunk().ok_or(PolicyError::Length)?;
        let (widths, rest) = rest
            .split_first_chunk::<LAYERS>()
            .ok_or(PolicyError::Length)?;
        let [mode, steps, count] = *how;
        if *versions != [OBSERVATION_VERSION, ACTIONS_VERSION, SHIELD_VERSION] || steps != STEPS {
            return Err(PolicyError::OtherObservation);
        }
        let mode = match mode {
            0 => Mode::Best,
            1 => Mode::Drawn,
            _ => return Err(PolicyError::Header),
        };
        let score = u16::from_le_bytes(*score);
        let count = usize::from(count);
        let there = widths.iter().enumerate();
        let fits = |(layer, width): (usize, &u8)| (*width == 0) == (layer >= count);
        let sane = (1..=LAYERS).contains(&count) && there.into_iter().all(fits);
        if !sane || (score > 1_000 && score != NO_SCORE) {
            return Err(PolicyError::Header);
        }
        Ok(Self {
            mode,
            score: (score != NO_SCORE).then_some(score),
            training,
            layers: layers(rest, &widths[..count], trust)?,
        })
    }

    /// Its layers, from the observation on.
    pub fn layers(&self) -> impl Iterator<Item = &Dense<'a>> {
        self.layers.iter().flatten()
    }
}

/// What is taken for granted of bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Trust {
    /// They may be anything.
    Nothing,
    /// They were read before, and are the same.
    Contents,
}

fn layers<'a>(
    bytes: &'a [u8],
    widths: &[u8],
    trust: Trust,
) -> Result<[Option<Dense<'a>>; LAYERS], PolicyError> {
    let mut layers = [None; LAYERS];
    let (mut rest, mut inputs) = (bytes, WIDTH);
    let all = layers.iter_mut().zip(widths).zip(1..);
    for ((layer, outputs), number) in all {
        let outputs = usize::from(*outputs);
        let bad = PolicyError::Network(number);
        let own = Dense::bytes(inputs, outputs);
        let (own, others) = rest.split_at_checked(own).ok_or(bad)?;
        let read = match trust {
            Trust::Nothing => Dense::new(own, inputs, outputs, number).ok(),
            Trust::Contents => Dense::known(own, inputs, outputs),
        };
        *layer = Some(read.ok_or(bad)?);
        (rest, inputs) = (others, outputs);
    }
    if inputs != Action::COUNT || !rest.is_empty() {
        return Err(PolicyError::Network(widths.len() as u16));
    }
    Ok(layers)
}
