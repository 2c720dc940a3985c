"""A user's algorithm in a process of its own, and what it is asked.

We keep the measuring and the process has the algorithm alone: it is sent inputs and
answers with outputs. Whatever runs there, the plug-in's code, what it imports or has
forked, and whatever of these writes to us, is no more than an answer of the algorithm:
no statistic, standard error, number of samples or prediction comes from there. It
ends with the session; it may raise, exit, hang, crash or answer nonsense, and each
ends as a `PluginError` that says so.
"""

import json
import select
import socket
import subprocess
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from time import monotonic
from typing import Any, Final

from simval.arrays import Array
from simval.errors import CrashedPluginError, PluginError
from simval.plugins.child import (
    UNREADABLE,
    died,
    own_folder,
    started,
    too_late,
    unreadable,
)
from simval.plugins.messages import MOST_NUMBERS, Message, received

GLANCE: Final = 0.1
"""Seconds after which we look whether the process that we wait for is still there."""

LAST: Final = 2.0
"""Seconds in which a process that has closed its end must end itself."""

PIECE: Final = 1 << 20
"""Bytes that are sent or read at once."""

Arrays = Mapping[str, Array]


class Lost(BaseException):
    """No more can be asked: the process has ended, or answers what nobody asked.

    It is no `Exception`, so that nothing that takes an error of the algorithm for an
    answer takes this for one; `session` makes it the error that it holds.
    """

    def __init__(self, error: PluginError) -> None:
        super().__init__(str(error))
        self.error = error


class Session:
    """A process that answers questions until its time is over."""

    def __init__(
        self,
        child: subprocess.Popen[bytes],
        connection: socket.socket,
        folder: Path,
        time_limit: float,
        who: str,
    ) -> None:
        self.child, self.connection, self.folder = child, connection, folder
        self.time_limit, self.who = time_limit, who
        self.end = monotonic() + time_limit
        self.ready = select.poll()

    @property
    def left(self) -> float:
        """Seconds that it may still take."""
        return self.end - monotonic()

    @property
    def spent(self) -> float:
        """Seconds since it was begun."""
        return self.time_limit - self.left

    def ask(
        self,
        question: str,
        words: Mapping[str, Any],
        arrays: Arrays | None = None,
        says: Collection[str] = (),
        most: float = MOST_NUMBERS,
    ) -> Message:
        """Ask a question, and wait for an answer of these words and so many bytes.

        Raises
        ------
        PluginError
            What the plug-in made of it: it refused, raised or broke a rule.
        Lost
            If there is no answer, now or later.
        """
        self._require_nothing()
        given = {"question": question, "words": dict(words)}
        for part in Message(words=given, arrays=arrays or {}).parts():
            self._send(part)
        try:
            answer = received(self._read, most)
        except UNREADABLE as error:
            raise self.unreadable(error) from None
        if answer.words.keys() == {"error", "kind"}:
            raise _error(str(answer.words["error"]), answer.words["kind"])
        if answer.words.keys() != set(says):
            msg = f"it says {', '.join(answer.words) or 'nothing'}"
            raise self.unreadable(msg)
        return answer

    def unreadable(self, error: object) -> Lost:
        """What ends a session whose process answered with something else."""
        return Lost(PluginError(unreadable(self.who, error, self.folder)))

    def _require_nothing(self) -> None:
        """Require that there is nothing to read, but for its end."""
        if self._is(select.POLLIN, 0.0):
            self._read(1)
            msg = "it answered before it was asked"
            raise self.unreadable(msg)

    def _send(self, left: memoryview) -> None:
        while left:
            self._wait(select.POLLOUT)
            try:
                left = left[self.connection.send(left[:PIECE]) :]
            except BlockingIOError:
                continue
            except OSError:  # it reads no more
                raise self._death() from None

    def _read(self, count: int) -> bytearray:
        parts = bytearray()
        while len(parts) < count:
            self._wait(select.POLLIN)
            try:
                more = self.connection.recv(min(count - len(parts), PIECE))
            except BlockingIOError:
                continue
            except OSError:
                more = b""
            if not more:
                raise self._death()
            parts += more
        return parts

    def _wait(self, event: int) -> None:
        """Wait for something to read, or for room to write."""
        self._require_time()
        while not self._is(event, min(GLANCE, self.left)):
            self._require_time()
            # what it has answered before its end is read first
            if self.child.poll() is not None and not self._is(event, 0.0):
                raise self._death()

    def _is(self, event: int, seconds: float) -> bool:
        self.ready.register(self.connection, event)
        return bool(self.ready.poll(max(seconds, 0.0) * 1e3))

    def _require_time(self) -> None:
        if self.left <= 0.0:
            raise Lost(CrashedPluginError(too_late(self.who, self.time_limit)))

    def _death(self) -> Lost:
        try:
            code = self.child.wait(timeout=max(0.0, min(LAST, self.left)))
        except subprocess.TimeoutExpired:
            msg = f"{self.who} closed the connection by which it answers, and runs on"
            return Lost(CrashedPluginError(msg))
        return Lost(CrashedPluginError(died(self.who, code, self.folder)))


def _error(words: str, kind: object) -> PluginError | Lost:
    """What a process says of a question: the next may be asked, or none."""
    if kind == "refused":
        return PluginError(words)
    own = CrashedPluginError(words)
    return own if kind == "crashed" else Lost(own)


@contextmanager
def session(program: str, time_limit: float, who: str) -> Iterator[Session]:
    """Start a Python program, which calls `serve`, and end it with all it has started.

    Raises
    ------
    PluginError
        If the process ended, did not end in time, or answered what cannot be read.
    """
    ours, theirs = socket.socketpair()
    with ours, theirs, own_folder() as folder:
        content = json.dumps({"time_limit": time_limit})
        (folder / "request.json").write_text(content, encoding="utf-8")
        with started(program, folder, theirs.fileno()) as child:
            theirs.close()  # so that its end is seen
            ours.setblocking(False)
            try:
                yield Session(child, ours, folder, time_limit, who)
            except Lost as lost:
                raise lost.error from None
