"""FOMO: a MobileNetV2 trunk cut at one eighth of the resolution, and a classifier for each cell.

Howard et al., "MobileNets" (2017); Sandler et al., "MobileNetV2" (2018); Edge Impulse, "FOMO"
(2022).
"""

import numpy as np
import torch
from torch import nn

from data import CLASSES

# Activations are clipped here instead of at 6: 0 to 255 steps of 1/64, so that int8 costs nothing.
CEILING = 255 / 64

# Channels of the stem; (expansion, channels, stride) of the blocks; channels of the head.
TRUNKS = {
    "nano": (8, [(1, 8, 1), (4, 12, 2), (4, 12, 1), (4, 24, 2)] + 3 * [(4, 24, 1)], 32),
    "small": (8, [(1, 8, 1), (4, 12, 2), (4, 12, 1), (4, 32, 2)] + 3 * [(4, 32, 1)], 48),
    "wide": (16, [(1, 16, 1), (4, 24, 2), (4, 24, 1), (4, 48, 2)] + 3 * [(4, 48, 1)], 64),
}


class Clip(nn.Module):
    """A rectifier with a ceiling."""

    def forward(self, x):
        return nn.functional.hardtanh(x, 0.0, CEILING, inplace=True)


def unit(inputs, outputs, kernel, stride=1, groups=1, clip=True):
    layers = [
        nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, groups=groups, bias=False),
        nn.BatchNorm2d(outputs),
    ]
    return nn.Sequential(*layers, Clip()) if clip else nn.Sequential(*layers)


class Block(nn.Module):
    """An inverted residual."""

    def __init__(self, inputs, expansion, outputs, stride):
        super().__init__()
        inner = inputs * expansion
        layers = [] if expansion == 1 else [unit(inputs, inner, 1)]
        layers.append(unit(inner, inner, 3, stride, groups=inner))
        layers.append(unit(inner, outputs, 1, clip=False))
        self.layers = nn.Sequential(*layers)
        self.shortcut = stride == 1 and inputs == outputs

    def forward(self, x):
        return x + self.layers(x) if self.shortcut else self.layers(x)


class Detector(nn.Module):
    """(batch, 3, 96, 96), each -1 to 1, to logits (batch, classes, 12, 12)."""

    def __init__(self, trunk="nano"):
        super().__init__()
        stem, blocks, head = TRUNKS[trunk]
        self.stem = unit(3, stem, 3, 2)
        channels = stem
        self.blocks = nn.ModuleList()
        for expansion, outputs, stride in blocks:
            self.blocks.append(Block(channels, expansion, outputs, stride))
            channels = outputs
        self.head = unit(channels, head, 1)
        self.classify = nn.Conv2d(head, len(CLASSES), 1)

    def forward(self, x):
        x = self.stem(x)
        for block in self.blocks:
            x = block(x)
        return self.classify(self.head(x))


def load(path):
    """The network of a file of weights, for use."""
    saved = np.load(path)
    net = Detector(str(saved["trunk"]))
    net.load_state_dict({name: torch.from_numpy(saved[name]) for name in net.state_dict()})
    return net.eval()


def prunable(net):
    """Of every block that widens: the norm of its depthwise layer, and the layer that reads it."""
    return [(block.layers[1][1], block.layers[2][0]) for block in net.blocks if len(block.layers) == 3]


def multiplications(net, pruned, side=96):
    """Multiplications of a run, with so many channels pruned of each block that widens."""
    side //= 2
    total = side**2 * net.stem[0].weight.numel()
    pruned = iter(pruned)
    for block in net.blocks:
        gone = next(pruned) if len(block.layers) == 3 else 0
        for layer in block.layers:
            convolution = layer[0]
            side //= convolution.stride[0]
            depthwise = convolution.groups > 1
            widened = convolution.in_channels if depthwise or layer is block.layers[-1] else convolution.out_channels
            total += side**2 * convolution.weight.numel() * (widened - gone) // widened
    for convolution in (net.head[0], net.classify):
        total += side**2 * convolution.weight.numel()
    return total


def normalised(frames):
    """Pixels as the network wants them: a tensor of bytes (batch, 96, 96, 3)."""
    return (frames.permute(0, 3, 1, 2).float() - 128.0) / 128.0
