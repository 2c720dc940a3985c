"""A user's algorithm in a process of its own, which answers what simval asks.

The parent keeps the measuring and has a function called where the plug-in is. It sends
the function's name and its arguments, and gets what it returns: words as JSON, numbers
as they are, so that every number crosses to the bit and nothing is unpickled. Which
functions is open: who asks is our own code, and each study asks something else. The
plug-in may raise, print, exit, hang or crash its interpreter: each ends as a
`PluginError` that says so (`CrashedPluginError` where it raised or died,
`SlowPluginError` where it did not end), and its whole process group goes with it.
What it has answered is counted in a file that both have, so that a slow one is told
how far it came.

It is started as a program, not by `multiprocessing`: a daemonic worker, as Dask's are,
may have no children there, and a child by `spawn` would run the user's script again.
"""

import contextlib
import ctypes
import faulthandler
import json
import os
import resource
import signal
import socket
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextvars import ContextVar
from dataclasses import fields, is_dataclass, replace
from functools import wraps
from importlib import import_module
from math import prod
from mmap import mmap
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic
from types import MappingProxyType
from typing import IO, Any, Concatenate, Final, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from simval.errors import (
    CrashedPluginError,
    PluginError,
    RefusedError,
    SimvalError,
    SlowPluginError,
)
from simval.plugins.protocol import Plugin
from simval.text import raised

MAX_OUTPUT = 1 << 26
"""Bytes that the child, or a command that it runs, may write to any one file."""

MOST_WORDS = 1 << 28
"""Bytes of a message's words; what says more is no message."""

GLANCE = 0.1
"""Seconds after which it is seen whether the process that is waited for still runs."""

GRACE = 5.0
"""Seconds past the limit after which the child ends itself."""

TAIL = 400
"""Bytes of what a process has written that are its last words."""

SIZES = struct.Struct(">QQ")
"""Of what a message says of its arrays, and of its words."""

PR_SET_PDEATHSIG = 1

FAULTS: Final[Mapping[str, type[PluginError]]] = MappingProxyType(
    {each.__name__: each for each in (CrashedPluginError, SlowPluginError)}
)
"""Errors that cross by their names; any other is a plain refusal."""

ANSWERS, COUNT = "answers", 8
"""File of a child with the number of its answers, and the bytes of that."""

KIND = "@"
"""Key of the words for a value that JSON does not have."""

UNREADABLE = (ValueError, TypeError, KeyError, AttributeError, ImportError, MemoryError)
"""Errors by which an answer shows that it is none."""

P = ParamSpec("P")
T = TypeVar("T")
Own = TypeVar("Own", bound=Plugin)
AnyArray = NDArray[Any]


class Lost(BaseException):
    """The child is lost; `started` turns this into the error that it carries.

    It is no `Exception`, so that no probe takes it for an answer of the algorithm.
    """

    def __init__(self, error: PluginError) -> None:
        super().__init__(str(error))
        self.error = error


class End:
    """One end of the connection between parent and child.

    Values are plain ones, arrays, dataclasses of the package, its classes and
    functions, and plug-ins, whose functions stay in their process. Arrays that are one
    here are one there.
    """

    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        self.plugin: Any = None  # of this process

    def send(self, value: Any) -> None:
        """Send a value."""
        places: dict[int, tuple[int, AnyArray]] = {}
        tree = json.dumps(value, default=lambda each: self._spelled(each, places))
        arrays = [array for _, array in places.values()]
        heads = json.dumps([(a.dtype.str, a.shape) for a in arrays]).encode()
        parts = [heads, tree.encode(), *(a.tobytes() for a in arrays)]
        sizes = SIZES.pack(len(parts[0]), len(parts[1]))
        self.connection.sendall(b"".join([sizes, *parts]))

    def receive(self) -> Any:
        """Receive a value.

        Raises
        ------
        EOFError
            If the other end is closed.
        ValueError
            If what comes is none, or another of `UNREADABLE`.
        """
        sizes = SIZES.unpack(self._read(SIZES.size))
        if max(sizes) > MOST_WORDS:
            msg = f"{max(sizes)} bytes of words"
            raise ValueError(msg)
        heads, words = (self._read(size) for size in sizes)
        arrays: list[AnyArray] = []
        for name, shape in json.loads(heads):
            dtype = np.dtype(name)
            numbers = self._read(dtype.itemsize * prod(shape))
            arrays.append(np.frombuffer(numbers, dtype).reshape(shape))
        return json.loads(words, object_hook=lambda each: self._meant(each, arrays))

    def _read(self, count: int) -> bytearray:
        found = bytearray(count)
        left = memoryview(found)
        while left:
            got = self._received_into(left)
            if not got:
                raise EOFError
            left = left[got:]
        return found

    def _received_into(self, left: memoryview) -> int:
        return self.connection.recv_into(left)

    def _spelled(
        self, value: Any, places: dict[int, tuple[int, AnyArray]]
    ) -> dict[str, Any]:
        """Encode a value for JSON; arrays become their numbers in a list."""
        if isinstance(value, np.ndarray):
            place, _ = places.setdefault(id(value), (len(places), value))
            return {KIND: "array", "place": place}
        if isinstance(value, Plugin):
            return {KIND: "plugin", **self._declared(value)}
        if isinstance(value, Mapping):
            return dict(value)
        if is_dataclass(value) and not isinstance(value, type):
            words = {each.name: getattr(value, each.name) for each in fields(value)}
            return {KIND: "object", "type": type(value), "words": words}
        return {KIND: "name", "name": f"{value.__module__}:{value.__qualname__}"}

    def _meant(self, spelled: dict[str, Any], arrays: list[AnyArray]) -> Any:
        """Decode a value that `_spelled` encoded."""
        kind = spelled.pop(KIND, "")
        if kind == "array":
            return arrays[spelled["place"]]
        if kind == "plugin":
            return self._here(**spelled)
        if kind == "object":
            return spelled["type"](**_fields(spelled["words"]))
        if kind == "name":
            module, _, name = spelled["name"].partition(":")
            return getattr(import_module(module), name)
        return spelled

    def _declared(self, plugin: Plugin) -> dict[str, Any]:
        """Encode the declarations of a plug-in, its functions by name alone."""
        kind = next(
            c for c in type(plugin).__mro__ if c.__module__.startswith("simval.")
        )
        values = {f.name: getattr(plugin, f.name) for f in fields(kind)}
        gives = [name for name, value in values.items() if callable(value)]
        if home_of(plugin) is None:
            self.plugin = plugin
        words = {name: v for name, v in values.items() if name not in gives}
        return {"kind": kind, "gives": gives, "words": words}

    def _here(self, kind: Any, gives: list[str], words: dict[str, Any]) -> Any:
        """The plug-in of this process, as it was declared."""
        return replace(self.plugin, **_fields(words))


def _fields(words: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of a dataclass, with lists made tuples again."""
    return {k: tuple(v) if isinstance(v, list) else v for k, v in words.items()}


class Elsewhere:
    """Stand-in for a function of a plug-in that lives in a child."""

    def __init__(self, child: "Child") -> None:
        self.child = child

    def __call__(self, *_: Any, **__: Any) -> Any:
        """Refuse, as the function cannot be called from here."""
        msg = "this function is in another process"
        raise AssertionError(msg)


class Child(End):
    """A process that runs a plug-in and calls our functions, up to a time limit."""

    def __init__(
        self,
        process: subprocess.Popen[bytes],
        connection: socket.socket,
        output: Path,
        counter: mmap,
        time_limit: float,
        who: str,
        advice: str,
    ) -> None:
        super().__init__(connection)
        self.process, self.output, self.counter = process, output, counter
        self.who, self.advice = who, advice
        self.time_limit, self.begun, self.asked = time_limit, monotonic(), 0
        self.trials: tuple[int, str] = 0, ""
        self.before: int | None = None  # answers before the trials

    @property
    def spent(self) -> float:
        """Seconds since it was started."""
        return monotonic() - self.begun

    @property
    def answers(self) -> int:
        """Number of answers so far: rows, or calibrations."""
        return int.from_bytes(self.counter[:], sys.byteorder)

    def expect(self, trials: int, what: str) -> None:
        """State how many answers will be measured, and of what."""
        self.trials = trials, what

    def measure(self) -> None:
        """Count the answers from here on as measured."""
        self.before = self.answers

    def ask(self, function: Callable[..., T], *arguments: Any, **words: Any) -> T:
        """Call a function of a module in the child, and return its result.

        Raises
        ------
        PluginError
            What the plug-in made of it: it refused, raised or broke a rule.
        Lost
            If there is no answer, now or later.
        """
        self.asked += 1
        try:
            self.connection.settimeout(max(self.time_limit - self.spent, 1e-3))
            self.send((self.asked, function, arguments, words))
            number, fault, answer = self.receive()
            if number != self.asked:
                msg = "it answered before it was asked"
                raise ValueError(msg)
        except TimeoutError:
            raise self._too_late() from None
        except (EOFError, OSError):
            raise Lost(CrashedPluginError(self._death())) from None
        except UNREADABLE as error:
            msg = f"the process of {self.who} left no readable answer ({error})"
            raise Lost(PluginError(f"{msg}{self._last_words()}")) from None
        if fault == "lost":
            raise Lost(CrashedPluginError(answer))
        if fault:
            raise FAULTS.get(fault, PluginError)(answer)
        return answer

    def _received_into(self, left: memoryview) -> int:
        while (rest := self.time_limit - self.spent) > 0.0:
            ended = self.process.poll() is not None
            self.connection.settimeout(min(GLANCE, rest))
            try:
                return super()._received_into(left)
            except TimeoutError:
                if ended:  # what it has forked holds the connection open
                    return 0
        raise self._too_late()

    def _here(self, kind: Any, gives: list[str], words: dict[str, Any]) -> Any:
        return kind(**_fields(words), **dict.fromkeys(gives, Elsewhere(self)))

    def _too_late(self) -> Lost:
        msg = f"{self.who} did not end within {self.time_limit:g} s and was stopped"
        count, what = self.trials
        if count:
            done, where = 0, ", and was still at its checks without noise"
            if self.before is not None:
                done, where = min(self.answers - self.before, count), ""
            if done == count:
                where = ", and not all that is asked after them"
            msg = (
                f"{self.who} is too slow, or hangs: it answered {done:,} of {count:,} "
                f"{what} in {self.time_limit:g} s{where}"
            )
        return Lost(SlowPluginError(f"{msg}; {self.advice}"))

    def _death(self) -> str:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(timeout=2.0)
        code = self.process.poll()
        if code is None:
            return f"{self.who} closed the connection by which it answers, and runs on"
        how = f"{self.who}'s process {ending(code)} without an answer"
        return f"{how}{self._last_words()}"

    def _last_words(self) -> str:
        with contextlib.suppress(OSError), self.output.open("rb") as output:
            lines = tail_of(output).splitlines()
            words = " | ".join(line.strip() for line in lines[-3:])
            return f"; its last words: {words}" if words else ""
        return ""


@contextlib.contextmanager
def started(
    time_limit: float,
    who: str = "the plug-in",
    advice: str = "give it more time by `time_limit`, or less to do",
) -> Iterator[Child]:
    """Start a child; at the end, kill its whole process group.

    The advice is for one that does not end in time.

    Raises
    ------
    PluginError
        If the process ended, did not end in time, or answered what cannot be read.
    """
    ours, theirs = socket.socketpair()
    with (
        ours,
        TemporaryDirectory(
            prefix="simval-plugin-", ignore_cleanup_errors=True
        ) as folder,
    ):
        program = (sys.executable, "-P", "-m", "simval.plugins")
        output = Path(folder, "output")
        Path(folder, ANSWERS).write_bytes(bytes(COUNT))
        counter = counter_of(folder)
        with theirs, output.open("wb") as file:
            process = subprocess.Popen(
                [*program, str(theirs.fileno()), str(time_limit), folder],
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
                env={**os.environ, "TMPDIR": folder},  # goes with the folder
                start_new_session=True,
                pass_fds=(theirs.fileno(),),
            )
        try:
            yield Child(process, ours, output, counter, time_limit, who, advice)
        except Lost as lost:
            raise lost.error from None
        finally:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


_COUNTER: ContextVar[mmap | None] = ContextVar("counter", default=None)
"""In a child, the number of answers."""


def counter_of(folder: str) -> mmap:
    """Counter of answers in memory that parent and child share."""
    with Path(folder, ANSWERS).open("r+b") as file:
        return mmap(file.fileno(), COUNT)


def answered(count: int = 1) -> None:
    """Count answers of a plug-in, if this process is a child."""
    counter = _COUNTER.get()
    if counter is not None:
        total = int.from_bytes(counter[:], sys.byteorder) + count
        counter[:] = total.to_bytes(COUNT, sys.byteorder)


def home_of(plugin: Plugin) -> Child | None:
    """The child in which a plug-in's functions live; None if they are here."""
    function = getattr(plugin, plugin.runs)
    return function.child if isinstance(function, Elsewhere) else None


def where_it_lives(
    function: Callable[Concatenate[Own, P], T],
) -> Callable[Concatenate[Own, P], T]:
    """Decorate a function so that it runs in the process that has the plug-in."""

    @wraps(function)
    def call(plugin: Own, /, *args: P.args, **kwargs: P.kwargs) -> T:
        child = home_of(plugin)
        if child is None:
            return function(plugin, *args, **kwargs)
        return child.ask(call, plugin, *args, **kwargs)

    return call


def tail_of(content: IO[bytes]) -> str:
    """The last part of what was written to a file."""
    content.seek(max(0, content.seek(0, os.SEEK_END) - TAIL))
    return content.read().decode(errors="replace").strip()


def ending(code: int) -> str:
    """Say how a process ended."""
    if code >= 0:
        return f"ended with exit code {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:
        name = f"signal {-code}"
    return f"was killed by {name} ({signal.strsignal(-code) or 'unknown'})"


def as_plugin_error(error: BaseException) -> PluginError:
    """Convert an error to one of a plug-in that failed, refused or raised."""
    if isinstance(error, SimvalError):
        refused = isinstance(error, RefusedError)
        crashed = isinstance(error, CrashedPluginError) or not refused
        return (CrashedPluginError if crashed else PluginError)(str(error))
    return CrashedPluginError(f"the plug-in raised {raised(error)}")


def answer_all(connection: socket.socket) -> None:
    """In the child: answer calls until the connection closes."""
    end = End(connection)
    while True:
        try:
            number, function, arguments, words = end.receive()
        except EOFError:
            return
        try:
            end.send((number, "", function(*arguments, **words)))
        except PluginError as error:
            end.send((number, type(error).__name__, str(error)))
        except BaseException as error:  # SystemExit too: no plug-in ends the cell
            end.send((number, "lost", str(as_plugin_error(error))))


def main(number: int, time_limit: float, folder: str) -> None:
    """Run as a child: restrained, answering calls, and leaving nothing behind."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (MAX_OUTPUT, MAX_OUTPUT))
    faulthandler.dump_traceback_later(time_limit + GRACE, exit=True)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
        with contextlib.suppress(OSError):  # out of memory, we are what is ended
            Path("/proc/self/oom_score_adj").write_text("1000")
    os.set_inheritable(number, False)  # what the plug-in starts has no part in it
    _COUNTER.set(counter_of(folder))
    answer_all(socket.socket(fileno=number))
    sys.stdout.flush()
    os._exit(0)  # whatever threads and exit handlers the plug-in has left behind
