r"""Audit of simulated IMUs: right ones must pass, and errors must be named.

Simulators are of `simval.studies.simulated_imus`: motions in closed form, right by
construction or wrong in one way.

**Right** ones are drawn at each rate of rows, a quarter at rest, half of them in single
precision, with white noise or none. At most `ALPHA` of them may be called wrong: rows
are held to the count that this rate exceeds in `SELDOM` of the runs.

**Wrong** ones have each error at three sizes. Its unit is what theory says of it: five
deviations of the least variance that an unbiased estimate has beside six biases, with
c the derivative of the readings by the error, and W the inverse variance of a row,

.. math:: s = 5 \left(\sum (c - \bar c)^T W (c - \bar c)\right)^{-1/2}, \tag{AU1}

or, of a time, the tenth of a step that is nobody's fault, if that is more. An error of
that size is *named* in a third of the recordings, one of twice that in nearly all. A
whole error, as of a unit, has no size. Each share that is missed is held to what was
counted once, `MISSED`, by eq. (DG1) of `simval.studies.diagnosis`. To count again:
``simval sweep FILE`` with ``seed = 5201`` and the section ``[audit]`` of ``trials =
20`` and all ``simulators``.
"""

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Final, Literal

import numpy as np
from pydantic import Field

from simval import statistics as stat
from simval.arrays import Array
from simval.figures import Figure, Listing, along_entry, entry
from simval.imu.audit import ALPHA, Audit, Declared, SimulatedImu, audit
from simval.results import Outcome, Row, unjudged
from simval.streams import Streams
from simval.studies.diagnosis import again, by_markov, held
from simval.studies.simulated_imus import (
    DENSITY,
    KINDS,
    SIZED,
    Rng,
    declared,
    names,
    simulated,
)
from simval.studies.study import Cost, StudyParameters, ranged
from simval.studies.trials import mean_of, share_error

TITLE = "Audit of simulated IMUs: are right ones called wrong, and wrong ones named?"
SECTION = "audit"

SIZES: Final = (0.5, 1.0, 2.0)  # times (AU1)
DEVIATIONS: Final = 5.0
STEP: Final = 1e-4  # of a derivative
RATES: Final = (10.0, 100.0, 1e3, 1e4)  # Hz
ROWS: Final = (150.0, 3000.0)
RIGHT: Final = 4  # right ones at each rate to one of each wrong kind
STILL: Final = MappingProxyType({"move": 0.0, "turn": 0.0, "spin": 0.0})
GROUPS: Final = tuple(dict.fromkeys(each.group for each in SIZED.values()))


class Parameters(StudyParameters):
    """One cell: what is wrong with the simulators, and how many there are."""

    simulators: Literal["right", "arms", "scales", "times", "whole"] = Field(
        default="right", description="Right ones, or which error wrong ones have."
    )
    rate: float = ranged(100.0, "Rows a second of wrong ones, Hz.", 10.0, 1e4)
    seconds: float = ranged(8.0, "Duration of wrong ones, s.", 1.0, 600.0)
    noise: float = ranged(
        0.01,
        "White noise of a row of wrong ones, m/s^2; of the rate a tenth, rad/s.",
        1e-6,
        1.0,
    )
    trials: int = ranged(
        4, "Simulators of each error and size; of right ones 4 times at each rate.", 2,
        10_000,
    )  # fmt: skip

    def cost(self) -> Cost:
        """Cost of a cell: 0.1 s for an audit, and 0.2 ms a row."""
        if self.simulators == "right":
            return Cost(0.3 * len(RATES) * RIGHT * self.trials, 2 * len(RATES) + 14)
        kinds = [*_kinds(self.simulators)]
        sizes = 1 if self.simulators == "whole" else len(SIZES)
        each = 0.1 + 2e-4 * self.rate * self.seconds
        return Cost(each * self.trials * len(kinds) * sizes, len(kinds) * 9)


COUNTED: Final = 20
"""Simulators of each error and size behind `MISSED`."""
MISSED: Final[Mapping[str, tuple[int, ...]]] = MappingProxyType({
    "lever arm in m": (20, 17, 2, 3),
    "Euler term in m": (20, 15, 4, 4),
    "centripetal term in m": (20, 17, 0, 0),
    "scale of the gyroscope": (20, 15, 0, 0),
    "scale of the accelerometer": (19, 15, 0, 0),
    "linear term": (20, 13, 0, 0),
    "tilt of gravity in rad": (20, 18, 1, 1),
    "transport term": (20, 15, 0, 0),
    "gyroscope late in steps": (20, 9, 0, 0),
    "accelerometer late in steps": (20, 13, 0, 0),
    "two instants in steps": (20, 15, 2, 4),
    "backward difference": (2, 2),
})  # fmt: skip
"""Missed of `COUNTED` at each size, and misnamed of all, by the error; else none."""


def _kinds(group: str) -> Iterator[str]:
    if group == "whole":
        yield from (name for name in KINDS if name != "right")
    yield from (name for name, each in SIZED.items() if each.group == group)


def run(parameters: Parameters, streams: Streams) -> Outcome:
    """Audit the simulators of one cell."""
    if parameters.simulators == "right":
        return Outcome(rows=(*_right_rows(parameters.trials, streams),))
    return Outcome(rows=(*_wrong_rows(parameters, streams),))


# right ones


def _right_rows(trials: int, streams: Streams) -> Iterator[Row]:
    found: dict[str, list[Audit]] = {}
    for number, rate in enumerate(RATES):
        rng = streams.block(number)
        for k in range(RIGHT * trials):
            # a quarter at rest, half of each in single precision, a third without noise
            rest, single, quiet = k % 4 == 0, k % 8 < 4, k % 3 == 0
            made = audit(*_right(rate, rest, single, quiet, rng))
            for name in (
                "all", f"{rate:g} Hz", "at rest" if rest else "moving",
                "single" if single else "double", "no noise" if quiet else "noise",
            ):  # fmt: skip
                found.setdefault(name, []).append(made)
    for name, each in found.items():
        wrong = [x.exit_code == 1 for x in each]
        yield from held(
            stat.CALLED_WRONG(name), wrong, lambda n: by_markov(ALPHA, n), stat.BINOMIAL
        )
        n, share = len(each), float(np.mean([x.exit_code == 3 for x in each]))
        yield from unjudged(stat.NOT_JUDGED(name), share, share_error(share, n), n)


def _right(
    rate: float, rest: bool, single: bool, quiet: bool, rng: Rng
) -> tuple[SimulatedImu, Declared]:
    rows = np.exp(rng.uniform(*np.log(ROWS)))
    pace, spin = rng.uniform(0.3, 1.0), rng.uniform(0.1, 2.0)
    motion = {"pace": pace, "spin": spin, "turn": 0.5 + spin / 2.0}
    noise = 0.0 if quiet else float(10.0 ** rng.uniform(-5.0, -0.5))
    imu = simulated(
        "right", rng, rate=rate, seconds=rows / rate, noise=noise, single=single,
        **(STILL if rest else motion),
    )  # fmt: skip
    return imu, declared() if rng.random() < 0.7 else Declared()


# wrong ones


def least_size(name: str, seed: int, parameters: Parameters) -> float:
    """Return the size (AU1) from which an error shows, for one motion."""
    noise = parameters.noise * np.repeat([0.1, 1.0], 3)
    c = np.diff([_readings(name, seed, parameters, x) for x in (0.0, STEP)], axis=0)
    c = c[0] / noise / STEP
    told = DEVIATIONS / float(np.linalg.norm(c - c.mean(axis=0)))
    return max(told, SIZED[name].floor)


def _readings(name: str, seed: int, parameters: Parameters, size: float) -> Array:
    imu = _made(name, seed, parameters, size)
    return np.hstack([x for x in (imu.gyroscope, imu.accelerometer) if x is not None])


def _made(
    name: str, seed: int, parameters: Parameters, size: float | None
) -> SimulatedImu:
    rng = np.random.Generator(np.random.SFC64(seed))
    options = parameters.model_dump(include={"rate", "seconds", "noise"})
    return simulated(name, rng, size=size, **options)


def _wrong_rows(parameters: Parameters, streams: Streams) -> Iterator[Row]:
    n, sized = parameters.trials, parameters.simulators in GROUPS
    density = parameters.noise / parameters.rate**0.5
    pooled: dict[str, tuple[list[bool], list[int]]] = {}
    for number, name in enumerate(_kinds(parameters.simulators)):
        seeds = streams.block(number).integers(2**63, size=n).tolist()
        wanted = {SIZED[name].named} if sized else KINDS[name].named
        said = declared(parameters.noise if name == DENSITY else density)

        def stood(seed: int, size: float | None) -> set[str]:
            return names(audit(_made(name, seed, parameters, size), said))  # noqa: B023

        if sized:
            units = [least_size(name, seed, parameters) for seed in seeds]
            found = [
                [stood(seed, times * unit)
                 for seed, unit in zip(seeds, units, strict=True)]
                for times in SIZES
            ]  # fmt: skip
            mean, error, _ = mean_of(np.array(units))
            yield from unjudged(stat.LEAST_SIZE(name), mean, error, n)
        else:
            found = [[stood(seed, None) for seed in seeds]]
        *counts, misnamed = MISSED.get(name, (0, 0))
        for times, k, each in zip(SIZES, counts, found, strict=False):
            at = f"{times:g}"
            missed = [x != wanted for x in each]
            share = 1.0 - float(np.mean(missed))
            if sized:
                yield from unjudged(stat.NAMED_AT(name, at), share,
                                    share_error(share, n), n)  # fmt: skip
            what = stat.MISSED_AT(name, at) if sized else stat.MISSED(name)
            yield from again(what, missed, k, COUNTED)
            every, counted = pooled.setdefault(at, ([], []))
            every += missed
            counted.append(k)
        wrong = [bool(x) and x != wanted for each in found for x in each]
        yield from again(stat.MISNAMED(name), wrong, misnamed, COUNTED * len(found))
    for at, (every, counted) in pooled.items():
        what = stat.MISSED_AT("all", at) if sized else stat.MISSED("all")
        yield from again(what, every, sum(counted), COUNTED * len(counted))


FIGURES = (
    Figure(
        name="audit-power",
        asked="How great must an error of a simulated IMU be to be named?",
        rows=[stat.NAMED_AT],
        along=along_entry,
        axis="size of the error, times what five deviations of its bound tell",
        value="share named",
        where=lambda parameters: parameters["simulators"] in GROUPS,
        lines=entry(0),
        compared=False,
        log_y=False,
        caption=(
            "Share of wrong simulators of which the error is named, alone, over its "
            "size; the table below has what its unit is for each."
        ),
    ),
    Listing(
        name="audit-right",
        caption="Right simulators that are called wrong, and that are not judged whole",
        rows=[stat.CALLED_WRONG, stat.NOT_JUDGED],
        keys={"simulators": entry(0)},
        column=lambda row: row.statistic.family.words,
        open=True,
    ),
    Listing(
        name="audit-sizes",
        caption="Unit of the sizes, and errors that are misnamed",
        rows=[stat.LEAST_SIZE, stat.MISSED, stat.MISNAMED],
        keys={"error": entry(0)},
        column=lambda row: row.statistic.family.words,
        where=lambda parameters: parameters["simulators"] != "right",
    ),
)
