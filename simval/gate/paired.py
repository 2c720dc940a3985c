"""A cell with the noise that it had in the baseline: only rounding may differ.

What rounding may do is accepted (`simval.change.rounding_bound`), more is a change.
What the value is judged by must stay as well: its standard error, its number of samples
and each prediction with its remainder.
"""

from collections.abc import Iterator, Mapping
from math import isfinite

from simval.change import (
    EXACT_BOUND,
    JUDGING_BOUND,
    is_near,
    on_same_noise,
    rounding_bound,
)
from simval.gate.baseline import Entry
from simval.gate.comparison import Change, Comparison
from simval.results import CellName


def paired(
    cell: CellName, old: Mapping[str, Entry], new: Mapping[str, Entry]
) -> Iterator[Comparison]:
    """Compare a cell with the same noise."""
    for statistic in sorted({*old, *new}):
        entry, now = old.get(statistic), new.get(statistic)
        left = 0.0 if entry is None else _left_open(entry, now)
        bound = (
            0.0
            if entry is None
            else rounding_bound(entry.value or 0.0, entry.error, left)
        )
        change = known(entry, now)
        detail = ""
        if change is None and entry is not None and now is not None:
            change = "same"
            if entry.value is not None and now.value is not None:
                change = on_same_noise(entry.value, now.value, bound)
            other = next(_judging(entry, now, bound), None)
            if change != "changed" and other is not None:
                change, detail = other
        assert change is not None
        yield Comparison(
            cell=cell,
            statistic=statistic,
            change=change,
            stored=None if entry is None else entry.value,
            value=None if now is None else now.value,
            standard_error=0.0 if entry is None else entry.error,
            margin=bound,
            n=0 if entry is None else entry.n,
            detail=detail,
            measured=None if now is None else now.statistic,
            predictions=predictions(entry, now),
            same_noise=True,
            left_open=left,
        )
    if not old and not new:  # a cell of the baseline without any statistic
        yield Comparison(cell=cell, statistic="", change="missing")


def _left_open(entry: Entry, now: Entry | None) -> float:
    """The least that a theory leaves open of a value."""
    checks = {} if now is None else {k: j.check for k, j in now.judged.items()}
    remainders = (
        j.remainder
        for key, j in entry.judged.items()
        if checks.get(key) == "exact" or entry.error > 0.0
    )
    return min((r for r in remainders if isfinite(r)), default=0.0)


def known(old: Entry | None, new: Entry | None) -> Change | None:
    """Name the change that shows without comparing the numbers, if any."""
    if new is None:
        return "missing"
    if old is None:
        return "new"
    if not old.judged.keys() <= new.judged.keys() or (old.value is None) != (
        new.value is None
    ):
        return "unjudged"
    return None


def predictions(
    old: Entry | None, new: Entry | None
) -> tuple[float | None, float | None]:
    """What the first theory that judges both predicts of them."""
    if old is None or new is None:
        return None, None
    shared = (key for key in old.judged if key in new.judged)
    pairs = ((old.judged[k].prediction, new.judged[k].prediction) for k in shared)
    known = (pair for pair in pairs if all(map(isfinite, pair)))
    return next(known, (None, None))


def _judging(old: Entry, new: Entry, bound: float) -> Iterator[tuple[Change, str]]:
    """Changes of what the value is judged by."""
    if new.n != old.n or not is_near(old.error, new.error, JUDGING_BOUND):
        yield (
            "precision",
            f"a standard error of {old.error:.6g} from {old.n} samples in the "
            f"baseline, now {new.error:.6g} from {new.n}",
        )
    for key, (prediction, remainder, _) in old.judged.items():
        predicted, left, check = new.judged[key]
        relative = JUDGING_BOUND if check == "limit" else EXACT_BOUND
        if not (
            is_near(prediction, predicted, relative, bound)
            and is_near(remainder, left, JUDGING_BOUND, bound)
        ):
            yield (
                "theory",
                f"judged by {key}: {prediction:.9g} with a remainder of "
                f"{remainder:.3g} in the baseline, now {predicted:.9g} with {left:.3g}",
            )
