r"""Two runs side by side: what changed, with its uncertainty.

A cell is matched by its study and parameters, without the seed and the number of
samples, and among equals by the seed or, where no seed is common, by the order. Of a
statistic with standard errors :math:`s_A, s_B` the difference :math:`d = v_B - v_A` has
at most the standard error

.. math:: s = \sqrt{s_A^2 + s_B^2}  \tag{D1}

which holds for independent noise and is generous for cells of the same name and seed,
which draw the same noise. :math:`p = 2\Phi(-|d|/s)`; all p-values together share the
false-alarm rate by Holm's rule. A statistic without chance changed where it moved by
more than `EXACT_BOUND` of its size; one that has a limit (`limit`) is rounding below
it, and changed where it went from one side of its limit to the other.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import hypot, inf, isfinite
from typing import Literal

import numpy as np
from scipy.special import ndtr

from simval.results import Row
from simval.sweep.provenance import differences
from simval.sweep.run import CellResult, Run

EXACT_BOUND = 1e-6
"""Relative change that a value without chance may show: rounding, amplified."""

PAIRED_BOUND = 1e-3
"""Standard errors that a value drawn from the same noise moves by rounding alone."""

EFFORT = ("trials", "samples")
"""Parameters that say how much was computed, not what."""

Kind = Literal["changed", "moved", "same"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Difference:
    """One statistic in both runs.

    Attributes
    ----------
    cells : tuple of str
        Name of the cell in A and in B.
    a, b : Row
        The statistic in both.
    kind : Kind
        ``changed`` beyond its uncertainty; ``moved`` within it, though the noise was
        the same, so the algorithm is not; ``same``.
    standard_error : float
        Of the difference, eq. (D1).
    p_value : float or None
        None where no chance is involved.
    """

    cells: tuple[str, str]
    a: Row
    b: Row
    kind: Kind
    standard_error: float
    p_value: float | None

    @property
    def difference(self) -> float:
        """Value in B minus value in A."""
        return self.b.value - self.a.value

    @property
    def sigmas(self) -> float | None:
        """Difference in standard errors; None where no chance is involved."""
        if not self.standard_error > 0.0:
            return None
        return self.difference / self.standard_error

    @property
    def relative(self) -> float | None:
        """Difference over the size of A's value; None where that is zero."""
        return self.difference / abs(self.a.value) if self.a.value else None

    @property
    def prediction_changed(self) -> bool:
        """Whether theory itself says something else."""
        old, new = self.a.prediction, self.b.prediction
        if old is None or new is None:
            return old is not new
        return not abs(new - old) <= EXACT_BOUND * max(abs(old), abs(new))


@dataclass(frozen=True, slots=True, kw_only=True)
class RunComparison:
    """What two runs have in common and where they differ.

    Attributes
    ----------
    differences : tuple of Difference
        Changed ones first, each by how far it moved.
    only_a, only_b : tuple of str
        Names of finished cells, or cell and statistic, that one run alone has.
    environment : tuple of str
        Where versions, commit, models or machine differ.
    alpha : float
        False-alarm rate that all differences share.
    """

    differences: tuple[Difference, ...]
    only_a: tuple[str, ...]
    only_b: tuple[str, ...]
    environment: tuple[str, ...]
    alpha: float

    def of(self, kind: Kind) -> tuple[Difference, ...]:
        """Differences of one kind, in order.

        Parameters
        ----------
        kind : {"changed", "moved", "same"}
            Which.

        Returns
        -------
        tuple of Difference
            Those.
        """
        return tuple(d for d in self.differences if d.kind == kind)


def compare_runs(a: Run, b: Run, alpha: float = 1e-3) -> RunComparison:
    """Compare two runs, statistic by statistic.

    Parameters
    ----------
    a, b : Run
        Before and after.
    alpha : float, default 1e-3
        False-alarm rate of all differences together.

    Returns
    -------
    RunComparison
        Sorted: what changed most comes first.
    """
    matched, only_a, only_b = match(a, b)
    pairs: list[tuple[CellResult, CellResult, Row, Row]] = []
    for old, new in matched:
        known, found = _rows(old), _rows(new)
        shared = [key for key in known if key in found]
        pairs += [(old, new, known[key], found[key]) for key in shared]
        only_a += [f"{old.name} {_named(key)}" for key in known if key not in found]
        only_b += [f"{new.name} {_named(key)}" for key in found if key not in known]
    found_differences = sorted(_judged(pairs, alpha), key=_rank)
    return RunComparison(
        differences=tuple(found_differences),
        only_a=tuple(only_a),
        only_b=tuple(only_b),
        environment=tuple(differences(_dependencies(a), _dependencies(b))),
        alpha=alpha,
    )


def match(
    a: Run, b: Run
) -> tuple[list[tuple[CellResult, CellResult]], list[str], list[str]]:
    """Find the finished cells that two runs have in common.

    Parameters
    ----------
    a, b : Run
        The runs.

    Returns
    -------
    pairs : list of (CellResult, CellResult)
        In the order of A.
    only_a, only_b : list of str
        Names of the cells without a partner.
    """
    left, right = _by_key(a), _by_key(b)
    pairs: list[tuple[CellResult, CellResult]] = []
    only_a: list[str] = []
    only_b = [c.name for key, cells in right.items() if key not in left for c in cells]
    for key, cells in left.items():
        others = list(right.get(key, ()))
        rest = []
        for cell in cells:
            twin = next((o for o in others if o.seed == cell.seed), None)
            if twin is None:
                rest.append(cell)
                continue
            pairs.append((cell, twin))
            others.remove(twin)
        count = min(len(rest), len(others))
        pairs += zip(rest[:count], others[:count], strict=True)
        only_a += [cell.name for cell in rest[count:]]
        only_b += [cell.name for cell in others[count:]]
    return pairs, only_a, only_b


def _by_key(run: Run) -> dict[str, list[CellResult]]:
    groups: dict[str, list[CellResult]] = {}
    for cell in run.cells:
        if cell.status == "done":
            kept = {k: v for k, v in cell.parameters.items() if k not in EFFORT}
            groups.setdefault(f"{cell.study} {sorted(kept.items())}", []).append(cell)
    return groups


def _rows(cell: CellResult) -> dict[tuple[str, str], Row]:
    return {(row.statistic, row.predictor): row for row in cell.rows}


def _named(key: tuple[str, str]) -> str:
    return f"{key[0]} against {key[1]}" if key[1] else key[0]


def _dependencies(run: Run) -> Mapping[str, object]:
    kept = ("suite", "versions", "git", "models", "machine")
    return {key: run.manifest[key] for key in kept if key in run.manifest}


def _judged(
    pairs: Sequence[tuple[CellResult, CellResult, Row, Row]], alpha: float
) -> Iterator[Difference]:
    errors = [hypot(a.standard_error, b.standard_error) for *_, a, b in pairs]
    values = np.array(
        [
            _p_value(b.value - a.value, s) if s > 0.0 else np.nan
            for (*_, a, b), s in zip(pairs, errors, strict=True)
        ]
    )
    limit = _holm_limit(values[np.isfinite(values)], alpha)
    for (old, new, a, b), s, p in zip(pairs, errors, values, strict=True):
        paired = old.name == new.name and a.n == b.n
        yield Difference(
            cells=(old.name, new.name),
            a=a,
            b=b,
            kind=_kind(a, b, s, float(p), limit, paired=paired),
            standard_error=s,
            p_value=float(p) if s > 0.0 else None,
        )


def _p_value(difference: float, error: float) -> float:
    if not (isfinite(difference) and isfinite(error)):
        return 0.0  # a number that became none has changed
    return float(2.0 * ndtr(-abs(difference) / error))


def _kind(
    a: Row, b: Row, error: float, p: float, limit: float, *, paired: bool
) -> Kind:
    step = abs(b.value - a.value)
    if a.check == b.check == "limit" and a.prediction is not None:
        crossed = (a.value <= a.prediction) != (b.value <= (b.prediction or 0.0))
        return "changed" if crossed else "same"
    if not error > 0.0:
        size = max(abs(a.value), abs(b.value))
        same = a.value == b.value or (isfinite(step) and step <= EXACT_BOUND * size)
        return "same" if same else "changed"
    if not p > limit:
        return "changed"
    return "moved" if paired and not step <= PAIRED_BOUND * error else "same"


def _holm_limit(values: np.ndarray, alpha: float) -> float:
    """Greatest p-value that Holm's step-down rule rejects; -1 where it rejects none."""
    ordered = np.sort(values)
    steps = alpha / (len(ordered) - np.arange(len(ordered)))
    kept = ordered > steps
    rejected = int(np.argmax(kept)) if kept.any() else len(ordered)
    return float(ordered[rejected - 1]) if rejected else -1.0


def _rank(difference: Difference) -> tuple[int, float, str]:
    kind = {"changed": 0, "moved": 1, "same": 2}[difference.kind]
    size = difference.sigmas if difference.sigmas is not None else difference.relative
    distance = inf if size is None or not isfinite(size) else abs(size)
    if size is None and difference.difference == 0.0:
        distance = 0.0
    return kind, -distance, difference.cells[0]
