"""A log's file as a table: the names of its columns, and their numbers.

Text may be in any of three encodings, or the file MATLAB's (format 4 or 5); other kinds
of file are refused by what they are.
"""

import io
import subprocess
import sys
import unicodedata
from collections import defaultdict
from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np
import scipy

from simval.arrays import Array, frozen
from simval.errors import InputError
from simval.files import MOST_LOG, read_bytes
from simval.imu.logs.names import channel
from simval.imu.logs.text import TextTable, text_table
from simval.shapes import Float

_KINDS = {  # first bytes: what the file is, and what to do
    b"\x1f\x8b": "compressed by gzip; unpack it first (gunzip)",
    b"BZh": "compressed by bzip2; unpack it first (bunzip2)",
    b"\xfd7zXZ": "compressed by xz; unpack it first (unxz)",
    b"\x28\xb5\x2f\xfd": "compressed by zstd; unpack it first (unzstd)",
    b"7z\xbc\xaf": "a 7-zip archive; unpack it first",
    b"PK\x03\x04": "a zip archive or a spreadsheet (.xlsx); unpack or save it as CSV",
    b"\xd0\xcf\x11\xe0": "an old spreadsheet (.xls); save it as CSV",
    b"\x89HDF": "HDF5 (also MATLAB 7.3); save it as text, or in MATLAB with -v7",
    b"MATLAB 7.3": "a MATLAB 7.3 file; save it with -v7, or as text",
    b"PAR1": "a Parquet file; save it as CSV",
    b"SQLite format 3": "a SQLite database (a ROS 2 bag?); export the IMU topic as CSV",
    b"#ROSBAG": "a ROS bag; export the IMU topic as CSV (rostopic echo -p)",
    b"ULog": "a PX4 ULog; export it as CSV (ulog2csv)",
    b"\x93NUMPY": "a NumPy array; write it with numpy.savetxt",
    b"%PDF": "a PDF; export the log as rows of numbers",
}
_PLAIN_CONTROLS = "\t\n\r\f\v\x1a"  # the last ends a file of DOS


def file_bytes(path: str | PathLike[str]) -> bytes:
    """Read a file whole.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    try:
        return read_bytes(path, MOST_LOG)
    except (OSError, ValueError) as error:  # ValueError: a path with a NUL
        why = getattr(error, "strerror", None) or error
        msg = f"cannot read {path}: {why}; give the path of a log"
        raise InputError(msg) from None


def is_matlab(path: str, content: bytes) -> bool:
    """Whether a file is MATLAB's: format 5 by its first bytes, format 4 by its name."""
    if content.startswith(b"MATLAB 5.0"):
        return True
    named = path.lower().endswith(".mat") and b"\0" in content[:20]
    return named and not content.startswith(tuple(_KINDS))


def decoded(path: str | PathLike[str], content: bytes) -> str:
    """Text in UTF-8, UTF-16 with its mark, or Windows-1252 (which holds Latin-1).

    Compatibility characters become plain ones (NFKC): a superscript 2 is a 2, and the
    two Greek mu are one.

    Raises
    ------
    InputError
        If the bytes are no text, with what they are and what to do.
    """
    for start, kind in _KINDS.items():
        if content.startswith(start):
            msg = f"{path} is not a text file but {kind}"
            raise InputError(msg)
    utf16 = content.startswith((b"\xff\xfe", b"\xfe\xff"))
    for encoding in ("utf-16",) if utf16 else ("utf-8-sig", "cp1252"):
        try:
            text = content.decode(encoding)
        except UnicodeDecodeError:
            continue
        if all(c in _PLAIN_CONTROLS or ord(c) >= 32 for c in set(text)):
            text = text.rstrip("\x1a")
            return text if text.isascii() else _plain(text)
    msg = f"{path} is not a text file; export the log as rows of numbers"
    raise InputError(msg)


def _plain(text: str) -> str:
    return unicodedata.normalize("NFKC", text).replace("\N{MINUS SIGN}", "-")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArrayTable:
    """Columns that are numbers already."""

    path: str  # file they came from
    names: tuple[str, ...] | None  # name of each column
    values: Float[Array, "n columns"]  # (n, columns)

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", frozen(self.values))

    @property
    def width(self) -> int:
        """Number of columns."""
        return int(self.values.shape[1])

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.values)

    def numbers(self, places: list[int]) -> Float[Array, "n columns"]:
        """Return the columns at these places."""
        return self.values[:, places]

    def texts(self, place: int) -> list[str]:
        """Return one column as text."""
        return [str(value) for value in self.values[:, place]]

    def where(self, row: int) -> str:
        """Say where a row stands in the file."""
        return f"{self.path}, row {row + 1}"

    def is_text(self, place: int) -> bool:
        """Return False: no column is text."""
        return False


TIME_LIMIT = 60.0  # s; a minute reads gigabytes
ROWS = 10  # an array with fewer is no column of a log, which has a rest in it


def matlab_table(path: str, content: bytes) -> ArrayTable:
    """Columns of the variables that have as many rows as the accelerometer's.

    A variable of n rows and one column is a column by its own name, one of n by 3 is
    three with ``_x``, ``_y``, ``_z`` behind it; structures are looked into. One matrix
    alone has no names.

    Raises
    ------
    InputError
        If it cannot be read, or has no variable with rows of numbers.
    """
    by_length: dict[int, dict[str, Array]] = defaultdict(dict)
    for name, array in _variables(path, content).items():
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
    program = [sys.executable, "-c", "from simval.imu.logs.tables import send; send()"]
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


Table = ArrayTable | TextTable


def read_table(path: str) -> Table:
    """Read a file of either kind.

    Raises
    ------
    InputError
        If it cannot be read, is of another kind, or has no rows of numbers.
    """
    content = file_bytes(path)
    if is_matlab(path, content):
        return matlab_table(path, content)
    return text_table(path, decoded(path, content))
