r"""Page of filters on a log: how wrong they are, if they know it, and when.

Roll, pitch and yaw are those of the sensor in the world north-west-up: with R the
matrix that takes sensor to world, z-y'-x'' (ISO 8855's order, its x north, y west),

.. math:: \psi = \operatorname{atan2}(R_{21}, R_{11}), \quad
   \theta = -\arcsin R_{31}, \quad \varphi = \operatorname{atan2}(R_{32}, R_{33}).
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from simval.account import Account
from simval.arrays import Array
from simval.geometry import attitude_matrix
from simval.imu.logs import Log
from simval.imu.recorded import Evaluation
from simval.imu.recorded.description import FilteredLog
from simval.imu.recorded.errors import WINDOW
from simval.imu.recorded.evaluation import WithTruth, from_its_start
from simval.imu.statics.detector import runs_of
from simval.report.formatting import slug
from simval.report.log_page import LogPage, linear, signal, stated
from simval.report.panels import COLOURS, INK, Drawing, Series
from simval.report.section import made
from simval.shapes import Float
from simval.spelling import measured
from simval.units import DEGREE

BAND = 3.0
"""Standard deviations of the band that is drawn."""

CHI2 = {2: (0.0506, 7.3778), 3: (0.2158, 9.3484)}
"""Ends of 95 % of a chi-square, that of one row, by degrees of freedom: of inclination
alone where heading is free."""

STATED = f"{BAND:g} standard deviations that it states"
NAMES = ("total", "heading", "inclination")
ANGLES = ("roll", "pitch", "yaw")
STEEP = 80.0
"""Degrees of pitch beyond which roll and yaw are not compared."""
WITHIN = 99.73
"""% of normal numbers that lie within `BAND` of their standard deviations."""


def filter_page(
    log: Log, whole: FilteredLog, account: Account, command: str = ""
) -> LogPage:
    """State the figures of filters on a log, with their account.

    Parameters
    ----------
    log : Log
        The log.
    whole : FilteredLog
        What filters made of it.
    account : Account
        What there is to say of that, with what was read of the log.
    command : str
        The command that makes the page again; empty leaves it out.
    """
    known = {x.run.name: x.truth for x in whole.done if x.truth is not None}
    errors = [*_beside(known), *(_drawing(*each) for each in known.items())]
    kinds = {
        "Errors over time": errors,
        "Roll, pitch and yaw": [_attitude(whole, each) for each in whole.done],
        "Bias of the gyroscope": [x for e in whole.done for x in _bias(whole, e)],
        "Innovations": [x for e in whole.done for x in innovations(whole, e)],
    }
    return LogPage(
        account=account,
        log=log,
        chapters=[
            # one at once, the others a click away
            made([*each[:1], *(replace(x, fold=x.asked) for x in each[1:])]).under(
                slug(title), title
            )
            for title, each in kinds.items()
            if each
        ],
        command=command,
    )


def _beside(known: Mapping[str, WithTruth]) -> Iterator[Drawing]:
    """Plot the errors of several filters together; nothing for a single one."""
    if len(known) < 2:
        return
    sizes = {name: truth.rms["all"]["total"] for name, truth in known.items()}
    said = ", ".join(
        f"{name} {measured(*np.degrees([rms.value, rms.sd]))}"
        for name, rms in sorted(sizes.items(), key=lambda each: each[1].value)
    )
    yield Drawing(
        name="errors-beside",
        asked="Which filter is wrong, and when?",
        finding=f"RMS error in degrees, the least first: {said}.",
        caption="Errors of all filters over time.",
        panels=[
            linear(word, "time, s", f"{word} error, degrees", [
                signal(truth.errors.time, np.degrees(getattr(truth.errors, word)),
                       name, COLOURS[k % len(COLOURS)])
                for k, (name, truth) in enumerate(known.items())
            ])
            for word in NAMES
        ],
        columns=1,
    )  # fmt: skip


def _drawing(name: str, truth: WithTruth) -> Drawing:
    errors = truth.errors
    rests = errors.time[runs_of(errors.rest) - [0, 1]].tolist()
    panels = [
        linear(word, "time, s", f"{word} error, degrees", _lines(truth, k), spans=rests)
        for k, word in enumerate(NAMES)
    ]
    if truth.squares is not None:
        # above the lines the covariance is too small, below too large
        panels.append(
            linear(
                "squared error over covariance",
                "time, s",
                "NEES of a row",
                [signal(errors.time, truth.squares, "error")],
                log_y=True,
                references=_expected(2 if truth.free else 3),
                spans=rests,
            )
        )
    caption = f"Errors of {name} over time."
    if truth.band is not None:
        caption += " What it states is by its own covariance."
    return Drawing(
        name=f"errors-{slug(name)}",
        asked=f"When is the filter {name} wrong?",
        finding=_farthest(truth),
        caption=caption,
        panels=panels,
        columns=1,
    )


def _expected(freedom: int) -> tuple[tuple[float, str], ...]:
    low, high = CHI2[freedom]
    mean = f"{freedom}, its mean if the covariance is true"
    return (
        (low, "95 % of the rows are between if it is true"),
        (freedom, mean),
        (high, ""),
    )


def _farthest(truth: WithTruth) -> str:
    """Say in one sentence the largest error, and when the filter had converged."""
    errors = truth.errors
    k = int(np.argmax(errors.total))
    found = (
        f"Most at {errors.time[k]:.1f} s, by {np.degrees(errors.total[k]):.3g} degrees"
    )
    if not np.isfinite(truth.settled):
        return f"{found}; it never converges."
    if truth.settled == 0.0:
        early = errors.time[k] - errors.time[0] < WINDOW
        return f"{found}." if early else f"{found}; it had converged at the start."
    return f"{found}; it had converged after {truth.settled:.2g} s."


def _lines(truth: WithTruth, k: int) -> list[Series]:
    """An error over time and the band that the filter states."""
    time = truth.errors.time
    error: Float[Array, " k"] = getattr(truth.errors, NAMES[k])
    lines = [signal(time, np.degrees(error), "error")]
    if truth.band is not None:
        band = BAND * np.degrees(truth.band[:, k])
        low = -band if NAMES[k] == "heading" else 0.0
        lines.insert(0, stated(time, low, band, STATED))
    return lines


def roll_pitch_yaw(q: Float[Array, "k 4"]) -> Float[Array, "k 3"]:
    """Roll, pitch and yaw of attitudes north-west-up to sensor, degrees."""
    A = attitude_matrix(q)  # from world to sensor
    pitch = -np.arcsin(np.clip(A[:, 0, 2], -1.0, 1.0))
    roll = np.arctan2(A[:, 1, 2], A[:, 2, 2])
    yaw = np.arctan2(A[:, 0, 1], A[:, 0, 0])
    return np.degrees(np.stack([roll, pitch, yaw], axis=1))


def _attitude(whole: FilteredLog, each: Evaluation) -> Drawing:
    run, found = each.run, whole.found
    kept, own = run.output.kept, run.output.attitude[0]
    truth = np.empty((0, 3))
    if whole.alignment is not None:
        there = np.isfinite(whole.alignment.attitude[kept, 0])
        kept, own = kept[there], own[there]
        true = whole.alignment.attitude[kept]
        own = from_its_start(own, true) if run.six else own
        truth = np.unwrap(roll_pitch_yaw(true), period=360.0, axis=0)
    time, angles = found.time[kept], roll_pitch_yaw(own)
    finding = ""
    if len(truth):
        apart = np.remainder(angles - truth + 180.0, 360.0) - 180.0
        angles = truth + apart
        # near a pitch of 90 degrees a small error is a large one of roll and yaw
        seen = np.where(np.abs(truth[:, 1:2]) < STEEP, np.abs(apart), 0.0)
        row, k = np.unravel_index(int(np.argmax(seen)), seen.shape)
        finding = f"Farthest apart at {time[row]:.1f} s, in {ANGLES[k]}, by "
        finding += f"{seen[row, k]:.3g} degrees (pitch below {STEEP:g})."
    else:
        angles = np.unwrap(angles, period=360.0, axis=0)
    lines = [
        [signal(time, angles[:, k], run.name)]
        + (
            [Series(label="truth", x=time, y=truth[:, k], colour=INK, line="--")]
            if len(truth)
            else []
        )
        for k in range(3)
    ]
    counted = ", turned to the truth's heading at the start" if run.six else ""
    return Drawing(
        name=f"attitude-{slug(run.name)}",
        asked=f"Which attitude has {run.name}?",
        finding=finding,
        caption=(
            f"Roll, pitch and yaw of {run.name}{counted}, of the sensor in "
            "north-west-up; beyond half a turn they are counted on."
        ),
        panels=[
            linear(word, "time, s", f"{word}, degrees", own)
            for word, own in zip(ANGLES, lines, strict=True)
        ],
        columns=1,
    )


def _bias(whole: FilteredLog, each: Evaluation) -> Iterator[Drawing]:
    output, name = each.run.output, each.run.name
    if output.bias is None:
        return
    time, bias = whole.found.time[output.kept], DEGREE.factor * output.bias[0]
    P = output.covariance
    known = P is not None and P.shape[-1] >= 6
    panels = []
    for k, axis in enumerate("xyz"):
        lines = [signal(time, bias[:, k], "bias")]
        if P is not None and known:
            half = (
                BAND * DEGREE.factor * np.sqrt(np.maximum(P[0, :, 3 + k, 3 + k], 0.0))
            )
            lines.insert(0, stated(time, bias[:, k] - half, bias[:, k] + half, STATED))
        panels.append(linear(axis, "time, s", f"bias of {axis}, °/s", lines))
    ends = ", ".join(f"{axis} {b:.3g}" for axis, b in zip("xyz", bias[-1], strict=True))
    yield Drawing(
        name=f"bias-{slug(name)}",
        asked=f"Which bias has {name} for the gyroscope?",
        finding=f"At the end {ends} °/s.",
        caption=f"Bias of the gyroscope by {name}.",
        panels=panels,
        columns=1,
    )


def innovations(whole: FilteredLog, each: Evaluation) -> Iterator[Drawing]:
    """Plot innovations over their stated deviations; nothing without them."""
    output, name = each.run.output, each.run.name
    if output.innovation is None or output.innovation_covariance is None:
        return
    time, S = whole.found.time[output.kept], output.innovation_covariance[0]
    sd = np.sqrt(np.diagonal(S, axis1=1, axis2=2))
    shares = output.innovation[0] / np.where(sd > 0.0, sd, np.nan)
    within = 100.0 * float(np.mean(np.abs(shares) <= BAND))
    yield Drawing(
        name=f"innovations-{slug(name)}",
        asked=f"Are the innovations of {name} as large as it states?",
        finding=(
            f"{within:.3g} % are within {BAND:g} of the standard deviations that it "
            f"states, where {WITHIN} % should be."
        ),
        caption=(
            f"Innovations of {name} over the standard deviation that it states, in its "
            "order."
        ),
        panels=[
            linear(
                f"innovation {k + 1}",
                "time, s",
                "over its standard deviation",
                [signal(time, shares[:, k], "innovation")],
                references=((-BAND, f"{WITHIN} % should be between"), (BAND, "")),
            )
            for k in range(shares.shape[1])
        ],
        columns=1,
    )
