"""The event file of ``terracrawler train`` is read by those who have made the format."""

from __future__ import annotations

import csv
import signal
import subprocess
from pathlib import Path

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.backend.event_processing.event_file_loader import LegacyEventFileLoader

ROUNDS = 60
ROUND = 4 * 3 * 128
COLUMNS = {
    "train/reward": "reward",
    "train/success": "success",
    "train/length": "length",
    "train/episodes": "episodes",
    "train/entropy": "entropy",
    "train/divergence": "divergence",
    "train/clipped": "clipped",
    "loss/policy": "loss",
    "loss/value": "critic",
    "shield/vetoes": "vetoes",
}


def test_a_training_that_was_killed_is_one_curve(program: Path, tmp_path: Path) -> None:
    options = ["--steps", str(ROUNDS * ROUND), "--worlds", "4", "--units", "4", "--threads", "1"]
    command = [str(program), "train", "--out", str(tmp_path), *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as training:
        assert training.stdout is not None
        # A line for each fifth round; there is a checkpoint of the tenth.
        for line in training.stdout:
            if line.split()[0] == "15":
                training.kill()
                break
    assert training.returncode == -signal.SIGKILL
    subprocess.run(command, stdout=subprocess.DEVNULL, check=True)

    (file,) = tmp_path.glob("*tfevents*")
    starts = [event.step for event in LegacyEventFileLoader(str(file)).Load() if event.HasField("session_log")]
    assert starts == [10 * ROUND + 1]

    events = EventAccumulator(str(tmp_path), size_guidance={"scalars": 0})
    events.Reload()
    tags = events.Tags()["scalars"]
    assert set(tags) == {*COLUMNS, "speed/steps_per_second"}
    speeds = events.Scalars("speed/steps_per_second")
    assert [event.step for event in speeds] == [round_ * ROUND for round_ in range(1, ROUNDS + 1)]
    with (tmp_path / "curve.csv").open() as curve:
        rows = list(csv.DictReader(curve))
    assert len(rows) == ROUNDS
    for tag, column in COLUMNS.items():
        told = {event.step: event.value for event in events.Scalars(tag)}
        wanted = {int(row["agent_steps"]): float(row[column]) for row in rows if row[column]}
        assert told == pytest.approx(wanted, rel=1e-6), tag
