"""What Gymnasium and PettingZoo ask of an environment."""

from __future__ import annotations

import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from pettingzoo.test import parallel_api_test, parallel_seed_test

from terracrawler import EpisodeOverError, ParallelEnv, TerracrawlerEnv, VectorEnv, parallel_env


def test_gymnasium_has_nothing_to_say() -> None:
    env = TerracrawlerEnv()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # It is made by its class, and not by a name.
        warnings.filterwarnings("ignore", message=".*[Ss]pec.*")
        check_env(env, skip_render_check=True)
    env.close()


def test_pettingzoo_has_nothing_to_say() -> None:
    env = ParallelEnv()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parallel_api_test(env, num_cycles=1000)
    env.close()
    parallel_seed_test(parallel_env, num_cycles=300)


def test_a_robot_has_to_be_told_and_only_while_there_is_an_episode() -> None:
    env = ParallelEnv()
    with pytest.raises(EpisodeOverError):
        env.step({})
    with pytest.raises(EpisodeOverError):
        env.state()
    env.reset(seed=1)
    assert env.state() in env.state_space
    with pytest.raises(ValueError, match="robot_2"):
        env.step({"robot_0": 0, "robot_1": 0})
    env.close()


def episodes(env: VectorEnv, steps: int) -> list[tuple[int, np.ndarray]]:
    """When episodes of the first world end, and what was observed first of the next ones."""
    rng = np.random.default_rng(1)
    env.reset(seed=5)
    begun = []
    same = env.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP
    ended = False
    for step in range(steps):
        observed, rewards, terminated, truncated, infos = env.step(rng.integers(0, 7, env.num_envs))
        if ended and not same:
            assert not rewards[:3].any()
            begun.append((step, observed[0]))
        ended = bool(terminated[0] or truncated[0])
        assert terminated[0] == terminated[1] == terminated[2]
        if ended and same:
            begun.append((step, observed[0]))
            assert infos["_final_obs"][:3].all()
            final = infos["final_obs"][0]
            assert not np.array_equal(final, observed[0])
    return begun


def test_worlds_begin_their_next_episode_by_themselves() -> None:
    with_next = VectorEnv(2)
    with_same = VectorEnv(2, autoreset_mode=AutoresetMode.SAME_STEP)
    first, second = episodes(with_next, 1_200), episodes(with_same, 1_200)
    assert len(first) > 1 and len(second) > 1
    # The same episodes follow each other.
    assert np.array_equal(first[0][1], second[0][1])
    for env in (with_next, with_same):
        assert env.num_envs == 6
        assert isinstance(env.single_action_space, gymnasium.spaces.Discrete)
        assert env.reset(seed=1)[0] in env.observation_space
        env.close()
    with pytest.raises(ValueError, match="themselves"):
        VectorEnv(autoreset_mode=AutoresetMode.DISABLED)


def test_wrappers_of_gymnasium_go_round_it() -> None:
    env = gymnasium.wrappers.vector.RecordEpisodeStatistics(VectorEnv(1))
    env.reset(seed=3)
    for _ in range(600):
        *_, terminated, truncated, infos = env.step(env.action_space.sample())
        if terminated[0] or truncated[0]:
            break
    assert infos["episode"]["l"][0] > 0
    env.close()
