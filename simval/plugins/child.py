"""A child process that runs a user's code, with a time limit.

The child gets a request file and leaves an answer file, both JSON; nothing that it
writes is unpickled or run. It may raise, print, exit, hang, crash its interpreter or
answer nonsense: each ends as a `PluginError` that says so (`CrashedPluginError` where
it raised, died or did not end), and the child's whole process group is gone when the
question ends, on Linux with all else that it has started (`simval.plugins.supervisor`).
"""

import contextlib
import faulthandler
import json
import os
import platform
import resource
import signal
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO, TypeVar

from pydantic import BaseModel

from simval.errors import (
    CrashedPluginError,
    PluginError,
    RefusedError,
    SimvalError,
)
from simval.plugins.supervisor import ENDING
from simval.text import message_of

MAX_OUTPUT = 1 << 26
"""Bytes that the child, or a command that it runs, may write to any one file."""

UNREADABLE = (OSError, ValueError, TypeError, KeyError, OverflowError, RecursionError)
"""Errors by which a forged or broken answer shows itself."""

GRACE = 5.0
"""Seconds past the limit after which the child ends itself, if its parent is gone."""


class Answer(BaseModel):
    """What a child answers: an error, or the fields of a subclass."""

    error: str = ""
    crashed: bool = False


Kind = TypeVar("Kind", bound=Answer)


def asked(
    program: str, request: Any, time_limit: float, kind: type[Kind], who: str
) -> Kind:
    """Answer a request by a Python program, which calls `respond`, in a child process.

    Raises
    ------
    PluginError
        If the child did not answer in time, its answer is not of that kind, or says
        why there is none.
    """
    with own_folder() as folder:
        content = json.dumps({"time_limit": time_limit, "request": request})
        Path(folder, "request.json").write_text(content, encoding="utf-8")
        try:
            with started(program, folder) as child:
                code = child.wait(timeout=time_limit)
        except subprocess.TimeoutExpired:
            raise CrashedPluginError(too_late(who, time_limit)) from None
        return read_answer(folder, code, kind, who)


@contextlib.contextmanager
def own_folder() -> Iterator[Path]:
    """Folder of one child, which goes with it however it ends."""
    with TemporaryDirectory(
        prefix="simval-plugin-", ignore_cleanup_errors=True
    ) as folder:
        yield Path(folder)


@contextlib.contextmanager
def started(
    program: str, folder: Path, connection: int | None = None
) -> Iterator[subprocess.Popen[bytes]]:
    """Start a Python program with a folder, and end it and all that it has started.

    A connection, a socket's number, is handed to it alone.
    """
    handed = () if connection is None else (connection,)
    own = "from simval.plugins.supervisor import supervised; supervised("
    whole = f"{own}{', '.join(map(str, handed))}); {program}"
    with (folder / "output").open("wb") as output:
        child = subprocess.Popen(
            [sys.executable, "-P", "-c", whole, str(folder), *map(str, handed)],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            # its temporary files are in our folder, and go with it
            env={**os.environ, "TMPDIR": str(folder)},
            start_new_session=True,
            pass_fds=handed,
        )
    try:
        yield child
    finally:
        _end(child)


def _end(child: subprocess.Popen[bytes]) -> None:
    """End a child: its supervisor ends what has left the group, we the group."""
    if platform.system() == "Linux" and child.poll() is None:
        child.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            child.wait(timeout=2.0 * ENDING)
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(child.pid, signal.SIGKILL)
    child.wait()


def too_late(who: str, time_limit: float) -> str:
    """Say that a process was stopped."""
    return f"{who} did not end within {time_limit:g} s and was stopped"


def ending(code: int) -> str:
    """Say how a process ended."""
    if code >= 0:
        return f"ended with exit code {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:
        name = f"signal {-code}"
    return f"was killed by {name} ({signal.strsignal(-code) or 'unknown'})"


def read_answer(folder: Path, code: int, kind: type[Kind], who: str) -> Kind:
    """Read the answer of a child that has ended.

    Raises
    ------
    PluginError
        As `asked`.
    """
    try:
        with _plain(folder / "answer.json") as file:
            content = file.read(MAX_OUTPUT)
    except FileNotFoundError:
        raise CrashedPluginError(died(who, code, folder)) from None
    except OSError as error:
        raise PluginError(unreadable(who, error, folder)) from None
    try:
        answer = kind.model_validate_json(content)
    except UNREADABLE as error:
        raise PluginError(unreadable(who, error, folder)) from None
    if answer.error:
        raise (CrashedPluginError if answer.crashed else PluginError)(answer.error)
    return answer


@contextlib.contextmanager
def _plain(file: Path) -> Iterator[BinaryIO]:
    """What a child has written, if it is a plain file of a size that it may have."""
    # a link could lead anywhere, and a pipe without a writer would be waited for
    number = os.open(file, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    with os.fdopen(number, "rb") as content:
        state = os.fstat(number)
        if not stat.S_ISREG(state.st_mode) or state.st_size > MAX_OUTPUT:
            msg = f"it must be a plain file of at most {MAX_OUTPUT} bytes"
            raise OSError(msg)
        yield content


def died(who: str, code: int, folder: Path) -> str:
    """Say that a process ended before it answered."""
    return f"{who}'s process {ending(code)} without an answer{_tail(folder)}"


def unreadable(who: str, error: object, folder: Path) -> str:
    """Say that what a process answered cannot be read."""
    return f"{who}'s process left no readable answer ({error}){_tail(folder)}"


def _tail(folder: Path) -> str:
    with contextlib.suppress(OSError), _plain(folder / "output") as output:
        output.seek(max(0, output.seek(0, os.SEEK_END) - 400))
        lines = output.read().decode(errors="replace").strip().splitlines()
        words = " | ".join(line.strip() for line in lines[-3:])
        return f"; its last words: {words}" if words else ""
    return ""


def respond(function: Callable[[Any], Mapping[str, Any]]) -> None:
    """In the child: answer the request with what a function returns, and exit."""
    folder = Path(sys.argv[1])
    content = json.loads((folder / "request.json").read_text(encoding="utf-8"))
    restrain(float(content["time_limit"]))
    try:
        answer = function(content["request"])
    except BaseException as error:  # SystemExit too: a plug-in must not end the cell
        own = told(error)
        answer = {"error": str(own), "crashed": isinstance(own, CrashedPluginError)}
    part = folder / "answer.part"
    part.write_text(json.dumps(answer), encoding="utf-8")
    part.rename(folder / "answer.json")
    sys.stdout.flush()
    os._exit(0)  # whatever threads and exit handlers the plug-in has left behind


def told(error: BaseException) -> PluginError:
    """What is said of a plug-in that has made an error, refused or raised."""
    if isinstance(error, SimvalError):
        refused = isinstance(error, RefusedError)
        crashed = isinstance(error, CrashedPluginError) or not refused
        return (CrashedPluginError if crashed else PluginError)(str(error))
    return CrashedPluginError(f"the plug-in raised {message_of(error)}")


def restrain(time_limit: float) -> None:
    """Limit what the child can leave behind, and see that it cannot outlive us."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (MAX_OUTPUT, MAX_OUTPUT))
    faulthandler.dump_traceback_later(time_limit + GRACE, exit=True)
    if sys.platform == "linux":
        with contextlib.suppress(OSError):  # out of memory, we are what is ended
            Path("/proc/self/oom_score_adj").write_text("1000")
