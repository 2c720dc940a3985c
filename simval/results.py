"""One measured number beside its prediction: the row of every results table.

A study returns an `Outcome`: rows, and artifacts for the report to draw from. How
a row is judged is said by its `check`; the judging itself is in `verdict`.

======== =====================================================================
check    meaning
======== =====================================================================
plain    sampling against theory: the mean of plain samples, tested with its
         standard error against the interval prediction +- remainder
control  the same, sampled with control variates (blind to a wrong noise
         generator, so never without a plain row beside it)
nees     the same, for a normalised squared error pooled over parameters
exact    no chance involved: |value - prediction| must not exceed the remainder
limit    no chance involved: the value must not exceed the prediction
record   reported, not judged
======== =====================================================================
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from simval.arrays import Array

Check = Literal["plain", "control", "nees", "exact", "limit", "record"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """A statistic of one cell, its standard error and its prediction.

    Attributes
    ----------
    statistic : str
        Name, unique in the cell together with `predictor`: ``bias[K_x]``.
    value : float
        What was measured.
    unit : str
        Unit of the value; ``1`` where it has none.
    standard_error : float, default 0.0
        Standard error of the value; 0 where no chance is involved.
    n : int, default 0
        Number of independent samples behind the value.
    prediction : float, optional
        What theory says it should be.
    predictor : str, default ""
        Which theory: ``exact``, ``order 4``, ``first order`` and so on.
    remainder : float, default 0.0
        What the prediction itself may be off by: the stated size of the terms it
        leaves out.
    check : Check, default "record"
        How the row is judged.
    """

    statistic: str
    value: float
    unit: str
    standard_error: float = 0.0
    n: int = 0
    prediction: float | None = None
    predictor: str = ""
    remainder: float = 0.0
    check: Check = "record"


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What one cell of a study leaves behind.

    Attributes
    ----------
    rows : tuple of Row
        The statistics.
    artifacts : mapping, default empty
        File name to array (stored as npz) or bytes (stored as they are), for the
        report; names are shared by the cells of a run, the last one written wins,
        so a name says what it depends on.
    """

    rows: tuple[Row, ...]
    artifacts: Mapping[str, Mapping[str, Array] | bytes] = field(default_factory=dict)
