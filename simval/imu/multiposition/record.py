r"""What the record of a calibration needs beside its numbers: labels and a budget.

**Budget.** The variance of a parameter is that of the scatter of the poses, in which
noise, the steps of the readings and motion within rests are seen, and that of gravity,
which is in no residual; the two add up. Below the scatter stands what is known of its
parts: the noise by the Cramér-Rao bound at what was measured, and of steps, and of a
trembling hand, the share of the noise that they are. The expanded uncertainty is
:math:`U = k u`, k the 97.5 % quantile of the law of each interval.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from simval.account import Fact, Line, Quantity, Values
from simval.arrays import Array
from simval.imu.calibrate.gravity import Gravity
from simval.imu.calibrate.values import BARS
from simval.imu.sensor import forms
from simval.imu.sensor.readable import kinds_of, readable
from simval.moments import deviations
from simval.shapes import Float
from simval.spelling import counted

LABELS: Final = {"date": "YYYY-MM-DD", "sensor": "ID", "operator": "NAME"}
"""Labels that a record should have, and what they hold."""


def record_facts(labels: Mapping[str, str], gravity: Gravity) -> Iterator[Fact]:
    """The labels as given, the usual ones that are missing, and the place."""
    for name, what in LABELS.items():
        missing = f"not stated (--label {name}={what})"
        yield Fact(name, labels.get(name, missing))
    yield from (Fact(name, said) for name, said in labels.items() if name not in LABELS)
    yield Fact("gravity from", gravity.source)


class Contribution(NamedTuple):
    """One source of uncertainty of a sensor's parameters."""

    name: str
    words: str  # how it was found
    sd: Float[Array, " n"]  # NaN where there is no number
    part: bool = False  # whether it is in the scatter already
    most: bool = False  # whether it is an upper limit
    missing: str = "not known"  # where there is no number

    @property
    def label(self) -> str:
        """Name of the source, indented if it is part of the scatter."""
        return f"{'- ' * self.part}{self.name}"

    def cell(self, name: str, value: float) -> Quantity:
        """Its contribution to a parameter, in the unit of the column."""
        if not np.isfinite(value):
            return Quantity(name, None, missing=self.missing)
        if self.most:
            return Quantity(name, None, None, 0.0, value)
        return Quantity(name, float(f"{value:.2g}"))


def known_gravity_bound(whole: Any) -> Float[Array, "9"]:
    """Square root of the Cramer-Rao bound for a known gravity; NaN if not known."""
    if whole.predicted is None:
        return np.full(9, np.nan)
    return deviations(whole.predicted.cramer_rao)


def bound_sd(whole: Any) -> Float[Array, "9"]:
    """Square root of the Cramer-Rao bound on each variance; NaN if not known."""
    return np.hypot(known_gravity_bound(whole), whole.fit.of_gravity)


def sources(whole: Any) -> tuple[Contribution, ...]:
    """Sources of the uncertainty of a log's accelerometer."""
    fit, noise = whole.accelerometer, whole.pose_noise
    bound, gravity = known_gravity_bound(whole), np.abs(fit.of_gravity)
    scatter = np.sqrt(np.maximum(fit.sd**2 - gravity**2, 0.0))
    joint = whole.together or whole.gyroscope or whole.magnetometer
    found = BARS[fit.covariance_kind]
    if joint is not None and fit.covariance_kind == "known sigma":
        found = f"{joint.noise.words or 'Every sensor scatters as its noise explains'}."
    # the rotations of a gyroscope help, and the scatter may be less than this part
    alone = "of the accelerometer alone, " if joint is not None else ""
    share = np.where(noise.std > 0.0, noise.std, np.inf)
    rounded = _rms(noise.rounded / share)
    trembled = np.linalg.norm(np.broadcast_to(noise.trembled, (len(share), 3)), axis=1)
    steps = f"steps of the readings, {100.0 * rounded:.2g} % of the noise"
    motion, moved = np.full(9, np.nan), "no trembling that shortens a mean"
    if shaken := bool(np.any(trembled)):
        motion = bound * _rms(trembled / share)
        moved = "a trembling hand shortens the means: put back, and at most so much"
    if whole.cuts:
        moved += f"; {counted(len(whole.cuts), 'rest')} cut where the sensor turns"
    return (
        Contribution("scatter", found, scatter),
        Contribution("noise", f"{alone}by {noise.words}", bound, part=True),
        Contribution(
            "resolution", steps if rounded else "the readings show no steps",
            bound * rounded, part=True,
        ),
        Contribution(
            "residual motion", moved, motion, part=True, most=shaken,
            missing="not known" if shaken else "not seen",
        ),
        Contribution("gravity", gravity_words(fit), gravity),
    )  # fmt: skip


def gravity_words(fit: Any) -> str:
    """Say how well gravity was known."""
    words = Gravity(fit.g, fit.g_std).words
    if fit.g_std:
        return f"{words}, in every K alike"
    return f"{words}; state the place (--latitude, --height) or --g-uncertainty"


def _rms(values: Array) -> float:
    return np.sqrt(np.mean(np.square(values)))


def budget(whole: Any) -> Values:
    """Uncertainty of the worst parameter of each kind, source by source."""
    fit, found = whole.accelerometer, sources(whole)
    names = [name for name, _ in forms.entries(fit.model)]
    kinds = np.array(kinds_of(fit.model))
    bars = readable(fit)
    sizes = np.array([bar for bar, _ in bars])
    worst = [
        int(np.argmax(np.where(kinds == kind, sizes, 0.0)))
        for kind in dict.fromkeys(kinds.tolist())
    ]
    factors = np.array([size / sd for size, sd in zip(sizes, fit.sd, strict=True)])
    heads = {k: f"{names[k]}, {bars[k][1].name}" for k in worst}
    return _table("uncertainty budget", found, fit.sd, fit.intervals, heads, factors)


def other_sources(fit: Any, count: int) -> tuple[Contribution, ...]:
    """Sources of the uncertainty of another sensor's own (last) parameters.

    That of the accelerometer, whose axes they are on, by the conditional covariance.
    """
    C, n = fit.covariance, len(fit.covariance) - count
    known = C[n:, n:] - C[n:, :n] @ np.linalg.solve(C[:n, :n], C[:n, n:])
    own, whole = np.diagonal(known), np.diagonal(C[n:, n:])
    found = fit.noise.words or "every sensor scatters as its noise explains"
    parts = "; the accelerometer's scatter alone is split into noise, steps and motion"
    carried = "its calibration, which was fitted together and fixes the axes"
    return (
        Contribution("scatter", f"{found}{parts}", np.sqrt(np.maximum(own, 0.0))),
        Contribution("accelerometer", carried, np.sqrt(np.maximum(whole - own, 0.0))),
        Contribution("gravity", "its direction alone is used", np.zeros(count)),
    )


def other_budget(sensor: str, fit: Any, names: Sequence[str]) -> Values:
    """Uncertainty of the worst entry of M and of the bias, source by source."""
    count, sd = len(names), fit.sd[-len(names) :]
    heads = {
        k: f"{names[k]}, {unit}"
        for part, unit in ((slice(9), "ppm of M"), (slice(9, 12), "units of the log"))
        for k in [int(np.arange(count)[part][np.argmax(sd[part])])]
    }
    factors = np.ones(count)
    factors[:9] = 1e6 / np.linalg.norm(fit.M, axis=0).mean()
    found, intervals = other_sources(fit, count), fit.intervals[-count:]
    title = f"uncertainty budget of the {sensor}"
    return _table(title, found, sd, intervals, heads, factors)


def _table(
    title: str,
    found: Sequence[Contribution],
    sd: Array,
    intervals: Array,
    heads: Mapping[int, str],
    factors: Array,
) -> Values:
    """A row for each source and for all together, a column for each parameter."""
    width = (intervals[:, 1] - intervals[:, 0]) / 2.0
    rows = (
        *found,
        Contribution("together, u", "", sd),
        Contribution("expanded, U", "", width),
    )
    lines = [
        Line(each.label, "", [
            each.cell(head, factors[k] * each.sd[k]) for k, head in heads.items()
        ], notable=False)
        for each in rows
    ]  # fmt: skip
    ratios = (width / sd)[list(heads)].tolist()
    quantiles = " and ".join(dict.fromkeys(f"{x:.3g}" for x in ratios))
    return Values(
        title=title,
        how="of the worst axis of each kind, standard deviations",
        lines=lines,
        heads=list(heads.values()),
        facts=(
            *(Fact(each.label, each.words) for each in found),
            Fact(
                "expanded, U", f"U = k u holds the true value in 95 %, k = {quantiles}"
            ),
        ),
    )


def budget_object(found: Sequence[Contribution]) -> list[dict[str, Any]]:
    """The budget of all parameters as plain JSON values."""
    return [
        {
            "source": each.name, "said": each.words, "part": each.part,
            "limit": each.most,
            "sd": each.sd.tolist() if np.isfinite(each.sd).all() else None,
        }
        for each in found
    ]  # fmt: skip


def correlations(
    sensor: str, names: tuple[str, ...], covariance: Array, signs: Any = 1.0
) -> Values:
    """Correlation of each parameter of a sensor with those before it."""
    sd = deviations(covariance)
    r = covariance / np.outer(sd, sd) * np.outer(*2 * [signs * np.ones(len(sd))])
    lines = [
        Line(name, "", [
            Quantity(other, round(float(r[i, j]), 2) + 0.0)
            for j, other in enumerate(names[:i])
        ], notable=False)
        for i, name in enumerate(names)
        if i
    ]  # fmt: skip
    title = f"correlations of the {sensor}"
    return Values(title=title, lines=lines, heads=names[:-1])
