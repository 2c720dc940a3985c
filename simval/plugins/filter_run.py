r"""Running a user's filter over the readings of some trials.

A fresh filter is made for each trial, or one for a batch of all, and stepped row by row
in its own conventions; its answers are converted afterwards, all at once. What cannot
be believed is refused: answers that are no attitudes or covariances, input that is
changed, state that outlives a run, a step that takes the longer the longer it runs.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from simval.arrays import Array
from simval.errors import PluginError
from simval.plugins.child import where_it_lives
from simval.plugins.filter_protocol import Filter
from simval.plugins.filter_signals import FilterInput, FilterOutput
from simval.plugins.filter_steps import Readings, Run, readings_of, run_of
from simval.plugins.filter_twice import (
    require_a_life_of_its_own,
    require_an_even_pace,
    require_the_same_again,
    require_trials_alone,
)
from simval.plugins.filter_worlds import on_body_side, own_quaternions, to_scene
from simval.shapes import Float

PARTS: Final = 8
"""Of a run, whose times are given."""


@where_it_lives
def run_filter(
    filter: Filter, given: FilterInput, keep: NDArray[np.intp], world: str
) -> FilterOutput:
    """Run a filter over the readings of some trials.

    Parameters
    ----------
    filter : Filter
        As it declares itself; its `world` is not asked.
    given : FilterInput
        Readings of n trials.
    keep : NDArray
        Rows whose answers are kept, increasing, (k,).
    world : str
        World frame that it has; see `simval.plugins.filter_frames`.

    Returns
    -------
    FilterOutput
        Its answers at these rows, in the package's conventions.

    Raises
    ------
    PluginError
        If it raises, breaks a rule of its answers, changes its input, keeps state
        between runs, or takes longer and longer for a row.
    """
    rows = _rows(keep, len(given.dt))
    trials: list[int | slice] = list(range(len(given.start)))
    if filter.batch:
        trials = [slice(0, len(given.start))]
    each = [readings_of(filter, given, own, world) for own in trials]
    runs = [run_of(filter, own, rows) for own in each]
    _require_one_form(filter, runs)
    require_the_same_again(filter, each[0], rows, runs[0])
    if filter.batch:
        alone = readings_of(filter, given, slice(0, 1), world)
        require_trials_alone(filter, each[0], alone)
    else:
        require_a_life_of_its_own(filter, each[0], each[-1])
    require_an_even_pace(filter, each[0], runs)
    return _output(filter, rows, each[0], runs, world)


def _rows(keep: NDArray[np.intp], count: int) -> NDArray[np.intp]:
    rows = np.asarray(keep, dtype=np.intp)
    assert rows.ndim == 1, "rows are a list"
    assert len(rows) > 0, "an answer is kept"
    assert (np.diff(rows) > 0).all(), "rows increase"
    assert 0 <= rows[0] <= rows[-1] < count, "rows are those of the readings"
    return rows


def _require_one_form(filter: Filter, runs: list[Run]) -> None:
    """Require the same words and shapes of all trials."""
    forms = [{word: a.shape for word, a in run.words.items()} for run in runs]
    for trial, form in enumerate(forms):
        if form != forms[0]:
            shapes = (
                ", ".join(f"{word} {shape[1:]}" for word, shape in each.items())
                for each in (form, forms[0])
            )
            msg = (
                f"{filter.name} answers trial {trial} with {next(shapes)} and trial 0 "
                f"with {next(shapes)}; every trial must have the same"
            )
            raise PluginError(msg)


def _output(
    filter: Filter,
    rows: NDArray[np.intp],
    first: Readings,
    runs: list[Run],
    world: str,
) -> FilterOutput:
    words = {word: _by_trial(first, word, runs) for word in runs[0].words}
    raw = words["attitude"]
    n, k = raw.shape[:2]
    own = own_quaternions(filter, raw.reshape(n * k, *raw.shape[2:]))
    covariance = words.get("covariance")
    if covariance is not None:
        shape = covariance.shape
        flat = on_body_side(filter, covariance.reshape(n * k, *shape[2:]), own)
        covariance = flat.reshape(shape)
    return FilterOutput(
        kept=rows,
        attitude=to_scene(own, world).reshape(n, k, 4),
        covariance=covariance,
        bias=words.get("bias"),
        innovation=words.get("innovation"),
        innovation_covariance=words.get("innovation_covariance"),
        seconds=np.median([row_times(first, run) for run in runs], axis=0),
    )


def _by_trial(first: Readings, word: str, runs: list[Run]) -> Float[Array, "n k ..."]:
    if first.lead:
        return np.ascontiguousarray(np.moveaxis(runs[0].words[word], 1, 0))
    return np.stack([run.words[word] for run in runs])


def row_times(first: Readings, run: Run) -> Float[Array, " q"]:
    """Seconds of a row of one trial, over equal parts of a run."""
    parts = min(PARTS, len(run.rows))
    trials = first.lead[0] if first.lead else 1
    pairs = zip(
        np.array_split(run.seconds, parts),
        np.array_split(run.rows, parts),
        strict=True,
    )
    return np.array([t.sum() / r.sum() / trials for t, r in pairs])
