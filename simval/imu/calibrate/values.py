"""The numbers of each sensor's calibration, as an account states them.

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
    Quantity,
    Reply,
    Values,
    in_thousands,
)
from simval.arrays import Array
from simval.imu.sensor import forms
from simval.shapes import Float
from simval.spelling import counted, rounded
from simval.units import (
    MILLIMETRE_PER_SECOND_SQUARED,
    MILLIRADIAN,
    OF_A_LOG,
    PPM,
    Unit,
)
from simval.vocabulary import Model

G_NAMES = tuple(f"G_{a}{b}" for a in "xyz" for b in "xyz")
"""Of the sensitivity of a gyroscope to specific force, row by row."""
NORMAL_95 = 1.959963984540054
"""Standard deviations from the middle to an end of a 95 % interval."""
NEAR = 1.2  # ratio of a scale to a unit's within which the readings are in that unit
OF_THE_LOG = "units of the log"
KINDS = {
    "misalignment": MILLIRADIAN,
    "scale factor": PPM,
    "bias": MILLIMETRE_PER_SECOND_SQUARED,
}
"""What the parameters are, and the unit in which a person reads their errors."""
BARS = {
    "known sigma": "The error bars are those of the noise that was measured.",
    "type A": "The error bars are from the scatter of the poses.",
    "none": "There are no error bars.",
}
"""Where the error bars are from, by the kind of the covariance."""
_SCALES_LATER = ("misalignment",) * 3 + ("scale factor",) * 3 + ("bias",) * 3
_SYMMETRIC = ("scale factor", "misalignment", "misalignment", "scale factor",
              "misalignment", "scale factor", "bias", "bias", "bias")  # fmt: skip
_NO_FORCE = np.zeros((3, 3))


def kinds_of(model: str) -> tuple[str, ...]:
    """Kind of each of the nine parameters of a form."""
    return _SYMMETRIC if model == "symmetric" else _SCALES_LATER


def readable(fit: Any, sd: Float[Array, "9"]) -> list[tuple[float, Unit]]:
    """Error bars of the nine parameters in the units of `KINDS`.

    A scale factor's is relative, a bias' is of the force that it stands for, and that
    of an entry off the diagonal of a symmetric matrix is over the mean scale.
    """
    gain = np.diagonal(fit.matrix)
    kinds = np.array(kinds_of(fit.model))
    per_unit = np.ones(9)
    if fit.model == "symmetric":
        per_unit[kinds == "misalignment"] = 1.0 / gain.mean()
    scales = kinds == "scale factor"
    per_unit[scales] = 1.0 / np.abs(fit.parameters[scales])
    per_unit[kinds == "bias"] = gain
    return [
        (float(each * size * KINDS[kind].factor), KINDS[kind])
        for kind, size, each in zip(kinds.tolist(), per_unit, sd, strict=True)
    ]


def greatest(fit: Any) -> dict[str, float]:
    """Greatest error bar of each kind, in the units of `KINDS`."""
    bars = [
        (kind, *bar)
        for kind, bar in zip(kinds_of(fit.model), readable(fit, fit.sd), strict=True)
    ]
    return {kind: max(bar for own, bar, _ in bars if own == kind) for kind in KINDS}


def how_good(
    fit: Any,
    bound: Float[Array, "9"] | None = None,
    more: str = "",
    *,
    force: bool = True,
) -> Reply:
    """How sure a calibration by a vector of constant length is, and what by.

    The vector is gravity, or not a `force`: then a bias has no size as one.
    """
    known = bool(np.isfinite(fit.sd).all())
    bars = ", ".join(
        f"{kind} {rounded(value)} {KINDS[kind].name}"
        for kind, value in greatest(fit).items()
        if force or kind != "bias"
    )
    left, g = 1e3 * float(fit.rms), f"{fit.g:g} m/s²"
    lines = [f"The poses leave {left:.2g} mm/s² RMS of | |TK(y - B)| - g |."] * force
    if bound is not None and known and np.all(bound > 0.0):
        lines.append(
            f"No error bar is more than {np.max(fit.sd / bound):.2f} times the least "
            f"that these poses and their noise{more} allow (Cramér-Rao bound)."
        )
    lines.append(BARS[fit.covariance_kind])
    if force:
        lines.append(
            f"Gravity was taken as {g}. If it is 0.1 % off, so is every K; T and B do "
            "not change."
        )
    return Reply(
        title="How good is it?",
        headline=f"Error of the worst axis (1 sd): {bars}."
        if known
        else "No error bars: nine poses fit exactly.",
        answer="pass" if known else "inconclusive",
        do="" if known else "Add poses.",
        lines=tuple(lines),
    )


def accelerometer_values(
    fit: Any,
    bound: Array | None = None,
    model: Model | None = None,
    *,
    force: bool = True,
) -> Values:
    """T, K and B, the first nine parameters of a fit, in its form or `model`."""
    intervals, sd, model = fit.intervals, fit.sd, model or fit.model
    cells = []
    for k, (name, sign) in enumerate(forms.entries(model)):
        low, high = sorted(sign * intervals[k])
        least = None if bound is None else float(bound[k])
        value = float(sign * fit.parameters[k])
        cells.append(Quantity(name, value, float(sd[k]), low, high, least))
    what, unit = ("force", ", m/s²") if force else ("field", f", of one of {fit.g:g}")
    per_unit = "m/s² per unit" if force else "per unit of the log"
    if model == "symmetric":
        diagonal, beside = [cells[k] for k in (0, 3, 5)], [cells[k] for k in (1, 2, 4)]
        lines = in_thousands([
            Line("scale K", per_unit, diagonal), Line("K", per_unit, beside, named=True)
        ])  # fmt: skip
    else:
        size = MILLIRADIAN.factor
        lines = [
            Line("misalignment", MILLIRADIAN.name, cells[:3], True, size),
            *in_thousands([Line("scale K", per_unit, cells[3:6])]),
        ]
    product = "K" if model == "symmetric" else "T diag(K)"
    return Values(
        title="accelerometer" if force else "magnetometer",
        how=f"{what} = {product} (reading - B){unit}",
        lines=[*lines, *in_thousands([Line("bias B", OF_THE_LOG, cells[6:9])])],
    )


def matrix_note(fit: Any, *, force: bool = True) -> Note:
    """T, or K where T is the identity, as it stands."""
    name, matrix = ("K", fit.K) if fit.model == "symmetric" else ("T", fit.T)
    product = f"{'' if name == 'K' else 'T diag'}{name if name == 'K' else '(K)'}"
    rows = ["  ".join(f"{entry:15.8g}" for entry in row) for row in matrix]
    what = "force" if force else "field"
    words = f"{what} = {product} (reading - B), with {name} ="
    return Note(words=words, matrix="\n".join(rows))


def _rows(
    name: str, unit: str, names: tuple[str, ...], values: Array, sd: Array
) -> list[Line]:
    # a matrix, row by row
    cells = _quantities(names, values, sd)
    return in_thousands([
        Line(f"{name}_{axis}", unit, cells[3 * k : 3 * k + 3])
        for k, axis in enumerate("xyz")
    ])  # fmt: skip


def _quantities(names: tuple[str, ...], values: Array, sd: Array) -> list[Quantity]:
    half = NORMAL_95 * sd
    rows = zip(names, *(x.tolist() for x in (values, sd, values - half, values + half)),
               strict=True)  # fmt: skip
    return [Quantity(*row) for row in rows]


def gyroscope_values(
    fit: Any, G: Array = _NO_FORCE, G_sd: Any = None, facts: tuple[Fact, ...] = ()
) -> Values:
    """M, B and G of a gyroscope."""
    felt = " - G f" if np.any(G) else ""
    cells = fit.names, fit.parameters, fit.sd
    lines = _rows("M", "rad/s per unit", *(x[:9] for x in cells))
    bias = _quantities(*(x[9:12] for x in cells))
    lines += in_thousands([Line("bias B", OF_THE_LOG, bias)])
    if felt:
        unit = f"{OF_THE_LOG} per m/s²"
        lines += _rows("G", unit, G_NAMES, G.ravel(), G_sd.ravel())
    return Values(
        title="gyroscope",
        how=f"rate = M (reading - B{felt}), rad/s; readings {rate_unit(fit.M)[1]}",
        lines=lines,
        facts=(chi_square(fit), *facts),
    )


def magnetometer_values(fit: Any, facts: tuple[Fact, ...] = ()) -> Values:
    """M, hard iron b and the dip of a magnetometer, and what is wrong with them."""
    own = fit.names[9:21], fit.parameters[9:21], fit.sd[9:21]
    (dip,) = _quantities(
        ("dip",), *(np.degrees(np.reshape(x, 1)) for x in (fit.dip, fit.sd[-1]))
    )
    iron = _quantities(*(x[9:12] for x in own))
    unit = "per unit of the log"
    return Values(
        title="magnetometer",
        how=f"field = M (reading - b), of a field of {fit.field:g}",
        lines=[
            *_rows("M", unit, *(x[:9] for x in own)),
            *in_thousands([Line("hard iron b", OF_THE_LOG, iron)]),
            Line("dip", "° below the horizon", [dip]),
        ],
        facts=(
            *(Fact("finding", each, notable=True) for each in fit.findings),
            Fact("taken", fit.assumption),
            chi_square(fit),
            *facts,
        ),
    )


def chi_square(fit: Any) -> Fact:
    """Chi-square of a fit and its degrees of freedom."""
    ratio = float(fit.chi2_per_dof)
    free = counted(fit.dof, "degree")
    return Fact("fit", f"chi-square {ratio:.3g} per degree of freedom, {free}")


def status(fit: Any) -> Fact:
    """How the solver ended; notable where it did not converge."""
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
            Fact("poses", f"condition {float(fit.condition):.3g}"),
            Fact("95 %", f"{kind}, {counted(fit.dof, 'degree')} of freedom"),
            *judged,
            *signs,
        ),
    )


def noise_facts(noise: Any) -> tuple[Fact, ...]:
    """What the residuals of a joint fit say of each sensor; notable of a misfit."""
    if noise.least_determined is None:
        return ()
    return (
        *(Fact("noise", each, notable=True) for each in noise.sentences),
        *(
            Fact("residuals", f"{x.name}: {x.sentence}", notable=bool(x.outliers))
            for x in noise.sensors
        ),
        Fact("least determined", noise.least_determined.sentence),
    )


def gyroscope_account(fit: Any) -> Account:
    """State the calibration of a gyroscope, alone or with its accelerometer."""
    return _of_rows(fit, "a gyroscope", (gyroscope_values(fit),))


def magnetometer_account(fit: Any) -> Account:
    """State the calibration of a magnetometer on an accelerometer's axes."""
    return _of_rows(fit, "a magnetometer", (magnetometer_values(fit),))


def several_account(found: Any) -> Account:
    """State the calibration of several sensors in one fit."""
    own, compass, taken = found.gyroscope, found.magnetometer, found.recording.taken
    values = [accelerometer_values(found, model=found.recording.model)]
    if own is not None:
        facts = tuple(Fact("chosen", each) for each in taken.reasons)
        values.append(gyroscope_values(own, taken.G, taken.G_sd, facts))
    if compass is not None:
        values.append(magnetometer_values(compass))
    return _of_rows(found, "several sensors", tuple(values))


def _of_rows(fit: Any, what: str, values: tuple[Values, ...]) -> Account:
    return Account(
        title=f"Calibration of {what}",
        said=status(fit).words,
        values=values,
        facts=(status(fit), chi_square(fit), *noise_facts(fit.noise)),
    )


def rate_unit(M: Float[Array, "3 3"]) -> tuple[float | None, str]:
    """Unit of a gyroscope's readings by their scale, rad/s, and what there is to say.

    None of counts, which come near the others.
    """
    scale = float(np.cbrt(abs(np.linalg.det(M))))
    for name in ("rad/s", "deg/s"):
        size = OF_A_LOG["gyro"][name]
        if 1.0 / NEAR < scale / size < NEAR:
            return size, f"are in {name} by their scale, {scale:.5g}"
    return None, f"are counts of {scale:.4g} rad/s"
