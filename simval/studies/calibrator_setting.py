"""Sensor and poses with which a calibrator is measured, and the theory beside them."""

from dataclasses import dataclass

import numpy as np

from simval.arrays import Array
from simval.errors import PluginError
from simval.plugins import Calibrator
from simval.plugins.calibrator_probe import G, probe_sensor
from simval.poses import cube_faces, fibonacci_sphere
from simval.sensor import AccelerometerModel, forms
from simval.sensor.estimated import ALL, own_sensor, places_of
from simval.shapes import Float
from simval.studies.coverage import FREEDOM
from simval.theory.calibration import VARIANCE_NEXT, calibration_moments
from simval.theory.calibration_classes import (
    bound_left,
    class_bound,
    least_left,
    pseudo_true,
)

FACES = 6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Expected:
    """Theory of one cell."""

    places: tuple[int, ...]  # of what is estimated among the nine parameters
    own: bool  # whether the sensor has these errors alone
    # error of what it converges to: the middle of all criteria; 0 in its own class
    bias: Float[Array, " p"]
    spread: Float[Array, " p"]  # range of the criteria
    bound: Float[Array, "p p"]  # Cramer-Rao, in its own class
    bound_left: float  # RMS left at that bound, m/s^2
    all_left: float | None  # RMS left at the bound of all nine, where poses show them
    least: float  # RMS left by the best of the class without noise, m/s^2
    variance_off: float  # remainder of a variance, relative


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Setting:
    """What is the same in every trial of a cell."""

    plugin: Calibrator
    sensor: AccelerometerModel
    directions: Float[Array, "n 3"]
    faces: bool  # whether they are those of a cube, and so known
    noise: float  # of an axis of a pose mean, raw units
    theory: Expected

    @property
    def own(self) -> bool:
        """Whether the sensor has no errors but those that are estimated."""
        return self.theory.own

    @property
    def named(self) -> tuple[list[str], list[str]]:
        """Names and units of what is estimated."""
        places, names = self.theory.places, forms.names("triangular")
        return [names[k] for k in places], [("1", "raw")[k >= 6] for k in places]

    @property
    def sizes(self) -> Float[Array, " p"]:
        """Natural sizes of what is estimated."""
        sizes = np.abs(self.sensor.parameters)
        sizes[:3] = 1.0
        sizes[6:] = G / np.abs(self.sensor.K).min()
        return sizes[list(self.theory.places)]


def setting_of(
    plugin: Calibrator, *, faces: bool, poses: int, own_class: bool, noise_std: float
) -> Setting:
    """Sensor, poses and theory of a cell.

    Raises
    ------
    PluginError
        If the poses do not show what is estimated.
    """
    directions = fibonacci_sphere(poses)
    if faces:
        directions = np.tile(cube_faces(), (poses // FACES, 1))
    if faces and plugin.estimates == ALL:
        msg = (
            f"{plugin.name} estimates nine parameters, of which six faces of a cube "
            'show six; use pose_set = "sphere", or declare in `estimates` what it '
            "estimates"
        )
        raise PluginError(msg)
    sensor = probe_sensor(plugin.estimates)
    if own_class:
        sensor = own_sensor(sensor, plugin.estimates)
    scale = float(np.abs(np.linalg.inv(sensor.matrix)).max())
    noise = noise_std * scale
    return Setting(
        plugin=plugin,
        sensor=sensor,
        directions=directions,
        faces=faces,
        noise=noise,
        theory=expected(
            sensor, directions, plugin.estimates, g=G, noise_std=noise, known=faces
        ),
    )


def expected(
    sensor: AccelerometerModel,
    directions: Float[Array, "n 3"],
    estimates: tuple[str, ...],
    *,
    g: float,
    noise_std: float,
    known: bool,
) -> Expected:
    """Work out the theory of one cell."""
    places, poses = places_of(estimates), (sensor, directions)
    inside = own_sensor(sensor, estimates)
    own = estimates == ALL or np.array_equal(inside.parameters, sensor.parameters)
    bias = spread = np.zeros(len(places))
    if not own:
        found = pseudo_true(*poses, places, g=g, known=known)
        off = (found - sensor.parameters)[:, list(places)]
        bias = (off.max(axis=0) + off.min(axis=0)) / 2.0
        spread = np.ptp(off, axis=0)
    if estimates == ALL:
        moments = calibration_moments(*poses, g=g, noise_std=noise_std)
        bound, remainder = moments.cramer_rao, moments.variance_remainder
    else:
        bound = class_bound(
            inside, directions, places, g=g, noise_std=noise_std, known=known
        )
        remainder = VARIANCE_NEXT * _relative(inside, g, noise_std)
    return Expected(
        places=places,
        own=own,
        bias=bias,
        spread=spread,
        bound=bound,
        bound_left=bound_left(inside, bound, places, g),
        all_left=None if known else _all_left(*poses, g, noise_std),
        least=least_left(sensor, places, g),
        variance_off=remainder + FREEDOM,
    )


def _relative(sensor: AccelerometerModel, g: float, noise_std: float) -> float:
    """Squared relative noise of the worst axis, as in eq. (K4)."""
    scale = np.linalg.norm(sensor.matrix, axis=1).max()
    return float((noise_std * scale / g) ** 2)


def _all_left(
    sensor: AccelerometerModel,
    directions: Float[Array, "n 3"],
    g: float,
    noise_std: float,
) -> float:
    """RMS left at the bound of nine parameters."""
    bound = calibration_moments(sensor, directions, g=g, noise_std=noise_std).cramer_rao
    return bound_left(sensor, bound, places_of(ALL), g)
