r"""Signs of what a filter says of the gyroscope's bias, by a bias that is known.

With the errors :math:`\theta` and :math:`\beta` as estimate minus truth,
:math:`\dot\theta = -\omega \times \theta - \beta`: their covariance begins with
:math:`-P_\beta t`, and no update turns its trace positive.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from simval.arrays import Array
from simval.errors import PluginError
from simval.plugins.filter_path import path
from simval.plugins.filter_protocol import Filter
from simval.plugins.filter_signals import FilterInput, Told
from simval.plugins.filter_steps import Run, readings_of, run_of
from simval.plugins.filter_worlds import on_body_side, own_quaternions
from simval.shapes import Float

BIAS: Final = (1e-3, -2e-3, 1.5e-3)
"""Of the gyroscope, rad/s: some minutes' drift of a cheap one."""

SECONDS: Final = 20.0

CLEAR: Final = 0.05
"""Share of the bias, and correlation, from which a sign is clear. Where nothing is seen
of the bias both are 0, and there is no verdict."""


def require_signs(filter: Filter, told: Told, world: str, rate: float) -> None:
    """Check the sign of the bias, and of its covariance with the attitude.

    Raises
    ------
    PluginError
        If one is the other way round.
    """
    still = path(told, rate, SECONDS, 0.0)
    given = replace(
        still.given,
        gyroscope=still.given.gyroscope + np.array(BIAS),
        start=still.truth[:1],
    )
    first = _run(filter, _beginning(given), world)
    covariance = first.words.get("covariance")
    larger = covariance is not None and covariance.shape[-1] >= 6
    if "bias" not in first.words and not larger:
        return
    words = {
        word: values[:, 0] if filter.batch else values
        for word, values in _run(filter, given, world).words.items()
    }
    if "bias" in words:
        _require_bias(filter, words["bias"][-1])
    if larger:
        own = own_quaternions(filter, words["attitude"][-1:])
        P = on_body_side(filter, words["covariance"][-1:], own)[0]
        _require_covariance(filter, P)


def _require_bias(filter: Filter, found: Float[Array, "3"]) -> None:
    bias = np.array(BIAS)
    if float(found @ bias) < -CLEAR * float(bias @ bias):
        msg = (
            f"{filter.name} answers with the `bias` {_numbers(found)} rad/s where it "
            f"is {_numbers(bias)}: return what the gyroscope reads at rest, so that "
            "the rate is the reading less the bias"
        )
        raise PluginError(msg)


def _require_covariance(filter: Filter, P: Float[Array, "p p"]) -> None:
    size = float(np.sqrt(np.trace(P[:3, :3]) * np.trace(P[3:6, 3:6])))
    if float(np.trace(P[:3, 3:6])) > CLEAR * size:
        msg = (
            f"{filter.name} answers with a `covariance` in which attitude and bias are "
            "of opposite signs: both errors are estimate minus truth, the attitude's "
            "the rotation vector of the body; turn the sign of the blocks between them"
        )
        raise PluginError(msg)


def _run(filter: Filter, given: FilterInput, world: str) -> Run:
    trials = slice(0, 1) if filter.batch else 0
    readings = readings_of(filter, given, trials, world)
    return run_of(filter, readings, np.array([len(given.dt) - 1]))


def _beginning(given: FilterInput) -> FilterInput:
    """The first row."""
    return replace(
        given,
        dt=given.dt[:1],
        gyroscope=given.gyroscope[:, :1],
        accelerometer=given.accelerometer[:, :1],
        magnetometer=given.magnetometer[:, :1],
    )


def _numbers(values: Float[Array, "3"]) -> str:
    return ", ".join(f"{value:.2g}" for value in values)
