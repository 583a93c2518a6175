"""Tasks that everybody knows: ours are those of Gymnasium step for step, and what was learned in ours solves those.

``CRAWLER_CLASSIC`` is the example ``elsewhere`` of ``crawler-policy``, which has ours; without it nothing is held
against them.
"""

from __future__ import annotations

import os
import struct
import subprocess

import gymnasium
import numpy as np
import pytest
from numpy.typing import NDArray

from terracrawler import Worlds

PROGRAM = os.environ.get("CRAWLER_CLASSIC")
TASKS = {"cartpole": ("CartPole-v1", 0.05), "acrobot": ("Acrobot-v1", 0.1)}
# In Acrobot we observe speeds in half turns.
SCALES = {"cartpole": np.ones(4), "acrobot": np.array([1, 1, 1, 1, np.pi, np.pi])}

needs_program = pytest.mark.skipif(PROGRAM is None, reason="CRAWLER_CLASSIC is not said")


def draws(seed: int) -> list[float]:
    """Four numbers from -1 to 1 from a seed, as ours are drawn."""
    mask = (1 << 64) - 1
    numbers = []
    for _ in range(4):
        seed = (seed + 0x9E3779B97F4A7C15) & mask
        value = ((seed ^ (seed >> 30)) * 0xBF58476D1CE4E5B9) & mask
        value = ((value ^ (value >> 27)) * 0x94D049BB133111EB) & mask
        value ^= value >> 31
        numbers.append((value >> 11) / (1 << 52) - 1)
    return numbers


def state(task: str, observed: NDArray[np.float64]) -> NDArray[np.float64]:
    """Say what the state is of which this is observed."""
    if task == "cartpole":
        return observed
    cos_first, sin_first, cos_second, sin_second, *speeds = observed
    return np.array([np.arctan2(sin_first, cos_first), np.arctan2(sin_second, cos_second), *speeds])


@needs_program
@pytest.mark.parametrize("task", TASKS)
def test_ours_are_theirs_step_for_step(task: str) -> None:
    name, spread = TASKS[task]
    theirs = gymnasium.make(name)
    rng = np.random.default_rng(1)
    steps, furthest = 0, 0.0
    with Worlds(program=PROGRAM, arguments=["serve", task], evaluation=True) as ours:
        assert ours.sizes.name == task
        for number in range(30):
            answer = ours.reset(number)
            theirs.reset(seed=number)
            theirs.unwrapped.state = np.array(draws(number)) * spread  # type: ignore[attr-defined]
            # The first ones by chance, the others steadily: some fall soon, some are swung up, some go on to the end.
            steady = number % 3
            over, length = False, 0
            while not over:
                # A pole falls: what is rounded otherwise grows. From here on each step is one of its own.
                if length >= 100:
                    seen = answer.observations[0, 0] * SCALES[task]
                    theirs.unwrapped.state = state(task, seen)  # type: ignore[attr-defined]
                if steady == 0:
                    action = int(rng.integers(ours.sizes.actions))
                elif task == "cartpole":
                    seen = answer.observations[0, 0]
                    action = int(seen[2] + 0.3 * seen[3] + (0.02 * seen[0] + 0.05 * seen[1] if steady == 1 else 0) > 0)
                else:
                    action = 2 if answer.observations[0, 0, 5] > 0 else 0
                answer = ours.step([[action]])
                observed, reward, terminated, truncated, _ = theirs.step(action)
                own = answer.observations[0, 0] * SCALES[task]
                furthest = max(furthest, float(np.abs(own - observed).max()))
                assert np.allclose(own, observed, rtol=1e-5, atol=1e-5), (number, steps)
                assert answer.rewards[0, 0] == reward
                over = bool(answer.over[0])
                assert over == (terminated or truncated)
                if over:
                    # Both at once is an end for us.
                    assert bool(answer.terminated[0]) == terminated
                steps, length = steps + 1, length + 1
    theirs.close()
    print(f"{task}: {steps} steps, no further apart than {furthest:.1e}")
    assert steps > 1_000


@needs_program
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize(("task", "goal"), [("cartpole", 475.0), ("acrobot", -100.0)])
@pytest.mark.parametrize("algorithm", ["ppo", "dqn"])
def test_what_was_learned_in_ours_solves_theirs(
    algorithm: str, task: str, goal: float, seed: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert PROGRAM is not None
    env = gymnasium.make(TASKS[task][0])
    rewards: list[float] = []
    words = [PROGRAM, algorithm, task, str(seed)]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as program:
        assert program.stdin is not None
        assert program.stdout is not None
        while asked := program.stdout.read(1):
            earned, status = 0.0, 0
            if asked == b"r":
                (number,) = struct.unpack("<I", program.stdout.read(4))
                observed, _ = env.reset(seed=number)
                rewards.append(0.0)
            else:
                observed, reward, terminated, truncated, _ = env.step(program.stdout.read(1)[0])
                earned = float(reward)
                rewards[-1] += earned
                status = 1 if terminated else 2 if truncated else 0
            scaled = (np.asarray(observed) / SCALES[task]).astype("<f4")
            program.stdin.write(scaled.tobytes() + struct.pack("<fB", earned, status))
            program.stdin.flush()
    env.close()
    assert program.returncode == 0
    assert len(rewards) == 100
    mean = sum(rewards) / len(rewards)
    with capsys.disabled():
        print(f"\n{algorithm} {task}, seed {seed}: {mean:.1f} in Gymnasium's own")
    assert mean >= goal
