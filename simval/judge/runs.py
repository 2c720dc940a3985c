r"""Comparison of two runs: what changed, compared with its uncertainty.

A cell is matched by its study and parameters, without the seed and the number of
samples. Several equal ones are matched by seed or, without a common seed, in order.

Of a statistic that both have, with standard errors :math:`s_A, s_B`, the difference
:math:`d = v_B - v_A` has at most the standard error

.. math:: s = \sqrt{s_A^2 + s_B^2}  \tag{D1}

if their noise is independent. :math:`p = 2\Phi(-|d|/s)`; all p-values together share
the false-alarm rate by Holm's rule. Cells of the same name and seed draw the same
noise: there a value changed if it moved by more than rounding, as for the gate
(`simval.judge.comparison`), and its error is that of the value before. One with a limit
is rounding noise below it, and changed if it crossed the limit. A value of one
draw that states no error is not compared with one of another seed.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import isfinite
from typing import Literal, NamedTuple

import numpy as np
import scipy

from simval.change import (
    EXACT_BOUND,
    holm,
    is_near,
    matched,
    on_same_noise,
    question,
    two_sided,
)
from simval.judge.baseline import Entry, by_statistic, entry_of
from simval.judge.comparison import bounds_on_same_noise, way_of
from simval.judge.steps import Move, Standing, Step, moved, rounding_of
from simval.results import Row
from simval.statistics import Statistic
from simval.sweep.identity import other_machines
from simval.sweep.provenance import differences
from simval.sweep.run import CellResult, Run
from simval.verdict import ALPHA

Kind = Literal["changed", "same"]

SHORT = 10
"""Digits of a commit that a person needs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Origin:
    """Where a run comes from: folder, suite, seeds and commit."""

    name: str  # of its folder
    suite: str
    seeds: tuple[int, ...]
    # the first digits, ``+`` where files were changed; empty where it is not known
    commit: str
    committed: str  # when the commit was made, ISO 8601; empty where not known
    started: str  # when the run was

    @property
    def label(self) -> str:
        """The commit if it is known, else the folder."""
        return self.commit or self.name

    @property
    def words(self) -> str:
        """The origin in one phrase, with dates as days."""
        when = self.committed or self.started
        of = " of " if self.committed else ", run on "
        commit = f"commit {self.commit}" if self.commit else "commit unknown"
        seeds = ", ".join(map(str, self.seeds)) or "none"
        return (
            f"{self.name}: suite {self.suite or 'unknown'}, seeds {seeds}, "
            f"{commit}{of + when[:10] if when else ''}"
        )


def origin_of(run: Run) -> Origin:
    """Read the origin of a run from its manifest."""
    git = run.manifest.get("git", {})
    commit = str(git.get("commit") or "")[:SHORT]
    return Origin(
        name=run.folder.resolve().name,
        suite=str(run.manifest.get("suite", "")),
        seeds=tuple(sorted({cell.seed for cell in run.cells})),
        commit=f"{commit}+" if commit and git.get("dirty") else commit,
        committed=str(run.timing.get("committed") or ""),
        started=str(run.timing.get("started") or ""),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Difference(Step):
    """Change of one statistic between two runs, with its rows in both.

    The standard error is that of eq. (D1), on the same noise that of the value before.
    Theories that the same value is compared with are one difference; `a` and `b` are
    the rows of the first one.
    """

    cell_a: str  # name of the cell in A; `cell` is that in B
    a: Row
    b: Row
    kind: Kind
    p_value: float | None  # None where the statistic is deterministic
    predictors: tuple[str, ...]
    prediction_changed: bool  # of one of them

    @property
    def name(self) -> str:
        """The statistic, and the theories that judge it."""
        theories = "; ".join(p for p in self.predictors if p)
        return f"{self.statistic}{' against ' if theories else ''}{theories}"


class Pair(NamedTuple):
    """A statistic of a cell in two runs, with the theories that judge it."""

    old: CellResult
    new: CellResult
    a: Row
    b: Row
    entries: tuple[Entry, Entry]  # as a baseline has them
    theories: list[str]
    moved: int  # theories whose prediction changed

    @property
    def same_noise(self) -> bool:
        """True if both were measured with the same noise."""
        return self.old.name == self.new.name


@dataclass(frozen=True, kw_only=True)
class RunComparison:
    """Comparison of the statistics that two runs share."""

    pairs: tuple[Pair, ...]  # a statistic in both
    kinds: tuple[Kind, ...]  # of each pair
    errors: tuple[float, ...]  # standard errors of the differences
    p_values: tuple[float, ...]  # of those that have a standard error
    within: int  # that changed on the same noise by less than chance may between seeds
    standings: Mapping[int, Standing]  # of the pairs that changed
    # names of finished cells, or cell and statistic, that only one run has
    only_a: tuple[str, ...]
    only_b: tuple[str, ...]
    environment: tuple[str, ...]  # where versions, commit, models or machine differ
    alpha: float  # false-alarm rate that all differences share

    @property
    def total(self) -> int:
        """Number of statistics that both runs have."""
        return len(self.pairs)

    @property
    def predictions_changed(self) -> int:
        """Number of predictions that changed."""
        return sum(pair.moved for pair in self.pairs)

    @cached_property
    def differences(self) -> tuple[Difference, ...]:
        """All differences, changed ones first, the largest first."""
        return (*self.of("changed"), *self.of("same"))

    @property
    def moves(self) -> tuple[Move, ...]:
        """Changes by study, kind of statistic and direction, largest first."""
        changed = self.of("changed")
        studies = {each.study for each in changed}
        return moved(
            changed,
            (
                (pair.new.study, pair.b.statistic, pair.new.name)
                for pair in self.pairs
                if pair.new.study in studies
            ),
        )

    def of(self, kind: Kind) -> tuple[Difference, ...]:
        """Differences of one kind, the largest first.

        Parameters
        ----------
        kind : {"changed", "same"}
            Which.

        Returns
        -------
        tuple of Difference
            Those.
        """
        places = (i for i, each in enumerate(self.kinds) if each == kind)
        found = map(self._difference, places)
        return tuple(sorted(found, key=lambda each: (-each.weight, each.cell_a)))

    def count(self, standing: Standing) -> int:
        """Number of statistics that changed in this direction.

        Parameters
        ----------
        standing : {"better", "worse", "neither"}
            Which way.

        Returns
        -------
        int
            Their number.
        """
        return sum(each == standing for each in self.standings.values())

    def _difference(self, i: int) -> Difference:
        old, new, a, b, _, theories, moved = self.pairs[i]
        return Difference(
            study=new.study,
            cell=new.name,
            statistic=b.statistic,
            before=a.value,
            after=b.value,
            error=self.errors[i],
            moved=self.kinds[i] == "changed",
            standing=self.standings.get(i, "neither"),
            predictions=(a.prediction, b.prediction),
            cell_a=old.name,
            a=a,
            b=b,
            kind=self.kinds[i],
            p_value=self.p_values[i] if self.errors[i] > 0.0 else None,
            predictors=tuple(theories),
            prediction_changed=moved > 0,
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
    pairs, *rest = matched(
        (cell for cell in a.cells if cell.status == "done"),
        (cell for cell in b.cells if cell.status == "done"),
        lambda cell: f"{cell.study} {question(cell.parameters)}",
        lambda cell: cell.seed,
    )
    only_a, only_b = ([cell.name for cell in cells] for cells in rest)
    return pairs, only_a, only_b


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
        What changed most comes first.
    """
    cells, only_a, only_b = match(a, b)
    pairs: list[Pair] = []
    for old, new in cells:
        before = {row.key: row for row in old.rows}
        after = {row.key: row for row in new.rows}
        pairs += _pairs_of(old, new)
        if before.keys() != after.keys():
            only_a += [f"{old.name} {_named(k)}" for k in before if k not in after]
            only_b += [f"{new.name} {_named(k)}" for k in after if k not in before]
    kinds, errors, p_values, within, standings = _judged(pairs, alpha)
    return RunComparison(
        pairs=tuple(pairs),
        kinds=kinds,
        errors=errors,
        p_values=p_values,
        within=within,
        standings=standings,
        only_a=tuple(only_a),
        only_b=tuple(only_b),
        environment=tuple(differences(_dependencies(a), _dependencies(b))),
        alpha=alpha,
    )


def _named(key: tuple[Statistic, str]) -> str:
    return f"{key[0]} against {key[1]}" if key[1] else str(key[0])


def _dependencies(run: Run) -> Mapping[str, object]:
    kept = ("suite", "versions", "git", "source", "models", "files", "machine")
    own = {key: run.manifest[key] for key in kept if key in run.manifest}
    others = other_machines(run.manifest)
    return {**own, "other machines": others} if others else own


def _pairs_of(old: CellResult, new: CellResult) -> Iterator[Pair]:
    """Each statistic that both cells have."""
    groups = by_statistic(new.rows)
    for name, before in by_statistic(old.rows).items():
        after = {row.predictor: row for row in groups.get(name, ())}
        pairs = [(a, after[a.predictor]) for a in before if a.predictor in after]
        if pairs:
            a, b = pairs[0]
            yield Pair(
                old, new, a, b,
                (entry_of(before), entry_of(groups[name])),
                [row.predictor for row, _ in pairs],
                sum(prediction_changed(*each) for each in pairs),
            )  # fmt: skip


def prediction_changed(a: Row, b: Row) -> bool:
    """True if the prediction of a statistic changed."""
    if a.prediction is None or b.prediction is None:
        return a.prediction is not b.prediction
    if a.prediction == b.prediction:
        return False
    least = float(rounding_of([a], a.standard_error)[0])
    return not is_near(a.prediction, b.prediction, EXACT_BOUND, least)


@np.errstate(all="ignore")  # what is no number has changed
def _judged(
    pairs: Sequence[Pair], alpha: float
) -> tuple[
    tuple[Kind, ...], tuple[float, ...], tuple[float, ...], int, dict[int, Standing]
]:
    """Judge all pairs together: kinds, errors, p-values, and directions."""
    both = [pair.entries for pair in pairs]
    numbers = [(p.a.value, p.b.value, p.a.standard_error, p.b.standard_error)
               for p in pairs]  # fmt: skip
    before, after, *errors = np.array(numbers, dtype=float).reshape(-1, 4).T
    paired = np.array([pair.same_noise for pair in pairs], dtype=bool)
    limits = np.array([[e.value is None for e in each] for each in both], dtype=bool)
    below, now_below = limits.reshape(-1, 2).T
    spread = np.hypot(*errors)
    error = np.where(paired, errors[0], spread)
    sampled = error > 0.0
    p = two_sided(after - before, spread)
    limit = np.full(len(pairs), -np.inf)
    limit[sampled] = holm(p[sampled], alpha)
    chance = ~(p > limit)  # beyond it
    rounding = rounding_of([pair.a for pair in pairs], spread)
    bound = np.where(paired, bounds_on_same_noise(both), rounding)
    moved = on_same_noise(before, after, bound) == "changed"
    once = np.array([p.b.statistic.family.one_draw for p in pairs], dtype=bool)
    moved &= paired | (~sampled & ~once) | chance
    changed = np.where(below | now_below, below != now_below, moved)
    standings: dict[int, Standing] = {}
    aim = float(-scipy.special.ndtri(alpha / max(len(pairs), 1) / 2.0))
    for i in np.flatnonzero(changed).tolist():
        a, b = pairs[i].a, pairs[i].b
        crossed = below[i] or now_below[i] or not isfinite(bound[i])
        least = 0.0 if crossed else float(bound[i])
        far = aim * float(error[i])
        if sampled[i] and not paired[i]:
            least = -float(scipy.special.ndtri(limit[i] / 2.0)) * float(error[i])
        values, predictions = (a.value, b.value), (a.prediction, b.prediction)
        standings[i] = way_of(b.statistic, values, predictions, least, far)
    kinds: tuple[Kind, ...] = tuple("changed" if each else "same" for each in changed)
    within = int(np.sum(changed & paired & sampled & ~chance))
    columns = tuple(error.tolist()), tuple(p.tolist())
    return kinds, *columns, within, standings


def shared_words(a: Run, b: Run) -> str:
    """Say what two runs have in common if it is not a single cell."""
    studies = [
        list(dict.fromkeys(c.study for c in run.cells if c.status == "done"))
        for run in (a, b)
    ]
    both = [study for study in studies[0] if study in studies[1]]
    suites = [str(run.manifest.get("suite", "unknown")) for run in (a, b)]
    of = f"both are of the suite {suites[0]}"
    if suites[0] != suites[1]:
        of = f"A is of the suite {suites[0]}, B of {suites[1]}"
    if both:
        return f"{of}; both have {', '.join(both)}, but at other parameters"
    listed = [", ".join(names) or "nothing" for names in studies]
    return f"{of}; A has measured {listed[0]}, B {listed[1]}"
