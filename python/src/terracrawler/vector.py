"""Many worlds in one call, as a vector environment of Gymnasium."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from . import spaces
from .worlds import ACT, REST, TRAIN, Randomisation, Worlds

Observations = NDArray[np.float32]
Actions = NDArray[np.int64]


class VectorEnv(gymnasium.vector.VectorEnv[Observations, Actions, NDArray[Any]]):
    """Worlds side by side, each robot of which is an environment: they share a policy, as in ``terracrawler train``.

    Environments ``3 * i`` to ``3 * i + 2`` are the robots of world ``i``, where a world has three of them. Their
    episodes begin and end together. All worlds advance in one message, however many there are.

    Args:
        worlds: how many.
        autoreset_mode: ``NEXT_STEP`` or ``SAME_STEP``, as Gymnasium has them.
        others: as for :class:`Worlds`.

    ``info["succeeded"]`` says for each environment whether its episode has reached its goal. With ``SAME_STEP`` and
    where episodes have ended, ``info["final_obs"]`` has what was observed last.

    """

    def __init__(
        self,
        worlds: int = 1,
        *,
        teammates: str | os.PathLike[str] | None = None,
        randomisation: Randomisation = "none",
        evaluation: bool = False,
        threads: int | None = None,
        program: str | os.PathLike[str] | None = None,
        autoreset_mode: AutoresetMode = AutoresetMode.NEXT_STEP,
    ) -> None:
        if autoreset_mode not in (AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP):
            raise ValueError("worlds begin their next episode by themselves")
        self.metadata = {"render_modes": [], "autoreset_mode": autoreset_mode}
        self._same_step = autoreset_mode == AutoresetMode.SAME_STEP
        self._worlds = Worlds(
            worlds,
            teammates=teammates,
            randomisation=randomisation,
            evaluation=evaluation,
            threads=threads,
            program=program,
        )
        sizes = self._worlds.sizes
        self._shape = (sizes.worlds, sizes.agents)
        self.num_envs = sizes.worlds * sizes.agents
        self.single_observation_space = spaces.observation(sizes)
        self.single_action_space = spaces.action(sizes)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def reset(
        self,
        *,
        seed: int | Sequence[int] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observations, dict[str, Any]]:
        """Begin the next episode of every world, or the first ones of a seed; see :meth:`Worlds.seed`.

        A sequence has a seed for each *world*.
        """
        super().reset(seed=seed if isinstance(seed, int) else None, options=options)
        answer = self._worlds.reset(seed)
        return self._flat(answer.observations), {"succeeded": np.zeros(self.num_envs, np.bool_)}

    def step(
        self, actions: Actions
    ) -> tuple[Observations, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Let 100 ms pass in every world; with ``NEXT_STEP`` the next episode begins where the last one has ended."""
        actions = np.asarray(actions)
        if actions.shape != (self.num_envs,):
            raise ValueError(f"actions have the shape {actions.shape}, not {(self.num_envs,)}")
        orders = np.where(self._worlds.running, ACT, TRAIN).astype(np.uint8)
        answer = self._worlds.advance(orders, actions.reshape(self._shape))
        observations = self._flat(answer.observations)
        infos: dict[str, Any] = {"succeeded": self._each(answer.succeeded)}
        over = answer.over
        if self._same_step and over.any():
            ended = self._each(over)
            final = np.full(self.num_envs, None, dtype=object)
            for place in np.flatnonzero(ended):
                final[place] = observations[place].copy()
            infos |= {
                "final_obs": final,
                "_final_obs": ended,
                "final_info": {"succeeded": infos["succeeded"], "_succeeded": ended},
                "_final_info": ended,
            }
            begun = self._worlds.advance(np.where(over, TRAIN, REST).astype(np.uint8))
            observations = self._flat(begun.observations)
        rewards = answer.rewards.reshape(-1).astype(np.float64)
        return observations, rewards, self._each(answer.terminated), self._each(answer.truncated), infos

    def _each(self, of_worlds: NDArray[np.bool_]) -> NDArray[np.bool_]:
        return np.repeat(of_worlds, self._shape[1])

    def _flat(self, observations: Observations) -> Observations:
        return observations.reshape(self.num_envs, -1)

    def close_extras(self, **kwargs: Any) -> None:  # noqa: ANN401
        """End the program."""
        self._worlds.close()
