"""The gate's false-alarm rate and power, measured on fresh seeds.

False alarms: the attitude study, and then the calibration studies, are run many times,
each time with a new seed, and the gate judges each run at 5, 1 and 0.1 %. The cells are
small, which is the harder case: their standard errors are less certain.

Power: one cell at the default size of the accuracy suite, with a fault in its
prediction (or in its noise), judged among as many sound rows as a large run has. One
cell is the harder case again: a fault in all cells is detected by any of them.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import scipy

from power.attitude import by_noise, second_order_alone
from power.fault import changed, replaced, result
from simval.montecarlo import simulate
from simval.montecarlo.reduction import simulate_reduced
from simval.results import CellName, Check, Row, plain
from simval.statistics import EXACT, RMS
from simval.streams import Streams, cell_key
from simval.studies import attitude, calibration, coverage, ladder
from simval.theory.attitude import attitude_moments
from simval.verdict import ALPHA, judge, overall

CLEAN_SAMPLES = 8 * attitude.BLOCK
"""The fewest that the study takes: the harder case."""
CLEAN_NOISE = (0.02, 0.05)
"""Chosen: two of the middle levels of the accuracy suite."""
DEFAULT_SAMPLES = 4_000_000
"""Samples of a cell of the accuracy suite."""
SOUND_ROWS: dict[Check, int] = {"plain": 2000, "control": 200, "nees": 100}
"""Rows with p = 1 beside a fault: more than the accuracy suite has."""

Rows = list[tuple[CellName, Row]]
"""Name of a cell and one of its rows."""

Clean = Callable[[int], dict[str, Rows]]
"""Rows of a clean run with a seed, by the name of what is counted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rate:
    """How often something happened, with a 95 % interval."""

    name: str  # what was counted
    # the stated rate: at most this for false alarms, at least this for power
    nominal: float
    # how often, out of how many
    count: int
    runs: int

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's interval of 95 %."""
        rate = scipy.stats.binomtest(self.count, self.runs)
        low, high = rate.proportion_ci(0.95, "wilson")
        return float(low), float(high)


def false_alarm_rates(clean: Clean, runs: dict[float, int], seed: int) -> list[Rate]:
    """Judge clean runs on fresh seeds."""
    counts: dict[tuple[float, str], int] = {}
    with known_theory():
        for number in range(max(runs.values())):
            for name, rows in clean(seed + number).items():
                for alpha, wanted in runs.items():
                    alarm = number < wanted and overall(judge(rows, alpha)) != "pass"
                    counts[alpha, name] = counts.get((alpha, name), 0) + alarm
    return [
        Rate(name=name, nominal=alpha, count=count, runs=runs[alpha])
        for (alpha, name), count in sorted(counts.items(), key=lambda c: -c[0][0])
    ]


def attitude_rows(seed: int) -> dict[str, Rows]:
    """Rows of the attitude study."""
    rows = [r for noise in CLEAN_NOISE for r in _rows(noise, CLEAN_SAMPLES, seed)]
    certain = [entry for entry in rows if entry[1].predictor == EXACT]
    return {"attitude": rows, "attitude, exact": certain}


def calibration_rows(seed: int) -> dict[str, Rows]:
    """Rows of the studies calibration, ladder and coverage together."""
    rows: Rows = []
    for module, parameters in _calibration_cells():
        study = module.__name__.rpartition(".")[2]
        name = CellName(study, f"{study}({parameters})")
        outcome = module.run(parameters, Streams(seed, cell_key(name.name)))
        rows += [(name, row) for row in outcome.rows]
    return {"calibration": rows}


def _calibration_cells() -> list[tuple[Any, Any]]:
    # as many trials as the smoke suite has, at its noise; short holds, few poses
    return [
        (
            calibration,
            calibration.Parameters(
                poses=12, hold_time=0.02, noise_std=0.01, trials=1024
            ),
        ),
        (ladder, ladder.Parameters(residual="squared", trials=1024)),
        (ladder, ladder.Parameters(residual="adjusted", trials=1024)),
        (coverage, coverage.Parameters(poses=20, trials=1024)),
    ]


def formula_faults() -> dict[str, tuple[float, Callable[..., Any]]]:
    """Faults in a prediction: noise level of the cell that has it, and the change."""
    return {
        "covariance 1 % too large": (
            0.003,
            result(covariance=lambda m: 1.01 * m.covariance),
        ),
        "covariance 1 % too small": (
            0.003,
            result(covariance=lambda m: 0.99 * m.covariance),
        ),
        "sign of the bias": (0.003, result(bias=lambda m: -m.bias)),
        # every prediction that claims more than the second order keeps the second only
        "fourth-order term missing": (0.05, by_noise(second_order_alone)),
    }


def powers(runs: int, seed: int) -> list[Rate]:
    """Judge one cell of default size with each fault."""
    faults = formula_faults()
    counts = dict.fromkeys([*faults, "noise 1 % larger"], 0)
    sound = list(_sound())
    for number in range(runs):
        for noise in sorted({noise for noise, _ in faults.values()}):
            with drawn_once():
                for name, (where, change) in faults.items():
                    if where == noise:
                        with claimed(change):
                            rows = _rows(noise, DEFAULT_SAMPLES, seed + number)
                        counts[name] += _caught([*rows, *sound])
        with claimed(lambda o, *given, order: o(*given[:3], 0.003, order=order)):
            rows = _rows(0.00303, DEFAULT_SAMPLES, seed + number)
        counts["noise 1 % larger"] += _caught([*rows, *sound])
    return [
        Rate(name=name, nominal=0.99, count=count, runs=runs)
        for name, count in counts.items()
    ]


def known_theory() -> AbstractContextManager[None]:
    """Compute each prediction of the attitude study only once."""
    once = cache(partial(attitude_moments, *attitude.random_geometry(3)))
    return claimed(lambda _, *given, order: once(given[3], order=order))


@contextmanager
def drawn_once() -> Iterator[None]:
    """Draw the samples of the attitude study only once, for several claims."""
    with (
        replaced(attitude, "simulate", _once(simulate)),
        replaced(attitude, "simulate_reduced", _once(simulate_reduced)),
    ):
        yield


def _once(function: Callable[..., Any]) -> Callable[..., Any]:
    kept: list[Any] = []

    def once(*arguments: Any, **options: Any) -> Any:
        if not kept:
            kept.append(function(*arguments, **options))
        return kept[0]

    return once


def claimed(change: Callable[..., Any]) -> AbstractContextManager[None]:
    """Inject a fault into the predictions of the attitude study."""
    return changed(attitude, "attitude_moments", change)


def _rows(noise: float, samples: int, seed: int) -> Rows:
    parameters = attitude.Parameters(geometry=3, noise_std=noise, samples=samples)
    name = f"attitude(geometry=3,noise_std={noise},samples={samples})"
    outcome = attitude.run(parameters, Streams(seed, cell_key(name)))
    return [(CellName("attitude", name), row) for row in outcome.rows]


def _sound() -> Iterator[tuple[CellName, Row]]:
    (row,) = plain(RMS(), 1.0, 1e-3, DEFAULT_SAMPLES, 1.0, EXACT)
    for check, count in SOUND_ROWS.items():
        for number in range(count):
            yield CellName(f"sound{number}", check), replace(row, check=check)


def _caught(rows: Sequence[tuple[CellName, Row]]) -> bool:
    return overall(judge(rows, ALPHA)) == "fail"
