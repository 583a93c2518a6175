//! From what was learned in floats to a blob for robots.
//!
//! Each output of a layer has a step for its weights, the finest with which the largest of them fits in 8 bits, and such
//! that from sums to what the next layer looks at there is a multiplication with 1 to 255 and a shift, exactly: weights
//! are rounded, and nothing else. What stands between layers are hyperbolic tangents in 1/127; they are as large as
//! that whatever is observed, so nothing has to be measured.

use std::error::Error;
use std::fmt;

use crawler_app::policy::{
    ACTIONS_VERSION, Action, FORMAT_VERSION, LAYERS, MAGIC, MAX_BYTES, Mode, NO_SCORE,
    OBSERVATION_VERSION, PRE_STEPS, Policy as Blob, PolicyError, SHIELD_VERSION, STEPS, WIDTH,
};
use crawler_micromodel::blob::checksum;
use crawler_micromodel::vector::LANES;
use crawler_policy::{Activation, Policy, Weights};
use sha2::{Digest, Sha256};

/// Bytes of a blob that its checksum is not of.
const BEFORE: usize = 12;

/// What a blob says beside its network.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Header {
    /// How actions are chosen.
    pub mode: Mode,
    /// Thousandths of the episodes of its evaluation that succeeded.
    pub score: Option<u16>,
}

/// Why a policy is none for robots.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unfit {
    /// It has other inputs or outputs, too many layers, or other activations than the hyperbolic tangent.
    Shape,
    /// It has too many weights.
    TooLarge(usize),
    /// A robot would refuse it.
    Refused(PolicyError),
}

impl fmt::Display for Unfit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Shape => write!(
                f,
                "a robot's policy has {WIDTH} inputs, {} actions, at most {LAYERS} layers, and tanh between them",
                Action::COUNT
            ),
            Self::TooLarge(bytes) => write!(f, "{bytes} bytes; a robot takes {MAX_BYTES}"),
            Self::Refused(error) => error.fmt(f),
        }
    }
}

impl Error for Unfit {}

/// The SHA-256 of a network's weights: what a blob names as its training.
pub(crate) fn training(policy: &Policy) -> [u8; 32] {
    Sha256::digest(policy.to_bytes()).into()
}

/// The blob of a policy.
///
/// # Errors
/// See [`Unfit`].
pub fn export(policy: &Policy, header: Header) -> Result<Vec<u8>, Unfit> {
    let shape = policy.network().shape();
    let layers: Vec<Weights<'_>> = policy.network().layers().collect();
    if shape.inputs != WIDTH
        || shape.outputs != Action::COUNT
        || layers.len() > LAYERS
        || shape.activation != Activation::Tanh
    {
        return Err(Unfit::Shape);
    }
    let mut rest = vec![OBSERVATION_VERSION, ACTIONS_VERSION, SHIELD_VERSION];
    rest.push(match header.mode {
        Mode::Best => 0,
        Mode::Drawn => 1,
    });
    rest.extend([STEPS, layers.len() as u8]);
    rest.extend(header.score.unwrap_or(NO_SCORE).to_le_bytes());
    rest.extend(training(policy));
    let mut widths = [0; LAYERS];
    for (width, layer) in widths.iter_mut().zip(&layers) {
        *width = u8::try_from(layer.outputs).map_err(|_| Unfit::TooLarge(layer.outputs))?;
    }
    rest.extend(widths);
    for layer in &layers {
        quantise(layer, &mut rest);
    }
    let bytes = BEFORE + rest.len();
    if bytes > MAX_BYTES {
        return Err(Unfit::TooLarge(bytes));
    }
    let mut blob = MAGIC.to_vec();
    blob.extend(FORMAT_VERSION.to_le_bytes());
    blob.extend((bytes as u16).to_le_bytes());
    blob.extend(checksum(&rest).to_le_bytes());
    blob.extend(rest);
    match Blob::new(&blob) {
        Ok(_) => Ok(blob),
        Err(error) => Err(Unfit::Refused(error)),
    }
}

/// One output of a layer in whole numbers.
struct Output {
    bias: i32,
    multiplier: u8,
    shift: u8,
    weights: Vec<i8>,
}

impl Output {
    /// Fills groups up.
    fn nothing(inputs: usize) -> Self {
        Self {
            bias: 0,
            multiplier: 1,
            shift: 1,
            weights: vec![0; inputs],
        }
    }

    fn of(layer: &Weights<'_>, output: usize) -> Self {
        let weights = (0..layer.inputs).map(|input| f64::from(layer.weight(input, output)));
        let largest = weights.clone().fold(0.0, |most: f64, w| most.max(w.abs()));
        // What a product of 1 in a weight and 1/127 in an input is worth, in what comes out.
        let worth = largest / 127.0 * f64::from(PRE_STEPS) / 127.0;
        let (mut multiplier, mut shift) = (1, 1);
        for finer in 1..=24_u8 {
            let needed = (worth * f64::from(1 << finer)).ceil();
            if needed > 255.0 {
                break;
            }
            (multiplier, shift) = (needed.max(1.0) as u8, finer);
        }
        let step = f64::from(multiplier) / f64::from(1_u32 << shift) * 127.0 / f64::from(PRE_STEPS);
        let whole = |value: f64| value.round_ties_even();
        let most = f64::from(1 << 21);
        let bias = whole(f64::from(layer.bias(output)) / step * 127.0);
        Self {
            bias: bias.clamp(-most, most) as i32,
            multiplier,
            shift,
            weights: weights
                .map(|weight| whole(weight / step).clamp(-127.0, 127.0) as i8)
                .collect(),
        }
    }
}

fn quantise(layer: &Weights<'_>, out: &mut Vec<u8>) {
    let mut outputs: Vec<Output> = (0..layer.outputs).map(|n| Output::of(layer, n)).collect();
    while !outputs.len().is_multiple_of(LANES) {
        outputs.push(Output::nothing(layer.inputs));
    }
    for output in &outputs {
        out.extend(output.bias.to_le_bytes());
    }
    out.extend(outputs.iter().map(|output| output.multiplier));
    out.extend(outputs.iter().map(|output| output.shift));
    for group in outputs.chunks(LANES) {
        for input in 0..layer.inputs {
            out.extend(group.iter().map(|o| o.weights[input].cast_unsigned()));
        }
    }
}

#[cfg(test)]
mod tests;
