"""A calibration as a record: labels, the place, and where its uncertainty is from."""

import json
import re
from dataclasses import replace

import click
import made_logs as logs
import numpy as np
import pytest

from simval.account.terminal import lines
from simval.cli import run
from simval.cli.calibrate import gravity_of
from simval.imu.calibrate import load_calibration, local_gravity
from simval.imu.logs import read_log
from simval.imu.multiposition import calibrate_log, calibrate_sensors
from simval.imu.multiposition.description import with_log
from simval.imu.multiposition.record import bound_sd, other_sources, sources
from simval.theory import calibration_moments

PLACE = ("--latitude", "46.5", "--height", "800")


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A log of three sensors."""
    return str(logs.of_scene(tmp_path_factory.mktemp("scene")))


def answered(capsys, *words):
    """JSON of a command."""
    assert run(["calibrate", *words, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_the_place_is_in_every_k_and_in_the_budget(scene, tmp_path, capsys):
    where, out = local_gravity(46.5, 800.0), tmp_path / "cal.json"
    told = answered(
        capsys, scene, *PLACE, "--out", str(out), "--label", "sensor=A7",
        "--label", "date=2026-11-29", "--label", "jig=3", "--sensors", "none",
        "--to", "ros", str(tmp_path / "imu.yaml"),
    )  # fmt: skip
    assert (told["g"], told["g_std"]) == tuple(where)[:2]
    assert told["labels"] == {"sensor": "A7", "date": "2026-11-29", "jig": "3"}
    assert re.fullmatch(r"[0-9a-f]{64}", told["sha256"])
    assert f"# gravity: {where.g:.5f} +- 0.00042" in (tmp_path / "imu.yaml").read_text()
    fit = load_calibration(out)
    assert fit.g_std == where.std
    parts = {each["source"]: each for each in told["budget"]}
    expected = where.std / where.g * np.r_[np.zeros(3), fit.K, np.zeros(3)]
    np.testing.assert_allclose(parts["gravity"]["sd"], expected, rtol=1e-12)
    total = np.hypot(parts["scatter"]["sd"], expected)
    np.testing.assert_allclose(total, told["sd"], rtol=1e-12)


def test_what_is_known_of_a_place_may_be_stated():
    with click.Context(click.Command("calibrate")):
        found = gravity_of(9.80665, 1e-5, 46.5, 800.0)
    assert (found.g, found.std) == (local_gravity(46.5, 800.0).g, 1e-5)


def test_a_record_is_seen_where_it_is_asked_for(scene):
    log = read_log(scene)
    found = calibrate_log(log, g=9.81, g_std=3e-3, predict=calibration_moments)
    whole = calibrate_sensors(log, found)
    account = with_log(whole.account, log)
    short = "\n".join(lines(account))
    everything = "\n".join(lines(account, verbose=True))
    assert len(lines(account)) <= 35
    for words in (
        "uncertainty budget",
        "correlations of the magnetometer",
        "gravity  ",
    ):
        assert words in everything
        assert words not in short
    assert "9.8100 ± 0.0030 m/s², in every K alike" in everything
    # all have one covariance; no error bar is below what gravity alone leaves
    assert np.all(bound_sd(whole)[3:6] > 3e-3 / 9.81 * np.abs(whole.accelerometer.K))
    own, P = whole.accelerometer, whole.together.covariance
    np.testing.assert_array_equal(own.covariance, P[:9, :9])
    assert np.all(own.sd[3:6] > 3e-3 / 9.81 * np.abs(own.K))
    # those of K are 306 ppm and more
    assert "scale factor 310 ppm" in short
    (table,) = (x for x in account.values if x.title == "uncertainty budget")
    rows = {x.label: np.array([cell.value for cell in x.cells]) for x in table.lines}
    # the noise is known: k of a normal law, of numbers with two digits
    ratio = rows["expanded, U"] / rows["together, u"]
    np.testing.assert_allclose(ratio, 1.96, rtol=0.1)
    # of the others by the inverse of the information, whose block is as if the
    # accelerometer's nine were known; gravity's scale is in none of their parameters
    exact = calibrate_sensors(log, calibrate_log(log, g=9.81))
    for each, other, count in (
        (whole.gyroscope, exact.gyroscope, 12),
        (whole.magnetometer, exact.magnetometer, 13),
    ):
        size = np.sqrt(np.diagonal(each.covariance))
        scaled = each.covariance / np.outer(size, size)
        known = np.linalg.inv(np.linalg.inv(scaled)[9:, 9:])
        scatter, carried, gravity = (x.sd for x in other_sources(each, count))
        alone = np.sqrt(np.diagonal(known)) * size[9:]
        np.testing.assert_allclose(scatter, alone, rtol=1e-6)
        np.testing.assert_allclose(np.hypot(scatter, carried), size[9:], rtol=1e-9)
        assert np.any(carried > 0.05 * scatter)
        np.testing.assert_allclose(each.sd[-count:], other.sd[-count:], rtol=1e-3)
        assert not gravity.any()
    parts = {each.name: each for each in sources(whole)}
    assert "of the accelerometer alone" in parts["noise"].words
    assert np.all(parts["resolution"].sd <= parts["noise"].sd)


def test_steps_of_the_readings_are_in_the_budget():
    """By a simulation: what rounding adds to the scatter of means that noise blurs."""
    made = logs.three(7, turning=False)
    log, (start, stop) = made.log, made.holds[5]
    step = log.accelerometer[start:stop].std(axis=0).mean()
    coarse = replace(log, accelerometer=np.round(log.accelerometer / step) * step)
    found = calibrate_log(coarse, predict=calibration_moments)
    parts = {each.name: each.sd for each in sources(found)}
    counts = np.diff(found.intervals)[:, 0]
    off = step / np.sqrt(12.0 * counts)
    ratio = np.sqrt(np.mean((off / found.pose_noise.std) ** 2))
    np.testing.assert_allclose(parts["resolution"], ratio * parts["noise"], rtol=0.05)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--latitude", "46"], "give both"),
        (["--height", "800"], "give both"),
        ([*PLACE, "--g", "9.81"], "one of the two"),
        (["--latitude", "46", "--height", "2e4"], "-500 to 9000"),
        (["--label", "sensor"], "KEY=VALUE"),
        (["--label", "a=1", "--label", "a=2"], "each name once"),
        (["--label", "=1"], "KEY=VALUE"),
    ],
)
def test_what_is_no_place_or_label_is_refused(scene, words, said, capsys):
    assert run(["calibrate", scene, *words]) == 2
    assert said in capsys.readouterr().err.replace("\n", " ")
