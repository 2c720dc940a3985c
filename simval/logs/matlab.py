"""A log saved by MATLAB (format 4 or 5) as a table."""

import io
from collections import defaultdict
from typing import Any

import numpy as np
import scipy.io

from simval.arrays import Array
from simval.errors import InputError
from simval.logs.names import channel
from simval.logs.table import ArrayTable

ROWS = 10  # an array with fewer is no column of a log


def matlab_table(path: str, content: bytes) -> ArrayTable:
    """Columns of the variables that have as many rows as the accelerometer's.

    A variable of n rows and one column is a column by its own name, one of n by 3 is
    three with ``_x``, ``_y``, ``_z`` behind it; structures are looked into. One matrix
    alone has no names.

    Parameters
    ----------
    path : str
        Where the bytes come from, for messages.
    content : bytes
        The file.

    Returns
    -------
    ArrayTable
        Columns of one length.

    Raises
    ------
    InputError
        If it cannot be read, or has no variable with rows of numbers.
    """
    try:
        variables = scipy.io.loadmat(io.BytesIO(content), squeeze_me=False)
    except Exception as error:  # a damaged file makes scipy raise nearly anything
        msg = (
            f"{path} is not a MATLAB file that can be read "
            f"({type(error).__name__}: {str(error)[:80]}); save the log again with "
            "-v7, or as rows of numbers in text"
        )
        raise InputError(msg) from None
    found = {
        name: array
        for key, value in variables.items()
        if not key.startswith("__")
        for name, array in _arrays(key, value)
    }
    by_length: dict[int, dict[str, Array]] = defaultdict(dict)
    for name, array in found.items():
        by_length[len(array)][name] = array
    if not by_length:
        listed = ", ".join(key for key in variables if not key.startswith("__"))
        msg = (
            f"{path} has no variable with rows of numbers (it has {listed or 'none'}); "
            "save the accelerometer as a matrix of n rows and 3 columns"
        )
        raise InputError(msg)
    group = max(by_length.values(), key=lambda each: (_force(each), len(each)))
    if len(group) == 1 and not _force(group):
        return ArrayTable(path=path, names=None, values=next(iter(group.values())))
    columns = [pair for name, array in group.items() for pair in _columns(name, array)]
    names = tuple(name for name, _ in columns)
    values = np.column_stack([values for _, values in columns])
    return ArrayTable(path=path, names=names, values=values)


def _arrays(name: str, value: Any) -> list[tuple[str, Array]]:
    # arrays of numbers with rows along the longer axis, those in structures too
    if not isinstance(value, np.ndarray):
        return []
    if value.dtype.names and value.size == 1:
        record = value.reshape(-1)[0]
        parts = [
            _arrays(f"{name}.{field}", record[field]) for field in value.dtype.names
        ]
        return [pair for part in parts for pair in part]
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


def _force(group: dict[str, Array]) -> bool:
    names = [name for key, array in group.items() for name, _ in _columns(key, array)]
    return any(channel(each).kind == "force" and channel(each).axis for each in names)
