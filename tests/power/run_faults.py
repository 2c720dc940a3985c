"""Faults of the machinery: workers, store, samples, standard errors, rows."""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from power.fault import Fault, after, wrapped
from simval.results import Outcome
from simval.statistics import NEES
from simval.studies import attitude
from simval.sweep import executors, runner, store
from simval.sweep.cells import Done, digest_of_entries


def run_faults() -> list[Fault]:
    """All faults of the machinery."""
    return [*_samples(), *_cells(), *_rows()]


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

_fault = partial(Fault, "attitude", "run")


def _samples() -> list[Fault]:
    def half(original: Any, *law: Any, samples: int, **o: Any) -> Any:
        return original(*law, samples=samples // 2, **o)

    def claimed(sums: Any) -> Any:
        # sixteen times as many batches as there were, with the scatter to match
        return replace(sums, batches=16 * sums.batches, scatter=16 * sums.scatter)

    def errors(factor: float) -> Any:
        return after(
            attitude,
            "moments_of",
            lambda m: replace(
                m,
                bias_error=factor * m.bias_error,
                covariance_error=factor * m.covariance_error,
            ),
        )

    plain = "simulate_closed_form"
    return [
        _fault("half of the samples", wrapped(attitude, plain, half)),
        _fault("samples counted sixteenfold", after(attitude, plain, claimed)),
        _fault("standard errors a tenth", errors(0.1)),
        _fault("standard errors of zero", errors(0.0)),
    ]


def _under_the_name(own: Done, other: Done) -> Done:
    """Rows of another cell as if they were a cell's own, with a digest to match."""
    rows = [(own.cell[0], *row[1:]) for row in other.rows]
    digest = digest_of_entries(own.cell, rows)
    return other._replace(cell=own.cell, rows=rows, digest=digest)


def _cells() -> list[Fault]:
    def drop(original: Any, queue: Any) -> Any:
        return list(original(queue))[:-1]

    def swapped(original: Any, queue: Any) -> Any:
        done = [each for batch in original(queue) for each in batch]
        pairs = zip(done, done[::-1], strict=True)
        return [[_under_the_name(own, other)] for own, other in pairs]

    def crash(original: Any, cell: Any) -> Any:
        msg = "crashed on purpose"
        raise RuntimeError(msg)

    def fewer(original: Any, path: Any, cells: Any, manifest: Any) -> Any:
        return original(path, list(cells)[:-1], manifest)

    return [
        _fault("a worker drops a cell", wrapped(runner, "serial", drop), stops=True),
        _fault(
            "results under another cell's name",
            wrapped(runner, "serial", swapped),
            baseline=OTHERS,
        ),
        _fault("a cell crashes", wrapped(executors, "execute", crash), crash=True),
        _fault("the store lacks a cell", wrapped(store, "create", fewer)),
    ]


def _rows() -> list[Fault]:
    def rows(name: str, change: Any, *, baseline: str = "") -> Fault:
        def broken(outcome: Outcome) -> Outcome:
            return replace(outcome, rows=tuple(change(list(outcome.rows))))

        return _fault(name, after(executors, "execute", broken), baseline=baseline)

    return [
        rows("values of NaN", lambda rows: [replace(r, value=np.nan) for r in rows]),
        rows("cells that measure nothing", lambda rows: []),
        rows(
            "checks that judge nothing",
            lambda rows: [replace(r, check="record") for r in rows],
        ),
        rows(
            "remainders without end",
            lambda rows: [replace(r, remainder=1e6) for r in rows],
        ),
        rows(
            "standard errors tenfold",
            lambda rows: [
                replace(r, standard_error=10 * r.standard_error) for r in rows
            ],
            baseline=WIDE,
        ),
        rows(
            "four times the samples said",
            lambda rows: [replace(r, n=4 * r.n) for r in rows],
            baseline=WIDE,
        ),
        rows(
            "remainders of half a prediction",
            lambda rows: [
                replace(r, remainder=0.5 * abs(r.prediction or 0.0)) for r in rows
            ],
            baseline=OWN_WORD,
        ),
        rows(
            "predictions copied from the samples",
            lambda rows: [
                r if r.prediction is None else replace(r, prediction=r.value)
                for r in rows
            ],
            baseline=OWN_WORD,
        ),
        rows(
            "predictions left out",
            lambda rows: [replace(r, prediction=None) for r in rows],
        ),
        rows(
            "a statistic no longer measured",
            lambda rows: [r for r in rows if r.statistic != NEES()],
            baseline=ABSENT,
        ),
        rows(
            "values that moved by a hundredth of a standard error",
            lambda rows: [
                replace(r, value=r.value + 0.01 * r.standard_error) for r in rows
            ],
            baseline=WITHIN,
        ),
    ]
