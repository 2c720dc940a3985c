"""MATLAB files: format 5 by their first bytes, format 4 by their name."""

import io
import subprocess
import sys
from collections import defaultdict
from typing import Any

import numpy as np
import scipy

from simval.arrays import Array
from simval.errors import InputError
from simval.imu.logs.names import channel
from simval.imu.logs.source import Source
from simval.imu.logs.tables import ArrayTable

TIME_LIMIT = 60.0  # s; a minute reads gigabytes
ROWS = 10  # an array with fewer is no column of a log, which has a rest in it


def sniff(source: Source) -> bool:
    """Return whether a file is MATLAB's."""
    if source.start.startswith(b"MATLAB 5.0"):
        return True
    return source.path.lower().endswith(".mat") and b"\0" in source.start[:20]


def read(source: Source) -> ArrayTable:
    """Columns of the variables that have as many rows as the accelerometer's.

    A variable of n rows and one column is a column by its own name, one of n by 3 is
    three with ``_x``, ``_y``, ``_z`` behind it; structures are looked into. One matrix
    alone has no names.

    Raises
    ------
    InputError
        If it cannot be read, or has no variable with rows of numbers.
    """
    path = source.path
    by_length: dict[int, dict[str, Array]] = defaultdict(dict)
    for name, array in _variables(path, source.content).items():
        by_length[len(array)][name] = array
    if not by_length:
        msg = (
            f"{path} has no variable with {ROWS} rows of numbers or more; save the "
            "accelerometer as a matrix of n rows and 3 columns"
        )
        raise InputError(msg)
    group = max(by_length.values(), key=lambda each: (_names_force(each), len(each)))
    if len(group) == 1 and not _names_force(group):
        return ArrayTable(path=path, names=None, values=next(iter(group.values())))
    columns = [pair for name, array in group.items() for pair in _columns(name, array)]
    names = tuple(name for name, _ in columns)
    values = np.column_stack([values for _, values in columns])
    return ArrayTable(path=path, names=names, values=values)


def _variables(path: str, content: bytes) -> dict[str, Array]:
    # in a child process, since a damaged file can crash the interpreter within scipy
    program = [sys.executable, "-c", "from simval.imu.logs.matlab import send; send()"]
    try:
        done = subprocess.run(
            program, input=content, capture_output=True, timeout=TIME_LIMIT, check=False
        )
    except subprocess.TimeoutExpired:
        why = f"not done after {TIME_LIMIT:g} s"
    else:
        if done.returncode == 0:
            with np.load(io.BytesIO(done.stdout), allow_pickle=False) as sent:
                names = [str(name) for name in sent["names"]]
                return {name: sent[f"array{k}"] for k, name in enumerate(names)}
        lines = done.stderr.decode(errors="replace").strip().splitlines()
        why = lines[-1][:80] if lines else "the reader crashed"
    msg = (
        f"{path} is not a MATLAB file that can be read ({why}); save the log again "
        "with -v7, or as rows of numbers in text"
    )
    raise InputError(msg)


def send() -> None:
    """Read a MATLAB file from the input and write its arrays as ``.npz`` to the output.

    Raises what scipy raises; the parent process looks at the exit code.
    """
    variables = scipy.io.loadmat(io.BytesIO(sys.stdin.buffer.read()))
    pairs = [
        pair
        for key, value in variables.items()
        if not key.startswith("__")
        for pair in _arrays(key, value)
    ]
    arrays = {f"array{k}": array for k, (_, array) in enumerate(pairs)}
    names = np.array([name for name, _ in pairs], dtype=np.str_)
    np.savez(sys.stdout.buffer, allow_pickle=False, names=names, **arrays)


def _arrays(name: str, value: Any) -> list[tuple[str, Array]]:
    # arrays of numbers with rows along the longer axis, those in structures too
    if not isinstance(value, np.ndarray):
        return []
    if value.dtype.names and value.size == 1:
        fields = value.reshape(-1)[0]
        return [
            pair
            for key in value.dtype.names
            for pair in _arrays(f"{name}.{key}", fields[key])
        ]
    real = value.dtype.kind in "iufb" and value.ndim == 2
    if not real or max(value.shape) < ROWS:
        return []
    array = np.asarray(value, dtype=np.float64)
    return [(name, array.T if array.shape[0] < min(ROWS, array.shape[1]) else array)]


def _columns(name: str, array: Array) -> list[tuple[str, Array]]:
    width = array.shape[1]
    if width == 1:
        return [(name, array[:, 0])]
    ends = "xyz" if width == 3 else [str(k) for k in range(width)]
    return [(f"{name}_{end}", array[:, k]) for k, end in enumerate(ends)]


def _names_force(group: dict[str, Array]) -> bool:
    names = [name for key, array in group.items() for name, _ in _columns(key, array)]
    return any(channel(each).kind == "force" and channel(each).axis for each in names)
