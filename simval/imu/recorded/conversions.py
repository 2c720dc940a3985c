r"""Settings of a filter in the terms of other projects.

With N and K of the gyroscope, R the noise of a row of a vector sensor of the length v,
f the rows a second of the filter they were found for, and h the time that one step or
reading of the project's is of:

.. math::
   \text{Kalibr, OpenVINS:}\quad & N,\ K,\ R/\sqrt f; \qquad
   \text{GTSAM:}\quad N^2 I,\ K^2 I,\ (R^2/f) I; \tag{TO1} \\
   \text{PX4, ArduPilot:}\quad & N/\sqrt h,\ K/\sqrt h,\ R/\sqrt{f h}; \tag{TO2} \\
   \text{ROS messages:}\quad & N^2 f,\ R^2; \qquad
   \text{ahrs:}\quad N^2 f,\ (R/v)^2; \tag{TO3} \\
   \text{filterpy:}\quad & Q = \begin{bmatrix} N^2 h + K^2 h^3/3 & -K^2 h^2/2 \\
     \cdot & K^2 h \end{bmatrix} \otimes I,\ R^2; \tag{TO4} \\
   \text{vqf:}\quad & \tau = \frac{R}{v N \sqrt f},\ (0.1^\circ/\mathrm{s})^2/K^2; \quad
   \text{imufusion:}\quad \text{gain} = 1/\tau. \tag{TO5}

Projects that add the variance :math:`(h p)^2` to an angle or a bias in each step h need
(TO2): N and K are :math:`p \sqrt h`. Autopilots take a magnetometer more seldom than
they step, each time the mean of its readings since: every 1/15 s in PX4, every 0.1 s in
ArduPilot; that is h of its noise. A complementary filter has no covariance;
:math:`\tau` is the time constant of the Kalman filter's constant gain for one angle
with these noises, :math:`N/(R/(v \sqrt f))` a second. Of a magnetometer v is the
horizontal field there, as a heading is what it corrects.

Sources: Kalibr's wiki, "IMU Noise Model", and OpenVINS's ``Propagator.cpp`` (068490c);
PX4's ``covariance.cpp`` (028733e: squares of ``delta_ang_dt * gyro_noise`` and ``dt *
gyro_bias_p_noise``) and ``gravity_fusion.cpp`` (27f5a19: of a unit vector), with
EKF2_PREDICT_US at 10 ms; its ``VehicleMagnetometer.cpp`` (012c25c: the mean since the
last), ``sensor_params_mag.yaml`` (e87d6af: SENS_MAG_RATE is 15 Hz) and
``mag_control.cpp`` (8eca9db: fused once a reading, with 0.01 gauss or more);
ArduPilot's ``AP_NavEKF3_core.cpp`` (003a5c9: ``sq(dt * gyrNoise)``, ``sq(sq(dt) *
gyroBiasProcessNoise)`` of an angle) with EKF_TARGET_DT of 12 ms; its
``AP_Compass_Backend.cpp`` (2017268: ``drain_accumulated_samples``, the mean since the
last) and its vehicles' ``update_batt_compass``, 10 times a second, where
``AP_NavEKF3_Measurements.cpp`` (d84f825) takes what is 50 ms later than the last;
GTSAM's ``PreintegratedRotation.h`` and ``PreintegrationCombinedParams.h``
(005c7d4: continuous-time covariances, deviations in rad/s/sqrt(Hz)); ahrs 0.4's
``EKF.update`` (Q is ``noises[0]`` of the rate times its Jacobian, readings of length
1); vqf's ``vqf.cpp`` (03a04b7: ``biasV`` grows from 0 to 0.1°/s in
``biasForgettingTime``); Fusion's README (03cbf29: the feedback is the error times the
gain).
"""

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import numpy as np

from simval.arrays import Array
from simval.imu.multiposition.parameters import AUTOPILOTS, WRITERS, flow, yaml_lines
from simval.units import G0

FORGOTTEN: Final = 0.1  # degrees/s
GAUSS: Final = 1e4  # in a tesla


class Given(NamedTuple):
    """Noise and start that a filter is given, SI units."""

    noise: Mapping[str, float]  # N, K, and of each vector sensor, per root hertz
    rate: float  # rows a second
    vectors: Mapping[str, Array]  # of the sensors, NWU
    start: Array  # variances of the angles, then of the biases


class Setting(NamedTuple):
    """How a project states one noise."""

    of: str
    every: float = 1.0  # s, that a step or reading with it is of; 1 of a density
    times: float = 1.0  # to its unit
    documented: tuple[float, float] | None = None


FORCE, FIELD = "accelerometer", "magnetometer"
_DENSITIES: Final = {
    "gyroscope_noise_density": Setting("N"),
    "gyroscope_random_walk": Setting("K"),
    "accelerometer_noise_density": Setting(FORCE),
}
SETTINGS: Final[Mapping[str, Mapping[str, Setting]]] = {
    "kalibr": _DENSITIES,
    "openvins": _DENSITIES,
    "ros": {
        "angular_velocity_covariance": Setting("N"),
        "linear_acceleration_covariance": Setting(FORCE),
        "magnetic_field_covariance": Setting(FIELD),
    },
    "px4": {
        "EKF2_GYR_NOISE": Setting("N", 0.010, 1.0, (1e-4, 0.1)),
        "EKF2_GYR_B_NOISE": Setting("K", 0.010, 1.0, (0.0, 0.01)),
        "EKF2_GRAV_NOISE": Setting(FORCE, 0.010, 1.0 / G0, (0.1, 10.0)),
        "EKF2_MAG_NOISE": Setting(FIELD, 1.0 / 15.0, GAUSS, (1e-3, 1.0)),
    },
    "ardupilot": {
        "EK3_GYRO_P_NSE": Setting("N", 0.012, 1.0, (1e-4, 0.1)),
        "EK3_GBIAS_P_NSE": Setting("K", 0.012, 1.0, (1e-5, 1e-3)),
        "EK3_MAG_M_NSE": Setting(FIELD, 0.1, GAUSS, (0.01, 0.5)),
    },
}
"""Numbers of a project by name, with the ranges that it documents."""
_INTEGRATED: Final = (
    "accelerometer_noise_density is for a filter that takes the vertical from the "
    "accelerometer; one that integrates it may need more",
    "accelerometer_random_walk: not asked here; measure it (simval noise)",
)
NOTES: Final = {
    "kalibr": _INTEGRATED,
    "openvins": _INTEGRATED,
    "ros": ("fields of sensor_msgs/Imu and MagneticField",),
    "px4": (
        "EKF2_GRAV_NOISE counts where EKF2_IMU_CTRL fuses gravity",
        "EKF2_MAG_NOISE is of the mean of 1/15 s (SENS_MAG_RATE of 15 Hz); less than "
        "0.01 counts as that",
    ),
    "ardupilot": (
        "the accelerometer's noise is not carried: EKF3 does not take the vertical "
        "from it",
        "EK3_MAG_M_NSE is of the mean of 0.1 s, as compasses are read 10 times a "
        "second",
    ),
}  # fmt: skip


def settings_of(project: str, given: Given) -> dict[str, Any]:
    """Settings of a project by name, eqs. (TO1) to (TO3)."""
    found: dict[str, Any] = {
        name: given.noise[own.of] * own.times / own.every**0.5
        for name, own in SETTINGS[project].items()
        if own.of in given.noise
    }
    if project == "ros":
        covariances = {n: size**2 * given.rate * np.eye(3) for n, size in found.items()}
        return {name: C.ravel().tolist() for name, C in covariances.items()}
    rate = {"update_rate": float(f"{given.rate:.9g}")}
    return found if project in AUTOPILOTS else found | rate


def settings_file(project: str, given: Given) -> tuple[str, list[str]]:
    """Text of a project's settings file, and remarks on it."""
    notes, values = list(NOTES[project]), settings_of(project, given)
    for name, own in SETTINGS[project].items():
        ends = own.documented
        if ends and name in values and not ends[0] <= values[name] <= ends[1]:
            documented = "documented are {:g} to {:g}".format(*ends)
            notes.append(f"{name} is {values[name]:.3g}, {documented}")
    if project in AUTOPILOTS:
        line = AUTOPILOTS[project].line
        lines = [line.format(name, flow(value)) for name, value in values.items()]
    else:
        lines = [*yaml_lines({"imu0": values} if project == "openvins" else values)]
    # a version of YAML must stand first
    first, _ = WRITERS[project]
    return "\n".join([*first, *lines, *(f"# {x}" for x in notes), ""]), notes


def arguments(given: Given) -> dict[str, dict[str, Any]]:
    """Arguments of Python packages, eqs. (TO1) and (TO3) to (TO5).

    By package and what takes them; a variance is times the identity, and Q of the error
    of an angle and of its bias.
    """
    f, g, x = given.rate, float(given.vectors[FORCE][2]), given.noise
    N, K, force = x["N"], x["K"], x[FORCE] ** 2
    directions, readings = [force * f / g**2, 1.0], [force * f]
    tau = {"tauAcc": x[FORCE] / (g * N)}
    if FIELD in x:
        north, west, up = given.vectors[FIELD].tolist()
        readings.append(x[FIELD] ** 2 * f)
        directions[1] = readings[1] / (north**2 + west**2 + up**2)
        tau["tauMag"] = x[FIELD] / (float(np.hypot(north, west)) * N)
    if K > 0.0:
        tau["biasForgettingTime"] = float((FORGOTTEN / np.degrees(K)) ** 2)
    cross = -(K**2) / f**2 / 2.0
    Q = [[N**2 / f + K**2 / f**3 / 3.0, cross], [cross, K**2 / f]]
    angle, bias = float(given.start[:3].max()), float(given.start[3])
    return {
        "ahrs.filters.EKF": {"frequency": f, "noises": [N**2 * f, *directions]},
        "vqf.VQF": {
            "gyrTs": 1.0 / f, **tau, "biasSigmaInit": float(np.degrees(bias**0.5)),
        },
        "imufusion.AhrsSettings": {"gain": 1.0 / tau["tauAcc"]},
        "filterpy.kalman.KalmanFilter": {"Q": Q, "R": readings, "P": [angle, bias]},
        "gtsam.PreintegrationCombinedParams": {
            "setGyroscopeCovariance": N**2, "setBiasOmegaCovariance": K**2,
            "setAccelerometerCovariance": force,
        },
    }  # fmt: skip
