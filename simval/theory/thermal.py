r"""Calibration with terms in temperature: its bound, and a plan for it.

A reading at the temperature offset :math:`\tau` of a force a of length g is
:math:`y = b + \beta\tau + (M^{-1}a)/(1 + \kappa\tau)`; its direction is not known, so
that a rest says no more than
:math:`|M(1 + \kappa\tau)\circ(y - b - \beta\tau)|^2 = g^2`. The temperature is known,
so :math:`\beta` and :math:`\kappa` are further parameters with the columns of bias and
scale, times it; of an ideal sensor, after (P1) of `simval.poses`,

.. math:: \bigl[\,j(u),\ -2\tau u_a,\ 2\tau u_a^2\,\bigr]. \tag{TH2}

A plan adds the rest, of the poses and temperatures that can be had, that tells most
(`simval.poses.best_addition`), until there are as many as wanted.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from simval.account import Account, Line, Quantity, Reply, Told, Values
from simval.arguments import whole_number
from simval.arrays import Array, ReadOnly, outer, physical_array, positive_number
from simval.errors import GeometryError, InputError
from simval.geometry import normalize
from simval.imu.sensor import AccelerometerModel, forms
from simval.moments import deviations
from simval.poses import PARAMETERS, best_addition, direction_jacobian, one_set
from simval.shapes import Float, Inexact
from simval.spelling import counted, rounded
from simval.theory.estimating import Block, Estimating
from simval.units import MILLIMETRE_PER_SECOND_SQUARED, MILLIRADIAN, PPM

TERMS = 6  # slopes of three biases and of three scales
MOST = 200
"""Rests of a plan: each looks at every pose at every temperature."""
_FAINT = 1e-8  # relative, of an eigenvalue: rounding leaves 1e-15


def thermal_equations(
    model: AccelerometerModel,
    directions: Float[Array, "n 3"],
    tau: Float[Array, " n"],
    slopes: Float[Array, "2 3"],
    noise_std: float,
    *,
    g: float,
) -> Estimating:
    """Equations of a calibration with linear temperature terms, at the truth."""

    def parts(theta: Inexact[Array, "t p"]) -> tuple[Any, Any]:
        values = theta[:, PARAMETERS:].reshape(-1, 2, 1, 3)
        return tau[:, None] * values[:, 0], 1.0 + tau[:, None] * values[:, 1]

    def rows(
        theta: Inexact[Array, "t p"], y: Inexact[Array, "t n 3"]
    ) -> Inexact[Array, "t n 1"]:
        shift, stretch = parts(theta)
        M = forms.matrix("triangular", theta[:, :PARAMETERS]) / g
        f = (stretch * (y - theta[:, None, 6:9] - shift)) @ M.mT
        return np.sum(f * f, axis=-1, keepdims=True) - 1.0

    theta = np.concatenate([model.parameters, slopes.ravel()])
    shift, stretch = parts(theta[None])
    force = g * normalize(one_set("directions", directions))
    readings = model.B + shift + np.linalg.solve(model.matrix, force.T).T / stretch
    noise = np.full((len(force), 3), noise_std)
    return Estimating(
        blocks=(Block(rows=rows, y=readings[0], sigma=noise),), theta=theta
    )


def thermal_jacobian(
    directions: Float[Array, "n 3"], tau: Float[Array, " n"]
) -> Float[Array, "n 15"]:
    """Rows (TH2) of an ideal sensor."""
    nine = direction_jacobian(directions)
    return np.concatenate(
        [nine, nine[:, 6:] * tau[:, None], nine[:, 3:6] * tau[:, None]], axis=1
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ThermalPlan(ReadOnly, Told):
    """Rests of a calibration over temperature, the most useful first.

    Attributes
    ----------
    directions : Array
        Specific force of each rest, sensor axes, unit length, (n, 3).
    temperatures : Array
        Of each rest, degrees Celsius, (n,).
    names : tuple of str
        Names of the parameters, the nine and then the coefficients.
    sd : Array
        Standard deviation of each at the mean temperature: rad, 1, m/s^2, and m/s^2/K
        or 1/K for the coefficients, (p,).
    reference : float
        The mean of the temperatures that were given, degrees Celsius.
    """

    directions: Float[Array, "n 3"]
    temperatures: Float[Array, " n"]
    names: tuple[str, ...]
    sd: Float[Array, " p"]
    reference: float

    @property
    def account(self) -> Account:
        """Everything that there is to say of the plan."""
        return _account(self)


def plan_thermal(
    directions: Any,
    temperatures: Any,
    noise_std: float,
    *,
    rests: int,
    g: float = 9.80665,
) -> ThermalPlan:
    """Choose which pose to take at which temperature.

    Parameters
    ----------
    directions : array_like
        Poses that can be had, sensor axes, (n, 3), of any length but 0.
    temperatures : array_like
        Temperatures that can be had, degrees Celsius: two or more, of a square three.
    noise_std : float
        Noise of each axis of a pose mean, m/s^2.
    rests : int
        Rests to take; each pair may be taken again.
    g : float, default 9.80665
        Gravity, m/s^2.

    Returns
    -------
    ThermalPlan
        The rests, and the error bars that they leave.

    Raises
    ------
    InputError
        If an argument is not usable.
    GeometryError
        If so many rests of these poses and temperatures do not tell the terms.
    """
    u = normalize(one_set("directions", directions))
    degrees = physical_array("temperatures", temperatures, (None,))
    sigma = positive_number("noise_std", noise_std, "m/s^2")
    g = positive_number("g", g, "m/s^2")
    size = PARAMETERS + TERMS
    rests = whole_number("rests", rests, size, MOST)
    if degrees.ndim != 1 or len(np.unique(degrees)) < 2:
        msg = (
            f"`temperatures` is {degrees.tolist()}; 2 or more different ones, in "
            "degrees Celsius, are needed"
        )
        raise InputError(msg)
    reference = float(degrees.mean())
    half = float(np.abs(degrees - reference).max())
    which = np.repeat(np.arange(len(degrees)), len(u))
    every = np.tile(u, (len(degrees), 1))
    # the temperature in units of half its range, so that all columns are of one size
    rows = thermal_jacobian(every, (degrees[which] - reference) / half)
    each = outer(rows, rows)
    told, taken = np.zeros((size, size)), []
    for _ in range(rests):
        taken.append(best_addition(told, each))
        told = told + each[taken[-1]]
    values = np.linalg.eigvalsh(told)
    if not values[0] > _FAINT * values[-1]:
        msg = (
            f"{rests} rests of {len(u)} poses at {len(degrees)} temperatures do "
            "not determine every term; give poses all over the sphere, or more "
            "rests"
        )
        raise GeometryError(msg)
    # the noise of a row is 2 sigma / g; biases of the rows are in units of g
    sd = 2.0 * sigma / g * deviations(np.linalg.inv(told))
    unit = np.repeat([1.0, g, g / half, 1.0 / half], [6, 3, 3, 3])
    slopes = (f"{what}_{a} per K" for what in ("bias", "scale") for a in "xyz")
    return ThermalPlan(
        directions=every[taken], temperatures=degrees[which][taken],
        names=(*forms.names("triangular"), *slopes), sd=sd * unit, reference=reference,
    )  # fmt: skip


def _account(plan: ThermalPlan) -> Account:
    at, counts = np.unique(plan.temperatures, return_counts=True)
    where = f"at {plan.reference:g} °C"
    kinds = (("misalignment", MILLIRADIAN, "", 0.0), ("scale factor", PPM, "", 1.0),
             ("bias", MILLIMETRE_PER_SECOND_SQUARED, "", 0.0),
             ("bias", MILLIMETRE_PER_SECOND_SQUARED, " per K", 0.0),
             ("scale", PPM, " per K", 0.0))  # fmt: skip
    names = [forms.ENTRIES.get(name, (name, 1.0))[0] for name in plan.names]
    worst, lines = [], []
    for k, (kind, unit, per, value) in enumerate(kinds):
        own = slice(3 * k, 3 * k + 3)
        sd = plan.sd[own].tolist()
        worst.append(f"{kind} {rounded(unit.factor * max(sd))} {unit.name}{per}")
        cells = [Quantity(x, value, s) for x, s in zip(names[own], sd, strict=True)]
        plain = value != 0.0  # a scale, which is no error
        lines.append(
            Line(
                kind, "" if plain else f"{unit.name}{per}", cells, k == 0,
                1.0 if plain else unit.factor,
            )
        )  # fmt: skip
    rests = ""
    for degrees, count in zip(at, counts.tolist(), strict=True):
        own = plan.directions[plan.temperatures == degrees]
        places = ", ".join(f"({','.join(f'{x:.2f}' for x in u)})" for u in own)
        rests += f"At {degrees:g} °C, {counted(count, 'rest')}: {places}. "
    return Account(
        title="Plan of a calibration over temperature",
        said=f"{counted(int(counts.sum()), 'rest')} at "
        f"{counted(len(at), 'temperature')}",
        replies=(
            Reply(
                title="Is the plan good enough?",
                headline=f"Yes: the rests determine all {len(plan.names)} parameters. "
                f"Predicted error of the worst axis (1 sd): {', '.join(worst)}.",
            ),
            Reply(
                title="Which rests should be taken?",
                headline="These, chosen from all poses at all temperatures; "
                "directions are of the specific force, in sensor axes.",
                do=f"{rests}Take the temperatures up and down, so that no "
                "drift in time looks like an effect of temperature.",
            ),
        ),
        values=(Values(title="accelerometer", how=where, lines=lines),),
    )
