"""Scalars of a cell for the figures, each with its error and prediction."""

from collections.abc import Sequence

import numpy as np

from simval.arrays import Array
from simval.report.curves import Curve, Measure, read, triple
from simval.report.notes import Measured
from simval.results import Row
from simval.shapes import Float
from simval.statistics import COVARIANCE, EXACT, RMS, Family
from simval.sweep.run import CellResult

GROUPS = {"T": "misalignment T", "K": "scale K", "B": "bias B"}
STANDARD_GRAVITY = 9.80665
"""Unit in which the bias joins the other parameters, m/s^2."""
ROUNDING = 1e-9
"""By which the least eigenvalue of rounded correlations may be below zero."""
MOST_AXES = 12
"""Axes of a covariance that is looked up pair by pair; an attitude has three."""


def together(predictor: str) -> Measure:
    """RMS error of all nine parameters, the bias in units of standard gravity."""

    def measure(cell: CellResult) -> Measured | None:
        rows = [cell.row(RMS(name), predictor) for name in GROUPS]
        if any(row is None or row.prediction is None for row in rows):
            return None
        units = (1.0, 1.0, STANDARD_GRAVITY)
        parts = [
            (
                row.value / u,
                row.standard_error / u,
                row.prediction / u,
                row.remainder / u,
            )
            for row, u in zip(rows, units, strict=True)
            if row is not None and row.prediction is not None
        ]
        value, error, predicted, rest = np.array(parts).T
        if not np.isfinite(parts).all():
            return None
        rms = float(np.sqrt(np.mean(value**2)))
        return Measured(
            rms,
            float(np.sum(value * error)) / (3.0 * rms),
            float(np.sqrt(np.mean(predicted**2))),
            float(np.sum(value * rest)) / (3.0 * rms),
            min(row.n for row in rows if row is not None),
        )

    return measure


def part(family: Family, name: str, predictor: str) -> Measure:
    """RMS over the three entries of T, K or B of their sd or bias."""
    letters = tuple("ST" if name == "T" else name)

    @np.errstate(over="ignore", invalid="ignore")  # what overflows is not drawn
    def measure(cell: CellResult) -> Measured | None:
        rows = [
            row
            for row in cell.rows
            if row.predictor == predictor
            and row.statistic.family == family
            and row.statistic.entries[0].startswith(letters)
            and not row.statistic.controlled
        ]
        if not rows or any(row.prediction is None for row in rows):
            return None
        value = np.array([row.value for row in rows])
        error = np.array([row.standard_error for row in rows])
        predicted = np.array([row.prediction for row in rows], dtype=float)
        size = float(np.sqrt(np.mean(predicted**2)))
        if not (size > 0.0 and np.isfinite([value, error, predicted]).all()):
            return None
        weight = predicted / size / len(rows)
        # how the entries of one trial go together no row says: as `together`
        spread = float(np.abs(weight) @ error)
        rest = float(np.abs(weight) @ [row.remainder for row in rows])
        return Measured(float(weight @ value), spread, size, rest, *samples(rows))

    return measure


def moment(family: Family, predictor: str) -> Measure:
    """Bias or covariance, projected on the direction of the prediction.

    The entries come from the same samples. What correlates their errors is the
    covariance that is predicted; without it, all are taken to move one way.
    """

    @np.errstate(over="ignore", invalid="ignore")  # what overflows is not drawn
    def measure(cell: CellResult) -> Measured | None:
        rows = _entries(cell, family, predictor)
        predicted = np.array([row.prediction for row in rows], dtype=float)
        twice = np.array([_times(row) for row in rows])
        size = float(np.sqrt(np.sum(twice * predicted**2)))
        value = np.array([row.value for row in rows])
        error = np.array([row.standard_error for row in rows])
        if not (size > 0.0 and np.isfinite([value, error, predicted]).all()):
            return None
        weight = twice * predicted / size
        parts, whole = weight * error, _correlations(cell, rows, predictor)
        spread = float(np.sum(np.abs(parts)))
        if whole is not None:
            spread = float(np.sqrt(max(parts @ whole @ parts, 0.0)))
        rest = float(np.abs(weight) @ [row.remainder for row in rows])
        return Measured(float(weight @ value), spread, size, rest, *samples(rows))

    return measure


def left_out(family: Family, predictor: str, reference: str = EXACT) -> Measure:
    """How far a prediction is from a better one: what it leaves out."""

    def measure(cell: CellResult) -> Measured | None:
        truth = {r.statistic: r for r in _entries(cell, family, reference)}
        rows = [r for r in _entries(cell, family, predictor) if r.statistic in truth]
        if not rows:
            return None
        twice = np.array([_times(row) for row in rows])
        exact = np.array([truth[r.statistic].prediction for r in rows], dtype=float)
        predicted = np.array([r.prediction for r in rows], dtype=float)
        distance = float(np.sqrt(np.sum(twice * (predicted - exact) ** 2)))
        size = float(np.sqrt(np.sum(twice * exact**2)))
        return Measured(distance, 0.0, size, against="of")

    return measure


def samples(rows: Sequence[Row]) -> tuple[int, str]:
    """Independent samples and unit of rows that are taken together."""
    return min(row.n for row in rows), rows[0].unit


def _entries(cell: CellResult, family: Family, predictor: str) -> list[Row]:
    return [
        row
        for row in cell.rows
        if row.predictor == predictor
        and row.statistic.family == family
        and not row.statistic.controlled
        and row.prediction is not None
    ]


def _correlations(
    cell: CellResult, rows: Sequence[Row], predictor: str
) -> Float[Array, "k k"] | None:
    """Correlations of sampled means or covariances; None if they are not known.

    Of normal samples, S_ij and S_kl covary as P_ik P_jl + P_il P_jk does.
    """
    predicted = {
        frozenset(row.statistic.entries): row.prediction
        for row in _entries(cell, COVARIANCE, predictor)
    }
    axes = sorted(set().union(*predicted))
    if len(axes) > MOST_AXES:
        return None
    pairs = [[predicted.get(frozenset((a, b))) for b in axes] for a in axes]
    P = np.array(pairs, dtype=float)
    words = [row.statistic.entries for row in rows]
    if not all(words) or not set().union(*words) <= set(axes):
        return None
    ends = [(each[0], each[-1]) for each in words]
    if not (np.isfinite(P).all() and (np.diagonal(P) > 0.0).all()):
        return None
    sd = np.sqrt(np.diagonal(P))
    R = P / sd / sd[:, None]
    if not np.abs(R).max() <= 1.0 + ROUNDING:  # an infinite one has no eigenvalues
        return None
    if not np.linalg.eigvalsh(R)[0] >= -ROUNDING:
        return None
    i, j = np.array([[axes.index(axis) for axis in pair] for pair in ends]).T
    if all(len(row.statistic.entries) == 1 for row in rows):
        return R[np.ix_(i, i)]
    C = R[np.ix_(i, i)] * R[np.ix_(j, j)] + R[np.ix_(i, j)] * R[np.ix_(j, i)]
    own = np.sqrt(np.diagonal(C))
    return C / own / own[:, None]


def _times(row: Row) -> float:
    """How often an entry of the upper triangle occurs in the matrix."""
    return 2.0 if len(set(row.statistic.entries)) == 2 else 1.0


def placed(label: str, rows: Sequence[Row], cell: CellResult | None = None) -> Curve:
    """Rows of a cell side by side, each at its place in the order."""
    value, error, prediction = np.array([triple(r) for r in rows]).reshape(-1, 3).T
    places = np.arange(float(len(rows)))
    return Curve(
        label=label,
        x=places,
        value=value,
        error=error,
        prediction=prediction,
        remainder=np.array([row.remainder for row in rows]),
        sources=() if cell is None else [(cell, read(row)) for row in rows],
    )
