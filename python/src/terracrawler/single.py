"""One robot that learns, as an environment of Gymnasium."""

from __future__ import annotations

import os
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from . import spaces
from .worlds import Randomisation, Worlds

Observation = NDArray[np.float32]


class TerracrawlerEnv(gymnasium.Env[Observation, np.int64]):
    """One robot learns; its teammates drive by a policy that is fixed.

    The task is one of several robots: they are to get apart. Where only one of them learned and the others stood, or
    drove about, most worlds could not be solved, and whether one is would not be up to the learner. So the others do
    what ``spread`` does, the policy that every robot comes with, which solves nine of ten worlds where all robots
    drive by it. It is a part of the world: with the same seed and the same actions it does the same.

    Args:
        teammates: ``"spread"``, or a file that ``terracrawler train`` has written.
        randomisation: how far the parameters of each world differ from the nominal ones.
        evaluation: episodes are those of evaluation, which nothing ever learns from.
        program: the program ``terracrawler``; see :mod:`terracrawler.program`.

    ``info["succeeded"]`` says whether an episode has reached its goal.

    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012

    def __init__(
        self,
        *,
        teammates: str | os.PathLike[str] = "spread",
        randomisation: Randomisation = "none",
        evaluation: bool = False,
        program: str | os.PathLike[str] | None = None,
    ) -> None:
        self._worlds = Worlds(
            1,
            teammates=teammates,
            randomisation=randomisation,
            evaluation=evaluation,
            threads=1,
            program=program,
        )
        self.observation_space = spaces.observation(self._worlds.sizes)
        self.action_space = spaces.action(self._worlds.sizes)

    def reset(
        self,
        *,
        seed: int | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin the next episode, or the first one of a seed; see :meth:`Worlds.seed`. There are no options."""
        super().reset(seed=seed, options=options)
        answer = self._worlds.reset(seed)
        return answer.observations[0, 0], {"succeeded": False}

    def step(self, action: np.int64 | int) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Let 100 ms pass."""
        answer = self._worlds.step(np.array([[action]]))
        return (
            answer.observations[0, 0],
            float(answer.rewards[0, 0]),
            bool(answer.terminated[0]),
            bool(answer.truncated[0]),
            {"succeeded": bool(answer.succeeded[0])},
        )

    def render(self) -> None:
        """Nothing is drawn: ``terracrawler evaluate --policy`` and the control room show what a policy does."""

    def close(self) -> None:
        """End the program."""
        self._worlds.close()
