r"""Covariance of a magnetometer's fit, and consistency of its poses with it.

The natural size of an error of the magnetometer is that of the corrected field:
:math:`E = dM\, M^{-1}`, :math:`M\, db` and ds, all relative to the strength of the
field; the same holds for the accelerometer with gravity.
"""

from typing import Any, NamedTuple

import numpy as np
import scipy

from simval.arrays import Array
from simval.errors import GeometryError, RefusedError
from simval.imu.calibrate.covariance import WIDEST
from simval.imu.calibrate.equations import (
    Accelerometer,
    Corrected,
    Magnetometer,
    Problem,
    Whitened,
)
from simval.imu.calibrate.magnetometer.result import (
    ACCELEROMETER,
    DIP,
    IRON,
    MATRIX,
    PARAMETERS,
)
from simval.imu.sensor import forms
from simval.imu.sensor.readable import NORMAL_95
from simval.shapes import Float

LEAST_COSINE = 0.01
"""Of the dip. At 89.4 degrees the horizontal field is 1 % of the whole: the noise of a
good magnetometer. Up to 89 degrees all are alike (docs/magnetometer.md)."""
_SDS = 5.0  # standard deviations that the dip must be from 90 degrees, or from 0
_LEAST_PIVOT = 1e-14  # squared sine of a column on the others; rounding leaves 1e-16
_TAIL = 1e-3  # of the chi-square, beyond which the scatter seen widens the bars judged


class CompassCode:
    """Status of a trial, as an index into `STATUS_NAMES`."""

    CONVERGED, MAX_ITERATIONS, NON_FINITE, RANK, VERTICAL, WIDE = range(6)
    HEMISPHERE, AMBIGUOUS = range(6, 8)


STATUS_NAMES = np.array(
    [
        "converged",
        "max iterations",
        "refused: non-finite readings",
        "refused: rank below 22",
        "refused: field along the vertical",
        "refused: error bars too wide",
        "refused: the dip does not show the hemisphere",
        "refused: two calibrations fit alike",
    ]
)


class Fitted(NamedTuple):
    """Trials where their fit ended, in scaled units."""

    problem: Problem
    theta: Float[Array, "t 22"]
    here: Whitened
    covariance: Float[Array, "t 22 22"]  # NaN where the rank is below 22
    natural: Float[Array, "t 25"]  # error bars in natural sizes
    half_width: Float[Array, " t"]  # the greatest of a 95 % interval, natural
    full_rank: Any  # bool, (t,)
    converged: Any  # bool, (t,)

    @classmethod
    def of(
        cls,
        problem: Problem,
        theta: Array,
        converged: Any = True,
        here: Whitened | None = None,
    ) -> "Fitted":
        """Compute covariance and rank at the solutions."""
        with np.errstate(all="ignore"):  # hopeless trials are NaN
            here = here or problem.local(theta)
            covariance, pivot = here.covariance()
            full = pivot > _LEAST_PIVOT
            covariance[~full] = np.nan
            model = problem.accelerometer.model
            natural = natural_sd(model, theta, here.at, covariance)
            factor = seen_over_stated(here.chi_square, freedoms(problem))
            half = (NORMAL_95 * natural * factor[:, None]).max(axis=1)
        return cls(
            problem=problem, theta=theta, here=here, covariance=covariance,
            natural=natural, half_width=np.where(np.isfinite(half), half, np.inf),
            full_rank=full, converged=converged,
        )  # fmt: skip

    @property
    def dof(self) -> int:
        """Degrees of freedom: equations and prior knowledge, minus parameters."""
        return freedoms(self.problem)

    @property
    def chi_square(self) -> Float[Array, " t"]:
        """Weighted sum of squares of all equations."""
        return self.here.chi_square


def freedoms(problem: Problem) -> int:
    """Degrees of freedom of a problem."""
    known = 0 if problem.prior is None else 9
    return 3 * problem.accelerometer.readings.shape[1] + known - PARAMETERS


def seen_over_stated(chi_square: Float[Array, " t"], dof: int) -> Float[Array, " t"]:
    """Factor by which scatter exceeds the stated noise; 1 if chance explains it."""
    if dof <= 0:
        return np.ones(len(chi_square))
    limit = 2.0 * scipy.special.gammaincinv(dof / 2.0, 1.0 - _TAIL)
    return np.where(chi_square > limit, np.sqrt(chi_square / dof), 1.0)


def natural_sd(
    model: str, theta: Array, at: dict[str, Corrected], covariance: Array
) -> Float[Array, "t 25"]:
    """Standard deviations in natural sizes: of E, of M db for both sensors, of ds."""
    count = len(theta)
    carry = np.zeros((count, 25, PARAMETERS))
    bad = np.asarray(~np.isfinite(theta).all(axis=1))
    eye = np.eye(3)
    matrix_a, matrix_m = at["accelerometer"].matrix, at["magnetometer"].matrix
    inverse_a, inverse_m = (
        np.linalg.pinv(np.where(bad[:, None, None], eye, matrix))
        for matrix in (matrix_a, matrix_m)
    )
    slopes = forms.matrix_derivatives(model, theta[:, ACCELEROMETER])
    moved = slopes @ inverse_a[:, None]
    carry[:, :9, :6] = moved.reshape(count, 6, 9).mT
    carry[:, 9:12, 6:9] = matrix_a
    for row in range(3):  # a row of dM times the inverse
        rows = slice(12 + 3 * row, 15 + 3 * row)
        columns = slice(MATRIX.start + 3 * row, MATRIX.start + 3 * row + 3)
        carry[:, rows, columns] = inverse_m.mT
    carry[:, 21:24, IRON] = matrix_m
    carry[:, 24, DIP] = 1.0
    return np.sqrt(np.vecdot(carry @ covariance, carry))


def judge(fit: Fitted, hemisphere: str) -> Any:
    """Status code of each trial, from its fit."""
    sine = fit.theta[:, DIP]
    with np.errstate(invalid="ignore"):
        sd = np.sqrt(fit.covariance[:, DIP, DIP])
        cosine = np.sqrt(np.maximum(1.0 - sine**2, 0.0))
        # an error of the sine is one of the dip times the cosine
        vertical = ~(cosine > LEAST_COSINE) | ~(cosine**2 > _SDS * sd)
        weak = ~(np.abs(sine) > _SDS * sd)
    near = np.abs(sine) < 1.0 + LEAST_COSINE  # beyond, the poses fit no field at all
    wide = ~(fit.half_width <= WIDEST)
    code = np.where(fit.converged, CompassCode.CONVERGED, CompassCode.MAX_ITERATIONS)
    if hemisphere != "unstated":
        code = np.where(weak, CompassCode.HEMISPHERE, code)
    code = np.where(wide, CompassCode.WIDE, code)
    steep = ~(cosine > LEAST_COSINE)
    code = np.where(vertical & ~wide | steep & near, CompassCode.VERTICAL, code)
    return np.where(~fit.full_rank & ~(steep & near), CompassCode.RANK, code)


_LEVEL = np.radians(15.0)  # decides the words of a message only
_STILL = 1e-9  # of the length: a column that does not change
_RANK = 10.0  # times the relative noise, of the greatest singular value
_ADVICE = (
    "turn each axis up and down in turn, and change the heading at each tilt, so that "
    "gravity and the field are seen from all sides"
)


def refuse_still(readings: dict[str, Float[Array, "n 3"]]) -> None:
    """Refuse a sensor with an axis that reads the same in every pose."""
    for name, values in readings.items():
        still = np.ptp(values, axis=0) <= _STILL * np.abs(values).max()
        if still.all():
            msg = (
                f"the {name} reads the same in all {len(values)} poses; it was not "
                "moved, or its columns are not those of a sensor"
            )
            raise GeometryError(msg, _ADVICE, poses=len(values))
        if still.any():
            axis = int(np.flatnonzero(still)[0])
            msg = (
                f"axis {'xyz'[axis]} of the {name} reads {values[0, axis]:g} in all "
                f"{len(values)} poses; a working axis changes from pose to pose"
            )
            raise GeometryError(msg, "check the column and the wire", axis=axis)


def refuse(code: int, poses: dict[str, Float[Array, "n 3"]], fit: Fitted) -> None:
    """Raise the error of one refused set; geometry if its poses leave the fit open."""
    body, field = poses["accelerometer"], poses["magnetometer"]
    half_width, sine = float(fit.half_width[0]), float(fit.theta[0, DIP])
    noise = max(each.std.max() for each in fit.problem.sensors)
    if code == CompassCode.HEMISPHERE:
        msg = (
            f"the dip is {_degrees(sine)} degrees, too near 0 to show the "
            "hemisphere with these error bars"
        )
        do = (
            "leave `hemisphere` out: the axes of the magnetometer are then taken as "
            "right-handed (det M > 0)"
        )
        raise RefusedError(msg, do)
    if code == CompassCode.AMBIGUOUS:
        msg = (
            f"two different calibrations fit the {len(body)} poses equally "
            "well, and so few poses cannot show which is right"
        )
        do = "add poses; twelve or more are always enough when turned to all sides"
        raise GeometryError(msg, do, poses=len(body))
    said = _geometry_words(body, field)
    wide = not half_width <= WIDEST
    if code == CompassCode.VERTICAL and not wide and not said:
        msg = (
            f"the field is along the vertical (dip {_degrees(sine)} degrees), "
            "so it shows no heading, and the three equations of a pose are "
            f"only two; nearer than {np.degrees(np.arcsin(LEAST_COSINE)):.1f} "
            "degrees, or five error bars, nothing is fitted"
        )
        do = (
            "go to another place, look for iron below the sensor, and check that the "
            "columns of one sensor were not given twice"
        )
        raise GeometryError(msg, do)
    rank = nominal_rank(body, field, noise)
    if rank < PARAMETERS and not said:
        said = "the poses are too few or too much alike for their noise; "
    if code == CompassCode.VERTICAL:
        said += (
            f"the dip comes out as {_degrees(sine)} degrees, and a field along "
            "the vertical shows no heading;"
        )
    if wide and rank == PARAMETERS:
        factor = float(seen_over_stated(fit.chi_square, fit.dof)[0])
        scatter = (
            f"; the poses scatter {factor:.3g} times as much as the stated noise "
            "explains, which counts here: check units, the order of the poses, and "
            "that the two sensors are not swapped"
            if factor > 1.0
            else ""
        )
        worst = _named(int(np.argmax(fit.natural[0])))
        msg = (
            f"the calibration is uncertain by {100.0 * half_width:.3g} percent of the "
            f"field or of gravity ({worst}, 95 percent half-width), and at most "
            f"{100.0 * WIDEST:.0f} percent is accepted{scatter}"
        )
        kind = RefusedError if factor > 1.0 else GeometryError
        do = f"{said}{_ADVICE}, or hold each pose longer"
        raise kind(msg, do, half_width=half_width, scatter=factor)
    rank = min(rank, PARAMETERS - 1)
    msg = (
        f"the {len(body)} poses leave some of the {PARAMETERS} parameters open (rank "
        f"{rank} of {PARAMETERS})"
    )
    raise GeometryError(msg, f"{said}{_ADVICE}", rank=rank, poses=len(body))


def _degrees(sine: float) -> str:
    return f"{np.degrees(np.arcsin(np.clip(sine, -1.0, 1.0))):.2f}"


def _named(widest: int) -> str:
    if widest < 12:
        return f"the accelerometer's {'bias' if widest >= 9 else 'matrix'}"
    if widest < 24:
        return "the matrix M" if widest < 21 else "the hard iron b"
    return "the dip"


def _directions(readings: Float[Array, "n 3"], centre: Any) -> Float[Array, "n 3"]:
    off = readings - centre
    length = np.linalg.norm(off, axis=1, keepdims=True)
    return off / np.where(length > 0.0, length, 1.0)


def _geometry_words(body: Float[Array, "n 3"], field: Float[Array, "n 3"]) -> str:
    # what the raw readings themselves say against the poses
    up = _directions(body, 0.0)
    mean = _directions(up.mean(axis=0, keepdims=True), 0.0)[0]
    tilt = np.arccos(np.clip(np.min(up @ mean), -1.0, 1.0))
    if tilt < _LEVEL:
        return (
            f"the accelerometer points within {np.degrees(tilt):.2g} degrees of one "
            "direction in all poses, as on a level table, and turning there says "
            "little: tilt it; "
        )
    for name, readings in (("accelerometer", body), ("magnetometer", field)):
        off = readings - readings.mean(axis=0)
        values = np.linalg.svd(off, compute_uv=False)
        if not values[2] > 0.05 * values[0]:
            return (
                f"the readings of the {name} lie in a plane, as when all turns are "
                "about one axis: turn about another axis as well; "
            )
    return ""


def nominal_rank(
    body: Float[Array, "n 3"], field: Float[Array, "n 3"], noise: float
) -> int:
    """Rank of the equations above the noise, with both sensors taken as ideal."""
    middle = (field.max(axis=0) + field.min(axis=0)) / 2.0
    up, along = _directions(body, 0.0), _directions(field, middle)
    theta = np.zeros((1, PARAMETERS))
    theta[0, :9] = forms.from_gram("triangular", np.eye(3), np.zeros(3))
    theta[0, 9:18] = np.eye(3).ravel()
    theta[0, 21] = -np.mean(np.vecdot(up, along))
    one = np.ones((1, len(up), 3))
    problem = Problem(
        sensors=(
            Accelerometer(readings=up[None], std=one, model="triangular"),
            Magnetometer(readings=along[None], std=one),
        )
    )
    slopes = problem.rests(problem.corrected(theta), theta)[1].reshape(-1, PARAMETERS)
    values = np.linalg.svd(slopes, compute_uv=False)
    return int(np.count_nonzero(values > min(_RANK * noise, 0.1) * values[0]))
