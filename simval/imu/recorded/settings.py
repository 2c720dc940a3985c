"""Readings of a log in SI units, and what a filter is given: noise, field and start.

Noise is from a noise file, else from the log's own rests: N and K of the longest one,
the scatter of a row in all of them. Nothing is from the truth.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from dataclasses import field as default
from typing import Final, NamedTuple

import numpy as np

from simval.account import Fact
from simval.arrays import Array, frozen
from simval.errors import InputError, RefusedError
from simval.imu.filters.signals import Told
from simval.imu.logs import Log
from simval.imu.logs.rows import BEFORE, Rows
from simval.imu.multiposition.correction import corrected
from simval.imu.multiposition.log_units import Scale, unit_facts, units_of
from simval.imu.noise import AxisNoise, noise_of
from simval.imu.noise.model import NoiseFile
from simval.imu.recorded.attitudes import of_matrix
from simval.imu.recorded.errors import mean_with_error
from simval.imu.recorded.rows import RowEvidence
from simval.imu.statics import Intervals
from simval.imu.statics.detector import runs_of
from simval.shapes import Float
from simval.spelling import counted, rounded
from simval.units import OF_A_DATA_SHEET, OF_A_LOG

GAP_STEPS: Final = 5.0
"""Median steps of a hole in a log,"""
GAP_SECONDS: Final = 0.05
"""s, if it is longer than this, too: five steps at 100 Hz, at any rate."""
NEAR: Final = 0.1
"""Relative: scales of gyroscopes are within some per cent of their unit, and units are
a factor of 57 apart."""

NAMED: Final = 0.03
"""Relative: off a unit that the truth names; counts come near the smaller ones."""

UNSTATED: Final = Scale(None, "")
UNKNOWN: Final = "in the unit of its calibration or of the log"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Signals:
    """Readings of a log in SI units, as far as their units are known."""

    time: Float[Array, " n"]  # s
    gyro: Float[Array, "n 3"]  # rad/s, or the log's unit where `gyro_unit` is empty
    force: Float[Array, "n 3"]  # specific force, m/s^2
    # T, or the log's unit where `field_unit` is empty; None without a magnetometer
    field: Float[Array, "n 3"] | None
    rate: float  # Hz
    rests: Intervals
    gyro_unit: str  # where it came from, in words; empty: not known yet
    force_unit: str
    field_unit: str
    cuts: "tuple[TurnedRest, ...]" = ()  # rests in which the gyroscope turns
    scales: tuple[Scale, ...] = ()  # of its sensors, and what is wrong with them
    rows: Rows = BEFORE  # what the gyroscope's are of
    evidence: RowEvidence | None = None  # of that
    # mean rate over the step that ends at a row, made of `gyro`; NaN where not covered
    means: Float[Array, "n 3"] = default(init=False)

    def __post_init__(self) -> None:
        for name in ("time", "gyro", "force", "field"):
            if (value := getattr(self, name)) is not None:
                object.__setattr__(self, name, frozen(value))
        means = self.rows.means(self.time, self.gyro)
        means = means if means is self.gyro else frozen(means)
        object.__setattr__(self, "means", means)

    @property
    def covered(self) -> slice:
        """Rows that have a mean rate: all but a few at the ends."""
        rows = np.flatnonzero(np.isfinite(self.means[:, 0]))
        return slice(int(rows[0]), int(rows[-1]) + 1)

    @property
    def turning(self) -> tuple[Float[Array, " k"], Float[Array, "k 3"]]:
        """Times and mean rates of the rows that have a mean rate."""
        return self.time[self.covered], self.means[self.covered]

    def taken_as(self, rows: Rows) -> "Signals":
        """The same with its gyroscope's rows taken otherwise, and rests that fit."""
        found = replace(self, rows=rows)
        rests = np.maximum(found.rests, found.covered.start - 1)
        return replace(found, rests=rests[np.ptp(rests, axis=1) > 0])

    @property
    def facts(self) -> tuple[Fact, ...]:
        """State the units and where they are from, and what was cut off the rests."""
        field = "none" if self.field is None else self.field_unit or UNKNOWN
        few = f"{counted(len(self.cuts), 'rest')} cut or left out: the gyroscope turns"
        return (
            Fact("units", f"gyroscope {self.gyro_unit}"),
            Fact("units", f"accelerometer {self.force_unit}"),
            Fact("units", f"magnetometer {field}"),
            *unit_facts(self.scales),
            *([Fact("rests", few, notable=True)] if self.cuts else []),
            *(Fact("rests", each.words) for each in self.cuts),
        )


class TurnedRest(NamedTuple):
    """A rest in which the gyroscope turns, and the parts kept of it, s and rad/s."""

    start: float
    stop: float
    kept: tuple[tuple[float, float], ...]
    turns: float  # at most

    @property
    def words(self) -> str:
        """Say when it was, how fast it turns, and what is kept."""
        parts = " and ".join(f"{a:.2f} to {b:.2f} s" for a, b in self.kept)
        return (
            f"{self.start:.2f} to {self.stop:.2f} s "
            f"{f'cut to {parts}' if parts else 'left out'}: the gyroscope turns, by "
            f"{self.turns:.2g} rad/s at most"
        )


def signals(
    log: Log,
    rests: Intervals,
    *,
    accelerometer: Scale,
    gyro: Scale,
    magnetometer: Scale = UNSTATED,
    calibration: str | None,
) -> Signals:
    """Bring a log to SI units, by a calibration file or its columns' units.

    Raises
    ------
    InputError
        If the gyroscope is missing, or the accelerometer's unit is not known.
    RefusedError
        If the calibration is not of this sensor.
    """
    _require_gyroscope(log)
    assert log.gyro is not None
    raw = Signals(
        time=log.time,
        gyro=log.gyro * (gyro.si_per_raw or 1.0),
        force=log.accelerometer * (accelerometer.si_per_raw or 1.0),
        field=log.magnetometer,
        rate=log.rate,
        rests=rests,
        rows=log.gyro_rows,
        gyro_unit=gyro.how if gyro.si_per_raw else "",
        force_unit=accelerometer.how,
        field_unit="",
        scales=(accelerometer, gyro, magnetometer),
    )
    if calibration is not None:
        return _calibrated(log, raw, calibration, magnetometer)
    if accelerometer.si_per_raw is None:
        msg = f"{log.path}: the unit of the accelerometer is {accelerometer.how}"
        raise InputError(msg)
    return with_field_unit(raw, magnetometer)


def _require_gyroscope(log: Log) -> None:
    if log.gyro is None:
        why = "; ".join(map(str, log.unclear))
        msg = (
            f"{log.path} has no gyroscope "
            f"({why or 'no column is named as one'}), and a filter needs one; "
            "name its columns (--columns)"
        )
        raise InputError(msg)


def longest_part(log: Log) -> Log:
    """The longest part without a hole, as a filter needs every turn."""
    usual = float(np.median(np.diff(log.time)))
    parts = log.parts(max(GAP_STEPS * usual, GAP_SECONDS))
    if len(parts) == 1:
        return log
    longest = max(parts, key=lambda rows: rows.stop - rows.start)
    return log.within(longest, f"the longest of {len(parts)} without a hole")


def _calibrated(log: Log, raw: Signals, path: str, magnetometer: Scale) -> Signals:
    done, sensors, _ = corrected(log, path)
    words = f"by the calibration {path}"
    found = replace(
        raw, force=done.accelerometer, force_unit=words, field=done.magnetometer
    )
    # what is corrected has the calibration's axes, and its field the calibration's unit
    names = {"gyroscope": "gyro"}
    shown = units_of(replace(done, columns=()))
    used = {names.get(each, each) for each in sensors}
    logs = dict(zip(OF_A_LOG, raw.scales, strict=True))
    scales = {name: shown[name] if name in used else logs[name] for name in logs}
    found = replace(found, scales=tuple(scales.values()))
    if "gyroscope" in sensors:
        assert done.gyro is not None
        found = replace(found, gyro=done.gyro, gyro_unit=f"rad/s, {words}")
    return with_field_unit(found, scales["magnetometer"])


TURNS: Final = 0.05
"""rad/s, off its bias over half a second: what a rest is not, of any gyroscope."""
STILL: Final = 0.01  # rad/s, on top of noise, in the part that is kept of a rest
SHORTEST: Final = 1.0  # s; of each part of that


def without_turns(found: Signals) -> Signals:
    """Cut off the parts of rests that turn, even if only about the vertical.

    Four rests and more are judged by each other (`simval.imu.statics`); a yawing
    vehicle may have one, its whole log. The bias is that of the quietest half second.

    Raises
    ------
    RefusedError
        If nothing of the rests is still.
    """
    size = max(3, round(0.5 * found.rate))
    kept, cuts = [], []
    for start, stop in found.rests:
        rows = found.gyro[start:stop]
        if len(rows) < 2 * size:
            kept.append((start, stop))
            continue
        windows = np.lib.stride_tricks.sliding_window_view(rows, size, axis=0)
        mean, variance = windows.mean(axis=-1), windows.var(axis=-1).sum(axis=-1)
        quiet = int(np.argmin(variance))
        off = np.linalg.norm(mean - mean[quiet], axis=1)
        if not off.max() > TURNS + 6.0 * np.sqrt(variance[quiet] / size):
            kept.append((start, stop))
            continue
        still = off <= STILL + 6.0 * np.sqrt(variance[quiet] / size)
        parts = runs_of(still) + np.array([start, start + size - 1])
        parts[1:, 0] = np.maximum(parts[1:, 0], parts[:-1, 1])  # each row once
        parts = parts[np.ptp(parts, axis=1) >= SHORTEST * found.rate]
        kept.extend(map(tuple, parts))
        cuts.append(
            TurnedRest(
                start=float(found.time[start]),
                stop=float(found.time[stop - 1]),
                kept=tuple(
                    (float(found.time[a]), float(found.time[b - 1])) for a, b in parts
                ),
                turns=float(off.max()),
            )
        )
    if not kept:
        msg = (
            "the log has no rest: while the accelerometer is still the "
            f"gyroscope turns, {cuts[0].words}; record a rest of some seconds"
        )
        raise RefusedError(msg)
    return replace(found, rests=np.array(kept, dtype=np.intp), cuts=tuple(cuts))


def with_field_unit(found: Signals, scale: Scale) -> Signals:
    """Bring the field to tesla, if its unit is known."""
    if found.field is None or scale.si_per_raw is None:
        return found
    field = found.field * scale.si_per_raw
    return replace(found, field=field, field_unit=scale.how)


def with_gyro_unit(found: Signals, raw_per_si: float | None) -> Signals:
    """Settle the gyroscope's unit by its ratio to the truth, raw units per rad/s.

    Raises
    ------
    InputError
        If the truth contradicts the unit that is stated, or none fits, or there is no
        truth and none is stated.
    """
    if raw_per_si is None:
        if found.gyro_unit:
            return found
        msg = (
            "the unit of the gyroscope is not stated, and without a truth it "
            "cannot be found; give --gyro-unit rad/s or deg/s, or --calibration"
        )
        raise InputError(msg)
    if found.gyro_unit:
        if abs(raw_per_si - 1.0) <= NEAR:
            return found
        msg = (
            f"the gyroscope, {found.gyro_unit}, turns {raw_per_si:.4g} times as "
            "fast as the truth; check its unit (--gyro-unit) and the clock of "
            "the truth"
        )
        raise InputError(msg)
    for unit, size in OF_A_LOG["gyro"].items():
        if abs(raw_per_si * size - 1.0) <= NAMED:
            words = f"{unit}, as the truth says ({raw_per_si:.5g} to a rad/s)"
            return replace(found, gyro=found.gyro * size, gyro_unit=words)
    msg = (
        f"by the truth {raw_per_si:.6g} units of the gyroscope are one "
        "rad/s, which is not a usual unit; give --gyro-unit "
        f"{1.0 / raw_per_si:.6g} for raw counts, or --calibration"
    )
    raise InputError(msg)


START_STD: Final = 0.02
"""rad; told of the start from one rest: an accelerometer that is off by 0.02 g, and a
magnetometer off by as much of its field, are usual without a calibration."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Start:
    """The first row that a filter is given, and its attitude there."""

    row: int
    attitude: Float[Array, "4"]  # north-west-up to sensor
    told: Told
    facts: tuple[Fact, ...]  # the numbers, and where they are from
    known: Mapping[str, float]  # relative sd of the noises given, by name
    motion: float  # m/s^2, of real acceleration while moving; 0 where the noise has it
    limit: bool = False  # whether the gyroscope's walk is an upper limit

    def of_nis(self, reads: Collection[str], sensors: int) -> float:
        """Relative standard deviation of NIS from that of the noises a filter is given.

        Of so many `sensors` with innovations.
        """
        parts = [2.0 * sd for name, sd in self.known.items() if name in reads]
        return float(np.hypot.reduce([0.0, *parts])) / sensors


def start_of(
    found: Signals,
    known: NoiseFile | None = None,
    source: str = "the noise file",
    *,
    accelerometer_noise: float | None = None,
) -> Start:
    """Start at the first rest by two vectors, with the settings for the filter.

    Without known noise the log's longest rest is measured; the accelerometer's, m/s^2 a
    row, is the scatter at rest where it is not given. Without a magnetometer the
    start is by the specific force, its heading is any, and the field told is NaN.

    Raises
    ------
    InputError
        If the noise file has no gyroscope in rad/s.
    """
    parts = [slice(a, b) for a, b in found.rests]
    first = parts[0]
    longest = max(parts, key=lambda each: each.stop - each.start)
    N, K, limit, gyroscope = _gyro_noise(found, longest, known, source)
    forces = [found.force[part].mean(axis=0) for part in parts]
    gravity = float(np.mean([np.linalg.norm(force) for force in forces]))
    field, scatter = np.full(3, np.nan), np.nan
    noise, sd = _scatter(found.force, parts)
    known_to = {"accelerometer_noise": sd}
    words = f"accelerometer {noise:.3g} m/s²"
    if accelerometer_noise is not None:
        noise, known_to["accelerometer_noise"] = accelerometer_noise, 0.0
        words = f"accelerometer {noise:.3g} m/s² as given"
    motion = _motion(found, gravity, noise)
    of_field = f"gravity {gravity:.5g} m/s²: mean of the rests"
    vectors = "the force of the first rest, its heading free"
    if found.field is not None:
        fields = [found.field[part].mean(axis=0) for part in parts]
        length = float(np.mean([np.linalg.norm(field) for field in fields]))
        # of the dip: down against the field
        sine = [
            -float(f @ m / np.linalg.norm(f) / np.linalg.norm(m))
            for f, m in zip(forces, fields, strict=True)
        ]
        dip = float(np.arcsin(np.mean(sine)))
        field = length * np.array([np.cos(dip), 0.0, -np.sin(dip)])
        scatter, known_to["magnetometer_noise"] = _scatter(found.field, parts)
        size, unit = (1e6, "µT") if found.field_unit else (1.0, "of its unit")
        words += f", magnetometer {size * scatter:.3g} {unit}"
        of_field = (
            f"gravity {gravity:.5g} m/s², field {size * length:.4g} {unit}, dip "
            f"{np.degrees(dip):.2f}°: means of the rests"
        )
        vectors = "force and field of the first rest"
    bias = float(np.sqrt(np.mean(found.gyro[first].mean(axis=0) ** 2)))
    told = Told(
        gyroscope_noise=N,
        gyroscope_walk=K,
        accelerometer_noise=noise,
        magnetometer_noise=scatter,
        gravity=gravity,
        field=field,
        start_std=START_STD,
        bias_std=max(bias, N / np.sqrt((first.stop - first.start) / found.rate)),
    )
    words += " a row"
    if sizes := " and ".join(f"{100.0 * sd:.2g}" for sd in known_to.values() if sd):
        rests = counted(len(parts), "rest")
        words += f": scatter in {rests}, known to {sizes} %"
    more = f"{motion:.2g} m/s² an axis while moving; the noise used is {noise:.2g} "
    more += "(--accelerometer-noise)"
    return Start(
        row=int(first.start),
        attitude=two_vectors(found, first),
        told=told,
        known=known_to,
        motion=motion,
        limit=limit,
        facts=(
            *gyroscope,
            Fact("noise used", words),
            *([Fact("acceleration", more, notable=True)] if motion else []),
            Fact("field used", of_field),
            Fact("start", f"at {found.time[first.start]:.2f} s by {vectors}, "
                 f"± {np.degrees(START_STD):.2g}°"),
            Fact("start", f"bias 0 ± {told.bias_std:.2g} rad/s, which that rest reads"),
        ),
    )  # fmt: skip


def two_vectors(found: Signals, part: slice) -> Float[Array, "4"]:
    """Attitude north-west-up to sensor from the mean force and field of some rows.

    Without a field, north is the axis of the sensor that is most level.

    Raises
    ------
    RefusedError
        If the field is vertical.
    """
    up = found.force[part].mean(axis=0)
    up /= np.linalg.norm(up)
    if found.field is None:
        field = np.eye(3)[int(np.argmin(np.abs(up)))]
    else:
        field = found.field[part].mean(axis=0)
    flat = field - (field @ up) * up
    if not np.linalg.norm(flat) > 0.02 * np.linalg.norm(field):
        msg = (
            "at the start the magnetic field is vertical, so it has no north; "
            "look at the magnetometer, or calibrate it (--calibration)"
        )
        raise RefusedError(msg)
    north = flat / np.linalg.norm(flat)
    return of_matrix(np.stack([north, np.cross(up, north), up], axis=1))


def _scatter(rows: Float[Array, "n 3"], parts: list[slice]) -> tuple[float, float]:
    # of a row about the mean of its rest, and how well that is known, relative
    found = float(np.sqrt(np.mean([rows[part].var(axis=0).mean() for part in parts])))
    off = [np.mean((rows[p] - rows[p].mean(axis=0)) ** 2, axis=1) for p in parts]
    mean, covariance, _ = mean_with_error(np.concatenate(off)[:, None])
    sd = 0.5 * float(np.sqrt(covariance[0, 0])) / float(mean[0]) if mean[0] else 0.0
    return found, sd


MOVED: Final = 2.0
"""Times the accelerometer's noise, by which a force while moving is off gravity: beyond
it the acceleration is real, and a filter is told too little."""


def _motion(found: Signals, gravity: float, noise: float) -> float:
    # along gravity, as in any direction; to first order the length has that alone
    moving = np.ones(len(found.time), dtype=bool)
    for start, stop in found.rests:
        moving[start:stop] = False
    off = np.linalg.norm(found.force[moving], axis=1) - gravity
    size = float(np.sqrt(np.mean(off**2))) if moving.any() else 0.0
    return size if size > MOVED * noise else 0.0


def _gyro_noise(
    found: Signals, part: slice, known: NoiseFile | None, source: str
) -> tuple[float, float, bool, tuple[Fact, ...]]:
    # N and K, whether K is an upper limit, and where they are from
    axes, scale, words = _axes(found, part, known, source)
    seconds = (part.stop - part.start) / found.rate
    if known is not None:
        seconds = min(axis.rows / axis.rate_hz for axis in axes)
    N = _coefficient(axes, "N", scale)
    K = _coefficient(axes, "K", scale)
    unfit, hidden, limits = N is None, K is None, []
    slow = [axis.slow for axis in axes if axis.slow and not axis.slow.is_walk]
    if slow:
        horizon = max(each.horizon for each in slow)
        limits.append(Fact("noise used", f"K is equivalent over up to {horizon:.3g} s"))
    if N is None:
        # no model: the scatter from row to row
        steps = np.diff(found.gyro[part], axis=0)
        N = float(np.sqrt(0.5 * np.mean(steps**2) / found.rate))
        words = "row steps: no model fits the rest"
    if K is None:
        # what would double the variance of an average over the rest, N^2/T + K^2 T/3
        K = np.sqrt(3.0) * N / seconds
        shows = f"K is below what {seconds:.0f} s can show; that limit was used"
        limits.append(Fact("noise used", shows))
    of = OF_A_DATA_SHEET["gyro"]
    sizes = (
        f"{name} {rounded(of[name].factor * value, 3)} {of[name].name}"
        for name, value in (("N", N), ("K", K))
    )
    fact = Fact("noise used", f"gyroscope {', '.join(sizes)}, by {words}", unfit)
    return N, K, hidden, (fact, *limits)


def _axes(
    found: Signals, part: slice, known: NoiseFile | None, source: str
) -> tuple[tuple[AxisNoise, ...], float, str]:
    if known is None:
        seconds = (part.stop - part.start) / found.rate
        words = f"a rest of {seconds:.0f} s"
        try:
            return noise_of(found.gyro[part][:, None], found.rate), 1.0, words
        except RefusedError:  # a short rest
            return (), 1.0, words
    if not known.gyro or known.gyro_si_per_raw is None:
        msg = (
            f"{source} has no gyroscope with a known unit, but a filter takes "
            "its noise in rad/s; write the file with `simval noise LOG "
            "--gyro-unit rad/s --json`"
        )
        raise InputError(msg)
    return known.gyro, known.gyro_si_per_raw, source


def _coefficient(axes: tuple[AxisNoise, ...], kind: str, scale: float) -> float | None:
    # root mean square over the axes; an axis without a value counts as zero
    values = [c.value for axis in axes for c in axis.given if c.kind == kind]
    seen = [value for value in values if value is not None]
    if not seen or (kind == "N" and len(seen) < len(axes)):
        return None
    return scale * float(np.sqrt(np.sum(np.square(seen)) / len(axes)))
