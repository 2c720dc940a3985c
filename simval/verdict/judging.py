"""Judging many rows: as columns, some cells at a time, by `rules`.

What the rows of a run share, Holm's limits and the pooled squared errors, is found in a
first pass over them; the second one answers. Between the two, only the p-values that
could fail are kept, and the normalised squared errors.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from simval.arrays import Array
from simval.change import holm_of_least
from simval.columns import CHECKS, Columns, Places, columns_of
from simval.results import CellName, Row, nees
from simval.shapes import Bool, Float
from simval.statistics import POOLED_NEES
from simval.verdict.rules import (
    ALPHA,
    MAX_REMAINDER,
    MIN_SAMPLES,
    OBSTACLES,
    POWER,
    PRACTICAL,
    WEIGHTS,
    WORST_FIRST,
    Verdict,
    deterministic_reason,
    freedom,
    margin,
    sampled_reason,
)

Mask = Bool[NDArray[np.bool_], " n"]


def p_values(rows: Iterable[Row]) -> Float[Array, " n"]:
    """Probability of eq. (V1) for sampling rows.

    Parameters
    ----------
    rows : iterable of Row
        The rows.

    Returns
    -------
    Array
        The probabilities.
    """
    return _p_values(columns_of((CellName(""), row) for row in rows))


@np.errstate(all="ignore")  # what is no number has an obstacle
def _p_values(rows: Columns) -> Float[Array, " n"]:
    distance = np.abs(rows.value - rows.prediction)
    low = (distance - rows.remainder) / rows.standard_error
    high = (distance + rows.remainder) / rows.standard_error
    law = freedom(rows.n)
    left, right = (scipy.special.stdtr(law, -z) for z in (low, high))
    return np.asarray(left + right, dtype=float)


def judge(
    rows: Iterable[tuple[CellName, Row]], alpha: float = ALPHA
) -> tuple[Verdict, ...]:
    """Judge the rows of a run together.

    Parameters
    ----------
    rows : iterable of (CellName, Row)
        Each with its cell; those with check ``record`` are left out.
    alpha : float, default ALPHA
        False-alarm rate of all of them together.

    Returns
    -------
    tuple of Verdict
        In the order of the rows; last what is pooled over a study.
    """
    block = columns_of((cell, row) for cell, row in rows if row.check != "record")
    judged = judge_blocks(lambda: [block], alpha)
    return tuple(each.verdict(i) for each in judged for i in range(len(each.rows)))


Blocks = Callable[[], Iterable[Columns]]
"""The rows of a run that are judged, some cells at a time; read twice, in one order."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Judged:
    """The answers to some rows."""

    rows: Columns
    answer: Places  # place in `WORST_FIRST`
    obstacle: Places  # why it cannot be judged; 0 where it can
    p_value: Float[Array, " n"]  # NaN where the row is deterministic
    limit: Float[Array, " n"]
    detectable: Float[Array, " n"]  # eq. (V2); NaN where the row is deterministic

    def verdict(self, i: int) -> Verdict:
        """The verdict of one row.

        Parameters
        ----------
        i : int
            Its place in the block.

        Returns
        -------
        Verdict
            Its verdict, with the reason in words.
        """
        row = self.rows.row(i)
        answer = WORST_FIRST[self.answer[i]]
        sampled = not self.obstacle[i] and row.check in WEIGHTS
        p, limit = float(self.p_value[i]), float(self.limit[i])
        reason = ""
        if self.obstacle[i]:
            reason = OBSTACLES[self.obstacle[i] - 1](row)
        elif answer != "pass":
            reason = (
                sampled_reason(row, answer, p, limit, float(self.detectable[i]))
                if sampled
                else deterministic_reason(row)
            )
        return Verdict(
            cell=self.rows.named(i),
            row=row,
            answer=answer,
            p_value=p if sampled else None,
            limit=limit,
            reason=reason,
            detectable=float(self.detectable[i]),
            margin=margin(row) if sampled else float("nan"),
        )


def judge_blocks(blocks: Blocks, alpha: float = ALPHA) -> Iterator[Judged]:
    """Judge the rows of a run together, some cells at a time.

    In a first pass the rows of each family are counted, and of their p-values those are
    kept that could fail; the second pass answers.

    Parameters
    ----------
    blocks : callable
        ``blocks()`` gives the rows that are judged; called twice.
    alpha : float, default ALPHA
        False-alarm rate of all of them together.

    Yields
    ------
    Judged
        The answers to each block; last to what is pooled.
    """
    families: dict[int, _Family] = {}
    pools: dict[tuple[str, str], list[Float[Array, "5 m"]]] = {}
    for rows in blocks():
        sound = _obstacles(rows) == 0
        _note_families(rows, sound, alpha, families)
        _note_pools(rows, sound, pools)
    pooled = columns_of(_pooled(pools))
    _note_families(pooled, _obstacles(pooled) == 0, alpha, families)
    whole = sum(WEIGHTS[CHECKS[check]] for check in families)
    for check, family in families.items():
        family.close(alpha * WEIGHTS[CHECKS[check]] / whole)
    for rows in blocks():
        yield _answers(rows, families)
    yield _answers(pooled, families)


class _Family:
    """What the rows of one check share: their number, and who of them may fail."""

    def __init__(self) -> None:
        self.count = 0
        self._small: list[Float[Array, " m"]] = []
        self._alpha = 0.0  # p-values above it pass
        self._next = 0

    def note(self, values: Float[Array, " m"], alpha: float) -> None:
        """Count some p-values, and keep those that may fail."""
        self.count += len(values)
        self._alpha = alpha
        self._small.append(values[~(values > alpha)])

    def close(self, share: float) -> None:
        """Find the limits, when all have been noted."""
        small = np.concatenate(self._small)
        self._limits, self._others = holm_of_least(small, self.count, share)
        self.tail = share / self.count / 2.0

    def limits(self, values: Float[Array, " m"]) -> Float[Array, " m"]:
        """Limit of each p-value; they come in the order in which they were noted."""
        found = np.full(len(values), self._others)
        small = ~(values > self._alpha)
        stop = self._next + int(small.sum())
        found[small] = self._limits[self._next : stop]
        self._next = stop
        return found


def _note_families(
    rows: Columns, sound: Mask, alpha: float, families: dict[int, _Family]
) -> None:
    values = _p_values(rows)
    for check in dict.fromkeys(rows.check[sound].tolist()):
        if CHECKS[check] in WEIGHTS:
            members = sound & (rows.check == check)
            families.setdefault(check, _Family()).note(values[members], alpha)


def _note_pools(
    rows: Columns,
    sound: Mask,
    pools: dict[tuple[str, str], list[Float[Array, "5 m"]]],
) -> None:
    """Keep the normalised squared errors, by study and predictor."""
    members = sound & (rows.check == CHECKS.index("nees")) & (rows.prediction != 0.0)
    places = np.flatnonzero(members)
    keys = [
        (rows.named(i).study, rows.predictors[rows.predictor[i]])
        for i in places.tolist()
    ]
    for key in dict.fromkeys(keys):
        own = places[[other == key for other in keys]]
        columns = (rows.n, rows.prediction, rows.value, rows.standard_error)
        numbers = [column[own] for column in (*columns, rows.remainder)]
        pools.setdefault(key, []).append(np.array(numbers, dtype=float))


def _pooled(
    pools: Mapping[tuple[str, str], list[Float[Array, "5 m"]]],
) -> Iterator[tuple[CellName, Row]]:
    """Mean of each study's normalised squared errors, relative to the prediction."""
    # weighted by the numbers of samples, which do not depend on the values
    for (study, predictor), parts in pools.items():
        n, prediction, value, error, remainder = np.concatenate(parts, axis=1)
        if len(n) < 2:
            continue
        weights = n / n.sum() / prediction
        (row,) = nees(
            POOLED_NEES(),
            float(weights @ value),
            float(np.linalg.norm(weights * error)),
            int(n.sum()),
            1.0,
            predictor,
            float(np.abs(weights) @ remainder),
        )
        yield CellName(study), row


@np.errstate(all="ignore")  # what is no number has an obstacle
def _obstacles(rows: Columns) -> Places:
    """Place in `OBSTACLES` and 1 of each row; 0 where there is none."""
    numbers = (rows.value, rows.standard_error, rows.remainder, rows.prediction)
    sampled = _sampled(rows)
    found = [
        ~np.isfinite(numbers).all(axis=0),
        rows.remainder < 0.0,
        sampled & ~(rows.standard_error > 0.0),
        sampled & ~(rows.n >= MIN_SAMPLES),
        sampled & ~(rows.remainder <= MAX_REMAINDER * _sizes(rows)),
    ]
    return np.select(found, range(1, len(found) + 1), 0).astype(np.int64)


def _sampled(rows: Columns) -> Mask:
    return np.isin(
        rows.check, [CHECKS.index(name) for name in CHECKS if name in WEIGHTS]
    )


def _sizes(rows: Columns) -> Float[Array, " n"]:
    """Predicted value or one sample's own spread, whichever is greater."""
    spread = rows.standard_error * np.sqrt(rows.n)
    return np.maximum(np.abs(rows.prediction), spread)


@np.errstate(all="ignore")  # what is no number has an obstacle
def _answers(rows: Columns, families: Mapping[int, _Family]) -> Judged:
    obstacle = _obstacles(rows)
    sound, sampled = obstacle == 0, _sampled(rows)
    values = np.where(sound & sampled, _p_values(rows), np.nan)
    limited = rows.check == CHECKS.index("limit")
    limit = np.where(limited, rows.prediction, rows.remainder)
    limit[~sound | sampled] = np.nan
    detectable = np.full(len(rows), np.nan)
    for check, family in families.items():
        own = sound & (rows.check == check)
        limit[own] = family.limits(values[own])
        quantile = -scipy.special.stdtrit(freedom(rows.n[own]), family.tail)
        needed = quantile + float(scipy.special.ndtri(POWER))
        detectable[own] = needed * rows.standard_error[own]
    good = np.where(
        limited,
        rows.value <= rows.prediction,
        np.abs(rows.value - rows.prediction) <= rows.remainder,
    )
    failed = sound & np.where(sampled, ~(values > limit), ~good)
    unseen = sampled & ~(detectable <= PRACTICAL * _sizes(rows))
    unclear = ~sound | (~failed & unseen)
    codes = [WORST_FIRST.index("fail"), WORST_FIRST.index("inconclusive")]
    return Judged(
        rows=rows,
        answer=np.select([failed, unclear], codes, WORST_FIRST.index("pass")),
        obstacle=obstacle,
        p_value=values,
        limit=limit,
        detectable=detectable,
    )
