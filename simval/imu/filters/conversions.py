r"""Settings of a filter as other projects state them.

With N and K of the gyroscope, R the noise of a row of a vector sensor of the length v,
f the rows a second of the filter they were found for, and h the step of the project's:

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
(TO2): N and K are :math:`p \sqrt h`. A complementary filter has no covariance;
:math:`\tau` is the time constant of the Kalman filter's constant gain for one angle
with these noises, :math:`N/(R/(v \sqrt f))` a second. Of a magnetometer v is the
horizontal field there, as a heading is what it corrects.

Sources: Kalibr's wiki, "IMU Noise Model", and OpenVINS's ``Propagator.cpp`` (068490c);
PX4's ``covariance.cpp`` (028733e: squares of ``delta_ang_dt * gyro_noise`` and ``dt *
gyro_bias_p_noise``) and ``gravity_fusion.cpp`` (27f5a19: of a unit vector), with
EKF2_PREDICT_US at 10 ms; ArduPilot's ``AP_NavEKF3_core.cpp`` (003a5c9: ``sq(dt *
gyrNoise)``, ``sq(sq(dt) * gyroBiasProcessNoise)`` of an angle) with EKF_TARGET_DT of
12 ms; GTSAM's ``PreintegratedRotation.h`` and ``PreintegrationCombinedParams.h``
(005c7d4: continuous-time covariances, deviations in rad/s/sqrt(Hz)); ahrs 0.4's
``EKF.update`` (Q is ``noises[0]`` of the rate times its Jacobian, readings of length
1); vqf's ``vqf.cpp`` (03a04b7: ``biasV`` grows from 0 to 0.1°/s in
``biasForgettingTime``); Fusion's README (03cbf29: the feedback is the error times the
gain).
"""

from typing import Any, Final, NamedTuple

import numpy as np

from simval.imu.filters.signals import Told

GAUSS: Final = 1e4  # in a tesla
FORGOTTEN: Final = 0.1  # degrees/s
STEPS: Final = {"px4": 0.010, "ardupilot": 0.012}  # s
RANGES: Final = {
    "EKF2_GYR_NOISE": (1e-4, 0.1), "EKF2_GYR_B_NOISE": (0.0, 0.01),
    "EKF2_GRAV_NOISE": (0.1, 10.0), "EKF2_MAG_NOISE": (1e-3, 1.0),
    "EK3_GYRO_P_NSE": (1e-4, 0.1), "EK3_GBIAS_P_NSE": (1e-5, 1e-3),
    "EK3_MAG_M_NSE": (0.01, 0.5),
}  # fmt: skip
"""Of autopilots' parameters, as they document them."""
INTEGRATED: Final = (
    "accelerometer_noise_density is for a filter that takes the vertical from the "
    "accelerometer; one that integrates it may need more",
    "accelerometer_random_walk: not asked here; measure it (simval noise)",
)
NOTES: Final = {
    "kalibr": INTEGRATED,
    "openvins": INTEGRATED,
    "ros": ("fields of sensor_msgs/Imu and MagneticField",),
    "px4": ("EKF2_GRAV_NOISE counts where EKF2_IMU_CTRL fuses gravity",),
    "ardupilot": ("the accelerometer's noise is not carried: EKF3 does not take the "
                  "vertical from it",),
}  # fmt: skip
FORMS: Final = {
    "kalibr": ("", "{}: {}"),
    "openvins": ("%YAML:1.0\nimu0:\n", "  {}: {}"),
    "ros": ("", "{}: {}"),
    "px4": ("# Vehicle-Id Component-Id Name Value Type\n", "1\t1\t{}\t{}\t9"),
    "ardupilot": ("", "{},{}"),
}
"""What a project's file begins with, and a line of it."""


class Given(NamedTuple):
    """What a filter is given, and its rows a second."""

    told: Told
    rate: float


def settings_of(project: str, given: Given) -> dict[str, Any]:
    """Settings of a project by name, eqs. (TO1) to (TO3)."""
    told, f = given.told, given.rate
    N, K, R = told.gyroscope_noise, told.gyroscope_walk, told.accelerometer_noise
    field = told.magnetometer_noise
    if project in ("kalibr", "openvins"):
        return {
            "gyroscope_noise_density": N, "gyroscope_random_walk": K,
            "accelerometer_noise_density": R / f**0.5,
            "update_rate": float(f"{f:.9g}"),
        }  # fmt: skip
    if project == "ros":
        variances = {"angular_velocity": N**2 * f, "linear_acceleration": R**2,
                     "magnetic_field": field**2}  # fmt: skip
        return {
            f"{name}_covariance": (value * np.eye(3)).ravel().tolist()
            for name, value in variances.items()
            if np.isfinite(value)
        }
    root, rows = STEPS[project] ** 0.5, (f * STEPS[project]) ** -0.5
    found = {
        "EKF2_GYR_NOISE": N / root, "EKF2_GYR_B_NOISE": K / root,
        "EKF2_GRAV_NOISE": R / told.gravity * rows,
        "EKF2_MAG_NOISE": GAUSS * field * rows,
    }  # fmt: skip
    if project == "ardupilot":
        names = ("EK3_GYRO_P_NSE", "EK3_GBIAS_P_NSE", "", "EK3_MAG_M_NSE")
        found = dict(zip(names, found.values(), strict=True))
        del found[""]
    return {name: value for name, value in found.items() if np.isfinite(value)}


def settings_file(project: str, given: Given) -> tuple[str, list[str]]:
    """Text of a project's file with the settings, and what to know of it."""
    notes, values = list(NOTES[project]), settings_of(project, given)
    for name, value in values.items():
        least, most = RANGES.get(name, (-np.inf, np.inf))
        if name in RANGES and not least <= value <= most:
            notes.append(f"{name} is {value:.3g}, documented are {least:g} to {most:g}")
    first, form = FORMS[project]
    lines = [form.format(name, _spelled(value)) for name, value in values.items()]
    # a version of YAML must stand first
    return "\n".join(
        [first + lines[0], *lines[1:], *(f"# {x}" for x in notes), ""]
    ), notes


def _spelled(value: Any) -> str:
    # with a point: 1e-05 is a word in YAML 1.1
    if isinstance(value, list):
        return f"[{', '.join(map(_spelled, value))}]"
    text = repr(float(value))
    return text if "." in text else text.replace("e", ".0e")


def arguments(given: Given) -> dict[str, dict[str, Any]]:
    """Arguments of Python packages, eqs. (TO1) and (TO3) to (TO5).

    By package and what takes them; a variance is times the identity, and Q of the error
    of an angle and of its bias.
    """
    told, f = given.told, given.rate
    N, K, R = told.gyroscope_noise, told.gyroscope_walk, told.accelerometer_noise
    gain = N * f**0.5 * told.gravity / R
    cross = -(K**2) / f**2 / 2.0
    Q = [[N**2 / f + K**2 / f**3 / 3.0, cross], [cross, K**2 / f]]
    directions, readings, tau = [(R / told.gravity) ** 2, 1.0], [R**2], {}
    if np.isfinite(told.magnetometer_noise):
        m, (north, west, up) = told.magnetometer_noise, told.field.tolist()
        directions[1] = m**2 / (north**2 + west**2 + up**2)
        readings.append(m**2)
        tau["tauMag"] = m / (float(np.hypot(north, west)) * N * f**0.5)
    if K > 0.0:
        tau["biasForgettingTime"] = float((FORGOTTEN / np.degrees(K)) ** 2)
    return {
        "ahrs.filters.EKF": {"frequency": f, "noises": [N**2 * f, *directions]},
        "vqf.VQF": {"gyrTs": 1.0 / f, "tauAcc": 1.0 / gain, **tau,
                    "biasSigmaInit": float(np.degrees(told.bias_std))},
        "imufusion.AhrsSettings": {"gain": gain},
        "filterpy.kalman.KalmanFilter": {
            "Q": Q, "R": readings, "P": [told.start_std**2, told.bias_std**2]},
        "gtsam.PreintegrationCombinedParams": {
            "setGyroscopeCovariance": N**2, "setBiasOmegaCovariance": K**2,
            "setAccelerometerCovariance": R**2 / f},
    }  # fmt: skip
