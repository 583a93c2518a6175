"""What robots observe and choose from, as spaces of Gymnasium."""

from __future__ import annotations

from typing import cast

import numpy as np
from gymnasium import Space, spaces
from numpy.typing import NDArray

from .worlds import Sizes

# Numbers of 8 bits, of which 127 is one.
LOW = np.float32(-128) * np.float32(1 / 127)
HIGH = np.float32(1)


def observation(sizes: Sizes) -> Space[NDArray[np.float32]]:
    """Say what one robot observes."""
    box = spaces.Box(float(LOW), float(HIGH), (sizes.observation,), np.float32)
    return cast("Space[NDArray[np.float32]]", box)


def action(sizes: Sizes) -> Space[np.int64]:
    """Say what one robot chooses from."""
    return spaces.Discrete(sizes.actions)
