"""Faults of the machinery: workers, store, samples, standard errors, rows."""

from dataclasses import replace
from functools import partial

import numpy as np

from power.fault import Fault, then
from simval.statistics import NEES
from simval.studies import attitude
from simval.sweep import executors, runner, store
from simval.sweep.cells import digest_of_entries

OTHERS = (
    "its rows bring their own predictions with them, and these are right for the cell "
    "that they are of"
)
WIDE = (
    "a wider error bar agrees with whatever a narrower one does, and says itself how "
    "wide it is"
)
OWN_WORD = (
    "theory's word is what a run is held to: its predictions and remainders are judged "
    "by nothing above them"
)
ABSENT = "what is not there is not judged, and no theory says what must be measured"
WITHIN = (
    "far below what chance does to the sample; where a value has a deterministic row "
    "beside it, that row tells"
)

fault = partial(Fault, "attitude", "run")
samples = partial(fault, owner=attitude, function="simulate")


def errors(name, factor):
    """Standard errors that are wrong by a factor."""
    return fault(
        name, attitude, "moments_of",
        then(lambda m: replace(m, bias_error=factor * m.bias_error,
                               covariance_error=factor * m.covariance_error)),
    )  # fmt: skip


def under_the_name(own, other):
    """Rows of another cell as if they were a cell's own, with a digest to match."""
    rows = [(own.cell[0], *row[1:]) for row in other.rows]
    digest = digest_of_entries(own.cell, rows)
    return other._replace(cell=own.cell, rows=rows, digest=digest)


def swapped(batches):
    done = [each for batch in batches for each in batch]
    pairs = zip(done, done[::-1], strict=True)
    return [[under_the_name(own, other)] for own, other in pairs]


def crash(original, cell):
    msg = "crashed on purpose"
    raise RuntimeError(msg)


def rows(name, change, **more):
    """Each row of a cell is changed; None leaves it out."""

    def broken(outcome):
        found = [change(row) for row in outcome.rows]
        return replace(outcome, rows=tuple(r for r in found if r is not None))

    return fault(name, executors, "execute", then(broken), **more)


FAULTS = (
    samples(
        "half of the samples",
        change=lambda o, *a, samples, **more: o(*a, samples=samples // 2, **more),
    ),
    # sixteen times as many batches as there were, with the scatter to match
    samples(
        "samples counted sixteenfold",
        change=then(
            lambda s: replace(s, batches=16 * s.batches, scatter=16 * s.scatter)
        ),
    ),
    errors("standard errors a tenth", 0.1),
    errors("standard errors of zero", 0.0),
    fault(
        "a worker drops a cell", runner, "serial", then(lambda x: list(x)[:-1]),
        stops=True,
    ),
    fault(
        "results under another cell's name", runner, "serial", then(swapped),
        baseline=OTHERS,
    ),
    fault("a cell crashes", executors, "execute", crash, crash=True),
    fault(
        "the store lacks a cell", store, "create",
        lambda o, path, cells, manifest: o(path, list(cells)[:-1], manifest),
    ),
    rows("values of NaN", lambda r: replace(r, value=np.nan)),
    rows("cells that measure nothing", lambda r: None),
    rows("checks that judge nothing", lambda r: replace(r, check="record")),
    rows("remainders without end", lambda r: replace(r, remainder=1e6)),
    rows(
        "standard errors tenfold",
        lambda r: replace(r, standard_error=10 * r.standard_error), baseline=WIDE,
    ),
    rows("four times the samples said", lambda r: replace(r, n=4 * r.n), baseline=WIDE),
    rows(
        "remainders of half a prediction",
        lambda r: replace(r, remainder=0.5 * abs(r.prediction or 0.0)),
        baseline=OWN_WORD,
    ),
    rows(
        "predictions copied from the samples",
        lambda r: r if r.prediction is None else replace(r, prediction=r.value),
        baseline=OWN_WORD,
    ),
    rows("predictions left out", lambda r: replace(r, prediction=None)),
    rows(
        "a statistic no longer measured",
        lambda r: r if r.statistic != NEES() else None, baseline=ABSENT,
    ),
    rows(
        "values that moved by a hundredth of a standard error",
        lambda r: replace(r, value=r.value + 0.01 * r.standard_error), baseline=WITHIN,
    ),
)  # fmt: skip
