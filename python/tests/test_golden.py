"""The numbers are those of Rust, which its own tests have written down."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import terracrawler
from terracrawler.worlds import ACT, TRAIN

GOLDEN: dict[str, Any] = json.loads((Path(__file__).parent / "golden.json").read_text())


class Draws:
    """Actions that anybody can draw."""

    def __init__(self) -> None:
        self.state = 1

    def action(self, actions: int) -> int:
        self.state = (self.state * 1_664_525 + 1_013_904_223) % (1 << 32)
        return (self.state * actions) >> 32


@pytest.mark.parametrize(("what", "teammates"), [("all learn", None), ("one learns", "spread")])
@pytest.mark.parametrize("threads", [1, 2])
def test_numbers_are_those_of_rust(what: str, teammates: str | None, threads: int) -> None:
    expected = GOLDEN[what]
    draws = Draws()
    digest = hashlib.sha256()
    reward = 0.0
    with terracrawler.Worlds(GOLDEN["worlds"], teammates=teammates, states=True, threads=threads) as worlds:
        sizes = worlds.sizes
        worlds.seed(GOLDEN["run"])
        for step in range(GOLDEN["steps"]):
            actions = [[draws.action(sizes.actions) for _ in range(sizes.agents)] for _ in range(sizes.worlds)]
            orders = np.where(worlds.running, ACT, TRAIN).astype(np.uint8)
            answer = worlds.advance(orders, actions)
            if step == 0:
                whole = np.rint(answer.observations * 127).astype(np.int8)
                assert whole.reshape(-1).tolist() == expected["first"]
            statuses = answer.terminated + 2 * answer.truncated + 4 * answer.succeeded
            for part in (answer.observations, answer.rewards, statuses.astype(np.uint8)):
                digest.update(part.tobytes())
            reward += float(answer.rewards.astype(np.float64).sum())
    assert reward == pytest.approx(expected["reward"], abs=1e-9)
    assert digest.hexdigest() == expected["sha256"]


def test_every_environment_sees_the_same_episodes() -> None:
    from terracrawler import ParallelEnv, VectorEnv

    with terracrawler.Worlds(2) as worlds:
        plain = worlds.reset(11)
        acted = worlds.step([[1, 2, 3], [0, 6, 1]])
    vector = VectorEnv(2)
    observed, _ = vector.reset(seed=11)
    assert np.array_equal(observed, plain.observations.reshape(6, -1))
    observed, rewards, *_ = vector.step(np.array([1, 2, 3, 0, 6, 1]))
    assert np.array_equal(observed, acted.observations.reshape(6, -1))
    assert np.array_equal(rewards, acted.rewards.reshape(-1))
    vector.close()
    parallel = ParallelEnv()
    by_name, _ = parallel.reset(seed=11)
    assert all(np.array_equal(by_name[f"robot_{robot}"], plain.observations[0, robot]) for robot in range(3))
    by_name, earned, *_ = parallel.step({"robot_0": 1, "robot_1": 2, "robot_2": 3})
    assert all(np.array_equal(by_name[f"robot_{robot}"], acted.observations[0, robot]) for robot in range(3))
    assert list(earned.values()) == acted.rewards[0].tolist()
    parallel.close()
