"""Filters in any language: one process for each trial, one line for each row."""

import os
import re
import select
import subprocess
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryFile
from time import monotonic
from typing import Any, Final

import numpy as np

from simval.arrays import Array
from simval.errors import (
    CrashedPluginError,
    PluginError,
    SlowPluginError,
    UnusablePluginError,
)
from simval.plugins.child import ending, tail_of
from simval.plugins.programs import GIVEN, split_words
from simval.plugins.protocol import READS, Filter
from simval.text import shown

FIRST_LIMIT: Final = 60.0
ROW_LIMIT: Final = 10.0
"""Seconds for the first row, with the program's start, and for each other."""

END_LIMIT: Final = 5.0
"""Seconds in which the program must end after its input."""

LINE_LIMIT: Final = 1 << 16
"""Bytes of a line: eighteen numbers have some five hundred."""

FLUSH: Final = "flush after each line, as fflush(stdout) or print(..., flush=True) do"


def command_filter(words: str, **declared: Any) -> Filter:
    """Build a filter that runs a command once for each trial.

    The program gets a line of numbers for each row on standard input: the step in
    seconds, then the readings. It answers each line with one of its own, the attitude
    in the convention that is declared, before it reads the next.

    Parameters
    ----------
    words : str
        The program and its arguments. A setting in braces, as in ``./mine {start}``, is
        replaced by its numbers with commas between.
    **declared
        Anything else that `Filter` declares, such as ``components``, ``matrix`` or
        ``name``; not ``make``, ``reads`` or ``batch``, which follow from the command.

    Returns
    -------
    Filter
        A filter like any other. The program is started when it is measured.

    Raises
    ------
    UnusablePluginError
        If the words cannot be split, name no program or have an unknown placeholder, or
        if `declared` has what follows from the command.
    """
    split = split_words(words)
    if not split:
        msg = (
            f"`{words}` names no program; write `./mine`, or `python mine.py {{start}}`"
        )
        raise UnusablePluginError(msg)
    places = [place for word in split for place in GIVEN.findall(word)]
    unknown = [place for place in places if place not in READS]
    if unknown:
        known = ", ".join(f"{{{place}}}" for place in READS)
        msg = (
            f"`{words}` has the placeholder {{{unknown[0]}}}, which does not exist; a "
            f"filter's are {known}. Its readings come on standard input"
        )
        raise UnusablePluginError(msg)
    if declared.get("batch") or {"reads", "make"} & declared.keys():
        msg = (
            f"`{words}`: a command runs one trial and gets what it reads as "
            "arguments, so leave out `batch`, `reads` and `make`"
        )
        raise UnusablePluginError(msg)
    entries = 9 if declared.get("components") == "matrix" else 4

    def make(**reads: Any) -> "_Process":
        values = {
            word: np.ravel(np.asarray(v, dtype=float)) for word, v in reads.items()
        }

        def text(found: re.Match[str]) -> str:
            return ",".join(map(repr, values[found[1]].tolist()))

        return _Process([GIVEN.sub(text, word) for word in split], entries)

    given = {"name": Path(split[0]).name, **declared}
    return Filter(make=make, reads=tuple(dict.fromkeys(places)), **given)


class _Process:
    """A running program, between the lines that it is sent."""

    def __init__(self, words: Sequence[str], entries: int) -> None:
        self.program, self.entries, self.rows = words[0], entries, 0
        self.pending = b""
        self.errors = TemporaryFile()  # noqa: SIM115 - until `close`
        try:
            self.process = subprocess.Popen(
                words,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self.errors,
                bufsize=0,
            )
        except OSError as error:
            self.errors.close()
            msg = f"`{self.program}` cannot be run: {error}"
            raise CrashedPluginError(msg) from None
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.given, self.printed = self.process.stdin, self.process.stdout.fileno()
        self.ready = select.poll()
        self.ready.register(self.printed, select.POLLIN)

    def update(self, dt: float, *readings: Array) -> Any:
        """Send a row and read the answer; end a program that fails."""
        try:
            return self._answered(dt, readings)
        except PluginError:
            self._kill()
            raise

    def _answered(self, dt: float, readings: Sequence[Array]) -> Any:
        if not self.pending and self.rows:
            more = self._more(0.0)
            if more == b"":
                raise CrashedPluginError(self._death())
            self.pending = more or b""
        if self.pending:
            raise PluginError(self._more_than_a_line())
        numbers = [dt, *(x for reading in readings for x in reading.tolist())]
        row = f"{' '.join(map(repr, numbers))}\n".encode()
        try:
            self.given.write(row)
        except OSError:  # it reads no more
            raise CrashedPluginError(self._death()) from None
        line = self._line(ROW_LIMIT if self.rows else FIRST_LIMIT)
        self.rows += 1
        return self._answer(line)

    def close(self) -> None:
        """Close its input, and check that it ends well and prints nothing more."""
        if self.errors.closed:  # it has failed before
            return
        try:
            self._end_input()
            self.pending += self._rest(END_LIMIT)
            if self.pending:
                raise PluginError(self._more_than_a_line())
            code = self.process.wait(timeout=END_LIMIT)
            if code:
                msg = f"{self._ended(code)} after all of its rows"
                raise CrashedPluginError(msg)
        except subprocess.TimeoutExpired:
            msg = (
                f"`{self.program}` still runs {END_LIMIT:g} s after its input has "
                "ended; let it end when standard input ends"
            )
            raise SlowPluginError(msg) from None
        finally:
            self._kill()

    def _answer(self, line: bytes) -> Any:
        try:
            numbers = [float(word) for word in line.decode("ascii").split()]
        except ValueError:
            numbers = []
        size = self.entries
        if len(numbers) not in (size, size + 9):
            msg = (
                f"`{self.program}` answered with {shown(line.decode(errors='replace'))}"
                f"; an answer is a line of {size} numbers with spaces between them, or "
                f"of {size + 9} with the covariance"
            )
            raise PluginError(msg)
        first = np.array(numbers[:size])
        attitude = first.reshape(3, 3) if size == 9 else first
        if len(numbers) == size:
            return attitude
        return attitude, np.array(numbers[size:]).reshape(3, 3)

    def _line(self, seconds: float) -> bytes:
        """Read one line of its output."""
        end = monotonic() + seconds
        while b"\n" not in self.pending:
            if len(self.pending) > LINE_LIMIT:
                msg = (
                    f"`{self.program}` printed {len(self.pending)} bytes without a "
                    "line end; print one line for each row"
                )
                raise PluginError(msg)
            more = self._more(end - monotonic())
            if more is None:
                raise SlowPluginError(self._silence(seconds))
            if not more:
                raise CrashedPluginError(self._death())
            self.pending += more
        line, _, self.pending = self.pending.partition(b"\n")
        return line

    def _readable(self, seconds: float) -> bool:
        return bool(self.ready.poll(max(seconds, 0.0) * 1e3))

    def _more(self, seconds: float) -> bytes | None:
        """Read more of its output: empty at the end, None if there is none yet."""
        return os.read(self.printed, LINE_LIMIT) if self._readable(seconds) else None

    def _more_than_a_line(self) -> str:
        text = shown(self.pending[:80].decode(errors="replace"))
        return (
            f"`{self.program}` printed more than one line for a row (after its answer: "
            f"{text}); print one line for each, and what is meant for people on "
            "standard error"
        )

    def _silence(self, seconds: float) -> str:
        """Say that no answer came, and whether one comes once the input is closed."""
        self._end_input()
        said = self._rest(END_LIMIT)
        late = (
            f"it printed when its input ended: {FLUSH}"
            if said
            else f"{FLUSH}, and answer each row before you read the next"
        )
        return (
            f"`{self.program}` did not answer its row within {seconds:.3g} s; "
            f"{late}{self._last_words()}"
        )

    def _rest(self, seconds: float) -> bytes:
        """Start of what it prints until it ends or some seconds have passed."""
        end, kept = monotonic() + seconds, b""
        while len(kept) < LINE_LIMIT // 2 and (more := self._more(end - monotonic())):
            kept = (kept + more)[:LINE_LIMIT].strip()
        return kept

    def _death(self) -> str:
        try:
            code = self.process.wait(timeout=END_LIMIT)
        except subprocess.TimeoutExpired:
            return (
                f"`{self.program}` closed its standard output and runs on; print one "
                f"line for each row{self._last_words()}"
            )
        return f"{self._ended(code)}; answer each row until the input ends"

    def _ended(self, code: int) -> str:
        return f"`{self.program}` {ending(code)}{self._last_words()}"

    def _last_words(self) -> str:
        tail = tail_of(self.errors)
        return f" (standard error: {tail})" if tail else ""

    def _end_input(self) -> None:
        try:
            self.given.close()
        except OSError:  # it reads no more
            return

    def _kill(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        self._end_input()
        assert self.process.stdout is not None
        self.process.stdout.close()
        self.errors.close()
