"""Worlds as plain arrays: seeds, what is refused, and how they end."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from terracrawler import Answer, EpisodeOverError, ProgramEndedError, ProgramNotFoundError, Worlds, find_program
from terracrawler.worlds import ACT, EVALUATE, REST, TRAIN


def gone(process_id: int) -> bool:
    """Whether a process has ended, and somebody has taken note."""
    try:
        os.kill(process_id, 0)
    except ProcessLookupError:
        return True
    return False


def test_seeds_of_training_and_evaluation_never_meet() -> None:
    def begun(worlds: Worlds, episodes: int) -> set[bytes]:
        answers = [worlds.reset(1 if episode == 0 else None) for episode in range(episodes)]
        return {one.tobytes() for answer in answers for one in answer.observations}

    with Worlds(4) as training, Worlds(4, evaluation=True) as evaluation:
        learned, judged = begun(training, 5), begun(evaluation, 5)
        assert len(learned) == len(judged) == 20
        assert not learned & judged
        # Whatever is said.
        orders = np.full(4, TRAIN, np.uint8)
        evaluation.seed(1)
        first = evaluation.advance(orders)
        evaluation.seed(1)
        assert np.array_equal(evaluation.advance(np.full(4, EVALUATE, np.uint8)).observations, first.observations)


def test_seeds_say_which_episodes_come() -> None:
    def first(worlds: Worlds, seed: int | list[int] | None) -> list[bytes]:
        return [one.tobytes() for one in worlds.reset(seed).observations]

    with Worlds(3) as training, Worlds(3, evaluation=True) as evaluation:
        # World by world, and one after the other.
        one, two = first(training, 9), first(training, None)
        assert len({*one, *two}) == 6
        assert first(training, 9) == one
        assert first(training, [9, 9, 8])[:2] == [one[0], one[0]]
        # In turns.
        assert first(evaluation, 0) + first(evaluation, None) == first(evaluation, 0) + first(evaluation, 3)
        assert first(evaluation, [4, 1, 1])[1:] == [first(evaluation, 1)[0]] * 2
        # Nobody had it before.
        training.seed(None)
        assert first(training, None) != one
        for wrong in (-1, 1 << 64, [1, 2]):
            with pytest.raises(ValueError, match="seed"):
                training.seed(wrong)
        with pytest.raises(ValueError, match="seed"):
            evaluation.seed(1 << 32)
        training.reset((1 << 64) - 1)


def test_what_cannot_be_is_refused_before_it_is_asked() -> None:
    with Worlds(2) as worlds:
        with pytest.raises(EpisodeOverError, match="world 0"):
            worlds.step(np.zeros((2, 3), int))
        worlds.reset(1)
        for actions in ([[0, 0, 0]], np.zeros((2, 3)), np.full((2, 3), np.nan), [[0, 0, 7]] * 2, [[0, -1, 0]] * 2):
            with pytest.raises(ValueError, match="action"):
                worlds.step(actions)
        with pytest.raises(ValueError, match="takes actions"):
            worlds.advance(np.zeros(2, np.uint8))
        with pytest.raises(ValueError, match="orders"):
            worlds.advance(np.zeros(3, np.uint8))
        # It is there still.
        assert worlds.step(np.zeros((2, 3), int)).observations.shape == (2, 3, 48)


def test_a_world_is_left_alone_and_an_answer_stays_as_it_was() -> None:
    def kept(answer: Answer) -> bytes:
        return answer.observations.tobytes() + answer.rewards.tobytes()

    with Worlds(2, states=True) as worlds:
        begun = worlds.reset(1)
        before = kept(begun)
        after = worlds.advance(np.array([ACT, REST], np.uint8), np.full((2, 3), 2))
        assert kept(begun) == before
        assert np.array_equal(after.observations[1], begun.observations[1])
        assert not np.array_equal(after.observations[0], begun.observations[0])
        assert not after.rewards[1].any()
        assert after.states is not None
        assert after.states.shape == (2, 3, worlds.sizes.state)
        assert np.array_equal(after.states[..., :48], after.observations)
        after.observations[:] = 0


def test_randomisation_and_teammates_make_other_worlds() -> None:
    def begun(**options: str) -> bytes:
        with Worlds(1, **options) as worlds:  # type: ignore[arg-type]
            worlds.reset(2)
            agents = worlds.sizes.agents
            for _ in range(20):
                answer = worlds.step(np.full((1, agents), 2))
            return bytes(answer.observations[0, 0])

    assert len({begun(), begun(randomisation="wild"), begun(teammates="spread")}) == 3


def test_it_ends_with_the_block_with_close_and_as_garbage() -> None:
    with Worlds() as worlds:
        worlds.reset()
        process_id = worlds.process_id
    assert worlds.closed and gone(process_id)
    worlds.close()
    with pytest.raises(ProgramEndedError, match="closed"):
        worlds.reset()
    worlds = Worlds()
    process_id = worlds.process_id
    del worlds
    gc.collect()
    assert gone(process_id)


def test_it_ends_with_who_started_it() -> None:
    text = "import terracrawler, os; w = terracrawler.Worlds(); w.reset(); print(w.process_id, flush=True); os._exit(3)"
    ended = subprocess.run([sys.executable, "-c", text], stdout=subprocess.PIPE, check=False)
    assert ended.returncode == 3
    process_id = int(ended.stdout)
    # Its input has ended; it is waited for by somebody else, if at all.
    stat = Path(f"/proc/{process_id}/stat")
    for _ in range(600):
        if gone(process_id) or (stat.exists() and stat.read_text().split()[2] == "Z"):
            return
        subprocess.run(["sleep", "0.1"], check=True)
    raise AssertionError("the program is still there")


def test_the_program_is_found_or_it_is_said_how_to_get_it(monkeypatch: pytest.MonkeyPatch, program: Path) -> None:
    assert find_program(program) == program
    monkeypatch.setenv("TERRACRAWLER", str(program))
    monkeypatch.setenv("PATH", "")
    assert find_program() == program
    with pytest.raises(ProgramNotFoundError, match=r"program is '/no/such'.*cargo build"):
        find_program("/no/such")
    monkeypatch.setenv("TERRACRAWLER", "/no/such")
    with pytest.raises(ProgramNotFoundError, match="TERRACRAWLER is '/no/such'"):
        Worlds()
    monkeypatch.delenv("TERRACRAWLER")
    with pytest.raises(ProgramNotFoundError, match=r"search path.*cargo build"):
        find_program()
    monkeypatch.setenv("PATH", str(program.parent))
    assert find_program() == program


def test_what_the_program_says_last_is_told() -> None:
    with pytest.raises(ProgramEndedError, match=r"exit code 2(.|\n)*--worlds"):
        Worlds(0)
    with pytest.raises(ProgramEndedError, match=r"exit code 2(.|\n)*--teammates nobody"):
        Worlds(teammates="nobody")
