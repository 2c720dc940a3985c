"""Faults of the machinery: workers, store, samples, standard errors, rows."""

from dataclasses import replace
from functools import partial

import numpy as np

from power.fault import Fault, result, then, told
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
samples = partial(fault, attitude, "simulate")
serial = partial(fault, runner, "serial")
execute = partial(fault, executors, "execute")


def errors(name, factor):
    """Standard errors that are wrong by a factor."""
    change = result(
        bias_error=lambda m: factor * m.bias_error,
        covariance_error=lambda m: factor * m.covariance_error,
    )
    return fault(attitude, "moments_of", name, change)


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
        return tuple(row for row in found if row is not None)

    return execute(name, result(rows=broken), **more)


def field(name, entry, value, **more):
    """A field of each row is another, by the row."""
    return rows(name, lambda r: replace(r, **{entry: value(r)}), **more)


FAULTS = (
    samples("half of the samples", told(samples=lambda n: n // 2)),
    # sixteen times as many batches as there were, with the scatter to match
    samples(
        "samples counted sixteenfold",
        result(batches=lambda s: 16 * s.batches, scatter=lambda s: 16 * s.scatter),
    ),
    errors("standard errors a tenth", 0.1),
    errors("standard errors of zero", 0.0),
    serial("a worker drops a cell", then(lambda x: list(x)[:-1]), stops=True),
    serial("results under another cell's name", then(swapped), baseline=OTHERS),
    execute("a cell crashes", crash, crash=True),
    fault(
        store, "create", "the store lacks a cell",
        lambda o, path, cells, manifest: o(path, list(cells)[:-1], manifest),
    ),
    field("values of NaN", "value", lambda r: np.nan),
    rows("cells that measure nothing", lambda r: None),
    field("checks that judge nothing", "check", lambda r: "record"),
    field("remainders without end", "remainder", lambda r: 1e6),
    field(
        "standard errors tenfold", "standard_error", lambda r: 10 * r.standard_error,
        baseline=WIDE,
    ),
    field("four times the samples said", "n", lambda r: 4 * r.n, baseline=WIDE),
    field(
        "remainders of half a prediction", "remainder",
        lambda r: 0.5 * abs(r.prediction or 0.0), baseline=OWN_WORD,
    ),
    field(
        "predictions copied from the samples", "prediction",
        lambda r: None if r.prediction is None else r.value, baseline=OWN_WORD,
    ),
    field("predictions left out", "prediction", lambda r: None),
    rows(
        "a statistic no longer measured",
        lambda r: r if r.statistic != NEES() else None, baseline=ABSENT,
    ),
    field(
        "values that moved by a hundredth of a standard error", "value",
        lambda r: r.value + 0.01 * r.standard_error, baseline=WITHIN,
    ),
)  # fmt: skip
