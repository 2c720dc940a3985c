"""A child process that runs a user's code, with a time limit.

The child gets a request file and leaves an answer file, both JSON; nothing that it
writes is unpickled or run. It may raise, print, exit, hang, crash its interpreter or
answer nonsense: each ends as a `PluginError` that says so (`CrashedPluginError` where
it raised, died or did not end), and the child's whole
process group is gone when the question ends.
"""

import contextlib
import ctypes
import faulthandler
import json
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

from pydantic import BaseModel

from simval.errors import (
    CrashedPluginError,
    PluginError,
    RefusedError,
    SimvalError,
)
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
    with TemporaryDirectory(
        prefix="simval-plugin-", ignore_cleanup_errors=True
    ) as folder:
        content = json.dumps({"time_limit": time_limit, "request": request})
        Path(folder, "request.json").write_text(content, encoding="utf-8")
        words = [sys.executable, "-P", "-c", program, folder]
        try:
            code = _run_group(words, Path(folder), time_limit)
        except subprocess.TimeoutExpired:
            msg = f"{who} did not end within {time_limit:g} s and was stopped"
            raise CrashedPluginError(msg) from None
        return read_answer(Path(folder), code, kind, who)


def _run_group(words: list[str], folder: Path, time_limit: float) -> int:
    """Run a program in a new process group, and end the whole group with it."""
    with (folder / "output").open("wb") as output:
        child = subprocess.Popen(
            words,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            # its temporary files are in our folder, and go with it however it ends
            env={**os.environ, "TMPDIR": str(folder)},
            start_new_session=True,
        )
    try:
        return child.wait(timeout=time_limit)
    finally:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(child.pid, signal.SIGKILL)
        child.wait()


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
    file = folder / "answer.json"
    if not file.is_file():
        msg = f"{who}'s process {ending(code)} without an answer{_tail(folder)}"
        raise CrashedPluginError(msg)
    try:
        answer = kind.model_validate_json(file.read_bytes())
    except UNREADABLE as error:
        msg = f"{who}'s process left no readable answer ({error}){_tail(folder)}"
        raise PluginError(msg) from None
    if answer.error:
        raise (CrashedPluginError if answer.crashed else PluginError)(answer.error)
    return answer


def _tail(folder: Path) -> str:
    with contextlib.suppress(OSError), (folder / "output").open("rb") as output:
        output.seek(max(0, output.seek(0, os.SEEK_END) - 400))
        lines = output.read().decode(errors="replace").strip().splitlines()
        words = " | ".join(line.strip() for line in lines[-3:])
        return f"; its last words: {words}" if words else ""
    return ""


def respond(function: Callable[[Any], Mapping[str, Any]]) -> None:
    """In the child: answer the request with what a function returns, and exit."""
    folder = Path(sys.argv[1])
    content = json.loads((folder / "request.json").read_text(encoding="utf-8"))
    _restrain(float(content["time_limit"]))
    try:
        answer = function(content["request"])
    except SimvalError as error:
        crashed = isinstance(error, CrashedPluginError)
        refused = isinstance(error, RefusedError) and not crashed
        answer = {"error": str(error), "crashed": not refused}
    except BaseException as error:  # SystemExit too: a plug-in must not end the cell
        words = f"the plug-in raised {message_of(error)}"
        answer = {"error": words, "crashed": True}
    part = folder / "answer.part"
    part.write_text(json.dumps(answer), encoding="utf-8")
    part.rename(folder / "answer.json")
    sys.stdout.flush()
    os._exit(0)  # whatever threads and exit handlers the plug-in has left behind


def _restrain(time_limit: float) -> None:
    """Limit what the child can leave behind, and see that it cannot outlive us."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (MAX_OUTPUT, MAX_OUTPUT))
    faulthandler.dump_traceback_later(time_limit + GRACE, exit=True)
    if sys.platform == "linux":
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
        with contextlib.suppress(OSError):  # out of memory, we are what is ended
            Path("/proc/self/oom_score_adj").write_text("1000")
