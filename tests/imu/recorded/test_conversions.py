"""Settings for other projects: what each does with them, against the noise it is.

A project's use of a setting stands here by itself, from its source: see the module
`simval.imu.recorded.conversions`.
"""

import numpy as np
import pytest
import scipy
import yaml
from true_sensor import G

from simval.imu.recorded.conversions import Given, arguments, settings_file

FIELD = np.array([2e-5, 0.0, -4e-5])
N, K, FORCE, MAGNETIC, RATE = 2e-3, 3e-4, 0.05, 4e-7, 50.0
VECTORS = {"accelerometer": np.array([0.0, 0.0, G]), "magnetometer": FIELD}
DENSITIES = {"accelerometer": FORCE / RATE**0.5, "magnetometer": MAGNETIC / RATE**0.5}
START = np.repeat([0.05, 5e-3], 3) ** 2
GIVEN = Given({"N": N, "K": K} | DENSITIES, RATE, VECTORS, START)
_NO_FIELD = {k: v for k, v in GIVEN.noise.items() if k != "magnetometer"}
SIX = Given(_NO_FIELD, RATE, {"accelerometer": VECTORS["accelerometer"]}, START)


def numbers(project, given=GIVEN):
    """Settings by name of an autopilot's file."""
    text, _ = settings_file(project, given)
    rows = [line for line in text.splitlines() if line[0] != "#"]
    cells = [row.split("," if project == "ardupilot" else "\t") for row in rows]
    place = 0 if project == "ardupilot" else 2
    assert all(len(each) == (2 if project == "ardupilot" else 5) for each in cells)
    return {each[place]: float(each[place + 1]) for each in cells}


@pytest.mark.parametrize(
    ("project", "step", "reading", "names"),
    [
        (
            "px4",
            0.010,
            1 / 15,
            ("EKF2_GYR_NOISE", "EKF2_GYR_B_NOISE", "EKF2_MAG_NOISE"),
        ),
        (
            "ardupilot",
            0.012,
            0.1,
            ("EK3_GYRO_P_NSE", "EK3_GBIAS_P_NSE", "EK3_MAG_M_NSE"),
        ),
    ],
)
def test_an_autopilot_adds_the_noise_of_a_second(project, step, reading, names):
    """It adds (h p)^2 to an angle, or a bias, in each of 1/h steps a second."""
    found, (rate, walk, field) = numbers(project), names
    assert (step * found[rate]) ** 2 / step == pytest.approx(N**2)
    assert (step * found[walk]) ** 2 / step == pytest.approx(K**2)
    # a mean every so often, gauss: the variance of all of a second together
    assert (1e-4 * found[field]) ** 2 * reading == pytest.approx(MAGNETIC**2 / RATE)
    if project == "px4":  # of a unit vector, every step
        grav = found["EKF2_GRAV_NOISE"]
        assert (9.80665 * grav) ** 2 * step == pytest.approx(FORCE**2 / RATE)
    assert field not in numbers(project, SIX)


@pytest.mark.parametrize("project", ["kalibr", "openvins"])
def test_densities(project):
    text, notes = settings_file(project, GIVEN)
    assert text.startswith("%YAML") == (project == "openvins")  # as OpenCV asks
    found = yaml.safe_load(text.removeprefix("%YAML:1.0\n"))
    found = found["imu0"] if project == "openvins" else found
    assert found["gyroscope_noise_density"] == N
    assert found["gyroscope_random_walk"] == K
    density = found["accelerometer_noise_density"]
    assert density * np.sqrt(found["update_rate"]) == pytest.approx(FORCE)
    assert any("random_walk" in each for each in notes)


def test_ros_covariances():
    found = yaml.safe_load(settings_file("ros", GIVEN)[0])
    for name, variance in (
        ("angular_velocity", N**2 * RATE),
        ("linear_acceleration", FORCE**2),
        ("magnetic_field", MAGNETIC**2),
    ):
        held = np.reshape(found[f"{name}_covariance"], (3, 3))
        np.testing.assert_allclose(held, variance * np.eye(3), rtol=1e-12)


@pytest.mark.parametrize("project", ["px4", "ardupilot"])
def test_what_a_project_does_not_document_is_said(project):
    large = GIVEN._replace(noise=GIVEN.noise | {"N": 1.0})
    assert any("documented" in each for each in settings_file(project, large)[1])


def test_ahrs_takes_them():
    """The package's filter: a row's noise on the attitude, and on each reading."""
    filters = pytest.importorskip("ahrs.filters")
    ekf = filters.EKF(**arguments(GIVEN)["ahrs.filters.EKF"])
    directions = np.repeat([FORCE / G, MAGNETIC / np.linalg.norm(FIELD)], 3) ** 2
    np.testing.assert_allclose(np.diagonal(ekf.R), directions, rtol=1e-12)
    # with a reading that says nothing, what a row adds is left: four times the square
    # of half an angle, on three axes
    ekf.noises[1] = 1e12
    ekf.P = np.zeros((4, 4))
    q = np.array([1.0, 0.0, 0.0, 0.0])
    ekf.update(q, np.zeros(3), np.array([0.0, 0.0, G]))
    assert 4.0 * np.trace(ekf.P) / 3.0 == pytest.approx(N**2 / RATE, rel=1e-6)


def test_filterpy_has_the_step_of_the_noise():
    """Q by Van Loan's exponential of angle and bias, one axis."""
    found = arguments(GIVEN)["filterpy.kalman.KalmanFilter"]
    A, W = np.array([[0.0, -1.0], [0.0, 0.0]]), np.diag([N**2, K**2])
    block = np.block([[-A, W], [np.zeros((2, 2)), A.T]]) / RATE
    E = scipy.linalg.expm(block)
    Q = E[2:, 2:].T @ E[:2, 2:]
    np.testing.assert_allclose(found["Q"], Q, rtol=1e-10)
    assert found["R"] == pytest.approx([FORCE**2, MAGNETIC**2])
    six = arguments(SIX)["filterpy.kalman.KalmanFilter"]
    assert six["R"] == pytest.approx([FORCE**2])


def test_a_time_constant_is_that_of_the_constant_gain():
    """The gain of an angle's Kalman filter, by the Riccati equation."""
    found = arguments(GIVEN)["vqf.VQF"]
    level = np.hypot(*FIELD[:2])
    for name, r in (("tauAcc", FORCE / G), ("tauMag", MAGNETIC / level)):
        P = scipy.linalg.solve_discrete_are(1.0, 1.0, N**2 / RATE, r**2).item()
        gain = P / (P + r**2) * RATE
        # of small gains: the next term is half a row over the time constant
        assert found[name] * gain == pytest.approx(1.0, abs=1.0 / RATE / found[name])
    # of biasV: its deviation after the time, degrees/s
    time = found["biasForgettingTime"]
    assert np.degrees(K) * np.sqrt(time) == pytest.approx(0.1)
    assert arguments(GIVEN)["imufusion.AhrsSettings"]["gain"] == pytest.approx(
        1.0 / found["tauAcc"]
    )


def test_gtsam_has_continuous_covariances():
    assert arguments(GIVEN)["gtsam.PreintegrationCombinedParams"] == pytest.approx({
        "setGyroscopeCovariance": N**2, "setBiasOmegaCovariance": K**2,
        "setAccelerometerCovariance": FORCE**2 / RATE,
    })  # fmt: skip
