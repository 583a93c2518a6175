"""Frames and what is in them, as `cargo xtask dataset` writes them.

A split is a folder with two files:

* `frames.bin`: the frames, 96 x 96 pixels of red, green, blue, row by row;
* `truth.csv`: a line for each thing that shows: frame, class, x, y of the middle of its pixels
  (pixels from the left and from the top), number of pixels, share of it that is not hidden, share
  of it that lies within the picture.
"""

import csv
from pathlib import Path

import numpy as np

SIDE = 96
CELL = 8
CELLS = SIDE // CELL
CLASSES = ("nothing", "obstacle", "object", "robot")

# Which part of a thing, seen as a disc, its cells are labelled in.
CORE = 0.35
# Fewer pixels than this are no thing that has to be found, and nothing that must not be.
LEAST_PIXELS = 24


class Split:
    """One of train, check, test, or its first frames."""

    def __init__(self, folder, first=None):
        folder = Path(folder)
        frames = np.memmap(folder / "frames.bin", dtype=np.uint8, mode="r")
        self.frames = frames.reshape(-1, SIDE, SIDE, 3)[:first]
        self.things = [[] for _ in range(len(self.frames))]
        with open(folder / "truth.csv", newline="") as lines:
            for line in csv.DictReader(lines):
                if int(line["frame"]) >= len(self.things):
                    break
                self.things[int(line["frame"])].append(
                    (
                        CLASSES.index(line["class"]),
                        float(line["x"]),
                        float(line["y"]),
                        int(line["pixels"]),
                        float(line["visible"]),
                        float(line["inside"]),
                    )
                )

    def __len__(self):
        return len(self.frames)

    def labels(self):
        """Class of every cell, and how much it counts: (frames, cells, cells) each."""
        classes = np.zeros((len(self), CELLS, CELLS), np.int64)
        weights = np.ones((len(self), CELLS, CELLS), np.float32)
        middle = (np.arange(CELLS) + 0.5) * CELL
        for frame, things in enumerate(self.things):
            # What is small is written last, so that nothing large hides it.
            for kind, x, y, pixels, *_ in sorted(things, key=lambda thing: -thing[3]):
                radius = CORE * np.sqrt(pixels / np.pi)
                away = np.hypot(middle[None, :] - x, middle[:, None] - y)
                core = away <= radius
                core[min(int(y // CELL), CELLS - 1), min(int(x // CELL), CELLS - 1)] = True
                # Next to the core either answer will do.
                rim = (away <= radius + CELL) & ~core
                weights[frame][rim & (classes[frame] == 0)] = 0.3
                if pixels < LEAST_PIXELS:
                    weights[frame][core] = 0.0
                else:
                    classes[frame][core] = kind
                    weights[frame][core] = 1.0
        return classes, weights
