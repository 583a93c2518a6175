"""Any number of worlds, as plain arrays."""

from __future__ import annotations

import os
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import pipe
from .errors import EpisodeOverError, ProtocolError
from .program import find_program

Floats = NDArray[np.float32]
Flags = NDArray[np.bool_]

Randomisation = Literal["none", "mild", "wild"]

# What a world is told.
ACT = 0
TRAIN = 1
EVALUATE = 2
REST = 3

_SEED = np.dtype([("run", "<u8"), ("world", "<u4"), ("episode", "<u4")])
_MOST_RUN = (1 << 64) - 1
_MOST_NUMBER = (1 << 32) - 1


@dataclass(frozen=True)
class Sizes:
    """How many there are of everything."""

    worlds: int
    #: Robots of each world that learn.
    agents: int
    #: Numbers that one of them observes.
    observation: int
    #: Numbers that a privileged critic sees for one of them.
    state: int
    #: Actions to choose from.
    actions: int
    #: What the task is called.
    name: str


@dataclass(frozen=True)
class Answer:
    """What the worlds answer. Arrays are new ones each time, and may be kept or written to."""

    #: ``[worlds, agents, observation]``
    observations: Floats
    #: ``[worlds, agents]``; 0 where a world did not act.
    rewards: Floats
    #: ``[worlds, agents, state]`` where it was asked for.
    states: Floats | None
    #: ``[worlds]``: the episode has come to its end.
    terminated: Flags
    #: ``[worlds]``: the episode was broken off.
    truncated: Flags
    #: ``[worlds]``: and it had reached its goal.
    succeeded: Flags

    @property
    def over(self) -> Flags:
        """``[worlds]``: whether there is no episode that goes on."""
        return self.terminated | self.truncated


class Worlds:
    """Worlds side by side, each of which is told in one call to act, to begin an episode, or nothing.

    Args:
        worlds: how many.
        teammates: one robot of each world learns, and the others drive by this policy: ``"spread"``, which comes with
            the robot program, or a file that ``terracrawler train`` has written. Where it is not given, all robots
            learn.
        randomisation: how far the parameters of each world differ from the nominal ones.
        evaluation: episodes are those of evaluation, which nothing ever learns from.
        states: also ask for what a privileged critic sees.
        threads: of the program; they change nothing but the time it takes.
        program: the program ``terracrawler``; see :mod:`terracrawler.program`.
        arguments: in place of ``gym`` with the options above, for another program that speaks the protocol.

    The worlds end with :meth:`close`, as a context manager, and when they are garbage.

    """

    def __init__(
        self,
        worlds: int = 1,
        *,
        teammates: str | os.PathLike[str] | None = None,
        randomisation: Randomisation = "none",
        evaluation: bool = False,
        states: bool = False,
        threads: int | None = None,
        program: str | os.PathLike[str] | None = None,
        arguments: Sequence[str] | None = None,
    ) -> None:
        words = ["gym", "--worlds", str(worlds), "--randomisation", randomisation]
        if teammates is not None:
            words += ["--teammates", os.fspath(teammates)]
        if threads is not None:
            words += ["--threads", str(threads)]
        self.evaluation = evaluation
        self._states = states
        self._pipe = pipe.Pipe(find_program(program), words if arguments is None else arguments)
        try:
            self.sizes = self._hello()
        except BaseException:
            self._pipe.close()
            raise
        self._running: Flags = np.zeros(self.sizes.worlds, np.bool_)
        # Of the next episode of each world.
        self._seeds = np.zeros(self.sizes.worlds, _SEED)
        self.seed(None)

    def _hello(self) -> Sizes:
        hello = pipe.MAGIC + struct.pack("<HB", pipe.VERSION, int(self._states))
        self._pipe.send(pipe.HELLO, hello)
        body = self._pipe.receive(pipe.HELLO, None)
        if body[:4] != pipe.MAGIC:
            raise ProtocolError("the program is none that this package speaks to")
        version = int.from_bytes(body[4:6], "little")
        if version != pipe.VERSION:
            raise ProtocolError(f"the program speaks version {version} of the protocol, this package {pipe.VERSION}")
        if len(body) < 26:
            raise ProtocolError("the program says hello in too few words")
        worlds, agents, observation, state, actions = struct.unpack_from("<5I", body, 6)
        name = body[26:].decode(errors="replace")
        return Sizes(worlds, agents, observation, state, actions, name)

    @property
    def closed(self) -> bool:
        """Whether they were ended."""
        return self._pipe.closed

    @property
    def process_id(self) -> int:
        """The number that the system gave the program."""
        return self._pipe.process_id

    @property
    def running(self) -> Flags:
        """``[worlds]``: whether a world has an episode that goes on."""
        return self._running.copy()

    def seed(self, seed: int | Sequence[int] | None) -> None:
        """Say which episodes come next.

        In training a seed names a run. World ``i`` gets the episodes that ``terracrawler train --seed SEED`` draws for
        its world ``i``, one after the other; with a seed for each world, each gets those of the first world of that
        run. ``None`` is a run that nobody had before.

        In evaluation a seed is a number. The worlds get the episodes from that number on, in turns; with a seed for
        each world, each gets those from its number on. ``None`` is 0: the episodes that policies of ``train`` are
        judged on.
        """
        places = np.arange(self.sizes.worlds)
        most = _MOST_NUMBER if self.evaluation else _MOST_RUN
        if seed is None:
            seed = 0 if self.evaluation else int.from_bytes(os.urandom(8), "little")
        each = not isinstance(seed, (int, np.integer))
        seeds = [int(one) for one in seed] if not isinstance(seed, (int, np.integer)) else [int(seed)] * len(places)
        if len(seeds) != len(places):
            raise ValueError(f"{len(seeds)} seeds for {len(places)} worlds")
        if not all(0 <= one <= most for one in seeds):
            raise ValueError(f"a seed is from 0 to {most}")
        self._seeds = np.zeros(len(places), _SEED)
        if self.evaluation:
            numbers = [(one + (0 if each else place)) & _MOST_NUMBER for place, one in enumerate(seeds)]
            self._seeds["episode"] = numbers
            self._stride = 1 if each else len(places)
        else:
            self._seeds["run"] = np.array(seeds, np.uint64)
            self._seeds["world"] = 0 if each else places
            self._stride = 1

    def reset(self, seed: int | Sequence[int] | None = None) -> Answer:
        """Begin an episode in every world: the next one, or the first one of :meth:`seed`."""
        if seed is not None:
            self.seed(seed)
        return self.advance(np.full(self.sizes.worlds, TRAIN, np.uint8))

    def step(self, actions: ArrayLike) -> Answer:
        """Act in every world. ``actions`` is ``[worlds, agents]``, whole numbers."""
        return self.advance(np.full(self.sizes.worlds, ACT, np.uint8), actions)

    def advance(self, orders: NDArray[np.uint8], actions: ArrayLike | None = None) -> Answer:
        """Tell each world :data:`ACT`, :data:`REST`, or to begin its next episode, which is any other order.

        Raises:
            EpisodeOverError: when a world is to act that has no episode.
            ValueError: when an action is none.

        """
        sizes = self.sizes
        orders = np.asarray(orders, np.uint8)
        if orders.shape != (sizes.worlds,):
            raise ValueError(f"orders have the shape {orders.shape}, not {(sizes.worlds,)}")
        act = orders == ACT
        begin = (orders == TRAIN) | (orders == EVALUATE)
        if np.any(act & ~self._running):
            world = int(np.flatnonzero(act & ~self._running)[0])
            raise EpisodeOverError(f"world {world} has no episode that goes on: reset first")
        if actions is None:
            told = np.zeros((sizes.worlds, sizes.agents), np.uint8)
            if act.any():
                raise ValueError("who acts takes actions")
        else:
            told = self._checked(np.asarray(actions), act)
        # Never those of the other kind, whatever was said.
        orders = np.where(begin, EVALUATE if self.evaluation else TRAIN, orders).astype(np.uint8)
        seeds = self._seeds[begin]
        self._pipe.send(pipe.ADVANCE, orders.tobytes() + told.tobytes() + seeds.tobytes())
        self._seeds["episode"][begin] += np.uint32(self._stride)
        return self._answer()

    def _checked(self, actions: NDArray[Any], act: Flags) -> NDArray[np.uint8]:
        sizes = self.sizes
        shape = (sizes.worlds, sizes.agents)
        if actions.shape != shape:
            raise ValueError(f"actions have the shape {actions.shape}, not {shape}")
        if not np.issubdtype(actions.dtype, np.integer):
            raise ValueError(f"actions are {actions.dtype}, not whole numbers")
        # What a world is not told is not looked at.
        told = np.where(act[:, None], actions, 0)
        if told.min() < 0 or told.max() >= sizes.actions:
            wrong = told[(told < 0) | (told >= sizes.actions)][0]
            raise ValueError(f"action {wrong} is none: there are {sizes.actions}")
        return told.astype(np.uint8)

    def _answer(self) -> Answer:
        sizes = self.sizes
        agents = sizes.worlds * sizes.agents
        shapes = [(sizes.observation,), ()] + ([(sizes.state,)] if self._states else [])
        counts = [agents * int(np.prod(shape, dtype=int)) for shape in shapes]
        body = self._pipe.receive(pipe.ADVANCE, 4 * sum(counts) + sizes.worlds)
        arrays: list[Floats] = []
        at = 0
        for shape, count in zip(shapes, counts, strict=True):
            values = np.frombuffer(body, "<f4", count, at)
            arrays.append(values.astype(np.float32, copy=False).reshape(sizes.worlds, sizes.agents, *shape))
            at += 4 * count
        statuses = np.frombuffer(body, np.uint8, sizes.worlds, at)
        ending = statuses & 3
        self._running = ending == 0
        return Answer(
            observations=arrays[0],
            rewards=arrays[1],
            states=arrays[2] if self._states else None,
            terminated=ending == 1,
            truncated=ending == 2,
            succeeded=statuses >= 4,
        )

    def close(self) -> None:
        """End the program; nothing when that was done before."""
        self._pipe.close()

    def __enter__(self) -> Worlds:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()
