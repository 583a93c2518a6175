"""How many decisions a second come over the pipe, and what of the time the program alone needs for its worlds.

``--alone`` is the example ``decisions`` of the repository (``cargo build --release -p crawler-learning --example
decisions`` builds it): the same worlds in Rust, without a pipe. Processor time is that of both processes together; so
the ratio does not depend on what else the machine does.
"""

from __future__ import annotations

import argparse
import re
import resource
import subprocess
import time

import numpy as np

from terracrawler import Worlds
from terracrawler.worlds import ACT, TRAIN


def processor() -> float:
    """Processor time of this process and of those that have ended, in seconds."""
    used = 0.0
    for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN):
        usage = resource.getrusage(who)
        used += usage.ru_utime + usage.ru_stime
    return used


def measure(worlds: int, decisions: int) -> tuple[float, float]:
    """Decisions per second, and per second of processor time."""
    rng = np.random.default_rng(1)
    used, done = processor(), 0
    with Worlds(worlds, threads=1) as served:
        agents = served.sizes.agents
        served.reset(1)
        begun = time.perf_counter()
        while done < decisions:
            running = served.running
            actions = rng.integers(0, served.sizes.actions, (worlds, agents), np.uint8)
            served.advance(np.where(running, ACT, TRAIN).astype(np.uint8), actions)
            done += agents * int(running.sum())
        took = time.perf_counter() - begun
    return done / took, done / (processor() - used)


def alone(program: str) -> float:
    """Decisions per second of processor time of the worlds alone."""
    said = subprocess.run([program], stdout=subprocess.PIPE, text=True, check=True).stdout
    found = re.match(r"(\d+) decisions per second of processor time", said)
    if found is None:
        raise SystemExit(f"{program} says something else: {said}")
    return float(found[1])


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--decisions", type=int, default=300_000)
    parser.add_argument("--alone", metavar="PROGRAM")
    options = parser.parse_args()
    base = alone(options.alone) if options.alone else None
    if base:
        print(f"alone: {base:,.0f} decisions per second of processor time")
    for worlds in (1, 16, 64):
        wall, used = measure(worlds, options.decisions)
        ratio = f", {used / base:.0%} of alone" if base else ""
        print(f"{worlds:3} worlds: {wall:,.0f} decisions/s, {used:,.0f} per second of processor time{ratio}")


if __name__ == "__main__":
    main()
