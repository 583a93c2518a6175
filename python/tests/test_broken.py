"""A program that is not what it should be: an error, no hanging, and no process that stays."""

from __future__ import annotations

import struct
import sys
from pathlib import Path

import numpy as np
import pytest

from terracrawler import ProgramEndedError, ProtocolError, Worlds, pipe

HELLO = b"TCGY" + struct.pack("<H5I", 1, 2, 3, 4, 0, 7) + b"test"
ANSWER = bytes(4 * 2 * 3 * (4 + 1)) + bytes([0, 0])


def frame(kind: int, body: bytes) -> bytes:
    return struct.pack("<IB", len(body) + 1, kind) + body


def answering(*frames: bytes, last: str = "") -> Worlds:
    """Worlds of a program that answers this, whatever it is asked, and then goes on with `last`."""
    text = (
        "import sys\n"
        f"for answer in {list(frames)!r}:\n"
        "    length = int.from_bytes(sys.stdin.buffer.read(4), 'little')\n"
        "    sys.stdin.buffer.read(length)\n"
        "    sys.stdout.buffer.write(answer)\n"
        "    sys.stdout.buffer.flush()\n"
        f"{last}\n"
    )
    return Worlds(program=sys.executable, arguments=["-c", text])


def test_a_program_that_answers_right_is_taken() -> None:
    worlds = answering(frame(1, HELLO), frame(2, ANSWER), last="sys.stdin.read()")
    assert (worlds.sizes.worlds, worlds.sizes.agents, worlds.sizes.name) == (2, 3, "test")
    assert worlds.reset().observations.shape == (2, 3, 4)
    worlds.close()


def test_the_program_is_of_another_version() -> None:
    with pytest.raises(ProtocolError, match="version 2 of the protocol, this package 1"):
        answering(frame(1, b"TCGY\x02\x00 and whatever it says more"))


@pytest.mark.parametrize(
    ("first", "why"),
    [
        (b"HTTP/1.1 400 Bad Request\r\n", "another version"),
        (b"\0\0\0\0\0", "empty"),
        (frame(1, b"HTTP" + HELLO[4:]), "none that this package speaks to"),
        (frame(1, HELLO[:20]), "too few words"),
        (frame(2, HELLO), "kind 2"),
        (struct.pack("<IB", 0xFFFFFFFF, 1), "4294967294 bytes"),
    ],
)
def test_what_it_says_first_is_no_hello(first: bytes, why: str) -> None:
    with pytest.raises(ProtocolError, match=why):
        answering(first)


@pytest.mark.parametrize("body", [ANSWER[1:], ANSWER + b"\0", b""])
def test_an_answer_has_another_length(body: bytes) -> None:
    worlds = answering(frame(1, HELLO), frame(2, body))
    with pytest.raises(ProtocolError, match="bytes"):
        worlds.reset()
    assert worlds.closed


def test_it_refuses() -> None:
    worlds = answering(frame(1, HELLO), frame(3, "too früh".encode()))
    with pytest.raises(ProgramEndedError, match="refused what it was asked: too früh"):
        worlds.reset()
    assert worlds.closed


def test_it_ends_amid_an_answer_and_its_last_lines_are_told() -> None:
    last = "print('\\n'.join(f'line {number}' for number in range(100)), file=sys.stderr)\nsys.exit(7)"
    worlds = answering(frame(1, HELLO), frame(2, ANSWER)[:50], last=last)
    with pytest.raises(ProgramEndedError) as caught:
        worlds.reset()
    told = str(caught.value).splitlines()
    assert told[0] == "the program ended (exit code 7):"
    assert told[1:] == [f"line {number}" for number in range(95, 100)]


def test_it_ends_before_it_is_asked() -> None:
    worlds = answering(frame(1, HELLO), frame(2, ANSWER), last="print('enough', file=sys.stderr)")
    worlds.reset()
    worlds._pipe._process.wait()
    with pytest.raises(ProgramEndedError, match=r"the program ended \(exit code 0\):\nenough"):
        worlds.step(np.zeros((2, 3), int))


def test_it_is_no_program() -> None:
    with pytest.raises(ProgramEndedError):
        Worlds(program=sys.executable, arguments=["-c", "pass"])


def test_it_does_not_want_to_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipe, "_PATIENCE", 0.2)
    worlds = answering(frame(1, HELLO), last="import time\nwhile True: time.sleep(1)")
    worlds.close()
    assert worlds._pipe._process.returncode == -9


def test_it_cannot_be_started(tmp_path: Path) -> None:
    program = tmp_path / "terracrawler"
    program.write_text("#!/no/such/interpreter\n")
    program.chmod(0o755)
    with pytest.raises(ProgramEndedError, match="cannot be started"):
        Worlds(program=program)
