"""Races of what is done with the rows of a run, and of a log.

The first contender of a race of rows has the numbers in arrays already, and does the
arithmetic alone.
"""

import atexit
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp

import made_logs
import numpy as np
import rows_by_name
import scipy
from judge.made import run_of

from benchmarks.race import Contender, race
from simval.imu.logs import read_log
from simval.imu.multiposition import calibrate_log
from simval.judge import compare_runs
from simval.report.curves import fitted_slope
from simval.verdict import ALPHA, WEIGHTS, freedom, judge

ROWS, CURVES = 20_000, 200
SAMPLES = 65_536
FAR = 40.0  # standard errors by which every thousandth row is off


def drawn(seed, far):
    """Values and standard errors of rows; their predictions are 0."""
    rng = np.random.default_rng(seed)
    z, error = rng.standard_normal(ROWS), 10.0 ** rng.uniform(-6.0, 0.0, ROWS)
    z[::1000] += far
    return z * error, error


def rows(values, errors):
    """Rows of the same."""
    fields = {"n": SAMPLES, "prediction": 0.0, "check": "plain"}
    return [
        rows_by_name.row(f"bias[{k:05}]", value, standard_error=error, **fields)
        for k, (value, error) in enumerate(zip(values, errors, strict=True))
    ]


def tails(z):
    """Two-sided p-values of Student's t."""
    return 2.0 * scipy.special.stdtr(freedom(SAMPLES), -np.abs(z))


@race("gate", "Rows of a run judged against theory", "rows")
def gate():
    """List both ways; the reference is Student's t and Holm's rule in NumPy."""
    values, errors = drawn(1, FAR)
    given = rows_by_name.named(rows(values, errors))

    def bare():
        p = np.sort(tails(values / errors))
        kept = p > ALPHA * WEIGHTS["plain"] / (ROWS - np.arange(ROWS))
        return np.flatnonzero(tails(values / errors) < p[np.argmax(kept)])

    def simval():
        return [k for k, v in enumerate(judge(given)) if v.answer == "fail"]

    return [
        Contender("Holm's rule in NumPy, arrays given", ROWS, bare, failing),
        Contender("simval, each answer with its reason", ROWS, simval, failing),
    ]


def failing(found):
    """Places of what is off."""
    return {"places": (found, 0.0)}


@race("compare", "Rows of two runs compared", "rows")
def compare():
    """List both ways; the reference joins sorted columns in NumPy."""
    (old, old_error), (new, new_error) = drawn(1, 0.0), drawn(2, FAR)
    names = np.array([f"bias[{k:05}]" for k in range(ROWS)])
    runs = [
        run_of(rows_by_name.cell(rows(*each), seed))
        for seed, each in enumerate([(old, old_error), (new, new_error)])
    ]

    def bare():
        _, a, b = np.intersect1d(names, names, return_indices=True)
        z = (new[b] - old[a]) / np.hypot(new_error[b], old_error[a])
        return np.flatnonzero(tails(z) < ALPHA / ROWS)

    def simval():
        found = compare_runs(*runs)
        changed = [str(each.statistic) for each in found.of("changed")]
        return sorted(int(name[5:-1]) for name in changed)

    return [
        Contender("a join in NumPy, arrays given", ROWS, bare, failing),
        Contender("simval, what changed in words", ROWS, simval, failing),
    ]


@race("slopes", "Slopes of a page", "slopes")
def slopes():
    """List both ways; the reference is SciPy's `curve_fit`, curve by curve."""
    rng, x = np.random.default_rng(1), np.geomspace(1e-3, 0.1, 6)
    error = 1e-2 * x**2
    curves = [x**2 + error * rng.standard_normal(6) for _ in range(CURVES)]

    def bare(y):
        scale = x.max()  # so that both unknowns are of the size of 1

        def law(_, a, k):
            return a * y.max() * (x / scale) ** k / error

        return scipy.optimize.curve_fit(law, x, y / error, (1.0, 1.0))[0][1]

    def seen(found):  # to a thousandth of a slope's deviation
        return {"slopes": (found, 1e-5)}

    return [
        Contender("scipy curve_fit", CURVES, lambda: [*map(bare, curves)], seen),
        Contender(
            "simval", CURVES,
            lambda: [fitted_slope(x, y, error).value for y in curves], seen,
        ),
    ]  # fmt: skip


@race("log", "A log of an accelerometer", "rows")
def log():
    """List what is done with a log; the reference is NumPy's parser."""
    recorded = made_logs.good(np.random.default_rng(1)).log
    table = np.column_stack([recorded.time, recorded.accelerometer])
    folder = mkdtemp()
    atexit.register(rmtree, folder)
    path, count = Path(folder) / "log.csv", len(table)
    header = "time_s,ax_mps2,ay_mps2,az_mps2"
    np.savetxt(path, table, fmt="%.9g", delimiter=",", header=header, comments="")

    def bare():
        return np.loadtxt(path, delimiter=",", skiprows=1)

    def read():
        found = read_log(str(path))
        return np.column_stack([found.time, found.accelerometer])

    def seen(found):
        return {"readings": (found, 1e-9 * np.abs(found))}

    return [
        Contender("numpy loadtxt, data unchecked", count, bare, seen),
        Contender("simval, read and checked", count, read, seen),
        Contender(
            "simval, read and calibrated", count,
            lambda: calibrate_log(read_log(str(path))), other="calibrates it",
        ),
    ]  # fmt: skip
