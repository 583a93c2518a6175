"""F1 of centroids: what a detector found against what there was."""

import numpy as np

from data import CELL, CELLS, CLASSES, LEAST_PIXELS

# A detection is right when its class is, and it is this near to the middle of the thing, in pixels,
# or this share of the radius that a disc of as many pixels has.
NEAR = 1.5 * CELL
NEAR_SHARE = 1.0
# The scale that is judged: a thing that covers two cells.
JUDGED_PIXELS = 2 * CELL * CELL
# Things of which less than this share is to be seen, because something stands before them or the
# picture ends, need not be found, and finding them is no false alarm.
JUDGED_VISIBLE = 0.5
JUDGED_INSIDE = 0.5


def merged(classes, margins):
    """Neighbouring cells of one class become one detection: (class, x, y, margin), weighted by
    margin. The same, step by step, as the program on the robot does it."""
    seen = classes == 0
    found = []
    for start in np.ndindex(CELLS, CELLS):
        if seen[start]:
            continue
        kind = classes[start]
        seen[start] = True
        cells, at = [start], 0
        while at < len(cells):
            row, column = cells[at]
            at += 1
            for next_row in range(max(row - 1, 0), min(row + 2, CELLS)):
                for next_column in range(max(column - 1, 0), min(column + 2, CELLS)):
                    cell = (next_row, next_column)
                    if not seen[cell] and classes[cell] == kind:
                        seen[cell] = True
                        cells.append(cell)
        weights = np.array([margins[cell] for cell in cells], np.float64) + 1.0
        rows, columns = np.array(cells, np.float64).T
        x = (weights @ columns / weights.sum() + 0.5) * CELL
        y = (weights @ rows / weights.sum() + 0.5) * CELL
        found.append((int(kind), x, y, max(margins[cell] for cell in cells)))
    return found


def decided(logits, least_margin):
    """Class and margin of every cell of (classes, cells, cells); 0 where the lead is small."""
    ordered = np.sort(logits, axis=0)
    margins = ordered[-1] - ordered[-2]
    classes = logits.argmax(axis=0)
    return np.where(margins >= least_margin, classes, 0), margins


class Tally:
    """Hits, misses and false alarms of each class."""

    def __init__(self):
        self.hits, self.misses, self.alarms = np.zeros((3, len(CLASSES)), np.int64)

    def add(self, things, found):
        left = sorted(found, key=lambda one: -one[3])
        used = [False] * len(left)
        # Judged ones choose first; the others excuse what was found of them.
        for kind, x, y, pixels, visible, inside in sorted(things, key=lambda thing: -thing[3]):
            judged = (
                pixels >= JUDGED_PIXELS and visible >= JUDGED_VISIBLE and inside >= JUDGED_INSIDE
            )
            reach = max(NEAR, NEAR_SHARE * np.sqrt(pixels / np.pi))
            best, nearest = None, reach
            for at, (found_kind, found_x, found_y, _) in enumerate(left):
                away = np.hypot(found_x - x, found_y - y)
                if not used[at] and found_kind == kind and away <= nearest:
                    best, nearest = at, away
            if best is not None:
                used[best] = True
            if judged:
                self.hits[kind] += best is not None
                self.misses[kind] += best is None
        for at, (kind, x, y, _) in enumerate(left):
            near_small = any(
                thing[0] == kind
                and thing[3] < max(JUDGED_PIXELS, LEAST_PIXELS)
                and np.hypot(thing[1] - x, thing[2] - y) <= NEAR
                for thing in things
            )
            if not used[at] and not near_small:
                self.alarms[kind] += 1

    def f1(self):
        """Of each class but nothing, and of all together."""
        hits, misses, alarms = self.hits[1:], self.misses[1:], self.alarms[1:]
        each = 2 * hits / np.maximum(2 * hits + misses + alarms, 1)
        every = 2 * hits.sum() / max(2 * hits.sum() + misses.sum() + alarms.sum(), 1)
        return each, every


def judged(split, logits, least_margin):
    """The tally of a whole split; logits are (frames, classes, cells, cells)."""
    tally = Tally()
    for things, of_frame in zip(split.things, logits):
        tally.add(things, merged(*decided(of_frame, least_margin)))
    return tally
