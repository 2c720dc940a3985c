"""Read a log in a separate process with limits on its time and memory.

A library that reads binary files may end the interpreter, never end, or take all memory
where a file is damaged, and a log is what a user was sent. So each is imported in a
child process alone, by the function ``parsed(path)`` of a reader's module.
"""

import importlib
import os
import pickle
import resource
import subprocess
import sys
from contextlib import contextmanager
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

from simval.errors import InputError
from simval.extras import refuse_without
from simval.files import MEBIBYTE
from simval.imu.logs.source import Source

if TYPE_CHECKING:
    from collections.abc import Iterator

SECONDS = 60.0  # of any file, and one more a mebibyte
MEMORY = 2048 * MEBIBYTE  # of any file, beyond what Python takes, and
TIMES = 16  # times its size
EXTRAS = {"pyarrow": "parquet"}  # of a package; of the others, logs


def read_apart(module: str, source: Source, kind: str) -> Any:
    """Call the function ``parsed`` of a reader's module in a separate process."""
    seconds = SECONDS + source.size / MEBIBYTE
    memory = MEMORY + TIMES * source.size
    program = "from simval.imu.logs.apart import send; send()"
    with _on_disk(source) as path:
        command = [sys.executable, "-c", program, module, path, str(memory)]
        try:
            done = subprocess.run(
                command, capture_output=True, timeout=seconds, check=False
            )
        except subprocess.TimeoutExpired:
            raise _damaged(source, kind, f"not done after {seconds:.0f} s") from None
    if done.returncode != 0:
        lines = done.stderr.decode(errors="replace").strip().splitlines()
        why = lines[-1][:120] if lines else "the reader crashed"
        raise _damaged(source, kind, why)
    ending, value = pickle.loads(done.stdout)
    if ending == "missing":
        what = f"{source.path} is {kind}, which the package {value!r} reads: it"
        refuse_without(EXTRAS.get(value, "logs"), what)
    if ending == "refused":
        msg = f"{source.path}: {value}"
        raise InputError(msg)
    return value


def _damaged(source: Source, kind: str, why: str) -> InputError:
    return InputError(
        f"{source.path} is not {kind} that can be read ({why}); it may be damaged or "
        "cut off: record, copy or export it again"
    )


@contextmanager
def _on_disk(source: Source) -> "Iterator[str]":
    # the path of a log, of a copy where it is inside another file
    if source.inside is None:
        yield source.path
        return
    from tempfile import TemporaryDirectory

    with TemporaryDirectory(prefix="simval-log-") as folder:
        path = os.path.join(folder, PurePath(source.path).stem)
        with open(path, "wb") as file:
            file.write(source.content)
        yield path


def send() -> None:
    """In the separate process: parse the file and write its contents to the output.

    Raises what the reader raises; the parent process looks at the exit code.
    """
    module, path, memory = sys.argv[1:4]
    output, sys.stdout = sys.stdout.buffer, sys.stderr  # libraries print warnings
    sent: tuple[str, Any]
    try:
        parsed = importlib.import_module(f"simval.imu.logs.{module}").parsed
        _limit(int(memory))
        sent = "parsed", parsed(path)
    except ModuleNotFoundError as error:
        sent = "missing", error.name
    except InputError as error:
        sent = "refused", str(error)
    pickle.dump(sent, output, protocol=5)


def _limit(memory: int) -> None:
    with open("/proc/self/statm", encoding="ascii") as file:
        memory += int(file.read().split()[0]) * resource.getpagesize()
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    least = min(each for each in (memory, soft, hard) if each != resource.RLIM_INFINITY)
    resource.setrlimit(resource.RLIMIT_AS, (least, hard))
