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
   \text{vqf:}\quad & \tau = \frac{R}{v N \sqrt f},\ (0.1°/\mathrm{s})^2/K^2; \qquad
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

from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

import numpy as np

from simval.imu.filters.signals import Told

Setting = tuple[str, float, float, float]  # name, value, and what is documented
GAUSS: Final = 1e4  # in a tesla
PX4_STEP: Final = 0.010
ARDUPILOT_STEP: Final = 0.012
FORGOTTEN: Final = 0.1  # degrees/s


class Given(NamedTuple):
    """What a filter is given, and its rows a second."""

    told: Told
    rate: float
    accelerometer_walk: float | None = None  # m/s^2 per root second

    @property
    def density(self) -> float:
        """White noise of the accelerometer, m/s^2 per root hertz."""
        return float(self.told.accelerometer_noise / np.sqrt(self.rate))

    @property
    def magnetometer(self) -> bool:
        """True if there is one."""
        return bool(np.isfinite(self.told.magnetometer_noise))

    def of_steps(self, step: float) -> tuple[float, float, float, float]:
        """N, K, and the noise of accelerometer and magnetometer, eq. (TO2)."""
        told, more = self.told, np.sqrt(1.0 / (self.rate * step))
        return (
            told.gyroscope_noise / np.sqrt(step), told.gyroscope_walk / np.sqrt(step),
            told.accelerometer_noise * more, told.magnetometer_noise * more,
        )  # fmt: skip


def _densities(given: Given) -> list[str]:
    told, walk = given.told, given.accelerometer_walk
    values = {
        "gyroscope_noise_density": told.gyroscope_noise,
        "gyroscope_random_walk": told.gyroscope_walk,
        "accelerometer_noise_density": given.density,
        "accelerometer_random_walk": walk,
        "update_rate": float(f"{given.rate:.9g}"),
    }
    return [f"{name}: {_yaml(x)}" for name, x in values.items() if x is not None]


def _yaml(value: float) -> str:
    # with a point: 1e-05 is a word in YAML 1.1
    text = repr(float(value))
    return text if "." in text else text.replace("e", ".0e")


def _openvins(given: Given) -> list[str]:
    return ["imu0:", *(f"  {line}" for line in _densities(given))]


def _ros(given: Given) -> list[str]:
    told = given.told
    variances = {
        "angular_velocity_covariance": told.gyroscope_noise**2 * given.rate,
        "linear_acceleration_covariance": told.accelerometer_noise**2,
    }
    if given.magnetometer:
        variances["magnetic_field_covariance"] = told.magnetometer_noise**2
    return [
        f"{name}: [{', '.join(_yaml(x) for x in (value * np.eye(3)).ravel())}]"
        for name, value in variances.items()
    ]


def _px4(given: Given) -> list[Setting]:
    N, K, force, field = given.of_steps(PX4_STEP)
    found = [
        ("EKF2_GYR_NOISE", N, 1e-4, 0.1),
        ("EKF2_GYR_B_NOISE", K, 0.0, 0.01),
        ("EKF2_GRAV_NOISE", force / given.told.gravity, 0.1, 10.0),
    ]
    if given.magnetometer:
        found.append(("EKF2_MAG_NOISE", GAUSS * field, 1e-3, 1.0))
    return found


def _ardupilot(given: Given) -> list[Setting]:
    N, K, _, field = given.of_steps(ARDUPILOT_STEP)
    found = [("EK3_GYRO_P_NSE", N, 1e-4, 0.1), ("EK3_GBIAS_P_NSE", K, 1e-5, 1e-3)]
    if given.magnetometer:
        found.append(("EK3_MAG_M_NSE", GAUSS * field, 0.01, 0.5))
    return found


_INTEGRATED: Final = (
    "accelerometer: found for a filter that takes the vertical from it; one that "
    "integrates it may need more"
)
_FILES: Final[Mapping[str, tuple[str, Callable[[Given], list[Any]], str, str]]] = {
    "kalibr": ("", _densities, "", _INTEGRATED),
    "openvins": ("%YAML:1.0", _openvins, "", _INTEGRATED),
    "ros": ("", _ros, "", "fields of sensor_msgs/Imu and MagneticField"),
    "px4": ("# Vehicle-Id Component-Id Name Value Type", _px4, "1\t1\t{}\t{!r}\t9",
            "EKF2_GRAV_NOISE counts where EKF2_IMU_CTRL fuses gravity"),
    "ardupilot": ("", _ardupilot, "{},{!r}", "accelerometer: EKF3 does not take the "
                  "vertical from it, so its noise is not carried"),
}  # fmt: skip


def settings_file(project: str, given: Given) -> tuple[str, list[str]]:
    """Text of a project's file with the settings, and what to know of it."""
    first, made, form, note = _FILES[project]
    notes, lines = [note], []
    for each in made(given):
        if isinstance(each, str):
            lines.append(each)
            continue
        name, value, least, most = each
        lines.append(form.format(name, float(value)))
        if not least <= value <= most:
            words = (
                f"{name} is {value:.3g}, the project documents {least:g} to {most:g}"
            )
            notes.append(words)
    if project in ("kalibr", "openvins") and given.accelerometer_walk is None:
        notes.append("accelerometer_random_walk: not known; measure it (simval noise)")
    head = [first] * bool(first) + [f"# {each}" for each in notes]
    return "\n".join([*head, *lines, ""]), notes


def arguments(given: Given) -> dict[str, dict[str, Any]]:
    """Arguments of Python packages, by package and what takes them."""
    told, f = given.told, given.rate
    N, K, g = told.gyroscope_noise, told.gyroscope_walk, told.gravity
    R2 = [told.accelerometer_noise**2]
    tau = {"tauAcc": float(told.accelerometer_noise / (g * N * np.sqrt(f)))}
    directions = [R2[0] / g**2, 1.0]
    if given.magnetometer:
        R2.append(told.magnetometer_noise**2)
        directions[1] = float(R2[1] / (told.field @ told.field))
        level = float(np.hypot(*told.field[:2]))
        tau["tauMag"] = float(told.magnetometer_noise / (level * N * np.sqrt(f)))
    cross = -(K**2) / f**2 / 2.0
    Q = np.array([[N**2 / f + K**2 / f**3 / 3.0, cross], [cross, K**2 / f]])
    start = np.diag(np.repeat([told.start_std**2, told.bias_std**2], 3))
    if K > 0.0:
        tau["biasForgettingTime"] = float((FORGOTTEN / np.degrees(K)) ** 2)
    eye = np.eye(3)
    combined = {
        "setGyroscopeCovariance": N**2 * eye,
        "setBiasOmegaCovariance": K**2 * eye,
        "setAccelerometerCovariance": given.density**2 * eye,
    }
    if given.accelerometer_walk is not None:
        combined["setBiasAccCovariance"] = given.accelerometer_walk**2 * eye
    return {
        "ahrs.filters.EKF": {"frequency": f, "noises": [N**2 * f, *directions]},
        "vqf.VQF": {"gyrTs": 1.0 / f, **tau,
                    "biasSigmaInit": float(np.degrees(told.bias_std))},
        "imufusion.AhrsSettings": {"gain": 1.0 / tau["tauAcc"]},
        "filterpy.kalman.KalmanFilter": {
            "Q": np.kron(Q, eye), "R": np.diag(np.repeat(R2, 3)), "P": start},
        "gtsam.PreintegrationCombinedParams": combined,
    }  # fmt: skip
