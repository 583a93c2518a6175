//! Random networks, and the plainest way to compute them.

use crawler_micromodel::{Convolution, ModelError, Shape, Sum, Writer};

/// A network as its author thinks of it.
#[derive(Debug, Clone)]
pub(crate) struct Network {
    pub(crate) input: Shape,
    pub(crate) zero: i8,
    pub(crate) layers: Vec<Layer>,
}

#[derive(Debug, Clone)]
pub(crate) enum Layer {
    Convolution {
        depthwise: bool,
        input: u16,
        channels: u16,
        kernel: u8,
        stride: u8,
        padding: [u8; 2],
        zero: i8,
        range: [i8; 2],
        weights: Vec<i8>,
        bias: Vec<i32>,
        multipliers: Vec<u8>,
        shifts: Vec<u8>,
    },
    Sum(Sum),
}

/// Numbers out of a seed; the same ones every time.
pub(crate) struct Dice(u64);

impl Dice {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed ^ 0x9E37_79B9_7F4A_7C15)
    }

    pub(crate) fn next(&mut self) -> u64 {
        // Steele, Lea and Flood, "Fast splittable pseudorandom number generators" (2014).
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// From `low` to `high`, both included.
    pub(crate) fn between(&mut self, low: i64, high: i64) -> i64 {
        low + (self.next() % (high - low + 1) as u64) as i64
    }

    pub(crate) fn byte(&mut self) -> i8 {
        self.next() as i8
    }
}

impl Network {
    /// A network of any shape that a model may have, with values of any size.
    pub(crate) fn random(seed: u64) -> Self {
        let mut dice = Dice::new(seed);
        let mut extent = |most| dice.between(1, most) as u16;
        let input = Shape {
            height: extent(14),
            width: extent(14),
            channels: extent(12),
        };
        let zero = dice.byte();
        let mut shapes = vec![input];
        let mut layers = Vec::new();
        for _ in 0..dice.between(1, 7) {
            let last = shapes.len() as u16 - 1;
            let alike = |tensor: &u16| shapes[usize::from(*tensor)] == shapes[usize::from(last)];
            let other = (0..last).rev().find(alike);
            let (layer, shape) = match other {
                Some(other) if dice.between(0, 2) == 0 => {
                    (sum(&mut dice, [other, last]), shapes[usize::from(last)])
                }
                _ => convolution(&mut dice, last, shapes[usize::from(last)]),
            };
            layers.push(layer);
            shapes.push(shape);
        }
        Self {
            input,
            zero,
            layers,
        }
    }

    /// As a blob.
    pub(crate) fn blob(&self, labels: &[&str]) -> Result<Vec<u8>, ModelError> {
        let mut blob = vec![0xAA; 200_000];
        let mut writer = Writer::new(&mut blob, self.input, self.zero, self.layers.len())?;
        for layer in &self.layers {
            match layer {
                Layer::Convolution {
                    depthwise,
                    input,
                    channels,
                    kernel,
                    stride,
                    padding,
                    zero,
                    range,
                    weights,
                    bias,
                    multipliers,
                    shifts,
                } => {
                    writer.convolution(&Convolution {
                        depthwise: *depthwise,
                        input: *input,
                        channels: *channels,
                        kernel: *kernel,
                        stride: *stride,
                        padding: *padding,
                        zero: *zero,
                        range: *range,
                        weights,
                        bias,
                        multipliers,
                        shifts,
                    })?;
                }
                Layer::Sum(sum) => {
                    writer.sum(sum)?;
                }
            }
        }
        let length = writer.finish(-4, labels)?;
        blob.truncate(length);
        Ok(blob)
    }

    /// The output, layer by layer, in 64 bits and with division of rationals.
    pub(crate) fn expected(&self, input: &[i8]) -> Vec<i8> {
        let mut tensors = vec![(self.input, self.zero, input.to_vec())];
        for layer in &self.layers {
            let made = match layer {
                Layer::Sum(sum) => expected_sum(sum, &tensors),
                Layer::Convolution { input, .. } => {
                    expected_convolution(layer, &tensors[usize::from(*input)])
                }
            };
            tensors.push(made);
        }
        tensors.pop().expect("a layer").2
    }
}

type Tensor = (Shape, i8, Vec<i8>);

fn finish(zero: i8, range: [i8; 2], value: i64, shift: u8) -> i8 {
    let value = value as f64 / f64::from(1_u32 << shift);
    let value = i64::from(zero) + value.round_ties_even() as i64;
    value.clamp(range[0].into(), range[1].into()) as i8
}

fn expected_sum(sum: &Sum, tensors: &[Tensor]) -> Tensor {
    let [a, b] = sum.inputs.map(|tensor| &tensors[usize::from(tensor)]);
    let values = a.2.iter().zip(&b.2).map(|(&x, &y)| {
        let x = (i64::from(x) - i64::from(a.1)) << sum.lifts[0];
        let y = (i64::from(y) - i64::from(b.1)) << sum.lifts[1];
        finish(sum.zero, sum.range, x + y, sum.shift)
    });
    (a.0, sum.zero, values.collect())
}

fn expected_convolution(layer: &Layer, (shape, zero, values): &Tensor) -> Tensor {
    let Layer::Convolution {
        depthwise,
        channels,
        kernel,
        stride,
        padding,
        zero: out_zero,
        range,
        weights,
        bias,
        multipliers,
        shifts,
        ..
    } = layer
    else {
        unreachable!("asked for a convolution")
    };
    let out = shape_after(*shape, *channels, *kernel, *stride, *padding);
    let (k, deep) = (usize::from(*kernel), usize::from(shape.channels));
    let at = |y: i64, x: i64, c: usize| {
        let inside =
            (0..i64::from(shape.height)).contains(&y) && (0..i64::from(shape.width)).contains(&x);
        if inside {
            values[(y as usize * usize::from(shape.width) + x as usize) * deep + c]
        } else {
            *zero
        }
    };
    let mut made = Vec::new();
    for y in 0..i64::from(out.height) {
        for x in 0..i64::from(out.width) {
            for c in 0..usize::from(out.channels) {
                let mut sum = i64::from(bias[c]);
                for ky in 0..k {
                    for kx in 0..k {
                        let row = y * i64::from(*stride) + ky as i64 - i64::from(padding[0]);
                        let column = x * i64::from(*stride) + kx as i64 - i64::from(padding[0]);
                        if *depthwise {
                            let weight = weights[(ky * k + kx) * deep + c];
                            sum += i64::from(weight) * i64::from(at(row, column, c));
                        } else {
                            for d in 0..deep {
                                let weight = weights[((c * k + ky) * k + kx) * deep + d];
                                sum += i64::from(weight) * i64::from(at(row, column, d));
                            }
                        }
                    }
                }
                let product = sum * i64::from(multipliers[c]);
                made.push(finish(*out_zero, *range, product, shifts[c]));
            }
        }
    }
    (out, *out_zero, made)
}

fn shape_after(shape: Shape, channels: u16, kernel: u8, stride: u8, padding: [u8; 2]) -> Shape {
    let around = u16::from(padding[0]) + u16::from(padding[1]);
    let steps = |extent: u16| (extent + around - u16::from(kernel)) / u16::from(stride) + 1;
    Shape {
        height: steps(shape.height),
        width: steps(shape.width),
        channels,
    }
}

fn range(dice: &mut Dice) -> [i8; 2] {
    let (a, b) = (dice.byte(), dice.byte());
    [a.min(b), a.max(b)]
}

fn sum(dice: &mut Dice, inputs: [u16; 2]) -> Layer {
    Layer::Sum(Sum {
        inputs,
        lifts: [dice.between(0, 6) as u8, dice.between(0, 6) as u8],
        shift: dice.between(1, 8) as u8,
        zero: dice.byte(),
        range: range(dice),
    })
}

fn convolution(dice: &mut Dice, input: u16, shape: Shape) -> (Layer, Shape) {
    let depthwise = dice.between(0, 1) == 0;
    let kernel = dice.between(1, 5) as u8;
    let mut pad = || dice.between(0, i64::from(kernel) - 1) as u8;
    let padding = [pad(), pad()];
    let least = u16::from(padding[0]) + u16::from(padding[1]) + shape.height.min(shape.width);
    // A kernel that is larger than the picture is none.
    let kernel = kernel.min(least as u8).max(1 + padding[0].max(padding[1]));
    let (kernel, padding) = if u16::from(kernel) > least {
        (1, [0, 0])
    } else {
        (kernel, padding)
    };
    let stride = dice.between(1, 3) as u8;
    let channels = if depthwise {
        shape.channels
    } else {
        dice.between(1, 13) as u16
    };
    let deep = if depthwise {
        1
    } else {
        usize::from(shape.channels)
    };
    let count = usize::from(kernel) * usize::from(kernel) * deep * usize::from(channels);
    let layer = Layer::Convolution {
        depthwise,
        input,
        channels,
        kernel,
        stride,
        padding,
        zero: dice.byte(),
        range: range(dice),
        weights: (0..count).map(|_| dice.byte()).collect(),
        bias: (0..channels)
            .map(|_| dice.between(-9_000, 9_000) as i32)
            .collect(),
        multipliers: (0..channels).map(|_| dice.between(1, 255) as u8).collect(),
        shifts: (0..channels).map(|_| dice.between(8, 22) as u8).collect(),
    };
    (layer, shape_after(shape, channels, kernel, stride, padding))
}
