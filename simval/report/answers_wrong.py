"""How wrong: for each study of a run the size of its errors in one chosen cell.

The cell is that of the middle noise level of its study (of two middle ones the
smaller) and the most poses, and of the algorithm that the suite names first; of several
such cells the one with the greatest error. Noise-free cells have no error to tell.

The error of a quaternion q of unit length is half of the small angle that it is wrong
by, so an angle is twice the length of the quaternion's error, to the order of the
angle's square over 48.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from simval.compare.merits import STUDIES as OF_ALGORITHMS
from simval.gate.finding import reproduce
from simval.report.answers import (
    Block,
    Line,
    angle,
    called,
    in_order,
    in_unit,
    percent,
    rounded,
)
from simval.report.answers_algorithms import lines_of_algorithms
from simval.report.chapters import home
from simval.report.curves import varying
from simval.report.measures import GROUPS, part
from simval.report.section import Context
from simval.report.units import OF_A_CALIBRATION, PPM
from simval.report.words import measured, spelled
from simval.results import Row
from simval.statistics import (
    APART,
    BUDGET,
    CARRIED,
    COVARIANCE_ORDER,
    COVERAGE,
    CRAMER_RAO,
    EXACT,
    FIRST_ORDER,
    IMPURE,
    INTERVALS,
    LEADING_ERROR_RATIO,
    LIMIT_RATIO,
    PRECISION,
    RECALL,
    REST_FORCE,
    RMS,
    RMS_OVER_BOUND,
    RMS_RATIO,
    SCALE_BIAS,
    SD,
    SQUARED_ERROR,
    VARIANCE_OVER_BOUND,
)
from simval.sweep.run import CellResult

NOISES: Mapping[str, str] = {
    "noise_std": "noise",
    "accelerometer_noise_std": "accelerometer noise",
    "accelerometer_noise": "accelerometer noise",
    "magnetometer_noise_std": "magnetometer noise",
    "field_noise": "field noise",
    "angle_random_walk": "angle random walk",
}
"""Parameters that say how noisy a sensor is, and their words."""

ALGORITHM = ("estimator", "residual", "estimate", "sigma", "multiplier", "trim")
"""Parameters that choose an algorithm or set it, not what it is given."""

IN_ACCELERATION = ("calibration", "ladder", "coverage", "detector", "solvers")
"""Studies whose `noise_std` is an acceleration; elsewhere it is of a unit vector."""

MEAN = SQUARED_ERROR("mean")  # over the parameters of a gyroscope
BOUND = "\N{MULTIPLICATION SIGN} the bound"
RULE = (
    "Each in the cell of its study's middle noise level, most poses and first "
    "algorithm; of several such cells, in the one with the greatest error. "
    "\N{PLUS-MINUS SIGN}: standard error. The bound is Cramér and Rao's."
)


class Reading(NamedTuple):
    """What a cell says, and how great its error is beside other cells of its study."""

    said: str
    size: float
    n: int


def how_wrong(context: Context) -> Block:
    """Answer how great the errors are."""
    lines = lines_of_algorithms(context)
    told = {line.what for line in lines}
    for study in in_order([cell.study for cell in context.run.cells]):
        if study in OF_ALGORITHMS and told:
            continue
        lines.append(_line(context, study))
    return Block(
        title="How wrong",
        answer="pass",
        headline="",
        lines=lines,
        note=RULE,
        fold="more studies",
    )


def _line(context: Context, study: str) -> Line:
    cells = context.cells(study)
    found = chosen(study, cells)
    if found is None:
        left = [cell for cell in context.run.cells if cell.study == study]
        endings = dict.fromkeys(cell.ending for cell in left if cell not in cells)
        ended = {"pending": "never run", "done": "without numbers"}
        why = ", ".join(ended.get(word, word) for word in endings)
        said = f"not measured{f': {why}' if why else ''}"
        return Line(what=called(study), said=said, answer="inconclusive")
    cell, reading = found
    return Line(
        what=called(study),
        said=reading.said,
        where=where(cell, cells, reading.n),
        link=home(study),
        command=reproduce(cell.named, context.folder),
    )


def chosen(
    study: str, cells: Sequence[CellResult]
) -> tuple[CellResult, Reading] | None:
    """The cell that a study is told by, and what it says."""
    reader = READERS.get(study, _any)
    readings = [
        (cell, reading)
        for cell in typical(cells)
        if (reading := reader(cell) or _any(cell)) is not None
    ]
    return max(readings, key=lambda pair: pair[1].size, default=None)


def typical(cells: Sequence[CellResult], *, poses: bool = True) -> Sequence[CellResult]:
    """Cells of the middle noise, the first algorithm and, if asked, the most poses."""
    for key in NOISES:
        levels = sorted({v for cell in cells if (v := cell.parameters.get(key))})
        if levels:
            middle = levels[(len(levels) - 1) // 2]
            cells = [cell for cell in cells if cell.parameters.get(key) == middle]
    for key in ALGORITHM:
        names = [cell.parameters.get(key) for cell in cells]
        cells = [c for c, own in zip(cells, names, strict=True) if own == names[0]]
    if not poses:
        return cells
    most = max((cell.parameters.get("poses", 0) for cell in cells), default=0)
    return [cell for cell in cells if cell.parameters.get("poses", 0) == most]


def where(cell: CellResult, cells: Sequence[CellResult], n: int) -> str:
    """Which cell of its study this is, in words."""
    values = cell.parameters
    words = [
        f"{name} {values[key]:g}{' m/s²' if _of_acceleration(cell, key) else ''}"
        for key, name in NOISES.items()
        if values.get(key)
    ]
    if "poses" in values:
        words.append(f"{values['poses']} poses")
    skipped = (*NOISES, "poses", "samples", "trials")
    words += [_named(k, values.get(k)) for k in varying(cells) if k not in skipped]
    return ", ".join([*words, f"{n:,} trials"] if n > 1 else words)


def _of_acceleration(cell: CellResult, key: str) -> bool:
    return key == "noise_std" and cell.study in IN_ACCELERATION


def _named(key: str, value: Any) -> str:
    if isinstance(value, str) and value:
        return value
    return (
        f"{spelled(key)} {value:g}"
        if isinstance(value, float)
        else (f"{spelled(key)} {value}")
    )


def _calibration(cell: CellResult) -> Reading | None:
    rows = [cell.row(RMS(name), CRAMER_RAO) for name in GROUPS]
    good = [row for row in rows if row is not None and _sound(row)]
    if len(good) < len(GROUPS):
        return None
    ratio = np.array([row.value / (row.prediction or 1.0) for row in good])
    error = np.array([row.standard_error / (row.prediction or 1.0) for row in good])
    whole = float(np.sqrt(np.mean(ratio**2)))
    # the three come from the same trials: their errors are taken as one and the same
    spread = float(np.mean(ratio * error)) / whole
    sizes = ", ".join(
        f"{name} {in_unit(row.value, OF_A_CALIBRATION[name])}"
        for name, row in zip(GROUPS, good, strict=True)
    )
    return Reading(f"{sizes}; {measured(whole, spread)} {BOUND}", whole, good[0].n)


def _attitude(cell: CellResult) -> Reading | None:
    row = cell.row(RMS(), EXACT)
    if row is None or not _sound(row):
        return None
    said = f"{angle(2.0 * row.value)} RMS; {_ratio(row)} \N{MULTIPLICATION SIGN} theory"
    return Reading(said, row.value, row.n)


def _filter(cell: CellResult) -> Reading | None:
    row = cell.row(RMS(), CRAMER_RAO)
    if row is None or not _sound(row):
        return None
    return Reading(f"{angle(row.value)} RMS; {_ratio(row)} {BOUND}", row.value, row.n)


def _magnetometer(cell: CellResult) -> Reading | None:
    whole, dip = part(SD, "M", FIRST_ORDER)(cell), cell.row(SD("dip"), FIRST_ORDER)
    over = cell.row(VARIANCE_OVER_BOUND("M"), CRAMER_RAO)
    if whole is None or dip is None or over is None or not over.value > 0.0:
        return None
    root = float(np.sqrt(over.value))
    ratio = measured(root, over.standard_error / 2.0 / root)
    said = f"M {percent(whole[0])}, dip {angle(dip.value)}; {ratio} {BOUND}"
    return Reading(said, whole[0], dip.n)


def _gyroscope(cell: CellResult) -> Reading | None:
    size, over = cell.row(SD("M", "bound")), cell.row(MEAN, CRAMER_RAO)
    if size is None or over is None or not over.value > 0.0:
        return None
    root = float(np.sqrt(over.value))
    ratio = measured(root, over.standard_error / 2.0 / root)
    said = f"M {in_unit(size.value * root, PPM)}; {ratio} {BOUND}"
    return Reading(said, size.value * root, over.n)


def _end_to_end(cell: CellResult) -> Reading | None:
    row = cell.row(BUDGET("total"), CARRIED)
    if row is None or not _sound(row):
        return None
    said = (
        f"attitude {angle(row.value)} RMS; {_ratio(row)} \N{MULTIPLICATION SIGN} theory"
    )
    return Reading(said, row.value, row.n)


def _detector(cell: CellResult) -> Reading | None:
    rows = [cell.row(family()) for family in (PRECISION, RECALL, IMPURE, INTERVALS)]
    precision, recall, impure, intervals = rows
    if precision is None or recall is None or impure is None or intervals is None:
        return None
    said = (
        f"{rounded(100.0 * precision.value, 3)} % of the rows found are still, "
        f"{rounded(100.0 * recall.value, 3)} % of the still ones found; "
        f"{rounded(impure.value)} of {rounded(intervals.value)} intervals impure"
    )
    return Reading(said, impure.value / max(intervals.value, 1.0), precision.n)


ANY = (
    RMS,
    RMS_OVER_BOUND,
    RMS_RATIO,
    COVERAGE,
    SCALE_BIAS,
    SQUARED_ERROR,
    VARIANCE_OVER_BOUND,
    LIMIT_RATIO,
    COVARIANCE_ORDER,
    LEADING_ERROR_RATIO,
    REST_FORCE,
    APART,
)
"""What a study without words of its own is told by: the first that it has."""


def _any(cell: CellResult) -> Reading | None:
    """What a study without words of its own is told by."""
    row = headline_row(cell)
    return None if row is None else Reading(_told(row), _distance(row), row.n)


def headline_row(cell: CellResult) -> Row | None:
    """The statistic that says most, its entry farthest from what was predicted."""
    finite = [row for row in cell.rows if np.isfinite(row.value)]
    for family in (*ANY, *dict.fromkeys(row.statistic.family for row in finite)):
        rows = [row for row in finite if row.statistic.family == family]
        if rows:
            return max(rows, key=_distance)
    return None


def _told(row: Row) -> str:
    unit = "" if row.unit == "1" else f" {row.unit}"
    who = f" ({', '.join(row.statistic.entries)})" if row.statistic.entries else ""
    said = f"{row.statistic.family.words} {_value(row)}{unit}{who}"
    if row.check == "limit" or row.prediction is None:
        return said
    return f"{said}; {rounded(row.prediction, 3)} predicted"


def _value(row: Row) -> str:
    sampled = row.standard_error > 0.0
    exact = partial(rounded, digits=3)
    return measured(row.value, row.standard_error) if sampled else exact(row.value)


def _distance(row: Row) -> float:
    """How far a value is from its prediction, or from nothing."""
    if row.prediction is None or not np.isfinite(row.prediction):
        return abs(row.value)
    return abs(row.value - row.prediction) / (abs(row.prediction) or 1.0)


def _ratio(row: Row) -> str:
    by = row.prediction or 1.0
    return measured(row.value / by, row.standard_error / by)


def _sound(row: Row) -> bool:
    """Whether a row is a size beside a prediction."""
    numbers = (row.value, row.standard_error, row.prediction or 0.0)
    return bool(np.isfinite(numbers).all()) and min(row.value, numbers[2]) > 0.0


READERS: Mapping[str, Callable[[CellResult], Reading | None]] = {
    "calibration": _calibration,
    "attitude": _attitude,
    "filter": _filter,
    "magnetometer": _magnetometer,
    "gyroscope": _gyroscope,
    "end_to_end": _end_to_end,
    "detector": _detector,
}
