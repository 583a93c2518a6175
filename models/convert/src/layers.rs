//! From nodes to layers.

use std::collections::BTreeMap;

use crawler_micromodel::{Shape, Writer};
use prost::Message as _;

use crate::arithmetic::exponent;
use crate::error::ConvertError;
use crate::graph::{Lookup, attribute, input, ints, output, refused, same};
use crate::onnx::{Model, Node, Value};
use crate::pending::{Pending, Tensor, Weighted, Work};

/// Room for header and layers.
const OVERHEAD: usize = 64 * 1024;

/// How a model is converted.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// What the channels of the output stand for. Where there are none, the model's metadata
    /// `labels`, separated by commas, are taken.
    pub labels: Vec<String>,
}

#[derive(Debug, Clone)]
enum Known {
    /// The input of the model, before it is quantised.
    Input(Shape),
    Tensor(Tensor),
    Pending(Pending),
}

/// Converts the bytes of an ONNX file into those of a blob.
///
/// # Errors
/// The first node that does not fit, by its name, and why.
pub fn convert(onnx: &[u8], options: &Options) -> Result<Vec<u8>, ConvertError> {
    let model = Model::decode(onnx).map_err(|error| ConvertError::NotOnnx(error.to_string()))?;
    let graph = model.graph.as_ref();
    let graph = graph.ok_or_else(|| ConvertError::NotOnnx("it has no graph".to_owned()))?;
    let lookup = Lookup::new(graph);
    let input = input_of(&lookup)?;
    let count = |kind: &str| graph.nodes.iter().filter(|node| node.kind == kind).count();
    let layers = count("Conv") + count("Gemm") + count("Add");
    let mut blob = vec![0; onnx.len() + OVERHEAD];
    let mut room = Some(&mut blob[..]);
    let mut converter = Converter {
        lookup: &lookup,
        known: BTreeMap::from([(input.0, Known::Input(input.1))]),
        writer: None,
        layers,
    };
    for node in &graph.nodes {
        converter.node(node, &mut room)?;
    }
    let [output] = &graph.outputs[..] else {
        return Err(ConvertError::Model(
            "the model does not have one output".to_owned(),
        ));
    };
    let last = match converter.known.get(output.name.as_str()) {
        Some(Known::Tensor(tensor)) if usize::from(tensor.index) == layers => *tensor,
        Some(_) | None => {
            let why = format!(
                "the output {} is not the last layer, quantised",
                output.name
            );
            return Err(ConvertError::Model(why));
        }
    };
    let labels = labels_of(&model, options);
    let labels: Vec<&str> = labels.iter().map(String::as_str).collect();
    let writer = converter.writer.take();
    let writer = writer.ok_or_else(|| ConvertError::Model("the input is never used".to_owned()))?;
    let length = writer.finish(last.exponent as i8, &labels)?;
    blob.truncate(length);
    Ok(blob)
}

fn labels_of(model: &Model, options: &Options) -> Vec<String> {
    if !options.labels.is_empty() {
        return options.labels.clone();
    }
    let entry = model.metadata.iter().find(|entry| entry.key == "labels");
    entry.map_or_else(Vec::new, |entry| {
        entry.value.split(',').map(str::to_owned).collect()
    })
}

/// The one input that is no constant, and its shape.
fn input_of<'g>(lookup: &Lookup<'g>) -> Result<(&'g str, Shape), ConvertError> {
    let constants = &lookup.graph.constants;
    let real = |value: &&Value| constants.iter().all(|constant| constant.name != value.name);
    let inputs: Vec<&Value> = lookup.graph.inputs.iter().filter(real).collect();
    let [input] = inputs[..] else {
        return Err(ConvertError::Model(
            "the model does not have one input".to_owned(),
        ));
    };
    let kind = input.kind.as_ref().and_then(|kind| kind.tensor.as_ref());
    let shape = kind.and_then(|kind| kind.shape.as_ref());
    let extents: Vec<i64> = shape.map_or_else(Vec::new, |shape| {
        shape.extents.iter().map(|extent| extent.value).collect()
    });
    let (channels, height, width) = match extents[..] {
        [0 | 1, channels, height, width] => (channels, height, width),
        [0 | 1, channels] => (channels, 1, 1),
        _ => {
            let why = format!("the input's shape {extents:?} is not 1 × C × H × W or 1 × C");
            return Err(ConvertError::Model(why));
        }
    };
    let extent = |value: i64| {
        u16::try_from(value).map_err(|_| ConvertError::Model(format!("an extent of {value}")))
    };
    let shape = Shape {
        height: extent(height)?,
        width: extent(width)?,
        channels: extent(channels)?,
    };
    Ok((&input.name, shape))
}

/// Weights as they are given: values, shape, and a scale for each output channel.
type Weights = (Vec<i8>, Vec<usize>, Vec<f32>);

struct Converter<'l, 'g, 'b> {
    lookup: &'l Lookup<'g>,
    known: BTreeMap<&'g str, Known>,
    /// There from the moment that the input's zero point is known.
    writer: Option<Writer<'b>>,
    layers: usize,
}

impl<'g, 'b> Converter<'_, 'g, 'b> {
    fn node(
        &mut self,
        node: &'g Node,
        blob: &mut Option<&'b mut [u8]>,
    ) -> Result<(), ConvertError> {
        let output = output(node)?;
        let known = match node.kind.as_str() {
            "QuantizeLinear" => self.quantise(node, blob)?,
            "DequantizeLinear" => match self.dequantise(node)? {
                Some(known) => known,
                // Weights: whoever looks at them comes later.
                None => return Ok(()),
            },
            "Conv" => self.conv(node)?,
            "Gemm" => self.gemm(node)?,
            "Add" => self.add(node)?,
            "Relu" => self.clipped(node, 0.0, f32::INFINITY)?,
            "Clip" => {
                let (low, high) = self.bounds(node)?;
                self.clipped(node, low, high)?
            }
            "Identity" => self.value(node, 0)?.clone(),
            "Flatten" => {
                let tensor = self.tensor(node, 0)?;
                if tensor.shape.height != 1 || tensor.shape.width != 1 {
                    return Err(refused(node, "flattens more than one pixel"));
                }
                Known::Tensor(tensor)
            }
            _ => return Err(refused(node, "there is no such operation in micromodel")),
        };
        self.known.insert(output, known);
        Ok(())
    }

    fn value(&self, node: &'g Node, n: usize) -> Result<&Known, ConvertError> {
        let input = input(node, n)?;
        let known = self.known.get(input);
        known.ok_or_else(|| {
            refused(
                node,
                format!("its input {input} is made by no layer before"),
            )
        })
    }

    fn tensor(&self, node: &'g Node, n: usize) -> Result<Tensor, ConvertError> {
        match self.value(node, n)? {
            Known::Tensor(tensor) => Ok(*tensor),
            Known::Input(_) | Known::Pending(_) => {
                Err(refused(node, format!("its input {n} is not quantised")))
            }
        }
    }

    fn dequantise(&self, node: &'g Node) -> Result<Option<Known>, ConvertError> {
        let input = input(node, 0)?;
        let Some(known) = self.known.get(input) else {
            let constants = &self.lookup.graph.constants;
            return if constants.iter().any(|constant| constant.name == input) {
                Ok(None)
            } else {
                Err(refused(
                    node,
                    format!("its input {input} is made by nobody"),
                ))
            };
        };
        let (scale, zero) = self.lookup.scale(node)?;
        match known {
            Known::Tensor(tensor)
                if exponent(scale) == Some(tensor.exponent) && zero == tensor.zero =>
            {
                Ok(Some(Known::Tensor(*tensor)))
            }
            Known::Tensor(_) => Err(refused(
                node,
                "has another scale than the quantisation before",
            )),
            Known::Input(_) | Known::Pending(_) => Err(refused(node, "its input is not quantised")),
        }
    }

    fn quantise(
        &mut self,
        node: &'g Node,
        blob: &mut Option<&'b mut [u8]>,
    ) -> Result<Known, ConvertError> {
        let (scale, zero) = self.lookup.scale(node)?;
        let power = exponent(scale)
            .ok_or_else(|| refused(node, format!("its scale {scale} is no power of two")))?;
        let known = self.value(node, 0)?.clone();
        let (index, shape) = match known {
            Known::Input(shape) => {
                let room = blob.take();
                let room = room.ok_or_else(|| refused(node, "quantises the input again"))?;
                self.writer = Some(Writer::new(room, shape, zero, self.layers)?);
                (0, shape)
            }
            Known::Pending(pending) => {
                if self.lookup.readers(input(node, 0)?) > 1 {
                    return Err(refused(node, "others look at what it quantises"));
                }
                {
                    let writer = self.writer.as_mut();
                    let writer = writer
                        .ok_or_else(|| refused(node, "comes before the input is quantised"))?;
                    pending.write(writer, node, power, zero)?
                }
            }
            Known::Tensor(tensor) => {
                if (tensor.exponent, tensor.zero) == (power, zero) {
                    return Ok(Known::Tensor(tensor));
                }
                return Err(refused(
                    node,
                    "changes the scale of what is quantised already",
                ));
            }
        };
        Ok(Known::Tensor(Tensor {
            index,
            shape,
            exponent: power,
            zero,
        }))
    }

    /// Weights with their scales, which come out of a `DequantizeLinear` of constants.
    fn weights(&self, node: &'g Node, axis: i64) -> Result<Weights, ConvertError> {
        let value = input(node, 1)?;
        let maker = self
            .lookup
            .maker(value)
            .filter(|maker| maker.kind == "DequantizeLinear");
        let maker = maker.ok_or_else(|| refused(node, "its weights are not int8"))?;
        let (weights, shape) = self.lookup.i8s(maker, 0)?;
        let mut scales = self.lookup.f32s(maker, 1)?;
        if maker.inputs.len() < 3 || self.lookup.i8s(maker, 2)?.0.iter().any(|&zero| zero != 0) {
            return Err(refused(maker, "weights need zero points that are 0"));
        }
        let given = attribute(maker, "axis").map_or(1, |attribute| attribute.int);
        let channels = shape.get(axis as usize).copied().unwrap_or(0);
        if channels == 0 || channels > 512 {
            return Err(refused(node, format!("has {channels} output channels")));
        }
        if scales.len() == 1 {
            scales = vec![scales[0]; channels];
        } else if given != axis || scales.len() != channels {
            return Err(refused(
                maker,
                "does not have a scale for each output channel",
            ));
        }
        Ok((weights, shape, scales))
    }

    fn bias(&self, node: &'g Node, channels: usize) -> Result<Vec<f32>, ConvertError> {
        if node.inputs.len() < 3 {
            return Ok(vec![0.0; channels]);
        }
        let bias = self.lookup.f32s(node, 2)?;
        if bias.len() == channels {
            Ok(bias)
        } else {
            Err(refused(
                node,
                "does not have a bias for each output channel",
            ))
        }
    }

    fn conv(&self, node: &'g Node) -> Result<Known, ConvertError> {
        let input = self.tensor(node, 0)?;
        let (weights, shape, scales) = self.weights(node, 0)?;
        let [channels, deep, height, width] = shape[..] else {
            return Err(refused(node, "is not of two dimensions"));
        };
        let given = ints(node, "kernel_shape", &[height as i64, width as i64]);
        let kernel = same(node, "a kernel of", &given)?;
        if [height, width] != [usize::from(kernel); 2] {
            return Err(refused(
                node,
                "its kernel has another shape than its weights",
            ));
        }
        let stride = same(node, "strides of", &ints(node, "strides", &[1, 1]))?;
        if ints(node, "dilations", &[1, 1])
            .iter()
            .any(|&dilation| dilation != 1)
        {
            return Err(refused(node, "is dilated"));
        }
        let padded = attribute(node, "auto_pad").map_or(&b"NOTSET"[..], |pad| &pad.text);
        let pads = ints(node, "pads", &[0; 4]);
        let (b"NOTSET", [top, left, bottom, right]) = (padded, &pads[..]) else {
            return Err(refused(node, "needs its padding as four numbers"));
        };
        let before = same(node, "padding above and left of", &[*top, *left])?;
        let after = same(node, "padding below and right of", &[*bottom, *right])?;
        let group = attribute(node, "group").map_or(1, |attribute| attribute.int);
        let inputs = usize::from(input.shape.channels);
        let depthwise = group != 1 && group as usize == inputs;
        let fits = if depthwise {
            channels == inputs && deep == 1
        } else {
            group == 1 && deep == inputs
        };
        if !fits {
            let why = format!("{group} groups of {inputs} input and {channels} output channels");
            return Err(refused(node, why));
        }
        let pixels = height * width;
        let weights = if depthwise {
            // [channel][pixel] to [pixel][channel].
            let order =
                (0..pixels).flat_map(|pixel| (0..channels).map(move |c| c * pixels + pixel));
            order.map(|at| weights[at]).collect()
        } else {
            // [out][in][pixel] to [out][pixel][in].
            let order = (0..channels).flat_map(|c| {
                (0..pixels)
                    .flat_map(move |pixel| (0..deep).map(move |d| (c * deep + d) * pixels + pixel))
            });
            order.map(|at| weights[at]).collect()
        };
        Ok(Known::Pending(Pending::new(Work::Weighted(Weighted {
            input,
            depthwise,
            kernel,
            stride,
            padding: [before, after],
            weights,
            bias: self.bias(node, channels)?,
            scales,
        }))))
    }

    fn gemm(&self, node: &'g Node) -> Result<Known, ConvertError> {
        let input = self.tensor(node, 0)?;
        let factor = |name| attribute(node, name).map_or(1.0, |attribute| attribute.float);
        let flag = |name| attribute(node, name).map_or(0, |attribute| attribute.int);
        if factor("alpha") != 1.0
            || factor("beta") != 1.0
            || flag("transA") != 0
            || flag("transB") != 1
        {
            return Err(refused(
                node,
                "only with weights as [out][in] (transB = 1) and factors of 1",
            ));
        }
        let (weights, shape, scales) = self.weights(node, 0)?;
        let pixel = input.shape.height == 1 && input.shape.width == 1;
        if !pixel || shape.len() != 2 || shape[1] != usize::from(input.shape.channels) {
            return Err(refused(node, "its weights do not fit its input"));
        }
        Ok(Known::Pending(Pending::new(Work::Weighted(Weighted {
            input,
            depthwise: false,
            kernel: 1,
            stride: 1,
            padding: [0; 2],
            weights,
            bias: self.bias(node, shape[0])?,
            scales,
        }))))
    }

    fn add(&self, node: &'g Node) -> Result<Known, ConvertError> {
        Ok(Known::Pending(Pending::new(Work::Sum([
            self.tensor(node, 0)?,
            self.tensor(node, 1)?,
        ]))))
    }

    fn bounds(&self, node: &'g Node) -> Result<(f32, f32), ConvertError> {
        let bound = |n: usize, otherwise: f32| match node.inputs.get(n) {
            Some(name) if !name.is_empty() => match self.lookup.f32s(node, n)?[..] {
                [bound] if bound.is_finite() => Ok(bound),
                _ => Err(refused(node, "its bounds are not single numbers")),
            },
            Some(_) | None => Ok(otherwise),
        };
        Ok((bound(1, f32::NEG_INFINITY)?, bound(2, f32::INFINITY)?))
    }

    fn clipped(&self, node: &'g Node, low: f32, high: f32) -> Result<Known, ConvertError> {
        match self.value(node, 0)? {
            Known::Pending(pending) => Ok(Known::Pending(Pending {
                low: pending.low.max(low),
                high: pending.high.min(high),
                ..pending.clone()
            })),
            Known::Input(_) | Known::Tensor(_) => Err(refused(
                node,
                "clips what is quantised; it belongs before the quantisation",
            )),
        }
    }
}
