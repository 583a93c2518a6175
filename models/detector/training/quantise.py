"""Turns trained weights into int8 and writes them as ONNX.

    python3 quantise.py DATASET WEIGHTS.npz OUT.onnx

Scales of tensors are powers of two; scales of weights are, for each output channel, such that a
sum turns into an output by one multiplication with m = 1 to 255 and a shift. Every product of sum
and m stays below 2^24, so that engines which compute in f32 are exact too. Prints F1 on the test
split before and after.
"""

import argparse
from dataclasses import dataclass, field

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper

from data import CELLS, CLASSES, SIDE, Split
from net import CEILING, load, normalised
from scores import judged
from train import logits_of

LIMIT = 2**24
CLIPPED_SCALE = 2.0**-6
INPUT_SCALE = 2.0**-7
assert CEILING == 255 * CLIPPED_SCALE


@dataclass
class Tensor:
    name: str
    scale: float
    zero: int


@dataclass
class Conv:
    """y = clamp(zero + round(acc * m / 2^s))"""

    name: str
    source: str
    weight: torch.Tensor
    bias: torch.Tensor
    stride: int
    groups: int
    clip: bool
    integers: dict = field(default_factory=dict)


@dataclass
class Add:
    name: str
    source: str
    other: str


def folded(unit):
    """Weights and bias of a convolution with its normalisation folded in, in f64."""
    conv, norm = unit[0], unit[1]
    gain = norm.weight.double() / (norm.running_var.double() + norm.eps).sqrt()
    weight = conv.weight.double() * gain[:, None, None, None]
    return weight, norm.bias.double() - norm.running_mean.double() * gain


def layers_of(net):
    """The network as a list, each naming the tensors it looks at."""
    layers = []

    def add_unit(name, source, unit):
        weight, bias = folded(unit)
        conv = unit[0]
        layers.append(Conv(name, source, weight, bias, conv.stride[0], conv.groups, len(unit) == 3))
        return name

    last = add_unit("stem", "input", net.stem)
    for number, block in enumerate(net.blocks, 1):
        before = last
        for step, unit in enumerate(block.layers, 1):
            last = add_unit(f"block{number}.{step}", last, unit)
        if block.shortcut:
            layers.append(Add(f"block{number}.sum", before, last))
            last = layers[-1].name
    last = add_unit("head", last, net.head)
    classify = net.classify
    weight, bias = classify.weight.double(), classify.bias.double()
    layers.append(Conv("logits", last, weight, bias, 1, 1, False))
    return layers


def convolved(layer, x, weight, bias):
    kernel = weight.shape[-1]
    return torch.nn.functional.conv2d(x, weight, bias, layer.stride, kernel // 2, 1, layer.groups)


def float_tensors(layers, frames):
    """All tensors in f32, for their ranges."""
    made = {"input": normalised(frames)}
    for layer in layers:
        if isinstance(layer, Add):
            made[layer.name] = made[layer.source] + made[layer.other]
        else:
            y = convolved(layer, made[layer.source], layer.weight.float(), layer.bias.float())
            made[layer.name] = y.clamp(0, CEILING) if layer.clip else y
    return made


def scales(layers, frames):
    tensors = {"input": Tensor("input", INPUT_SCALE, 0)}
    clipped = {layer.name for layer in layers if isinstance(layer, Conv) and layer.clip}
    for name, values in float_tensors(layers, frames).items():
        if name in clipped:
            tensors[name] = Tensor(name, CLIPPED_SCALE, -128)
        elif name != "input":
            tensors[name] = Tensor(name, finest(values.flatten()[:8_000_000:7]), 0)
    return tensors


def finest(values):
    """The scale with the least squared error: clipping a few values may be worth a finer step of all
    others."""
    widest = np.ceil(np.log2(max(values.abs().max().item(), 1e-6) / 127))

    def error(scale):
        return ((values / scale).round().clamp(-128, 127) * scale - values).square().mean().item()

    return min((2.0 ** (widest - finer) for finer in range(4)), key=error)


def quantised_conv(layer, source, target):
    """Integer weights, bias, m and s of every output channel."""
    low = (-128 - source.zero, 127 - source.zero)
    weights, biases, multipliers, shifts = [], [], [], []
    for weight, bias in zip(layer.weight.numpy(), layer.bias.numpy()):
        for bits in range(8, 0, -1):
            least = max(np.abs(weight).max() / 127, 1e-12) * source.scale / target.scale
            shift = int(np.floor(np.log2((2**bits - 1) / least)))
            shift = min(max(shift, 1), 24)
            m = int(np.ceil(least * 2.0**shift))
            if m > 255:
                raise ValueError(f"{layer.name}: weights too large for their scales")
            step = m * 2.0**-shift * target.scale / source.scale
            q = np.clip(np.rint(weight / step), -127, 127).astype(np.int64)
            b = int(np.rint(bias / (source.scale * step)))
            most = np.where(q > 0, q * low[1], q * low[0]).sum()
            least_sum = np.where(q > 0, q * low[0], q * low[1]).sum()
            if (max(abs(most), abs(least_sum)) + abs(b)) * m < LIMIT:
                break
        else:
            raise ValueError(f"{layer.name}: sums too large")
        weights.append(q)
        biases.append(b)
        multipliers.append(m)
        shifts.append(shift)
    return {
        "weight": np.array(weights),
        "bias": np.array(biases),
        "m": np.array(multipliers),
        "s": np.array(shifts),
    }


def integer_logits(layers, tensors, split, batch=128):
    """The int8 network in exact arithmetic: integers in f64."""
    outputs = []
    for at in range(0, len(split), batch):
        frames = torch.from_numpy(np.array(split.frames[at : at + batch]))
        made = {"input": frames.permute(0, 3, 1, 2).double() - 128}
        for layer in layers:
            target = tensors[layer.name]
            if isinstance(layer, Add):
                parts = [(tensors[name], made[name]) for name in (layer.source, layer.other)]
                y = sum((x - one.zero) * (one.scale / target.scale) for one, x in parts)
            else:
                source, numbers = tensors[layer.source], layer.integers
                x = made[layer.source] - source.zero
                bias = torch.from_numpy(numbers["bias"]).double()
                y = convolved(layer, x, torch.from_numpy(numbers["weight"]).double(), bias)
                gain = torch.from_numpy(numbers["m"] * 2.0 ** -numbers["s"].astype(float))
                y = y * gain[None, :, None, None]
            made[layer.name] = (y.round() + target.zero).clamp(-128, 127)
        outputs.append(made[layers[-1].name])
    return torch.cat(outputs).numpy()


class Graph:
    """An ONNX graph in QDQ form: int8 between layers, f32 inside."""

    def __init__(self):
        self.nodes, self.constants = [], []

    def constant(self, name, value):
        self.constants.append(numpy_helper.from_array(np.asarray(value), name))
        return name

    def node(self, kind, inputs, output, **attributes):
        node = helper.make_node(kind, inputs, [output], name=f"{kind}:{output}", **attributes)
        self.nodes.append(node)
        return output

    def quantised(self, value, tensor):
        """int8 of a tensor, and f32 of that, which layers look at."""
        scale = self.constant(f"{tensor.name}.scale", np.float32(tensor.scale))
        zero = self.constant(f"{tensor.name}.zero", np.int8(tensor.zero))
        q = self.node("QuantizeLinear", [value, scale, zero], f"{tensor.name}.q")
        return self.node("DequantizeLinear", [q, scale, zero], f"{tensor.name}.dq")


def exported(layers, tensors):
    graph = Graph()
    seen = {"input": graph.quantised("input", tensors["input"])}
    for layer in layers:
        target = tensors[layer.name]
        if isinstance(layer, Add):
            y = graph.node("Add", [seen[layer.source], seen[layer.other]], f"{layer.name}.sum")
        else:
            source, numbers = tensors[layer.source], layer.integers
            step = numbers["m"] * 2.0 ** -numbers["s"].astype(float) * target.scale / source.scale
            names = [
                graph.constant(f"{layer.name}.w", numbers["weight"].astype(np.int8)),
                graph.constant(f"{layer.name}.w.scale", step.astype(np.float32)),
                graph.constant(f"{layer.name}.w.zero", np.zeros(len(step), np.int8)),
            ]
            weight = graph.node("DequantizeLinear", names, f"{layer.name}.w.dq", axis=0)
            bias = graph.constant(
                f"{layer.name}.b", (numbers["bias"] * step * source.scale).astype(np.float32)
            )
            kernel = layer.weight.shape[-1]
            y = graph.node(
                "Conv",
                [seen[layer.source], weight, bias],
                f"{layer.name}.y",
                kernel_shape=[kernel] * 2,
                strides=[layer.stride] * 2,
                pads=[kernel // 2] * 4,
                group=layer.groups,
            )
        seen[layer.name] = graph.quantised(y, target)
    output = graph.node("Identity", [seen[layers[-1].name]], "output")
    model = helper.make_model(
        helper.make_graph(
            graph.nodes,
            "detector",
            [helper.make_tensor_value_info("input", TensorProto.FLOAT, [1, 3, SIDE, SIDE])],
            [helper.make_tensor_value_info(output, TensorProto.FLOAT, [1, len(CLASSES), CELLS, CELLS])],
            graph.constants,
        ),
        opset_imports=[helper.make_opsetid("", 13)],
        producer_name="terracrawler",
    )
    model.ir_version = 8
    helper.set_model_props(model, {"labels": ",".join(CLASSES)})
    onnx.checker.check_model(model)
    return model


def told(name, tally):
    each, every = tally.f1()
    parts = ", ".join(f"{kind} {f1:.4f}" for kind, f1 in zip(CLASSES[1:], each))
    print(f"{name}: F1 {every:.4f} ({parts})")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dataset")
    parser.add_argument("weights")
    parser.add_argument("out")
    parser.add_argument("--margin", type=int, default=16, help="least lead of a class, steps")
    args = parser.parse_args()
    torch.set_num_threads(1)
    net = load(args.weights)
    layers = layers_of(net)
    check, test = Split(f"{args.dataset}/check"), Split(f"{args.dataset}/test")
    with torch.no_grad():
        tensors = scales(layers, torch.from_numpy(np.array(check.frames[:256])))
        for layer in layers:
            if isinstance(layer, Conv):
                source, target = tensors[layer.source], tensors[layer.name]
                layer.integers = quantised_conv(layer, source, target)
        step = tensors["logits"].scale
        told("float", judged(test, logits_of(net, test), args.margin * step))
        told("int8", judged(test, integer_logits(layers, tensors, test), args.margin))
    onnx.save(exported(layers, tensors), args.out)


if __name__ == "__main__":
    main()
