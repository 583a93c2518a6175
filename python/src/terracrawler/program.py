"""Where the program is.

It is, in this order: what ``program`` says; what the environment variable ``TERRACRAWLER`` says; ``terracrawler`` on
the search path.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from .errors import ProgramNotFoundError

VARIABLE = "TERRACRAWLER"
NAME = "terracrawler"

_HOW = (
    "Build it in a clone of the repository with `cargo build --release -p crawler-server`, and put "
    f"target/release/{NAME} on the search path, or its path into the environment variable {VARIABLE}."
)


def find_program(program: str | os.PathLike[str] | None = None) -> Path:
    """Find the program.

    Raises:
        ProgramNotFoundError: with how to get it.

    """
    told = program if program is not None else os.environ.get(VARIABLE)
    if told:
        found = shutil.which(os.fspath(told))
        if found is None:
            source = "program" if program is not None else VARIABLE
            raise ProgramNotFoundError(f"{source} is {os.fspath(told)!r}, which is no program. {_HOW}")
        return Path(found)
    found = shutil.which(NAME)
    if found is None:
        raise ProgramNotFoundError(f"there is no {NAME} on the search path. {_HOW}")
    return Path(found)
