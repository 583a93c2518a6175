"""The program that the tests talk to."""

from __future__ import annotations

from pathlib import Path

import pytest

import terracrawler


@pytest.fixture(scope="session")
def program() -> Path:
    """Where it is; without it nothing here can be tested."""
    return terracrawler.find_program()
