"""The numbers of each sensor's calibration, as its account states them.

Parameters stand as entries of T, K and B of the accelerometer and of M and B of the
others; a person reads misalignment in milliradians, errors of scale in parts per
million, and those of bias as the force that it stands for.
"""

from typing import Any

import numpy as np

from simval.account import (
    Account,
    Fact,
    Line,
    Note,
    Reply,
    Values,
    in_thousands,
)
from simval.arrays import Array
from simval.imu.sensor import forms
from simval.imu.sensor.readable import (
    OF_THE_LOG,
    accelerometer_values,
    matrix_rows,
    quantities,
    worst_axis,
)
from simval.shapes import Float
from simval.spelling import counted, measured, rounded
from simval.units import (
    OF_A_LOG,
)

G_NAMES = tuple(f"G_{a}{b}" for a in "xyz" for b in "xyz")
"""Of the sensitivity of a gyroscope to specific force, row by row."""
NEAR = 1.2  # ratio of a scale to a unit's within which the readings are in that unit
BARS = {
    "known sigma": "The error bars are those of the noise that was measured.",
    "type A": "The error bars are from the scatter of the poses.",
    "none": "There are no error bars.",
}
"""Where the error bars are from, by the kind of the covariance."""
_NO_FORCE = np.zeros((3, 3))


def how_good(
    fit: Any,
    bound: Float[Array, "9"] | None = None,
    more: str = "",
    *,
    force: bool = True,
) -> Reply:
    """Answer how accurate a calibration is, and what limits it.

    The vector is gravity, or not a `force`: then a bias has no size as one.
    """
    known = bool(np.isfinite(fit.sd).all())
    left = 1e3 * fit.rms
    lines = [f"The poses leave {left:.2g} mm/s² RMS of | |TK(y - B)| - g |."] * force
    if bound is not None and known and np.all(bound > 0.0):
        lines.append(
            f"No error bar is more than {np.max(fit.sd / bound):.2f} times the least "
            f"that these poses and their noise{more} allow (Cramér-Rao bound)."
        )
    lines.append(BARS[fit.covariance_kind])
    if force and fit.g_std:
        ppm = rounded(1e6 * fit.g_std / fit.g)
        lines.append(
            f"Gravity was taken as {measured(fit.g, fit.g_std)} m/s²: {ppm} ppm of "
            "every error bar of K, and nothing of T and B."
        )
    elif force:
        lines.append(
            f"Gravity was taken as {fit.g:g} m/s². If it is 0.1 % off, so is every K; "
            "T and B do not change."
        )
    return Reply(
        title="How good is it?",
        headline=f"E{worst_axis(fit, force=force)[1:]}."
        if known
        else "No error bars: nine poses fit exactly.",
        answer="pass" if known else "inconclusive",
        do="" if known else "Add poses.",
        lines=tuple(lines),
    )


def matrix_note(fit: Any, *, force: bool = True) -> Note:
    """The matrix T (K where T is the identity), printed as it stands."""
    name, matrix = ("K", fit.K) if fit.model == "symmetric" else ("T", fit.T)
    product = f"{'' if name == 'K' else 'T diag'}{name if name == 'K' else '(K)'}"
    rows = ["  ".join(f"{entry:15.8g}" for entry in row) for row in matrix]
    what = "force" if force else "field"
    words = f"{what} = {product} (reading - B), with {name} ="
    return Note(words=words, matrix="\n".join(rows))


def gyroscope_values(
    fit: Any, G: Array = _NO_FORCE, G_sd: Any = None, facts: tuple[Fact, ...] = ()
) -> Values:
    """M, B and G of a gyroscope."""
    felt = " - G f" if np.any(G) else ""
    cells = fit.names, fit.parameters, fit.sd
    lines = matrix_rows("M", "rad/s per unit", *(x[:9] for x in cells))
    bias = quantities(*(x[9:12] for x in cells))
    lines += in_thousands([Line("bias B", OF_THE_LOG, bias)])
    if felt:
        unit = f"{OF_THE_LOG} per m/s²"
        lines += matrix_rows("G", unit, G_NAMES, G.ravel(), G_sd.ravel())
    return Values(
        title="gyroscope",
        how=f"rate = M (reading - B{felt}), rad/s; readings {rate_unit(fit.M)[1]}",
        lines=lines,
        facts=(chi_square(fit), *facts),
    )


def magnetometer_values(
    fit: Any, facts: tuple[Fact, ...] = (), answered: tuple[str, ...] = ()
) -> Values:
    """M, hard iron b and the dip of a magnetometer, with warnings.

    Findings of a kind that an answer has said are not notable here.
    """
    own = fit.names[9:21], fit.parameters[9:21], fit.sd[9:21]
    (dip,) = quantities(
        ("dip",), *(np.degrees(np.reshape(x, 1)) for x in (fit.dip, fit.sd[-1]))
    )
    iron = quantities(*(x[9:12] for x in own))
    unit = "per unit of the log"
    return Values(
        title="magnetometer",
        how=f"field = M (reading - b), of a field of {fit.field:g}",
        lines=[
            *matrix_rows("M", unit, *(x[:9] for x in own)),
            *in_thousands([Line("hard iron b", OF_THE_LOG, iron)]),
            Line("dip", "° below the horizon", [dip]),
        ],
        facts=(
            *(Fact("finding", str(x), x.kind not in answered) for x in fit.findings),
            Fact("taken", fit.assumption),
            chi_square(fit),
            *facts,
        ),
    )


def chi_square(fit: Any) -> Fact:
    """Chi-square of a fit and its degrees of freedom."""
    ratio = fit.chi2_per_dof
    free = counted(fit.dof, "degree")
    return Fact("fit", f"chi-square {ratio:.3g} per degree of freedom, {free}")


def status(fit: Any) -> Fact:
    """Say how the solver ended; notable if it did not converge."""
    words = f"{fit.status} after {counted(int(fit.iterations), 'iteration')}"
    return Fact("status", words, notable=str(fit.status) != "converged")


def accelerometer_account(fit: Any) -> Account:
    """State the calibration of an accelerometer."""
    signs = (Fact("sign", each, notable=True) for each in forms.sign_notes(fit.model))
    kind = "Student's t" if fit.covariance_kind == "type A" else fit.covariance_kind
    judged = [chi_square(fit)] if np.isfinite(fit.chi2_per_dof) else []
    return Account(
        title="Calibration of an accelerometer",
        said=f"{fit.model} form; {status(fit).words}",
        replies=(how_good(fit),),
        values=(accelerometer_values(fit),),
        notes=(matrix_note(fit),),
        facts=(
            status(fit),
            Fact("poses", f"condition {fit.condition:.3g}"),
            Fact("95 %", f"{kind}, {counted(fit.dof, 'degree')} of freedom"),
            *judged,
            *signs,
        ),
    )


def noise_facts(noise: Any) -> tuple[Fact, ...]:
    """What the residuals of a joint fit say of each sensor; a misfit is notable."""
    if noise.least_determined is None:
        return ()
    return (
        *(Fact("noise", x, notable=True) for x in [noise.words] if x),
        *(
            Fact("residuals", str(x.remark), notable=bool(x.outliers))
            for x in noise.sensors
        ),
        Fact("least determined", noise.least_determined.sentence),
    )


def gyroscope_account(fit: Any) -> Account:
    """State the calibration of a gyroscope, alone or with its accelerometer."""
    return _of_rows(fit, (gyroscope_values(fit),))


def magnetometer_account(fit: Any) -> Account:
    """State the calibration of a magnetometer on an accelerometer's axes."""
    return _of_rows(fit, (magnetometer_values(fit),))


def several_account(found: Any) -> Account:
    """State the calibration of several sensors in one fit."""
    own, compass, taken = found.gyroscope, found.magnetometer, found.recording.taken
    values = [accelerometer_values(found, model=found.recording.model)]
    if own is not None:
        facts = tuple(Fact("chosen", each) for each in taken.reasons)
        values.append(gyroscope_values(own, taken.G, taken.G_sd, facts))
    if compass is not None:
        values.append(magnetometer_values(compass))
    return _of_rows(found, tuple(values))


def _of_rows(fit: Any, values: tuple[Values, ...]) -> Account:
    return Account(
        title=f"Calibration of {fit.what}",
        said=status(fit).words,
        values=values,
        facts=(status(fit), chi_square(fit), *noise_facts(fit.noise)),
    )


def rate_unit(M: Float[Array, "3 3"]) -> tuple[float | None, str]:
    """Unit of a gyroscope's readings, judged by their scale, and a remark.

    None of counts, which come near the others.
    """
    scale = np.cbrt(abs(np.linalg.det(M)))
    for name in ("rad/s", "deg/s"):
        size = OF_A_LOG["gyro"][name]
        if 1.0 / NEAR < scale / size < NEAR:
            return size, f"are in {name} by their scale, {scale:.5g}"
    return None, f"are counts of {scale:.4g} rad/s"
