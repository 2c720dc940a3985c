"""A measured number and its prediction: a row of every table of results.

A study returns an `Outcome`: rows, and artifacts for the report to draw from. The
`check` of a row says how `verdict` judges it. Each check has its constructor, which
takes one statistic or several and broadcasts:

======== =====================================================================
check    meaning
======== =====================================================================
plain    sampling against theory: the mean of plain samples, tested with its
         standard error against the interval prediction +- remainder
control  the same, sampled with control variates (blind to a wrong noise
         generator, so never without a plain row as well)
nees     the same, for a normalised squared error pooled over parameters
exact    deterministic: |value - prediction| must not exceed the remainder
limit    deterministic: the value must not exceed the prediction
record   reported, not judged
======== =====================================================================

A row of which theory says nothing at its cell's parameters is not judged either, and
says why (`outside`): the range in which theory holds, and where the cell is. So does a
sampled row whose remainder is above `MAX_REMAINDER` of both the prediction and the
spread of a sample: a prediction that may be off by more predicts nothing.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import ConfigDict, TypeAdapter

from simval.arrays import Array
from simval.statistics import Statistic
from simval.text import ROUNDING

Numbers = ArrayLike | tuple[float, ...]  # which NumPy's ArrayLike leaves out
Check = Literal["plain", "control", "nees", "exact", "limit", "record"]

COLUMNS = (
    "statistic",
    "predictor",
    "value",
    "standard_error",
    "n",
    "prediction",
    "remainder",
    "unit",
    "check",
    "outside",
)
"""Names of the columns of a results table, in their order."""

NUMBERS = ("value", "standard_error", "prediction", "remainder")
"""Fields of a row that its constructor broadcasts over the statistics."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """A measured statistic of a cell, with its standard error and its prediction."""

    # what was measured; unique in the cell together with `predictor`
    statistic: Statistic
    value: float  # the measured value, in the statistic's unit
    # standard error of the value; 0 where it is deterministic
    standard_error: float = 0.0
    n: int = 0  # number of independent samples behind the value
    prediction: float | None = None  # what theory says it should be
    predictor: str = ""  # which theory, see `simval.statistics`
    # what the prediction itself may be off by: the stated size of the terms it leaves
    # out
    remainder: float = 0.0
    check: Check = "record"
    # why theory says nothing of it here, with its range: then it is not judged
    outside: str = ""

    __pydantic_config__ = ConfigDict(strict=True, ser_json_inf_nan="constants")

    @property
    def unit(self) -> str:
        """Unit of the value."""
        return self.statistic.unit

    @property
    def shown(self) -> float:
        """The value for people, where mere rounding counts as 0."""
        allowed = self.prediction if self.check == "limit" else self.remainder
        computed = self.check in ("limit", "exact")  # in SI units, of a size about 1
        rounding = computed and abs(self.value) <= min(ROUNDING, allowed or 0.0)
        return 0.0 if rounding else self.value

    @property
    def claimed(self) -> bool:
        """True if theory predicts the value, even outside its range."""
        return self.check != "record" or bool(self.outside)

    @property
    def tidy(self) -> dict[str, Any]:
        """The row as the columns of a results table."""
        named = {"statistic": str(self.statistic)}
        return {name: named.get(name, getattr(self, name)) for name in COLUMNS}

    @property
    def key(self) -> tuple[Statistic, str]:
        """Key of the row within its cell: statistic and predictor."""
        return self.statistic, self.predictor


Rows = tuple[Row, ...]


@dataclass(frozen=True, slots=True, order=True)
class CellName:
    """Name of the cell that a row belongs to, and its study."""

    study: str  # name of its study; empty for the run as a whole
    # its unique name in the run; empty for all cells of the study together
    name: str = ""

    def __str__(self) -> str:
        return self.name or (f"{self.study}, all cells" if self.study else "")


Statistics = Statistic | Sequence[Statistic]
"""One statistic, or several for which the numbers are arrays."""

MAX_REMAINDER = 0.5
"""Greatest remainder over the predicted value or one sample's own spread, whichever
is greater."""


def _sampled(
    check: Check,
    statistics: Statistics,
    value: Numbers,
    standard_error: Numbers,
    n: int,
    prediction: Numbers,
    predictor: str,
    remainder: Numbers = 0.0,
) -> Rows:
    """Rows of sampled values, which are judged against the prediction of theory.

    Parameters
    ----------
    check : str
        Rule by which the rows are judged: ``plain``, ``control`` or ``nees``.
    statistics : Statistic or sequence of Statistic
        What was measured; the numbers have a value for each, or one for all.
    value, standard_error : array_like
        Measured values and their standard errors, in the statistics' units.
    n : int
        Number of independent samples.
    prediction : array_like
        Predicted values, in the same units.
    predictor : str
        Name of the theory.
    remainder : array_like, default 0
        Largest error of the prediction itself, by what the theory leaves out.

    Returns
    -------
    tuple of Row
        A row for each statistic. One whose remainder is too large is not judged.
    """
    numbers = (value, standard_error, prediction, remainder)
    rows = _rows(check, statistics, n, predictor, *numbers)
    return tuple(beyond([row], _too_much(row))[0] for row in rows)


def _too_much(row: Row) -> str:
    """Say why a remainder is too large to judge by; empty if it is not."""
    assert row.prediction is not None
    size = max(abs(row.prediction), row.standard_error * row.n**0.5)
    if not row.remainder > MAX_REMAINDER * size:
        return ""
    return (
        f"what theory leaves out may be {row.remainder:.2g} here, and it holds up to "
        f"{MAX_REMAINDER:g} of the prediction or of a trial's spread, {size:.2g}"
    )


def beyond(rows: Iterable[Row], why: str) -> Rows:
    """The same rows, unjudged if there is a reason why theory does not reach there."""
    return tuple(
        replace(row, check="record", outside=why)
        if why and row.check != "record"
        else row
        for row in rows
    )


plain = partial(_sampled, "plain")
"""Rows of plain samples: ``plain(statistics, value, standard_error, n, ...)``."""

control = partial(_sampled, "control")
"""Rows of samples with control variates; arguments as of `plain`."""

nees = partial(_sampled, "nees")
"""Rows of normalised squared errors; arguments as of `plain`."""


def exact(
    statistics: Statistics,
    value: Numbers,
    prediction: Numbers,
    predictor: str,
    remainder: Numbers,
    n: int = 0,
) -> Rows:
    """Rows without chance that must equal the prediction to within the remainder."""
    numbers = (value, 0.0, prediction, remainder)
    return _rows("exact", statistics, n, predictor, *numbers)


def limit(
    statistics: Statistics, value: Numbers, most: Numbers, predictor: str, n: int = 0
) -> Rows:
    """Rows without chance that must not exceed a limit."""
    return _rows("limit", statistics, n, predictor, value, 0.0, most, 0.0)


def unjudged(
    statistics: Statistics,
    value: Numbers,
    standard_error: Numbers = 0.0,
    n: int = 0,
    prediction: Numbers | None = None,
    predictor: str = "",
    remainder: Numbers = 0.0,
) -> Rows:
    """Rows that are reported but not judged."""
    numbers = (value, standard_error, prediction, remainder)
    return _rows("record", statistics, n, predictor, *numbers)


def _rows(
    check: Check, statistics: Statistics, n: int, predictor: str, *numbers: Any
) -> Rows:
    members = (statistics,) if isinstance(statistics, Statistic) else tuple(statistics)
    columns = {
        name: np.broadcast_to(np.asarray(value, dtype=float), len(members)).tolist()
        for name, value in zip(NUMBERS, numbers, strict=True)
        if value is not None
    }
    return tuple(
        Row(
            statistic=statistic,
            n=int(n),
            predictor=predictor,
            check=check,
            **{name: column[i] for name, column in columns.items()},
        )
        for i, statistic in enumerate(members)
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What a study's function returns for a cell.

    Attributes
    ----------
    rows : tuple of Row
        Its statistics, as `plain`, `exact`, `limit` and `unjudged` make them.
    artifacts : mapping of str to mapping or bytes
        Files for the page, by name: arrays by their names (stored as npz), or bytes
        (stored as they are). Cells of a run share the names and the last one written
        wins, so a name says which parameters its file depends on.
    times : mapping of str to float
        Times that were measured, s, and ratios of them; no comparison looks at them.
    """

    rows: Rows
    artifacts: Mapping[str, Mapping[str, Array] | bytes] = field(default_factory=dict)
    times: Mapping[str, float] = field(default_factory=dict)


ROWS: TypeAdapter[Rows] = TypeAdapter(Rows)
"""Rows from and to JSON, as they cross between processes."""
