"""Six axes: a log without a magnetometer: frame, drift of heading, bound."""

import json
from dataclasses import replace

import numpy as np
import pytest
from filter_examples import GOOD
from places import recording
from recorded_logs import made, write_log
from test_recorded_alignment import readings

from simval.cli import run
from simval.errors import GeometryError, RefusedError
from simval.geometry import (
    attitude_error,
    compose,
    conjugate,
    from_rotation_vector,
)
from simval.imu.filters import Mekf
from simval.imu.filters.signals import FilterOutput
from simval.imu.recorded import align, evaluate
from simval.imu.recorded.errors import judged_once
from simval.imu.recorded.evaluation import (
    FilterRun,
    filter_input,
    from_its_start,
    in_view,
)
from simval.imu.recorded.settings import start_of
from simval.studies.filter_prediction import six_axis_bound

SIX = (
    GOOD.replace(", field, gyroscope_noise", ", gyroscope_noise")
    .replace(", magnetometer_noise):", "):")
    .replace("np.array([0.0, 0.0, gravity]), field", "(np.array([0.0, 0.0, gravity]),)")
    .replace("+ [magnetometer_noise**2] * 3", "")
    .replace("rate, force, field):", "rate, force):")
    .replace("H = np.zeros((6, 6))", "H = np.zeros((3, 6))")
    .replace(
        "H[:3, :3], H[3:, :3] = cross(p[0]), cross(p[1])", "H[:, :3] = cross(p[0])"
    )
    .replace("np.concatenate([force - p[0], field - p[1]])", "force - p[0]")
    .replace('"gravity", "field",', '"gravity",')
    .replace('"accelerometer_noise", "magnetometer_noise")', '"accelerometer_noise")')
    .replace('name="mine"', 'name="six", magnetometer=False')
)
BOLD = SIX.replace('"covariance": self.P.copy()', '"covariance": self.P / 100.0')
BOLD = BOLD.replace('name="six"', 'name="bold"')
GREEDY = SIX.replace('reads=("start",', 'reads=("start", "field",')
GREEDY = GREEDY.replace('name="six"', 'name="greedy"')
GREEDY = GREEDY.replace(
    "start_std, bias_std, gravity", "field, start_std, bias_std, gravity"
)


def six_axes(log):
    """Readings of a made log without its field."""
    return replace(readings(log), field=None)


@pytest.mark.ci
@pytest.mark.parametrize("world", [(0, 0, 0.7), (0, 0, 0), (np.pi, 0, 0)])
def test_the_frame_is_found_up_to_heading(world):
    log = made(5, seconds=40.0, rate=50.0, world=world)
    found = align(log.truth, six_axes(log))
    nine = align(log.truth, readings(log), "estimated")
    # clock and axes are the gyroscope's, and the same to the bit
    assert found.fit.offset == nine.fit.offset
    np.testing.assert_array_equal(found.rotation, nine.rotation)
    assert found.world.taken == "nearest"
    assert (found.world.name == "NED") == (world[0] != 0)
    assert found.world.heading_dof == 0
    assert np.isnan(found.world.half("heading"))
    there = np.isfinite(found.attitude[:, 0])
    q = from_its_start(found.attitude[there], log.attitude[there])
    # axes and noise of the truth, degrees of which some hundredths are left
    assert attitude_error(q, log.attitude[there]).max() < np.radians(0.3)


@pytest.mark.ci
def test_no_frame_is_claimed_that_a_log_does_not_bear():
    log = made(21, seconds=30.0, rate=50.0)
    rng, time = np.random.default_rng(1), log.time
    noise = 2e-3 * rng.standard_normal(log.gyro.shape)
    angle = np.sin(time) + 0.3 * np.sin(2.7 * time)
    one = from_rotation_vector(angle[:, None] * [0.0, 0.0, 1.0])
    rate = np.gradient(angle, time)[:, None] * [0.0, 0.0, 1.0]
    still = np.broadcast_to(log.attitude[:1], log.attitude.shape)
    shaken = from_rotation_vector(2e-4 * rng.standard_normal(log.gyro.shape))
    for gyro, q in ((rate + noise, one), (noise, still)):
        signals = replace(six_axes(log), gyro=gyro)
        for components in (q, compose(q, shaken)):
            truth = replace(log.truth, components=components)
            with pytest.raises((GeometryError, RefusedError)):
                align(truth, signals)
    tilted = made(3, seconds=30.0, rate=50.0, world=[0.6, 0.0, 0.0])
    with pytest.raises(RefusedError, match="--truth-world estimated"):
        align(tilted.truth, six_axes(tilted))
    assert align(tilted.truth, six_axes(tilted), "estimated").world.heading_dof == 0


@pytest.mark.ci
def test_a_drift_is_judged_as_one_error():
    """Brownian headings: false alarms within the rate of 1 %, power against 1 of 9."""
    rng = np.random.default_rng(8)
    paths = np.cumsum(rng.standard_normal((2000, 400)), axis=1)
    squares = paths**2 / np.arange(1.0, 401.0)
    alarms = [judged_once(each).verdict != "consistent" for each in squares]
    assert np.mean(alarms) <= 0.01
    found = [judged_once(100.0 * each).verdict == "overconfident" for each in squares]
    assert np.mean(found) > 0.6
    assert judged_once(np.array([np.nan])).verdict == "not judged"


@pytest.mark.slow
def test_the_reference_filter_is_at_the_bound_and_consistent():
    """Over 30 logs: mean squares over the bound's; NEES of inclination and drift."""
    noise, words, found = 2e-3, ("heading", "inclination"), []
    for k in range(30):
        log = made(400 + k, seconds=42.0, rate=100.0, bias=2e-3, gyro_noise=noise)
        signals = replace(six_axes(log), rate=100.0)
        alignment = align(log.truth, signals, "NWU")
        # the truth itself: what an alignment leaves is in other tests
        exact = replace(alignment.errors, rotation=np.zeros((3, 3)))
        attitude = log.attitude.copy()
        attitude[: 500 * (k % 2)] = np.nan  # every other begins late, still at rest
        alignment = replace(
            alignment, attitude=attitude, errors=exact, noise=np.zeros(3)
        )
        told = {"gyroscope_noise": noise / 10.0, "gyroscope_walk": 1e-5,
                "accelerometer_noise": 0.02, "bias_std": 2e-3}  # fmt: skip
        start = in_view(start_of(signals), signals, attitude)
        assert start.row == (500 if k % 2 else signals.rests[0][0])
        start = replace(start, told=replace(start.told, **told))
        given = filter_input(signals, start)
        told |= {"start_std": 3e-3, "gravity": start.told.gravity}
        said = Mekf(start=start.attitude, **told).update_rows(
            given.dt, given.gyroscope[0], given.accelerometer[0]
        )
        output = FilterOutput(
            kept=np.arange(start.row + 1, len(log.time)),
            attitude=said["attitude"][None], covariance=said["covariance"][None],
            bias=None, innovation=None, innovation_covariance=None, seconds=np.ones(1),
        )  # fmt: skip
        answers = FilterRun(
            name="own", world="NWU", how="", output=output, thinned=False, six=start
        )
        bound = six_axis_bound(signals, start, alignment)
        truth = evaluate(answers, signals, alignment, bound).truth
        over = [truth.rms["all"][w].value / bound["all"][w] for w in words]
        found.append([*np.square(over), truth.drift.mean, truth.nees.mean / 2.0])
    mean = np.mean(found, axis=0)
    spread = np.std(found, axis=0, ddof=1) / np.sqrt(len(found))
    assert (np.abs(mean - 1.0) < 4.0 * spread).all(), (mean, spread)
    # power: a bound, or a covariance, four times as large or as small is refused
    for factor in (0.25, 4.0):
        off = np.abs(factor * mean - 1.0) > 4.0 * factor * spread
        assert off.all(), (factor, mean, spread)


def test_the_bound_of_a_log_that_starts_level():
    """However near to level: the free heading is of no axis of the sensor."""
    log = made(5, seconds=20.0, rate=25.0, bias=2e-3)
    signals = replace(six_axes(log), rate=25.0)
    alignment = align(log.truth, signals, "NWU")
    start = start_of(signals)
    flat = compose(log.attitude, conjugate(log.attitude[start.row]))  # level there
    found = []
    for tilt in (0.0, 1e-12, 1e-9, 1e-8, 3e-8, 1e-6, 1e-4):
        turn = from_rotation_vector(np.array([0.6 * tilt, 0.8 * tilt, 0.0]))
        at = replace(alignment, attitude=compose(flat, turn))
        bound = six_axis_bound(signals, start, at)["all"]
        found.append([bound[word] for word in ("total", "heading", "inclination")])
    # the least is that of the rows' noise, by the same path to the tilt
    np.testing.assert_allclose(found, found[0] * np.ones((7, 1)), rtol=1e-3)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A log of six axes with truth, filters, and what a nine-axis one is."""
    folder = tmp_path_factory.mktemp("six")
    words = {"offset": 0.0, "bias": 2e-3, "truth_noise": 1e-4, "world": (0.0, 0.0, 0.7)}
    log = made(31, seconds=42.0, rate=25.0, **words)
    write_log(folder / "log.csv", log, field=False)
    sources = {"mine": GOOD, "six": SIX, "bold": BOLD, "greedy": GREEDY}
    for name, source in sources.items():
        (folder / f"{name}.py").write_text(source)
    return folder


@pytest.mark.slow
def test_a_log_of_six_axes_is_measured_and_a_nine_axis_filter_told_so(folder, capsys):
    plugins = [f"--plugin={folder / name}.py" for name in ("mine", "bold", "greedy")]
    words = [str(folder / "log.csv"), "--truth", "log", "--plugin", "simval:mekf-six"]
    paths = ["--out", str(folder / "out.json"), "--report", str(folder / "page.html")]
    code = run(["filter", *words, "--plugin", str(folder / "six.py"), *plugins, *paths])
    printed = capsys.readouterr()
    assert code == 3, printed.err
    found = json.loads((folder / "out.json").read_text())
    assert "magnetometer=False" in found["failed"]["mine"]
    assert "`field`" in found["failed"]["greedy"]
    ours, own, bold = found["filters"]
    assert ours["rms"]["all"]["total"]["value"] == pytest.approx(
        own["rms"]["all"]["total"]["value"], rel=0.02
    )
    for each in (ours, own):
        assert (each["nees"]["verdict"], each["nees"]["expected"]) == ("consistent", 2)
        # it drifts by less than the start's own standard deviation
        assert each["nees_of_drift"]["verdict"] == "not judged"
        assert each["heading_free"]
        # one log: inclination is white in seconds, heading has drifted once
        ratio = each["rms"]["all"]["inclination"]["value"]
        assert ratio / each["bound"]["all"]["inclination"] == pytest.approx(
            1.0, abs=0.2
        )
    assert bold["nees"]["verdict"] == "overconfident"
    assert found["told"]["field"] == [None] * 3
    assert found["truth"]["world"]["heading_half"] is None
    for line in ("heading since the first row with truth", "bound", "drift of 1"):
        assert line in printed.out
    assert "mine and greedy were not measured" in printed.out
    assert "nan" not in printed.out
    assert (
        "heading is free: its error is the drift" in (folder / "page.html").read_text()
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "trial", ["05_undisturbed_slow_rotation_with_breaks_B",
              "10_undisturbed_slow_translation_A"],
)  # fmt: skip
def test_a_recording_without_its_magnetometer(trial, capsys):
    path = recording(f"broad/{trial}.mat")
    words = ["filter", str(path), "--rate", "285.714286", "--truth", "opt_quat"]
    words += ["--columns", "wx,wy,wz,ax,ay,az" + 11 * ",-"]
    assert run([*words, "--plugin", "simval:mekf-six", "--json"]) == 0
    (each,) = json.loads(capsys.readouterr().out)["filters"]
    rms = each["rms"]["all"]
    assert each["heading_free"]
    # nobody is below the bound; the field is not asked, the gyroscope's bias is
    for word in ("heading", "inclination"):
        assert rms[word]["value"] > each["bound"]["all"][word]
    # acceleration is taken for tilt and for a bias, of which the filter is told nothing
    assert each["nees"]["verdict"] == "overconfident"
    assert np.degrees(rms["inclination"]["value"]) < 3.0
