"""A cell that runs code of a user's own: in a child process, with a time limit.

The child gets a request file and leaves an answer file, both JSON; nothing that it
writes is unpickled or run. It may raise, print, exit, hang, crash its interpreter or
answer nonsense: each ends as a `PluginError` that says so, in this cell only, and the
child's whole process group is gone when the cell ends. It is the study that starts the
child, so it is the same under every scheduler.
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
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from pydantic import BaseModel

from simval.errors import SimvalError
from simval.plugins import PluginError
from simval.plugins.errors import told
from simval.plugins.process import ending, run_group
from simval.results import ROWS, Outcome, Row
from simval.streams import Streams
from simval.studies.study import StudyParameters

START = f"import sys; from {__name__} import main; main(sys.argv[1])"
"""What the child runs; ``-m`` would run this module a second time, and warn of it."""

MAX_OUTPUT = 1 << 26
"""Bytes that the child, or a command that it runs, may write to any one file."""

UNREADABLE = (OSError, ValueError, TypeError, KeyError, OverflowError, RecursionError)
"""Errors by which a forged or broken answer shows itself."""

GRACE = 5.0
"""Seconds past the limit after which the child ends itself, if nobody is left to."""


def isolated(
    study: str, parameters: StudyParameters, streams: Streams, time_limit: float
) -> Outcome:
    """Compute a cell in a child process.

    Raises
    ------
    PluginError
        If the child did not answer, or its answer is not made of rows.
    """
    with TemporaryDirectory(
        prefix="simval-plugin-", ignore_cleanup_errors=True
    ) as folder:
        request = {
            "study": study,
            "parameters": parameters.model_dump(mode="json"),
            "seed": streams.seed,
            "key": list(streams.key),
            "time_limit": time_limit,
        }
        Path(folder, "request.json").write_text(json.dumps(request))
        words = [sys.executable, "-P", "-c", START, folder]
        # its temporary files are in our folder, and go with it however it ends
        environment = {**os.environ, "TMPDIR": folder}
        try:
            with Path(folder, "output").open("wb") as output:
                code = run_group(words, output, time_limit, environment)
        except subprocess.TimeoutExpired:
            msg = f"the plug-in did not end within {time_limit:g} s and was stopped"
            raise PluginError(msg) from None
        return Outcome(rows=_answer(Path(folder), code))


class _Answer(BaseModel):
    """What the child leaves: rows, or why there are none."""

    error: str = ""
    rows: tuple[Row, ...] = ()


def _answer(folder: Path, code: int) -> tuple[Row, ...]:
    file = folder / "answer.json"
    if not file.is_file():
        msg = f"the plug-in's process {ending(code)} without an answer{_tail(folder)}"
        raise PluginError(msg)
    try:
        answer = _Answer.model_validate_json(file.read_bytes())
        rows = answer.rows
        if not all(0 <= row.n < 2**63 and not row.standard_error < 0.0 for row in rows):
            msg = "an entry that no store can hold"
            raise ValueError(msg)
    except UNREADABLE as error:
        msg = f"the plug-in's process left no readable answer ({error}){_tail(folder)}"
        raise PluginError(msg) from None
    if answer.error:
        raise PluginError(answer.error)
    if not rows:
        msg = "the plug-in's process measured nothing"
        raise PluginError(msg)
    return rows


def _tail(folder: Path) -> str:
    with contextlib.suppress(OSError), (folder / "output").open("rb") as output:
        output.seek(max(0, output.seek(0, os.SEEK_END) - 400))
        lines = output.read().decode(errors="replace").strip().splitlines()
        words = " | ".join(line.strip() for line in lines[-3:])
        return f"; its last words: {words}" if words else ""
    return ""


def main(place: str) -> None:
    """Answer one request, in the child."""
    folder = Path(place)
    request = json.loads((folder / "request.json").read_text())
    _restrain(float(request["time_limit"]))
    try:
        answer = {"rows": ROWS.dump_python(_compute(request), mode="json")}
    except SimvalError as error:
        answer = {"error": str(error)}
    except BaseException as error:  # SystemExit too: a plug-in must not end the cell
        answer = {"error": f"the plug-in raised {told(error)}"}
    part = folder / "answer.part"
    part.write_text(json.dumps(answer), encoding="utf-8")
    part.rename(folder / "answer.json")
    sys.stdout.flush()
    os._exit(0)  # whatever threads and exit handlers the plug-in has left behind


def _compute(request: dict[str, Any]) -> tuple[Row, ...]:
    from simval.studies import find_study  # they import this module

    study = find_study(request["study"])
    if study.compute is None:
        msg = f"{request['study']!r} is no study of plug-ins"
        raise ValueError(msg)
    parameters = study.parameters.model_validate(request["parameters"])
    streams = Streams(request["seed"], tuple(request["key"]))
    return study.compute(parameters, streams).rows


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
