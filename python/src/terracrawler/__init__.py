"""Worlds of Terracrawler to learn in.

The worlds are those that ``terracrawler train`` learns in: robots with the filters, the odometry, the observation and
the safety shield of the robot program, one decision every 100 ms. They are in a program of their own, to which this
package speaks over pipes: see :mod:`terracrawler.program` for how it is found.

=========================  =============================================================  ================
:class:`Worlds`            any number of worlds in one call, as plain arrays              numpy alone
:class:`VectorEnv`         the same for Gymnasium: each robot is an environment           ``[gymnasium]``
:class:`TerracrawlerEnv`   one robot that learns, its teammates drive by a policy         ``[gymnasium]``
:class:`ParallelEnv`       the robots of one world, all learn; also :func:`parallel_env`  ``[pettingzoo]``
=========================  =============================================================  ================

Episodes of training and of evaluation have nothing in common, whatever their seeds: an environment is made for one of
them (``evaluation=True``), and the program makes seeds of either kind in ways that never meet.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from .errors import EpisodeOverError, ProgramEndedError, ProgramNotFoundError, ProtocolError, TerracrawlerError
from .program import find_program
from .worlds import Answer, Sizes, Worlds

if TYPE_CHECKING:
    from .parallel import ParallelEnv, parallel_env
    from .single import TerracrawlerEnv
    from .vector import VectorEnv

__version__ = "0.1.0"

__all__ = [
    "Answer",
    "EpisodeOverError",
    "ParallelEnv",
    "ProgramEndedError",
    "ProgramNotFoundError",
    "ProtocolError",
    "Sizes",
    "TerracrawlerEnv",
    "TerracrawlerError",
    "VectorEnv",
    "Worlds",
    "find_program",
    "parallel_env",
]

# What takes more than numpy is imported when it is asked for.
_LATER = {
    "ParallelEnv": "parallel",
    "TerracrawlerEnv": "single",
    "VectorEnv": "vector",
    "parallel_env": "parallel",
}


def __getattr__(name: str) -> Any:  # noqa: ANN401
    module = _LATER.get(name)
    if module is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{module}", __name__), name)


def __dir__() -> list[str]:
    return sorted(__all__)
