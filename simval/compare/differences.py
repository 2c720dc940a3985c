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

from collections.abc import Mapping
from dataclasses import dataclass

from simval.compare.judged import Difference, Kind, judged
from simval.compare.matching import Pair, matched_places, pairs_of, rows_of
from simval.compare.moves import Move, Standing, Step, moved
from simval.statistics import Statistic
from simval.sweep.machines import other_machines
from simval.sweep.provenance import differences
from simval.sweep.run import Run
from simval.verdict import ALPHA


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

    @property
    def total(self) -> int:
        """How many statistics both have."""
        return len(self.differences)

    def number(self, kind: Kind) -> int:
        """How many differences are of one kind.

        Parameters
        ----------
        kind : {"changed", "moved", "same"}
            Which.

        Returns
        -------
        int
            Their number.
        """
        return len(self.of(kind))

    @property
    def predictions_changed(self) -> int:
        """How many predictions changed."""
        return sum(d.prediction_changed for d in self.differences)

    @property
    def moves(self) -> tuple[Move, ...]:
        """What changed, by study, kind of statistic and direction, largest first."""
        return moved(self.steps)

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
    places, only_a, only_b = matched_places(a, b)
    pairs: list[Pair] = []
    for i, j in places:
        old, new = a.cells[i], b.cells[j]
        before, after = rows_of(old), rows_of(new)
        pairs += pairs_of(old, new, before, after)
        only_a += [f"{old.name} {_named(key)}" for key in before if key not in after]
        only_b += [f"{new.name} {_named(key)}" for key in after if key not in before]
    return RunComparison(
        differences=tuple(sorted(judged(pairs, alpha), key=_rank)),
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


def _rank(difference: Difference) -> tuple[int, float, str]:
    kind = {"changed": 0, "moved": 1, "same": 2}[difference.kind]
    return kind, -difference.step.weight, difference.cells[0]
