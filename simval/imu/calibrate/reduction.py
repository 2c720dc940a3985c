r"""Reduce the rows of a recording to what its sensors showed in each rest.

The model of a gyroscope's bias, what it owes to the temperature and whether forces act
on it are chosen by evidence (`simval.imu.calibrate.gyroscope.at_rest`), and taken out.
"""

from dataclasses import replace
from typing import Any, Literal

import numpy as np

from simval.arguments import choice, switch
from simval.arrays import Array, finite_array, physical_array
from simval.errors import InputError
from simval.imu.calibrate.gyroscope.at_rest import (
    MOVES,
    BiasTerms,
    Sensitivity,
    bias_terms,
    choose_bias,
    choose_sensitivity,
    rest_motion,
    walk_of,
)
from simval.imu.calibrate.gyroscope.rest_effects import Rests
from simval.imu.calibrate.gyroscope.scale_terms import scale_terms
from simval.imu.calibrate.joint import accelerometer_of
from simval.imu.calibrate.path_statistics import (
    Scheme,
    checked_rests,
    inter_rest_rotations,
)
from simval.imu.calibrate.recording import Bias, Hemisphere, Recording, Taken, std_of
from simval.shapes import Float
from simval.spelling import chance as p_words
from simval.vocabulary import Model

_CHOICES = ("auto", "constant", "line")


def recording_of(
    time: Any,
    accelerometer: Any,
    intervals: Any,
    *,
    gyroscope: Any = None,
    magnetometer: Any = None,
    temperature: Any = None,
    g: float = 9.80665,
    g_std: float = 0.0,
    field: float = 1.0,
    hemisphere: Hemisphere = "unstated",
    model: Model = "triangular",
    pose_std: Any = None,
    field_std: Any = None,
    angle_random_walk: Any = None,
    bias_random_walk: float | None = None,
    clock_jitter: float = 0.0,
    bias: Bias | Literal["auto"] = "auto",
    sensitivity: bool | None = None,
    scheme: Scheme = "averages",
    margin: int = 10,
    chunk: int = 1,
    full_scale: float | None = None,
    means: bool | None = None,
) -> Recording:
    """Reduce the rows of sensors to what they showed in each rest, and between them.

    Parameters
    ----------
    time : array_like
        Time of each row, s, (n,).
    accelerometer : array_like
        Raw readings, (n, 3).
    intervals : array_like
        Rows of each rest, start <= row < stop, in order, (m, 2).
    gyroscope, magnetometer : array_like, optional
        Raw readings, (n, 3).
    temperature : array_like, optional
        Of the sensor at each row, degrees Celsius, (n,): the gyroscope's bias and
        scale may depend on it, by odds and an F test.
    g, g_std : float
        Gravity there and its standard deviation, m/s^2, as the next three of
        `Recording`.
    field : float
        Strength of the magnetic field there.
    hemisphere : {"unstated", "north", "south"}
        Where it was made.
    model : {"triangular", "upper", "symmetric"}
        Form of the accelerometer.
    pose_std, field_std : float or array_like, optional
        As of `Recording`; white noise from the scatter within rests if not given.
    angle_random_walk : float or array_like, optional
        As of `Recording`; from the rests if not given.
    bias_random_walk : float, optional
        K of the gyroscope, raw units times root hertz; from the differences between
        rests if not given.
    clock_jitter : float
        As of `Recording`.
    bias : {"auto", "constant", "line"}
        Model of the bias; auto chooses by evidence.
    sensitivity : bool, optional
        Whether specific force acts on the gyroscope; by its odds if not given.
    scheme : {"averages", "cubic", "linear"}
        As in `inter_rest_rotations`, as are the next three.
    margin : int
        Rows by which a rotation reaches into the rests at its ends.
    chunk : {1, 2, 4, 8}
        Steps that are merged into one.
    full_scale : float, optional
        Greatest reading of the gyroscope.
    means : bool, optional
        Whether rotations go between the mean attitudes of the rests, as in
        `inter_rest_rotations`; by the angles within the rests if not given.

    Returns
    -------
    Recording
        Means of the rests, their noise, the rotations, and what was taken out with the
        reasons.

    Raises
    ------
    InputError
        If an argument is not usable.
    RefusedError
        If the rests do not tell the accelerometer, rows are missing, or the range ends.
    """
    bias = choice("bias", bias, _CHOICES)
    clock = finite_array("time", time, (None,))
    force = _checked("accelerometer", accelerometer, len(clock))
    at = checked_rests(intervals, len(clock))
    given: dict[str, Any] = dict(
        g=g, g_std=g_std, field=field, hemisphere=hemisphere, model=model,
        time=clock[at.sum(axis=1) // 2],
    )  # fmt: skip
    for name, means_of, std, rows in (
        ("accelerometer", "poses", pose_std, force),
        ("magnetometer", "fields", field_std, magnetometer),
    ):
        if rows is None:
            continue
        read = _checked(name, rows, len(clock))
        given[means_of] = np.array([read[a:b].mean(axis=0) for a, b in at])
        # what white noise leaves in the mean of each rest
        white = np.sqrt(variance_within(read, at) / np.diff(at))
        stated = white if std is None else std
        given[f"{means_of[:-1]}_std"] = std_of(
            f"{means_of[:-1]}_std", stated, white.shape
        )
    recording = Recording(**given)
    if gyroscope is None:
        return recording
    how: dict[str, Any] = {
        "scheme": scheme, "margin": margin, "chunk": chunk, "full_scale": full_scale,
    }  # fmt: skip
    inter_rest = inter_rest_rotations(time, gyroscope, intervals, **how)
    walk = inter_rest.white[0] if angle_random_walk is None else angle_random_walk
    recording = replace(
        recording, rotations=inter_rest, clock_jitter=clock_jitter,
        angle_random_walk=walk,
        accelerometer=accelerometer_of(recording).require_converged(),
    )  # fmt: skip
    rows = clock, force, gyroscope, at
    asked = (
        bias,
        None if sensitivity is None else switch("sensitivity", sensitivity),
        None if means is None else switch("means", means),
    )
    return _without_effects(recording, rows, temperature, bias_random_walk, asked, how)


def _without_effects(
    recording: Recording, rows: tuple[Any, ...], temperature: Any, drift: float | None,
    asked: tuple[Any, ...], how: dict[str, Any],
) -> Recording:  # fmt: skip
    # rotations without what acts on the gyroscope's bias and scale
    time, read, gyroscope, at = rows
    bias, sensitivity, means = asked
    inter_rest, acc = recording.rotations, recording.accelerometer
    walk = recording.angle_random_walk
    assert inter_rest is not None
    assert acc is not None
    rests = Rests(
        rates=inter_rest.rest_rates[0], times=inter_rest.rest_times,
        seconds=inter_rest.rest_seconds, rotation_seconds=inter_rest.seconds,
        before=inter_rest.before, after=inter_rest.before + 1,
    )  # fmt: skip
    forces = acc.sensor().correct(recording.poses)
    warm = bias_terms(temperature, time, at, rests, forces, walk, drift)
    found = choose_sensitivity(
        rests, forces, walk, drift, asked=sensitivity, powers=warm.at_rest
    )
    rates = rests.rates - forces @ found.G.T - warm.at_rest @ warm.coefficients
    rests = rests._replace(rates=rates)
    chosen, drift, said = choose_bias(rests, walk, drift)
    chance, within = rest_motion(time, gyroscope, at, rests, walk, drift)
    moves = chance < MOVES if means is None else means
    if bias != "auto" and bias != chosen:
        chosen, said = bias, f"bias: {bias}, as asked; by evidence {said}"
    elif bias != chosen == "line" and moves and within < MOVES:
        # what a hand turns is no bias
        chosen, said = (
            "constant",
            f"bias: constant, rests move; were they still, {said}",
        )
    scatter, _ = walk_of(rests, np.ones((len(at), 1)))
    how["means"] = moves
    moved = moves and (
        "rotations go from the mean attitude of a rest to that of the next; that the "
        f"rests are still has {p_words(chance)}"
    )
    force = acc.sensor().correct(read) if found.kept else None
    more, known = _taken_out(time, warm, force, found, rests, chosen)
    recording = replace(
        recording, bias_random_walk=drift, bias=chosen, known_bias=known,
        bias_std=scatter / np.sqrt(inter_rest.rest_seconds.sum()),
    )  # fmt: skip
    gain = scale_terms(
        recording, time, gyroscope, at, warm, how, more.get("offset", 0.0)
    )
    if more or moves or gain.thermal is not None:
        rates_of = gyroscope if gain.thermal is None else gain.rows
        inter_rest = inter_rest_rotations(time, rates_of, at, **how, **more)
    thermal = gain.thermal or warm.thermal
    reasons = (
        said, found.reason, inter_rest.left_out, moved, warm.reason, gain.reason,
    )  # fmt: skip
    taken = Taken(
        thermal={} if thermal is None else {"gyroscope": thermal},
        G=found.G, G_sd=found.sd, reasons=tuple(x for x in reasons if x),
    )  # fmt: skip
    if gain.covariance is not None:
        taken = taken._replace(of_scale=gain.covariance)
    return replace(recording, rotations=inter_rest, taken=taken)


def _checked(name: str, rows: Any, count: int) -> Float[Array, "n 3"]:
    read = physical_array(name, rows, (None, 3))
    if read.ndim != 2 or len(read) != count:
        msg = (
            f"`{name}` has shape {read.shape} for {count} rows of time; give a reading "
            "of each, (n, 3)"
        )
        raise InputError(msg)
    return read


def variance_within(rows: Float[Array, "n 3"], rests: Any) -> Float[Array, "3"]:
    """Variance of single readings about their rest's mean, by axis."""
    counts = np.diff(rests)[:, 0]
    squares = sum(rows[a:b].var(axis=0) * (b - a) for a, b in rests)
    return squares / (counts.sum() - len(counts))


def _taken_out(
    time: Any,
    warm: BiasTerms,
    force: Float[Array, "n 3"] | None,
    found: Sensitivity,
    rests: Rests,
    bias: str,
) -> tuple[dict[str, Any], Any]:
    # what the rows lose before they are integrated, and the bias that is then left
    parts = [] if force is None else [(force, found.G.T)]
    parts += [] if warm.thermal is None else [(warm.rows, warm.coefficients)]
    more: dict[str, Any] = {}
    if parts:
        more = {
            "force": np.concatenate([rows for rows, _ in parts[::-1]], axis=1),
            "force_noise": warm.shape if force is None else found.shape,
            "offset": sum(rows @ by for rows, by in parts),
        }
    known = None
    if bias == "line":
        known = np.average(rests.rates, axis=0, weights=rests.seconds)
        clock = time
        line = [np.interp(clock, rests.times, y) for y in (rests.rates - known).T]
        more["offset"] = more.get("offset", 0.0) + np.stack(line, axis=1)
    return more, known
