"""What is asked of the error bars of a log's calibration, each with its test.

Every sentence that says yes or no of them, in the terminal, in files and on the page,
is one of these: no where the chance of what is seen is below the level of its test.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from simval.calibrate.drift import DRIFT_FALSE_ALARM, Drift
from simval.calibrate.factors import CHANCE, NoiseFactors
from simval.calibrate.magnetometer.findings import FALSE_ALARM as ONE_POSE
from simval.calibrate.outliers import BELIEVED, BEYOND, chi_square_chance


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """One question about the error bars, and the answer of its test.

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
    """

    about: str
    holds: bool | None
    p_value: float
    level: float
    words: str

    def as_object(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        known = np.isfinite(self.p_value)
        return {
            "about": self.about,
            "holds": self.holds,
            "p_value": self.p_value if known else None,
            "level": self.level,
            "words": self.words,
        }


def judgements(whole: Any) -> tuple[Judgement, ...]:
    """Judge the sensors of a log, the accelerometer first."""
    found = [
        _outliers(whole.log),
        _scatter(whole.log),
        _drift("accelerometer", whole.log.diagnosis.drift),
    ]
    gyroscope, compass = whole.gyroscope, whole.magnetometer
    if gyroscope is not None:
        judged = gyroscope.noise.sources
        found.append(_joint(gyroscope.noise) if judged else _rows(gyroscope))
        if gyroscope.drift is not None:
            found.append(_drift("gyroscope", gyroscope.drift))
    if compass is not None:
        if whole.together is None and compass.noise.sources:
            found.append(_joint(compass.noise))
        found += [poses_alike(compass), steady(compass)]
    return tuple(found)


def honest(found: tuple[Judgement, ...]) -> tuple[bool | None, str]:
    """Say whether the error bars are honest, with the gravest answer."""
    for answer, begin in ((False, "No: "), (None, "Not told: ")):
        said = [each.words for each in found if each.holds is answer]
        if said:
            return answer, begin + said[0]
    said = [each.words for each in found if np.isfinite(each.p_value)]
    return True, f"Yes: {said[0]}"


def _outliers(log: Any) -> Judgement:
    named = log.diagnosis.outliers
    count = len(named)
    return Judgement(
        about="poses of the accelerometer",
        holds=not named,
        p_value=float("nan"),
        level=BELIEVED,
        words=f"{count} outlier{'s' * (count > 1)} among the poses"
        if named
        else "no pose is off the ellipsoid of the others",
    )


def _scatter(log: Any) -> Judgement:
    found = log.diagnosis
    p = found.p_value
    seen = f"chi-square per degree of freedom {found.chi2_per_dof:.3g}"
    words = f"the residuals are what the noise explains: {seen}"
    if not np.isfinite(p):
        words = "the noise of a pose, or a degree of freedom, is not there"
    elif p < BELIEVED:
        words = f"the residuals are greater than the noise: {seen}"
    elif p > 1.0 - BELIEVED:
        words = f"the residuals are smaller than the noise: {seen}"
    return _by_chance(
        "residuals of the accelerometer",
        2.0 * min(p, 1.0 - p) if np.isfinite(p) else p,
        2.0 * BELIEVED,
        words,
    )


def _drift(name: str, found: Drift) -> Judgement:
    hidden = not (found.seen or found.excluded)
    words = f"the residuals of the {name} do not follow the time"
    if found.seen:
        words = f"the {name} drifts: its residuals follow the time by {found.what}"
    elif not np.isfinite(found.p_value):
        words = f"too few poses to tell a drift of the {name}"
    elif hidden:
        words = f"the order of the poses hides a drift of {found.hides} of the {name}"
    told = _by_chance(f"drift of the {name}", found.p_value, DRIFT_FALSE_ALARM, words)
    return replace(told, holds=None) if hidden else told


def _joint(noise: NoiseFactors) -> Judgement:
    names = " and ".join(noise.sources)
    return _by_chance(
        f"joint fit of {names}",
        noise.p_value,
        CHANCE,
        "; ".join(noise.sentences) or "every sensor bears its stated noise",
    )


def _rows(fit: Any) -> Judgement:
    # of a fit whose sensors were not judged one by one
    p = chi_square_chance(float(fit.chi2_per_dof) * fit.dof, fit.dof)
    words = f"chi-square per degree of freedom {float(fit.chi2_per_dof):.3g}"
    return _by_chance("moves of the gyroscope", p, BEYOND, words)


def poses_alike(fit: Any) -> Judgement:
    """Judge whether the field is the same in every pose, as far as noise tells."""
    p = chi_square_chance(float(fit.chi_square), fit.dof)
    mean = f"chi-square {np.nanmean(fit.pose_chi_square):.2g} a pose, of about 3"
    words = f"the field is that of its noise in every pose: {mean}"
    if fit.disturbed:
        named = ", ".join(str(k) for k in fit.disturbed)
        words = f"the field is another in static interval {named}"
    elif p < BEYOND:
        words = f"the field differs from pose to pose by more than its noise: {mean}"
    told = _by_chance("poses of the magnetometer", p, BEYOND, words)
    return replace(told, holds=False) if fit.disturbed else told


def steady(fit: Any) -> Judgement:
    """Judge whether the strength of the field changes with time."""
    p = float(fit.steady_p_value)
    words = "the strength of the field varies with time" if p < ONE_POSE else ""
    return _by_chance(
        "field over time", p, ONE_POSE, words or "the field does not follow the time"
    )


def _by_chance(about: str, p: float, level: float, words: str) -> Judgement:
    holds = bool(p >= level) if np.isfinite(p) else None
    return Judgement(about=about, holds=holds, p_value=p, level=level, words=words)
