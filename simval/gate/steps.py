"""The comparisons with the baseline as steps: which way each value moved.

On the same noise the errors of both values are nearly one and the same, so a change of
an error or a share is one of the algorithm, whatever its size. A distance, of a bias
from zero or of a squared error from its mean, is noise itself where it is small: it has
a direction if it moved by more than chance explains at the false-alarm rate that all
comparisons share.
"""

from collections.abc import Iterable, Iterator

import scipy

from simval.compare import Step
from simval.compare.moves import AIMED, loss, standing
from simval.gate.comparison import Comparison


def steps_of(comparisons: Iterable[Comparison], alpha: float) -> tuple[Step, ...]:
    """Steps of the values that both have."""
    beside = steps_beside(comparisons, alpha)
    return tuple(step for _, step in beside if step is not None)


def steps_beside(
    comparisons: Iterable[Comparison], alpha: float
) -> Iterator[tuple[Comparison, Step | None]]:
    """Each comparison with its step; None where only one has the value."""
    members = tuple(comparisons)
    quantile = float(-scipy.special.ndtri(alpha / max(len(members), 1) / 2.0))
    for each in members:
        yield each, _step(each, quantile)


def _step(each: Comparison, quantile: float) -> Step | None:
    if each.measured is None or each.stored is None or each.value is None:
        return None
    least = each.margin
    if each.measured.better in AIMED:
        least = max(least, quantile * each.standard_error)
    change = loss(each.measured, each.value, each.predictions[1]) - loss(
        each.measured, each.stored, each.predictions[0]
    )
    moved = each.change == "changed"
    return Step(
        study=each.cell.study,
        cell=each.cell.name,
        statistic=each.measured,
        before=each.stored,
        after=each.value,
        error=each.standard_error,
        moved=moved,
        standing=standing(change, least) if moved else "neither",
        predictions=each.predictions,
        left_open=each.left_open,
    )
