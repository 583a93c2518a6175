"""Examples are carried out: those of the pages, and the files."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = ["docs/learning.md", "python/README.md"]


def blocks(page: str) -> list[str]:
    return re.findall(r"^```python\n(.*?)^```", (ROOT / page).read_text(), re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("page", PAGES)
def test_examples_of_the_pages_run(page: str, capsys: pytest.CaptureFixture[str]) -> None:
    found = blocks(page)
    assert found, f"{page} has no example"
    for block in found:
        exec(compile(block, page, "exec"), {"__name__": "__main__"})
        assert capsys.readouterr().out


def test_speed_is_measured(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["speed.py", "--decisions", "300"])
    runpy.run_path(str(ROOT / "python/examples/speed.py"), run_name="__main__")
    assert "64 worlds" in capsys.readouterr().out
