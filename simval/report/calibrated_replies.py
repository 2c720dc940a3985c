"""How good a calibration is, whether its error bars are honest, what to do next."""

from collections.abc import Sequence

import numpy as np

from simval.arrays import Array
from simval.calibrate import FitResult
from simval.calibrate.drift import Drift
from simval.multiposition import ImuCalibration
from simval.multiposition.described import fit_of
from simval.multiposition.judgements import Judgement, honest, judgements
from simval.report.answers import rounded
from simval.report.replies import Answer, Reply
from simval.report.units import MILLIMETRE_PER_SECOND_SQUARED, MILLIRADIAN, PPM, Unit
from simval.shapes import Float
from simval.text import chance_words

BARS = {
    "known sigma": "The error bars are those of the noise that was measured.",
    "type A": "The error bars are from the scatter of the residuals.",
    "none": "There are no error bars.",
}
"""Where the error bars are from, by the kind of the covariance."""

KINDS = {
    "misalignment": MILLIRADIAN,
    "scale factor": PPM,
    "bias": MILLIMETRE_PER_SECOND_SQUARED,
}
"""What the parameters are, and the unit in which a person reads their errors."""

_SCALES_LATER = ("misalignment",) * 3 + ("scale factor",) * 3 + ("bias",) * 3
_SYMMETRIC = ("scale factor", "misalignment", "misalignment", "scale factor",
              "misalignment", "scale factor", "bias", "bias", "bias")  # fmt: skip


def kinds_of(model: str) -> tuple[str, ...]:
    """Kind of each of the nine parameters of a form."""
    return _SYMMETRIC if model == "symmetric" else _SCALES_LATER


def readable(fit: FitResult, sd: Float[Array, "9"]) -> list[tuple[float, Unit]]:
    """Error bars of the nine parameters in the units of `KINDS`.

    A scale factor's is relative, a bias' is of the force that it stands for, and that
    of an entry off the diagonal of a symmetric matrix is over the mean scale.
    """
    gain = np.diagonal(fit.matrix)
    symmetric = fit.model == "symmetric"
    scale = {
        "misalignment": np.full(9, 1.0 / gain.mean() if symmetric else 1.0),
        "scale factor": np.full(9, np.nan),
        "bias": np.full(9, np.nan),
    }
    places = [0, 3, 5] if symmetric else [3, 4, 5]
    scale["scale factor"][places] = 1.0 / np.abs(fit.parameters[places])
    scale["bias"][6:] = gain
    return [
        (float(each * scale[kind][k] * KINDS[kind].factor), KINDS[kind])
        for k, (kind, each) in enumerate(zip(kinds_of(fit.model), sd, strict=True))
    ]


def greatest(fit: FitResult) -> dict[str, float]:
    """Greatest error bar of each kind, in the units of `KINDS`."""
    bars = readable(fit, fit.sd)
    return {
        kind: max(
            value
            for (value, _), own in zip(bars, kinds_of(fit.model), strict=True)
            if own == kind
        )
        for kind in KINDS
    }


def replies(whole: ImuCalibration, bound: Float[Array, "9"]) -> tuple[Reply, ...]:
    """Answers to the three questions."""
    return _how_good(whole, bound), _honest(whole), _next(whole)


def _how_good(whole: ImuCalibration, bound: Float[Array, "9"]) -> Reply:
    fit, result = whole.accelerometer, whole.log
    bars = ", ".join(
        f"{kind} {rounded(value)} {KINDS[kind].name}"
        for kind, value in greatest(fit).items()
    )
    known = bool(np.isfinite(fit.sd).all())
    lines = [
        f"{len(result.intervals)} poses leave a residual of "
        f"{1e3 * float(fit.rms):.2g} mm/s² RMS."
    ]
    ratio = np.max(fit.sd / bound) if known and np.all(bound > 0.0) else np.nan
    if np.isfinite(ratio):
        alone = ", without the moves," if fit_of(whole) else ""
        lines.append(
            f"No error bar is more than {ratio:.2f} times the least that these poses "
            f"and their noise{alone} allow (Cramér-Rao)."
        )
    lines.append(
        f"Gravity of {fit.g:g} m/s² was assumed: wrong by 0.1 %, it makes every K "
        "wrong by 0.1 % and leaves T and B."
    )
    return Reply(
        title="How good is this calibration?",
        headline=f"Greatest standard deviations: {bars}"
        if known
        else "No error bars: nine poses leave no degree of freedom",
        answer="pass" if known else "inconclusive",
        lines=tuple(lines),
    )


def _honest(whole: ImuCalibration) -> Reply:
    found = judgements(whole)
    holds, said = honest(found)
    answers: dict[bool | None, Answer] = {
        True: "pass", False: "fail", None: "inconclusive",
    }  # fmt: skip
    lines = [f"Verdict: {whole.log.diagnosis.verdict}."]
    lines += [
        f"{each.about.capitalize()}: {each.words}{_chance(each)}." for each in found
    ]
    lines.append(BARS[whole.accelerometer.covariance_kind])
    return Reply(
        title="Are its error bars honest?",
        headline=said,
        answer=answers[holds],
        lines=tuple(lines),
    )


def _chance(each: Judgement) -> str:
    if not np.isfinite(each.p_value):
        return ""
    return f" (chance {chance_words(each.p_value)}; no below {each.level:g})"


def _next(whole: ImuCalibration) -> Reply:
    result = whole.log
    further = ", ".join(f"{x:.2f}" for x in result.next_direction)
    pose = (
        f"A further pose with the specific force along ({further}) in sensor axes "
        "would lower the total variance most; it is the diamond on the map below."
    )
    lines = [f"Noise of a pose: {result.pose_noise.words}."]
    lines += [f"Left out, the {name}: {why}." for name, why in whole.left_out.items()]
    if not result.diagnosis.outliers:
        return Reply(
            title="What to do next?",
            headline=f"Add a pose along ({further})",
            lines=(pose, *lines),
        )
    named = ", ".join(str(k) for k in result.diagnosis.outliers)
    return Reply(
        title="What to do next?",
        headline=f"Look at static interval {named}, and calibrate without it",
        lines=("Or use --loss cauchy, which trusts it less.", pose, *lines),
    )


def farthest(
    residuals: Float[Array, " n"], outliers: Sequence[int], drift: Drift
) -> str:
    """What the residuals say in one sentence."""
    known = np.abs(residuals[np.isfinite(residuals)])
    if not len(known):
        return "Nine poses fit exactly, so the residuals say nothing."
    if outliers:
        named = ", ".join(str(k) for k in outliers)
        return f"Not static interval {named}, which is not on the others' ellipsoid."
    if drift.seen:
        return f"No: the residuals follow the time, as if {drift.what} drifted."
    return (
        f"Yes: the farthest of {len(known)} is {known.max():.1f} standard deviations "
        "off, no more than chance makes."
    )
