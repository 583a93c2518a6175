"""The program as a process, and frames to and from it.

The protocol is described in ``models/policy/src/gym.rs``; this is its version 1.
"""

from __future__ import annotations

import contextlib
import struct
import subprocess
import tempfile
import weakref
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import IO

from .errors import ProgramEndedError, ProtocolError

VERSION = 1
MAGIC = b"TCGY"

HELLO = 1
ADVANCE = 2
CLOSE = 3
REFUSED = 3

# Longest text of a refusal or of a hello.
_TEXT = 1 << 16
# How long the program has to end by itself, in seconds.
_PATIENCE = 5.0
# How much of what it said last is told.
_LAST_LINES = 5
_LAST_BYTES = 4096


def _end(process: subprocess.Popen[bytes], errors: IO[bytes]) -> None:
    """End the process, whatever it does: its input is closed first, and it has a moment to see that."""
    if process.stdin is not None:
        # It may be gone.
        with contextlib.suppress(OSError):
            process.stdin.close()
    try:
        process.wait(_PATIENCE)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    if process.stdout is not None:
        process.stdout.close()
    errors.close()


class Pipe:
    """A running program; nothing else has its pipes."""

    def __init__(self, program: Path, words: Sequence[str]) -> None:
        self._errors: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115
        try:
            self._process = subprocess.Popen(
                [str(program), *words],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._errors,
            )
        except OSError as error:
            self._errors.close()
            raise ProgramEndedError(f"{program} cannot be started: {error}") from error
        # Also when nobody closes it.
        self._finalizer = weakref.finalize(self, _end, self._process, self._errors)

    @property
    def closed(self) -> bool:
        """Whether the process was ended from here."""
        return not self._finalizer.alive

    @property
    def process_id(self) -> int:
        """The number that the system gave the process."""
        return self._process.pid

    def send(self, kind: int, body: bytes) -> None:
        """Send a frame."""
        if self.closed:
            raise ProgramEndedError("it was closed before")
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(struct.pack("<IB", len(body) + 1, kind) + body)
            self._process.stdin.flush()
        except OSError:
            # It has ended, and may have said why.
            self.receive(kind, None)
            raise

    def receive(self, kind: int, size: int | None) -> bytearray:
        """Receive what belongs to a frame of this kind, ``size`` bytes, or any reasonable number of them."""
        told, length = self._head()
        if told == REFUSED:
            self._refused(length)
        if told != kind:
            raise self._fault(f"a frame of the kind {told} where one of the kind {kind} was expected")
        if length != size if size is not None else length > _TEXT:
            raise self._fault(f"a frame of {length} bytes" + ("" if size is None else f" in place of {size}"))
        return self._read(length)

    def close(self) -> None:
        """End the process; nothing when that was done before."""
        self._finalizer()

    def _head(self) -> tuple[int, int]:
        length, kind = struct.unpack("<IB", self._read(5))
        if length == 0:
            raise self._fault("an empty frame")
        return kind, length - 1

    def _read(self, size: int) -> bytearray:
        assert self._process.stdout is not None
        room = bytearray(size)
        if self._process.stdout.readinto(room) < size:  # type: ignore[attr-defined]
            raise self._ended("the program ended")
        return room

    def _refused(self, length: int) -> None:
        if length > _TEXT:
            raise self._fault(f"a refusal of {length} bytes")
        text = self._read(length).decode(errors="replace")
        self.close()
        raise ProgramEndedError(f"the program refused what it was asked: {text}")

    def _fault(self, what: str) -> ProtocolError:
        self.close()
        return ProtocolError(f"the program answered {what}: is it another version than this package?")

    def _ended(self, what: str) -> ProgramEndedError:
        """End it, and say so with its last lines."""
        try:
            code: int | None = self._process.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            code = None
        self._errors.seek(0, 2)
        self._errors.seek(max(0, self._errors.tell() - _LAST_BYTES))
        lines = self._errors.read().decode(errors="replace").splitlines()[-_LAST_LINES:]
        self.close()
        if code is not None:
            what += f" (exit code {code})"
        return ProgramEndedError("\n".join([what + (":" if lines else ""), *lines]))

    def __enter__(self) -> Pipe:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()
