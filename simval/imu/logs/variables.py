"""Files of named arrays: MATLAB's, NumPy's (.npy, .npz), Parquet's and HDF5's.

MATLAB's format 7.3 is HDF5 with a structure as a group, and its arrays turned.
"""

import os
import zipfile
from collections import defaultdict
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, Final

import numpy as np

from simval.arrays import Array
from simval.errors import InputError
from simval.imu.logs.apart import read_apart
from simval.imu.logs.names import channel, is_known
from simval.imu.logs.source import Source, require_moderate
from simval.imu.logs.tables import ArrayTable

ROWS: Final = 10  # an array with fewer is no column of a log, which has a rest in it
RATES: Final = ("fs", "samplingrate", "samplerate", "samplingfrequency", "samplefreq")
"""Names of a number that is the rate in Hz, as in BROAD's files, in small letters and
without signs."""
_INDEX: Final = "__index_level_"  # of pandas, without a name
_NUMPY, _ZIP, _PARQUET = b"\x93NUMPY", b"PK", b"PAR1"
_HDF, _MATLAB = b"\x89HDF\r\n\x1a\n", b"MATLAB 7.3"
_KINDS: Final = {
    _NUMPY: "a NumPy file",
    _ZIP: "a NumPy file",
    _PARQUET: "a Parquet file",
    _HDF: "an HDF5 file",
    _MATLAB: "a MATLAB 7.3 file",
    b"": "a MATLAB file",
}


def sniff(source: Source) -> bool:
    """Return whether a file is MATLAB's, NumPy's, Parquet's or HDF5's."""
    if source.start.startswith((b"MATLAB 5.0", _MATLAB, _HDF, _NUMPY, _PARQUET)):
        return True
    end = source.path.lower()
    if source.start.startswith(_ZIP):
        return end.endswith(".npz")
    return end.endswith(".mat") and b"\0" in source.start[:20]


def read(source: Source) -> ArrayTable | dict[str, Callable[[], ArrayTable]]:
    """Columns of the variables that have as many rows as the accelerometer.

    A variable of n rows and one column is a column by its own name, one of n by 3 is
    three with ``_x``, ``_y``, ``_z`` behind it; structures are looked into. One matrix
    alone has no names, unless its own is that of another sensor. A number by one of the
    names of `RATES` is the rate of a log without a clock, the accelerometer's own where
    there are several. Accelerometers with different numbers of rows are candidates.
    """
    path = source.path
    kind = next(
        kind for start, kind in _KINDS.items() if source.start.startswith(start)
    )
    arrays, rates = read_apart("variables", source, kind)
    by_length: dict[int, dict[str, Array]] = defaultdict(dict)
    for name, array in arrays:
        by_length[len(array)][name] = array
    if not by_length:
        msg = (
            f"{path} has no variable with {ROWS} rows of numbers or more; save the "
            "accelerometer as a matrix of n rows and 3 columns"
        )
        raise InputError(msg)
    groups = [*by_length.values()]
    forces = {name: each for each in groups if (name := _force_of(each))}
    if len(forces) < 2:
        group = next(iter(forces.values()), max(groups, key=len))
        return _table(path, group, groups, rates)
    return {
        name: partial(_table, path, each, groups, rates)
        for name, each in forces.items()
    }


def _table(
    path: str,
    group: dict[str, Array],
    groups: list[dict[str, Array]],
    rates: dict[str, float],
) -> ArrayTable:
    # the variables of one number of rows, with a word on those of another
    force = _force_of(group)
    rows = len(next(iter(group.values())))
    source = tuple(
        ("left out", f"{name}: {len(array)} rows, where the others have {rows}")
        for each in groups
        if each is not group
        for name, array in each.items()
        if any(channel(label).axis for label, _ in _columns(name, array))
    )
    columns = [pair for name, array in group.items() for pair in _columns(name, array)]
    names: tuple[str, ...] | None = tuple(name for name, _ in columns)
    if len(group) == 1 and not force:
        name = next(iter(group))
        if not (is_known(name) or channel(f"{name}_x").kind not in ("bare", "other")):
            names = None
    return ArrayTable(
        path=path,
        names=names,
        values=np.column_stack([values for _, values in columns]),
        rate=_rate(force, rates),
        source=source,
    )


def _rate(force: str, rates: dict[str, float]) -> tuple[str, float] | None:
    # of several that differ, that of the accelerometer's own structure, or of the one
    # that this is in
    stems = [force]
    while stems[-1]:
        stems.append(stems[-1].rpartition(".")[0])
    own = [{n: x for n, x in rates.items() if n.rpartition(".")[0] == s} for s in stems]
    for each in (*own, rates):
        if len(set(each.values())) == 1:
            return next(iter(each.items()))
    return None


def parsed(path: str) -> tuple[list[tuple[str, Array]], dict[str, float]]:
    """Variables with rows of numbers, by name, and rates."""
    with open(path, "rb") as file:
        start = file.read(10)
    arrays: list[tuple[str, Array]] = []
    rates: dict[str, float] = {}
    for name, value in _loaded(path, start).items():
        if name.startswith("__") and not name.startswith(_INDEX):
            continue
        for key, leaf in _leaves(name, value):
            arrays += _array(key, leaf)
            rates |= _rate_of(key, leaf)
    return arrays, rates


def _loaded(path: str, start: bytes) -> dict[str, Any]:
    if start.startswith(_PARQUET):
        import pyarrow.parquet as parquet

        table = parquet.read_table(path, memory_map=False)
        return {
            name: column.to_numpy()
            for name, column in zip(table.column_names, table.columns, strict=True)
        }
    if start.startswith((_HDF, _MATLAB)):
        return _datasets(path)
    if start.startswith(_ZIP):
        with zipfile.ZipFile(path) as archive:
            size = sum(each.file_size for each in archive.infolist())
        require_moderate("it", size, os.path.getsize(path))
    if start.startswith((_NUMPY, _ZIP)):
        values = np.load(path, allow_pickle=False)
        if isinstance(values, np.ndarray):
            return {"": values}
        return {name: values[name] for name in values.files}
    import scipy.io

    return dict(scipy.io.loadmat(path))


def _datasets(path: str) -> dict[str, Any]:
    # arrays and attributes of an HDF5 file, with dots between the names of its groups
    import h5py

    found: dict[str, Any] = {}
    sizes: list[int] = []

    def take(name: str, item: Any) -> None:
        stem = name.replace("/", ".")
        if stem.startswith("#"):  # what MATLAB's cells refer to
            return
        for key, value in item.attrs.items():
            found[f"{stem}.{key}".lstrip(".")] = np.asarray(value)
        words = item.attrs.get("MATLAB_class", b"") in (b"char", b"cell")
        if isinstance(item, h5py.Dataset) and item.dtype.kind in "iufbV" and not words:
            sizes.append(item.nbytes)
            require_moderate("it", sum(sizes), os.path.getsize(path))
            found[stem] = np.asarray(item[()])

    with h5py.File(path) as file:
        take("", file)
        file.visititems(take)
    return found


def _leaves(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    # the arrays of a variable, those in structures too
    if not isinstance(value, np.ndarray):
        return
    if not value.dtype.names:
        yield name, value
        return
    fields = value.reshape(-1)[0] if value.size == 1 else value
    stem = f"{name}." if name else ""
    for key in value.dtype.names:
        yield from _leaves(f"{stem}{key}", fields[key])


def _array(name: str, value: Any) -> list[tuple[str, Array]]:
    # numbers with rows along the longer axis
    if value.dtype.kind in "mM" and value.ndim == 1 and len(value):
        value = (value - value[0]).astype("timedelta64[ns]").astype(np.float64)
        name = f"{'time' * name.startswith(_INDEX) or name} [ns]"
    elif name.startswith(_INDEX):
        return []
    value = value[:, None] if value.ndim == 1 else value
    real = value.dtype.kind in "iufb" and value.ndim == 2
    if not real or max(value.shape) < ROWS:
        return []
    array = np.asarray(value, dtype=np.float64)
    return [(name, array.T if array.shape[0] < min(ROWS, array.shape[1]) else array)]


def _rate_of(name: str, value: Any) -> dict[str, float]:
    # a number that is a rate
    word = "".join(filter(str.isalnum, name.rpartition(".")[2])).lower()
    if word not in RATES or value.size != 1 or value.dtype.kind not in "iuf":
        return {}
    rate = float(value.reshape(-1)[0])
    return {name: rate} if 0.0 < rate < np.inf else {}


def _columns(name: str, array: Array) -> list[tuple[str, Array]]:
    width = array.shape[1]
    if width == 1:
        return [(name, array[:, 0])]
    ends = "xyz" if width == 3 else [str(k) for k in range(width)]
    return [(f"{name}_{end}", array[:, k]) for k, end in enumerate(ends)]


def _force_of(group: dict[str, Array]) -> str:
    # the first variable that names axes of an accelerometer; empty for none
    for key, array in group.items():
        known = (channel(name) for name, _ in _columns(key, array))
        if any(each.kind == "force" and each.axis for each in known):
            return key
    return ""
