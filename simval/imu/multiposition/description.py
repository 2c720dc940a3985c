r"""The calibration of a log as an account and as JSON, with its conditions.

**Conditions.** Every sentence that says yes or no of the error bars, in any face, is a
`Condition`: no where the chance of what is seen is below the level of its test.

**ROS** (``sensor_msgs/Imu``) has the noise of single readings in SI units and the axes
of the calibration: with M the matrix of a sensor and :math:`\sigma_k` the white noise
of a reading on its axis k, the covariance of a corrected reading is
:math:`M\,\mathrm{diag}(\sigma^2)\,M^T`, row by row.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import PurePath
from typing import Any, NamedTuple

import numpy as np

from simval.account import (
    Account,
    Answer,
    Fact,
    Line,
    Quantity,
    Remark,
    Reply,
    Values,
)
from simval.arrays import Array, json_values
from simval.files import digest
from simval.imu.calibrate.diagnosis import (
    LEAST_FREEDOM,
    Diagnosis,
)
from simval.imu.calibrate.drift import DRIFT_FALSE_ALARM, HIDDEN, Drift
from simval.imu.calibrate.factors import NoiseFactors
from simval.imu.calibrate.files import to_json
from simval.imu.calibrate.goodness_of_fit import (
    BELIEVED,
    BEYOND,
    FALSE_ALARM,
    believed_range,
    chi_square_chance,
)
from simval.imu.calibrate.magnetometer.findings import FALSE_ALARM as ONE_POSE
from simval.imu.calibrate.magnetometer.result import OWN_NAMES
from simval.imu.calibrate.reduction import variance_within
from simval.imu.calibrate.rest_temperatures import LEAST_SPAN, Within
from simval.imu.calibrate.thermal import TEMPERATURE, TIME, Course, Term
from simval.imu.calibrate.values import (
    gyroscope_values,
    how_good,
    magnetometer_values,
    matrix_note,
    noise_facts,
    status,
)
from simval.imu.explain.judgement import CHANCE
from simval.imu.logs import Log
from simval.imu.multiposition.record import (
    bound_sd,
    budget,
    budget_object,
    correlations,
    gravity_words,
    other_budget,
    other_sources,
    sources,
)
from simval.imu.sensor import forms
from simval.imu.sensor.readable import WIDE, accelerometer_values
from simval.imu.statics import Intervals
from simval.poses import GEOMETRY_LIMIT
from simval.shapes import Float
from simval.spelling import chance, counted, series

ANSWERS: dict[bool | None, Answer] = {True: "pass", False: "fail", None: "inconclusive"}
BEGIN = {True: "Yes", False: "No", None: "Cannot tell"}
"""The answer of a condition, as a mark and as a word."""
ORDER = "order of the poses"
REPEAT = "Repeat the first poses at the end."
ADD = "Add poses."
WARM = "Record more rests, warmer and colder in turn."


class Condition(NamedTuple):
    """A condition on which the error bars depend, and the result of its test.

    Attributes
    ----------
    about : str
        What is judged.
    holds : bool or None
        Whether all is as the error bars take it; None where the log does not tell.
    p_value : float
        Chance of what is seen if it is; NaN where the test has none.
    level : float
        The test says no below it.
    words : str
        The answer.
    do : str
        What to do about it; empty where it holds, or the words say it.
    """

    about: str
    holds: bool | None
    p_value: float
    level: float
    words: str
    do: str = ""

    def as_object(self) -> dict[str, Any]:
        """Return the condition as plain JSON values."""
        return self._asdict() | {"p_value": json_values(self.p_value)}

    @property
    def sentence(self) -> str:
        """Say what was tested and the result, with its chance."""
        p = f" ({each})" if (each := chance(self.p_value)) else ""
        about = f"{self.about[:1].upper()}{self.about[1:]}"
        return f"{about}: {BEGIN[self.holds].lower()}, {self.words}{p}."


def conditions(whole: Any) -> tuple[Condition, ...]:
    """Test the conditions on which the error bars of a log depend."""
    found = [
        _rests(whole),
        _drift_in_fit(whole) or order(whole.diagnosis),
    ]
    if whole.warm.rests is not None:
        found += [_temperature(whole), _within(whole.warm.within)]
    gyroscope, compass = whole.gyroscope, whole.magnetometer
    if gyroscope is not None:
        judged = gyroscope.noise.sources
        found.append(_joint(gyroscope.noise) if judged else _rows(gyroscope))
        if gyroscope.drift is not None:
            found.append(_drift("gyroscope", gyroscope.drift))
    if compass is not None:
        if whole.together is None and compass.noise.sources:
            found.append(_joint(compass.noise))
        found += [poses_alike(compass, whole.numbers), steady(compass)]
    return tuple(found)


def honest(found: Sequence[Condition]) -> tuple[bool | None, str]:
    """Say whether the error bars can be trusted, by the gravest result."""
    first = graver(found)[0]
    return first.holds, f"{BEGIN[first.holds]}: {first.words}"


def graver(found: Sequence[Condition]) -> list[Condition]:
    """Conditions that fail, the gravest first; if all hold, the first one tested."""
    open_ = [x for answer in (False, None) for x in found if x.holds is answer]
    return open_ or [next(x for x in found if np.isfinite(x.p_value))]


def _rests(log: Any) -> Condition:
    # a Type A error bar takes the scatter as it is, whatever noise was stated
    found, answer = log.diagnosis, log.diagnosis.judgement.answer
    by_scatter = log.fit.covariance_kind == "type A"
    holds = {"sound": True, "unknown": None if by_scatter else False}.get(answer, False)
    words = found.cause or "the rests scatter as their noise explains"
    do = f"{found.do[:1].upper()}{found.do[1:].rstrip('.')}." if found.do else ""
    if answer == "unknown" and by_scatter:
        words += "; the error bars are as wide as that"
    if answer == "sound" and found.p_value > 1.0 - BELIEVED:
        holds, words = by_scatter, "the rests scatter less than their noise"
        do = "" if by_scatter else "State the noise (--noise FILE)."
    if answer == "sound" and not np.isfinite(found.p_value):
        holds, words = None, "the noise of a pose, or a degree of freedom, is not there"
        do = ADD
    p = found.judgement.chance
    return Condition("rests of the accelerometer", holds, p, CHANCE, words, do)


def order(found: Diagnosis | Drift, sensor: str = "accelerometer") -> Condition:
    """Judge whether a drift would be seen with the poses in this order."""
    begin = "in this order of the poses a drift"
    made = Condition(ORDER, True, np.nan, HIDDEN, f"{begin} would be seen")
    if not found.hidden > HIDDEN:
        return made
    words = f"of {found.hides} of the {sensor} looks like a change of other parameters"
    return made._replace(holds=None, words=f"{begin} {words}", do=REPEAT)


def _drift_in_fit(whole: Any) -> Condition | None:
    # nothing is hidden by the order of the poses where the fit has the drift
    found = whole.warm.thermal
    if found is None or found.over is not TIME or ("bias", 1) not in found.terms:
        return None
    words = "a drift of its bias is in the fit, and in the error bars"
    return Condition(ORDER, True, np.nan, HIDDEN, words)


def _drift(name: str, found: Drift) -> Condition:
    about = f"drift of the {name}"
    words, do = f"the residuals of the {name} do not follow the time", ""
    if found.seen:
        words = f"the {name} drifts: its residuals follow the time by {found.what}"
        do = "Let the sensor warm up, and record again."
    elif not np.isfinite(found.p_value):
        words, do = f"too few poses to see a drift of the {name}", ADD
    elif not found.excluded:
        p, level = found.p_value, DRIFT_FALSE_ALARM
        return order(found, name)._replace(about=about, p_value=p, level=level)
    return _by_chance(about, found.p_value, DRIFT_FALSE_ALARM, words, do)


def _temperature(whole: Any) -> Condition:
    # whether its effect is in the bars: tested, and not the same as a drift in time
    warm = whole.warm
    words = "the temperature has no effect that is left out"
    made = Condition("temperature of the rests", True, np.nan, FALSE_ALARM, words)
    untold = warm.rests.confounded if whole.taken.thermal else None
    if untold is None and not warm.tested and warm.rests.span >= LEAST_SPAN:
        untold = Remark("not tested", warm.reason, WARM)
    if untold is None:
        return made
    return made._replace(holds=None, words=untold.words, do=untold.do)


def _within(found: Within) -> Condition:
    about = "drift within the rests"
    made = _by_chance(about, found.chance, DRIFT_FALSE_ALARM, found.words)
    # none is judged where the temperature hardly changes within a rest
    return made if np.isfinite(found.chance) else made._replace(holds=True)


def _joint(noise: NoiseFactors) -> Condition:
    words, do = "every sensor scatters as its noise explains", ""
    if not noise.borne:
        off = [each for each in noise.sensors if each.name in noise.blamed]
        off = off or list(noise.sensors)
        worst = max(off, key=lambda each: abs(each.deviations[each.worst]))
        size = abs(worst.deviations[worst.worst])
        do = f"Look at {worst.item} {worst.worst} of the {worst.name} ({size:.2g} sd)."
        words = f"{noise.words}; error bars were widened to match"
    names = " and ".join(noise.sources)
    return _by_chance(f"joint fit of {names}", noise.p_value, CHANCE, words, do)


def _rows(fit: Any) -> Condition:
    # of a fit whose sensors were not judged one by one
    p = chi_square_chance(fit.chi2_per_dof * fit.dof, fit.dof)
    words = f"chi-square per degree of freedom is {fit.chi2_per_dof:.3g}"
    do = "Look at the moves with the largest residual angles (--report)."
    return _by_chance("moves of the gyroscope", p, BEYOND, words, do)


def poses_alike(fit: Any, numbers: Intervals) -> Condition:
    """Judge whether the field is the same in every pose, to within its noise."""
    p = chi_square_chance(fit.chi_square, fit.dof)
    words, do = "the field is the same in every pose", ""
    if fit.disturbed:
        named = [str(numbers[k]) for k in fit.disturbed]
        rests = "rest" if len(named) == 1 else "rests"
        words = f"the field is another in {rests} {series(named)}"
        do = "Look for iron, a current or a moved hold there, and leave out "
        do += f"(--leave-out {','.join(named)})."
    elif p < BEYOND:
        words = "the field differs from pose to pose by more than its noise"
        do = "Record away from iron and currents."
    made = _by_chance("poses of the magnetometer", p, BEYOND, words, do)
    return made._replace(holds=False) if fit.disturbed else made


def steady(fit: Any) -> Condition:
    """Judge whether the strength of the field changes with time."""
    p = float(fit.steady_p_value)
    words = "the field does not follow the time"
    if p < ONE_POSE:
        words = "the strength of the field varies with time"
    do = "Record again where nothing changes the field."
    return _by_chance("field over time", p, ONE_POSE, words, do)


def _by_chance(
    about: str, p: float, level: float, words: str, do: str = ""
) -> Condition:
    holds = bool(p >= level) if np.isfinite(p) else None
    return Condition(about, holds, p, level, words, do if holds is not True else "")


# ---- the account


def with_log(
    account: Account,
    log: Log,
    more: Iterable[Fact] = (),
    record: Iterable[Fact] = (),
    *,
    means: bool = False,
) -> Account:
    """Add to an account what was read of the log and how.

    A table of means has no clock.
    """
    said = account.said if means else f"{account.said}; {log.said}"
    read = [x for x in log.facts() if not (means and x.label == "clock")]
    facts = (*read, log.units(), *more, *account.facts)
    source = PurePath(log.path).name
    record = (*record, *account.record)
    return replace(account, source=source, said=said, facts=facts, record=record)


def calibration_account(whole: Any) -> Account:
    """State a log's calibration: how good, whether to be trusted, what next."""
    sensors = [name for name in ("gyroscope", "magnetometer") if getattr(whole, name)]
    poses = f"{counted(len(whole.intervals), 'pose')} of "
    poses += ", ".join(["accelerometer", *sensors])
    changed = [
        (whole.cuts, "shortened or left out: the sensor turns"),
        (whole.steps, "cut or left out: several levels"),
    ]
    for rests, why in changed:
        poses += f" ({counted(len(rests), 'rest')} {why})" if rests else ""
    more = ", without the rotations," if fit_of(whole) else ""
    good = how_good(whole.accelerometer, bound_sd(whole), more)
    return Account(
        title="Calibration from",
        source="a log",
        said=poses,
        replies=(limited(good, whole.diagnosis), trusted(whole), _next(whole)),
        values=tuple(_values(whole)),
        notes=(matrix_note(whole.accelerometer),),
        facts=tuple(_facts(whole)),
        record=tuple(_record(whole)),
    )


def limited(reply: Reply, found: Diagnosis) -> Reply:
    """Add to the first answer what limits the fit besides its noise, and what to do."""
    limits = []
    poor, wide = not found.geometry <= GEOMETRY_LIMIT, found.widest > WIDE
    if poor:
        limits.append(
            f"The worst error bar is {found.geometry:.2g} times that of as many poses "
            "spread evenly over the sphere: add poses in directions not yet covered."
        )
    if wide:
        percent = 100.0 * found.widest
        limits.append(f"A scale is known to {percent:.2g} % only: add poses.")
    if 0 < found.freedom < LEAST_FREEDOM:
        most = np.sqrt(believed_range(found.freedom)[1] / found.freedom)
        limits.append(
            f"With {counted(found.freedom, 'degree')} of freedom a scatter of "
            f"{most:.2g} times the noise would pass unseen: add poses."
        )
    return replace(
        reply,
        answer="inconclusive" if poor or wide else reply.answer,
        do=" ".join([reply.do, *limits]).strip(),
    )


def trusted(whole: Any) -> Reply:
    """Answer whether the error bars can be trusted, with each failed condition."""
    found = conditions(whole)
    first, *others = graver(found)
    also = [f"Also: {each.words}. {each.do}".rstrip() for each in others]
    return Reply(
        title="Can the error bars be trusted?",
        headline=f"{BEGIN[first.holds]}: {first.words}.",
        answer=ANSWERS[first.holds],
        do=" ".join(filter(None, [first.do, *also])),
        lines=tuple(each.sentence for each in found),
    )


def left_out_words(left_out: Mapping[str, Remark]) -> list[str]:
    """Say which sensors of a log were left out, and why."""
    return [
        f"The {name} is left out: {said}{'' if said.do else '.'}"
        for name, said in left_out.items()
    ]


def _next(whole: Any) -> Reply:
    further = ", ".join(f"{x:.2f}" for x in whole.next_direction)
    left = left_out_words(whole.left_out)
    if whole.pose_noise.do:
        left.append(f"The noise of a pose is {whole.pose_noise.words}.")
        left.append(whole.pose_noise.do)
    return Reply(
        title="What next?",
        headline=f"To do better, add a pose with the force along ({further}).",
        answer="inconclusive" if whole.left_out else "pass",
        do=" ".join(left),
        lines=(
            f"A pose with the force along ({further}) in sensor axes would lower the "
            "total variance most.",
        ),
    )


def _values(whole: Any) -> Iterator[Values]:
    fit = whole.accelerometer
    own, compass = whole.gyroscope, whole.magnetometer
    yield accelerometer_values(fit, bound_sd(whole))
    sizes = {"accelerometer": (fit.g / fit.raw_per_g, "m/s²")}
    if own is not None:
        facts = noise_facts(own.noise)[bool(own.noise.words) :]
        chosen = (Fact("chosen", each) for each in whole.taken.reasons)
        G = whole.taken.G, whole.taken.G_sd
        yield gyroscope_values(own, *G, (*facts, *chosen))
        sizes["gyroscope"] = np.linalg.norm(own.M, axis=0), "rad/s"
    if compass is not None:
        facts = () if whole.together else noise_facts(compass.noise)
        noise = Fact("noise of a pose", _noise(whole.field_noise))
        yield magnetometer_values(compass, (noise, *facts), ("poses", "varies"))
        sizes["magnetometer"] = np.linalg.norm(compass.M, axis=0), "of the field's unit"
    for name, each in whole.taken.thermal.items():
        yield _acting(name, each, *sizes[name])
    if np.isfinite(fit.sd).all():
        yield budget(whole)
        names, signs = zip(*forms.entries(fit.model), strict=True)
        yield correlations("accelerometer", names, fit.covariance, np.array(signs))
    if own is not None:
        yield other_budget("gyroscope", own, own.names)
        yield correlations("gyroscope", own.names, own.own_covariance)
    if compass is not None:
        yield other_budget("magnetometer", compass, OWN_NAMES)
        yield correlations("magnetometer", OWN_NAMES, compass.own_covariance)


def _acting(name: str, found: Term, size: Array, unit: str) -> Values:
    lines, at = [], "°C" if found.over is TEMPERATURE else "s"
    # a drift is stated by the hour
    unit_of_change, per_unit = ("K", 1.0) if at == "°C" else ("h", 3600.0)
    for k, (what, power) in enumerate(found.terms):
        per = unit_of_change if power == 1 else f"{unit_of_change}^{power}"
        factor = per_unit**power * (1e6 if what == "scale" else size * np.ones(3))
        cells = [
            Quantity(f"{what}_{axis}/{per}", value, sd)
            for axis, value, sd in zip(
                "xyz", (factor * found.coefficients[k]).tolist(),
                (factor * found.sd[k]).tolist(), strict=True,
            )
        ]  # fmt: skip
        lines.append(Line(what, f"{'ppm' if what == 'scale' else unit}/{per}", cells))
    ends = [(found.bars(t)["bias"] * size).max() for t in (found.low, found.high)]
    words = f"at either end a bias is off by {max(ends):.2g} {unit} (sd) more than at "
    return Values(
        title=f"{name} in {found.over.name}",
        how=f"about {found.reference:.2f} {at}, seen from {found.low:.2f} to "
        f"{found.high:.2f} {at}",
        lines=lines,
        facts=[Fact("ends", f"{words}the reference")],
    )


def _noise(noise: Any) -> str:
    return f"{np.median(noise.std):.4g} units of the log, {noise.words}"


def _record(whole: Any) -> Iterator[Fact]:
    fit, rests = whole.accelerometer, whole.warm.rests
    yield Fact("gravity", gravity_words(fit))
    yield Fact("temperature", "not in the log" if rests is None else rests.line)
    yield Fact("method", f"{fit.residual} residual, {fit.loss} loss, by {fit.method}; "
               f"{fit.model} form, {fit_of(whole) or 'alone'}")  # fmt: skip


def _facts(whole: Any) -> Iterator[Fact]:
    fit = whole.accelerometer
    diagnosis, warm = whole.diagnosis, whole.warm
    for each in whole.units.values():
        yield from (Fact("unit", str(remark), notable=True) for remark in each.said)
    if whole.gyroscope and whole.magnetometer and not whole.together:
        yield Fact("not together", whole.taken.reasons[-1], notable=True)
    yield Fact("initial rest", f"{whole.rest_seconds:.2f} s "
               f"({'found' if whole.rest.found else 'given'})")  # fmt: skip
    yield Fact("static intervals", f"{len(whole.intervals)} (threshold "
               f"{whole.multiplier:g} times the variance at rest)")  # fmt: skip
    yield from (Fact("cut", each) for each in (*whole.steps, *whole.cuts))
    if warm.rests is None:
        if warm.reason:  # it was asked for
            yield Fact("drift", warm.reason, notable=warm.thermal is None)
    else:
        for words in dict.fromkeys((warm.reason, *whole.thermal_reasons)):
            yield from [Fact("temperature", words)] if words else []
    yield status(fit)
    yield Fact("poses", f"condition {fit.condition:.3g}")
    per = "per degree of freedom"
    yield Fact("chi-square", f"{diagnosis.chi2_per_dof:.3g} {per}, of {fit.dof}")
    yield from (Fact("in files", each) for each in forms.sign_notes(fit.model))
    yield Fact("noise of a pose", _noise(whole.pose_noise))
    if whole.pose_noise.source != "white":
        white = np.median(whole.pose_noise.white)
        yield Fact("white noise", f"alone it would be {white:.4g}, and chi-square "
                   f"{whole.white_chi2_per_dof:.3g} {per}")  # fmt: skip
    yield Fact("least determined", diagnosis.least_determined.sentence)


def fit_of(whole: Any) -> str:
    """Say which joint fit gave the accelerometer's numbers; empty for its own fit."""
    if whole.together is not None:
        return "one fit of all three sensors, in which the rotations help the others"
    if whole.gyroscope is not None:
        return "fit together with the gyroscope, whose rotations help it"
    return ""


def log_object(log: Log) -> dict[str, Any]:
    """Return what was read of a log, and at what rate, as plain JSON values."""
    taken = {each.role: [each.place + 1, each.name] for each in log.columns}
    return {
        "source": [list(each) for each in log.source],
        "sha256": digest(log.path),
        "columns": taken,
        "rate": log.rate,
        "clock_unit_seconds": log.second,
    }


def as_object(whole: Any) -> dict[str, Any]:
    """Return the accelerometer as one JSON object: a calibration file, with extras."""
    diagnosis = whole.diagnosis
    return to_json(whole.accelerometer) | {
        "intervals": len(whole.intervals),
        "interval_samples": whole.intervals.tolist(),
        "multiplier": whole.multiplier,
        "rest_seconds": whole.rest_seconds,
        "rest_found": whole.rest.found,
        "chi2_per_dof": json_values(diagnosis.chi2_per_dof),
        "p_value": json_values(diagnosis.p_value),
        "white_chi2_per_dof": json_values(whole.white_chi2_per_dof),
        **whole.pose_noise.as_object(),
        "least_determined": diagnosis.least_determined.sentence,
        "outliers": list(diagnosis.outliers),
        "next_direction": whole.next_direction.tolist(),
        "bound_sd": None if whole.predicted is None else bound_sd(whole).tolist(),
        "bias": None if whole.predicted is None else whole.predicted.bias.tolist(),
        "budget": budget_object(sources(whole)),
    }


def sensors_object(whole: Any, log: Log) -> dict[str, Any]:
    """Return the other sensors, and the conditions, as plain JSON values."""
    units = {name: each.as_object() for name, each in whole.units.items()}
    left = {name: said.as_object() for name, said in whole.left_out.items()}
    values: dict[str, Any] = {"left_out": left, "units": units}
    seen = whole.warm.rests
    if seen is not None:
        values["temperature"] = {
            "rests_degC": seen.mean.tolist(),
            "change_within_rest_K": seen.change.tolist(),
            "reasons": list(whole.thermal_reasons),
            "confounded_with_time": str(seen.monotone or ""),
            "sensors": _terms_object(whole, TEMPERATURE),
        }
    if drifts := _terms_object(whole, TIME):
        values["drift"] = {"sensors": drifts}
    if whole.gyroscope is not None:
        values["gyroscope"] = whole.gyroscope.as_object() | {
            "G": whole.taken.G.tolist(),
            "G_sd": whole.taken.G_sd.tolist(),
            "reasons": list(whole.taken.reasons),
            "residuals": whole.gyroscope.noise.as_object(),
            "budget": budget_object(other_sources(whole.gyroscope, 12)),
        }
    if whole.magnetometer is not None:
        own = whole.magnetometer
        document = own.as_document()
        # without the accelerometer, which the file states once
        values["magnetometer"] = document | {
            "parameters": {name: document["parameters"][name] for name in OWN_NAMES},
            "names": list(OWN_NAMES),
            "covariance": own.own_covariance.tolist(),
            **whole.field_noise.as_object(),
            "residuals": own.noise.as_object(),
            "budget": budget_object(other_sources(own, len(OWN_NAMES))),
        }
    if whole.together is not None:
        values["together"] = whole.together.as_object()
    values["judgements"] = [each.as_object() for each in conditions(whole)]
    values["ros_imu"] = message_covariances(log, whole)
    return values


def _terms_object(whole: Any, over: Course) -> dict[str, Any]:
    terms = whole.taken.thermal.items()
    return {name: own.as_object() for name, own in terms if own.over is over}


def message_covariances(log: Log, whole: Any) -> dict[str, Any]:
    """Covariance fields of ROS messages, nine numbers each; -1 first if unknown."""
    unknown = [-1.0] + [0.0] * 8
    rests = whole.intervals
    force = whole.accelerometer.sensor().matrix
    rate = unknown
    if whole.gyroscope is not None and log.gyro is not None:
        rate = _covariance(log.gyro, rests, whole.gyroscope.M)
    return {
        "orientation_covariance": unknown,
        "angular_velocity_covariance": rate,
        "linear_acceleration_covariance": _covariance(log.accelerometer, rests, force),
    }


def _covariance(
    samples: Float[Array, "n 3"], rests: Intervals, M: Float[Array, "3 3"]
) -> list[float]:
    return (M * variance_within(samples, rests) @ M.T).ravel().tolist()
