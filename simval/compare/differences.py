r"""Two runs side by side: what changed, with its uncertainty.

Of a statistic that both have (see `matching`), with standard errors :math:`s_A, s_B`,
the difference :math:`d = v_B - v_A` has at most the standard error

.. math:: s = \sqrt{s_A^2 + s_B^2}  \tag{D1}

which holds for independent noise and is generous for cells of the same name and seed,
which draw the same noise. :math:`p = 2\Phi(-|d|/s)`; all p-values together share the
false-alarm rate by Holm's rule. A deterministic statistic changed if it moved by more
than `EXACT_BOUND` of its size. One with a limit (`limit`) is rounding noise below it,
and changed if it crossed the limit.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import hypot, isfinite
from typing import Literal

import numpy as np
import scipy

from simval.change import EXACT_BOUND, PAIRED_BOUND, holm, on_same_noise
from simval.compare.matching import Pair, match, pairs_of, prediction_changed, rows_of
from simval.compare.moves import Standing, Step, loss, standing
from simval.results import Row
from simval.statistics import Statistic
from simval.sweep.provenance import differences
from simval.sweep.run import Run
from simval.verdict import ALPHA

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
        None where the statistic is deterministic.
    predictors : tuple of str
        Theories that the same value is compared with; `a` and `b` are the first one's.
    standing : {"better", "worse", "neither"}
        Which way it moved, by the direction of its family.
    study : str
        Name of the study.
    """

    cells: tuple[str, str]
    a: Row
    b: Row
    kind: Kind
    standard_error: float
    p_value: float | None
    predictors: tuple[str, ...]
    standing: Standing = "neither"
    study: str = ""

    @property
    def name(self) -> str:
        """Statistic, and the theories it is compared with."""
        theories = "; ".join(p for p in self.predictors if p)
        return f"{self.a.statistic}{' against ' if theories else ''}{theories}"

    @property
    def difference(self) -> float:
        """Value in B minus value in A."""
        return self.b.value - self.a.value

    @property
    def sigmas(self) -> float | None:
        """Difference in standard errors; None for a deterministic statistic."""
        if not self.standard_error > 0.0:
            return None
        return self.difference / self.standard_error

    @property
    def relative(self) -> float | None:
        """Difference over the size of A's value; None where that is zero."""
        return self.difference / abs(self.a.value) if self.a.value else None

    @property
    def prediction_changed(self) -> bool:
        """Whether the prediction itself changed."""
        return prediction_changed(self.a, self.b)

    @property
    def step(self) -> Step:
        """The same as a step, for `simval.compare.moved`."""
        return Step(
            study=self.study,
            cell=self.cells[1],
            statistic=self.b.statistic,
            before=self.a.value,
            after=self.b.value,
            error=self.standard_error,
            moved=self.kind == "changed",
            standing=self.standing,
            predictions=(self.a.prediction, self.b.prediction),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class RunComparison:
    """What two runs have in common and where they differ.

    Attributes
    ----------
    differences : tuple of Difference
        Changed ones first, each by how far it moved.
    only_a, only_b : tuple of str
        Names of finished cells, or cell and statistic, that only one run has.
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

    @property
    def steps(self) -> tuple[Step, ...]:
        """Every common statistic as a step, once whatever theories it is beside."""
        return tuple(d.step for d in self.differences)

    def count(self, standing: Standing) -> int:
        """How many changed this way.

        Parameters
        ----------
        standing : {"better", "worse", "neither"}
            Which way.

        Returns
        -------
        int
            Their number.
        """
        return sum(d.standing == standing for d in self.of("changed"))


def compare_runs(a: Run, b: Run, alpha: float = ALPHA) -> RunComparison:
    """Compare two runs, statistic by statistic.

    Parameters
    ----------
    a, b : Run
        Before and after.
    alpha : float, default ALPHA
        False-alarm rate of all differences together.

    Returns
    -------
    RunComparison
        Sorted: what changed most comes first.
    """
    matched, only_a, only_b = match(a, b)
    pairs: list[Pair] = []
    for old, new in matched:
        before, after = rows_of(old), rows_of(new)
        pairs += pairs_of(old, new)
        only_a += [f"{old.name} {_named(key)}" for key in before if key not in after]
        only_b += [f"{new.name} {_named(key)}" for key in after if key not in before]
    return RunComparison(
        differences=tuple(sorted(_judged(pairs, alpha), key=_rank)),
        only_a=tuple(only_a),
        only_b=tuple(only_b),
        environment=tuple(differences(_dependencies(a), _dependencies(b))),
        alpha=alpha,
    )


def _named(key: tuple[Statistic, str]) -> str:
    return f"{key[0]} against {key[1]}" if key[1] else str(key[0])


def _dependencies(run: Run) -> Mapping[str, object]:
    kept = ("suite", "versions", "git", "source", "models", "files", "machine")
    return {key: run.manifest[key] for key in kept if key in run.manifest}


def _judged(pairs: Sequence[Pair], alpha: float) -> Iterator[Difference]:
    errors = [hypot(a.standard_error, b.standard_error) for _, _, a, b, _ in pairs]
    values = np.array(
        [
            two_sided(b.value - a.value, s) if s > 0.0 else np.nan
            for (_, _, a, b, _), s in zip(pairs, errors, strict=True)
        ]
    )
    sampled = np.isfinite(values)
    limits = np.full(len(pairs), np.nan)
    limits[sampled] = holm(values[sampled], alpha)
    for (old, new, a, b, theories), s, p, limit in zip(
        pairs, errors, values, limits, strict=True
    ):
        paired = old.name == new.name and a.n == b.n
        kind = _kind(a, b, s, beyond=not p > limit, paired=paired)
        yield Difference(
            cells=(old.name, new.name),
            study=new.study,
            a=a,
            b=b,
            kind=kind,
            standing=_standing(a, b, s, limit) if kind == "changed" else "neither",
            standard_error=s,
            p_value=float(p) if s > 0.0 else None,
            predictors=theories,
        )


def two_sided(difference: float, error: float) -> float:
    """Probability of so great a difference by chance; 0 of one that is no number."""
    if not (isfinite(difference) and isfinite(error)):
        return 0.0  # a value that became NaN or infinite has changed
    return float(2.0 * scipy.special.ndtr(-abs(difference) / error))


def _kind(a: Row, b: Row, error: float, *, beyond: bool, paired: bool) -> Kind:
    if a.check == b.check == "limit" and a.prediction is not None:
        crossed = (a.value <= a.prediction) != (b.value <= (b.prediction or 0.0))
        return "changed" if crossed else "same"
    sampled = error > 0.0
    if sampled and beyond:
        return "changed"
    bound = PAIRED_BOUND * error if sampled else EXACT_BOUND * abs(a.value)
    if on_same_noise(a.value, b.value, bound) != "changed":
        return "same"
    if not sampled:
        return "changed"
    return "moved" if paired else "same"


def _standing(a: Row, b: Row, error: float, limit: float) -> Standing:
    """Which way a value changed: its loss must have changed as well."""
    change = loss(b.statistic, b.value, b.prediction) - loss(
        a.statistic, a.value, a.prediction
    )
    least = EXACT_BOUND * abs(a.value) if isfinite(a.value) else 0.0
    if error > 0.0:
        least = -float(scipy.special.ndtri(limit / 2.0)) * error
    return standing(change, least)


def _rank(difference: Difference) -> tuple[int, float, str]:
    kind = {"changed": 0, "moved": 1, "same": 2}[difference.kind]
    return kind, -difference.step.weight, difference.cells[0]
