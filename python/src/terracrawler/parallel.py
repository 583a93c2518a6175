"""The robots of one world, as a parallel environment of PettingZoo."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import pettingzoo
from gymnasium import spaces as gymnasium_spaces
from numpy.typing import NDArray

from . import spaces
from .errors import EpisodeOverError
from .worlds import Randomisation, Worlds

Observation = NDArray[np.float32]
Infos = dict[str, dict[str, Any]]


class ParallelEnv(pettingzoo.ParallelEnv[str, Observation, int]):
    """The robots of one world, ``robot_0`` to ``robot_2``: all of them learn, and act at once.

    Their episodes end together. :meth:`state` is what a privileged critic sees: what all robots observe, and where they
    really are.

    Args:
        randomisation: how far the parameters of each world differ from the nominal ones.
        evaluation: episodes are those of evaluation, which nothing ever learns from.
        program: the program ``terracrawler``; see :mod:`terracrawler.program`.

    """

    metadata: dict[str, Any] = {"name": "terracrawler_spread_v0", "render_modes": []}  # noqa: RUF012
    render_mode: str | None = None

    def __init__(
        self,
        *,
        randomisation: Randomisation = "none",
        evaluation: bool = False,
        program: str | os.PathLike[str] | None = None,
    ) -> None:
        self._worlds = Worlds(
            1,
            randomisation=randomisation,
            evaluation=evaluation,
            states=True,
            threads=1,
            program=program,
        )
        sizes = self._worlds.sizes
        self.possible_agents = [f"robot_{number}" for number in range(sizes.agents)]
        self.agents: list[str] = []
        self.observation_spaces: dict[str, gymnasium_spaces.Space[Observation]] = {
            agent: spaces.observation(sizes) for agent in self.possible_agents
        }
        self.action_spaces: dict[str, Any] = {agent: spaces.action(sizes) for agent in self.possible_agents}
        self.state_space = gymnasium_spaces.Box(-np.inf, np.inf, (sizes.agents * sizes.state,), np.float32)
        self._state: NDArray[np.float32] | None = None

    def observation_space(self, agent: str) -> gymnasium_spaces.Space[Observation]:
        """Say what a robot observes."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Any:  # noqa: ANN401
        """Say what a robot chooses from."""
        return self.action_spaces[agent]

    def reset(
        self,
        seed: int | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[dict[str, Observation], Infos]:
        """Begin the next episode, or the first one of a seed; see :meth:`Worlds.seed`. There are no options."""
        answer = self._worlds.reset(seed)
        self.agents = list(self.possible_agents)
        self._state = answer.states
        observations = dict(zip(self.agents, answer.observations[0], strict=True))
        return observations, {agent: {"succeeded": False} for agent in self.agents}

    def step(
        self, actions: dict[str, int]
    ) -> tuple[dict[str, Observation], dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """Let 100 ms pass."""
        agents = self.agents
        if not agents:
            raise EpisodeOverError("the episode is over: reset first")
        missing = [agent for agent in agents if agent not in actions]
        if missing:
            raise ValueError(f"no action of {', '.join(missing)}")
        answer = self._worlds.step([[actions[agent] for agent in agents]])
        terminated, truncated = bool(answer.terminated[0]), bool(answer.truncated[0])
        if terminated or truncated:
            self.agents = []
        self._state = answer.states
        succeeded = bool(answer.succeeded[0])
        return (
            dict(zip(agents, answer.observations[0], strict=True)),
            {agent: float(reward) for agent, reward in zip(agents, answer.rewards[0], strict=True)},
            dict.fromkeys(agents, terminated),
            dict.fromkeys(agents, truncated),
            {agent: {"succeeded": succeeded} for agent in agents},
        )

    def state(self) -> NDArray[np.float32]:
        """Say what a privileged critic sees of all robots, one after the other."""
        if self._state is None:
            raise EpisodeOverError("there is no episode: reset first")
        return self._state.reshape(-1).copy()

    def render(self) -> None:
        """Nothing is drawn: ``terracrawler evaluate --policy`` and the control room show what a policy does."""

    def close(self) -> None:
        """End the program."""
        self._worlds.close()


def parallel_env(**options: Any) -> ParallelEnv:  # noqa: ANN401
    """Make a :class:`ParallelEnv`, as PettingZoo calls it."""
    return ParallelEnv(**options)
