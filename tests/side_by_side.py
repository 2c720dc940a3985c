"""A run of many algorithms, from rows alone: nothing is computed."""

from simval.plugins.attitudes import CLASSES
from simval.results import limit, nees, plain, unjudged
from simval.statistics import (
    BIAS,
    CHI_SQUARE_3,
    COVARIANCE,
    CRAMER_RAO,
    CUBATURE,
    EFFICIENCY,
    FAILURES,
    NEES,
    RMS,
    TRUTH,
)
from simval.sweep.run import CellResult, Run

MANIFEST = {
    "suite": "league",
    "title": "A league",
    "cells": 0,
    "grid": {"seed": [1]},
    "versions": {"simval": "1"},
    "git": {"commit": None, "dirty": None},
    "models": {},
    "files": {},
    "source": "0",
    "machine": {"system": "Linux", "processor": "x", "kernels": []},
}
N = 16_384


def estimator_rows(ratio, error, noise, *, bias=1e-3, honest=None, fails=None):
    """Rows of an estimator as the study leaves them."""
    bound = 3.0 * noise
    axes, failing = ("x", "y", "z"), fails or {}
    rows = [
        *unjudged(RMS(unit="rad"), ratio * bound, error * bound, N, bound, CRAMER_RAO),
        *unjudged(EFFICIENCY(), ratio**-2, 2.0 * error * ratio**-3, N),
        *plain(
            BIAS.each(axes, ["rad"] * 3), bias * bound, 1.0, N, bias * bound, CUBATURE
        ),
        *plain(COVARIANCE("x", "x", unit="rad²"), bound, 1.0, N, bound, CUBATURE),
    ]
    for name in CLASSES:
        share, declared = failing.get(name, (0.0, False))
        what = FAILURES(name)
        rows += (
            unjudged(what, share) if declared else limit(what, share, 0.0, TRUTH, n=1)
        )
    if honest is not None:
        rows += nees(NEES(), 3.0 * honest, 0.02, N, 3.0, CHI_SQUARE_3)
    return tuple(rows)


def cell(algorithm, rows, *, study="estimator", seed=1, status="done", **values):
    """A cell of an algorithm."""
    given = {"geometry": 3, "samples": N, "noise": "body", "vectors": 2, "cases": 1024}
    if study == "calibrator":
        given = {"poses": 24, "trials": 1024, "pose_set": "sphere", "sensor": "full"}
    given |= {"noise_std": 0.01, "time_limit": 300.0, "algorithm": algorithm} | values
    inside = ",".join(f"{k}={v}" for k, v in sorted(given.items()))
    return CellResult(
        name=f"{study}({inside})@{seed}",
        study=study,
        seed=seed,
        parameters=given,
        status=status,
        error="" if status == "done" else "refused: it answers NaN\n",
        seconds=0.0,
        rows=tuple(rows) if status == "done" else (),
    )


def run_of(folder, cells, calls=None):
    """A run with these cells."""
    timing = {"wall_seconds": 1.0, "workers": 1, "cpu_seconds": 1.0}
    return Run(
        folder=folder,
        cells=tuple(cells),
        manifest=MANIFEST | {"cells": len(cells)},
        timing=timing | {"calls": calls or {}},
    )


def league(folder, count=20, levels=(0.001, 0.01, 0.05)):
    """As many estimators at some noise levels; each third fails somewhere."""
    cells, calls = [], {}
    for k in range(count):
        name = f"league.py:estimator-{k}" if k else "simval:wahba"
        names = list(CLASSES)
        fails = {names[k % 16]: (0.3, k % 2 == 0), names[2]: (1.0, False)}
        for noise in levels:
            rows = estimator_rows(
                1.0 + 0.02 * k,
                0.004,
                noise,
                honest=1.0 + 0.1 * k if k % 2 else None,
                fails=fails if k % 3 == 2 else None,
            )
            broken = k == count - 1 and count > 2
            found = cell(
                name, rows, noise_std=noise, status="failed" if broken else "done"
            )
            cells.append(found)
            if not broken:
                calls[found.name] = {
                    "seconds": 1e-3 * (k + 1),
                    "builtin_seconds": 1e-3,
                    "ratio": k + 1.0,
                    "items": 1024.0,
                }
    return run_of(folder, cells, calls)
