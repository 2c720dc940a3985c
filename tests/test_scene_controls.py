"""Negative controls: two scenes whose data no calibrator may accept."""

import json

import numpy as np
import pytest

from simval.calibrate import calibrate
from simval.calibrate.solver import METHODS
from simval.cli import run
from simval.errors import GeometryError, RefusedError
from simval.poses import observability
from simval.scene import simulate
from simval.sensor import AccelerometerModel

SENSOR = AccelerometerModel.from_parameters(
    np.array([0.03, -0.02, 0.05, 1.03, 0.96, 1.05, 0.3, -0.2, 0.1]), noise_std=0.01
)
RESIDUALS = ("squared", "norm", "weighted", "sampson")


@pytest.fixture(scope="module")
def cube():
    return simulate("cube", poses=30)


@pytest.fixture(scope="module", params=["centre", "offset"])
def falling(request):
    place = [0.0, 0.0, 0.0] if request.param == "centre" else None
    return simulate("freefall", site_offset=place)


@pytest.mark.ci
def test_the_cube_shows_six_directions_of_rank_six(cube):
    means = cube.hold_means() / cube.g
    assert observability(means).rank == 6
    faces = means[np.arange(len(means)), np.abs(means).argmax(axis=1)]
    # it lies flat: corner balls sink in equally, 1e-5 m of 6e-2 m
    assert np.abs(np.abs(faces) - 1.0).max() < 1e-6
    assert len(np.unique(np.round(means), axis=0)) == 6


@pytest.mark.parametrize("noise_std", [0.0, 0.01])
def test_the_cube_is_refused(cube, noise_std):
    sensor = AccelerometerModel(T=SENSOR.T, K=SENSOR.K, B=SENSOR.B, noise_std=noise_std)
    raw = sensor.distort(cube.specific_force, np.random.default_rng(1))
    with pytest.raises(GeometryError, match="faces of a cube"):
        calibrate(cube.hold_means(raw), g=cube.g)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("residual", RESIDUALS)
def test_free_fall_never_passes_for_a_calibration(falling, method, residual):
    raw = SENSOR.distort(falling.specific_force, np.random.default_rng(2))
    readings = raw[::250]
    with pytest.raises(RefusedError):
        calibrate(
            readings, g=falling.g, method=method, residual=residual
        ).require_converged()


@pytest.mark.ci
@pytest.mark.parametrize(
    ("name", "setting", "message"),
    [
        ("cube", "poses=12", "add poses between them"),
        ("freefall", "seconds=10", "static interval"),
    ],
)
def test_their_logs_are_refused_by_the_command(
    tmp_path, capsys, name, setting, message
):
    sensor = tmp_path / "sensor.json"
    values = {"T": SENSOR.T, "K": SENSOR.K, "B": SENSOR.B}
    plain = {key: value.tolist() for key, value in values.items()}
    sensor.write_text(json.dumps(plain | {"noise_std_raw": 0.01}))
    log = tmp_path / "log.csv"
    words = ["--sensor", str(sensor), "--out", str(log), "--set", setting]
    assert run(["scene", name, *words]) == 0
    capsys.readouterr()
    assert run(["calibrate", str(log)]) == 3
    assert message in capsys.readouterr().err
