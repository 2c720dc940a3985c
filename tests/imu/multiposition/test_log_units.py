"""Units and axes that a header states against what the readings show."""

import json
from dataclasses import replace

import numpy as np
import pytest
from places import recording
from sound_motions import HEADER, MOTIONS, log_of, sound, table, tumble
from written import written

from simval.cli import run
from simval.imu.logs import read_log
from simval.imu.multiposition.log_units import units_of
from simval.units import G0, OF_A_LOG

DEGREE = np.pi / 180.0
MIRROR = np.diag([1.0, 1.0, -1.0])
SWAP = np.eye(3)[[1, 0, 2]]
FAULTS = {  # of a sensor: what its readings are taken times, and what is said
    "accelerometer": [(1.0 / G0, "are in g"), (1e3 / G0, "are in mg"),
                      (0.5, "is 2 times"), (2.0, "is 0.5 times")],
    "gyro": [(1.0 / DEGREE, "are in deg/s"), (0.5, "is 2 times"),
             (2.0, "is 0.5 times"), (-MIRROR, "along -x, -y, z"),
             (MIRROR, "z has the wrong sign"), (SWAP, "x and y are exchanged")],
    "magnetometer": [(1e-2, "header says uT, but"), (1e3, "header says uT, but"),
                     (MIRROR, "left-handed: z has the wrong sign")],
}  # fmt: skip


def changed(log, sensor, by):
    rows = getattr(log, sensor)
    return replace(log, **{sensor: rows * by if np.ndim(by) == 0 else rows @ by.T})


def said(log, sensor=None, **how):
    found = units_of(log, **how)
    return [
        str(each)
        for name in found
        for each in found[name].said
        if sensor in (None, name)
    ]


@pytest.mark.ci
@pytest.mark.parametrize("motion", MOTIONS, ids=lambda motion: motion.__name__)
@pytest.mark.parametrize("count", [8, pytest.param(200, marks=pytest.mark.slow)])
def test_nothing_sound_is_accused(motion, count):
    # one log in a hundred may be doubted, an accelerometer whose bias is half a g
    accused = [words for seed in range(count) for words in said(sound(motion, seed))]
    assert len(accused) <= count // 100, accused


@pytest.mark.ci
@pytest.mark.parametrize("motion", [table, tumble], ids=lambda motion: motion.__name__)
@pytest.mark.parametrize("sensor", FAULTS)
def test_what_is_wrong_is_named(motion, sensor):
    # power: three of four logs that turn to all sides, and never another reason
    for by, words in FAULTS[sensor]:
        if motion is tumble and sensor == "accelerometer" and by in (0.5, 2.0):
            words = "one unit of the log is"  # its zero is not known
        found = [
            said(changed(sound(motion, seed, 0.3), sensor, by), sensor)
            for seed in range(4)
        ]
        named = [len(each) == 1 and words in each[0] for each in found]
        assert sum(named) >= 3, (by, found)
        assert all(named[k] or not found[k] for k in range(4)), (by, found)


@pytest.mark.parametrize("sensor", OF_A_LOG)
def test_every_unit_is_as_good_as_its_header(sensor):
    log, si = sound(table, 3, 0.3), {"magnetometer": 1e-6}.get(sensor, 1.0)
    kind = {"accelerometer": "force", "gyro": "gyro", "magnetometer": "mag"}[sensor]
    for unit, size in OF_A_LOG[sensor].items():
        rows = {name: getattr(log, name) for name in OF_A_LOG}
        rows[sensor] = rows[sensor] * si / size
        named = log_of(log.time, *rows.values(), HEADER | {kind: f"{{}} [{unit}]"})
        found = units_of(named)[sensor]
        assert (found.kind, found.unit, found.said) == ("agrees", unit, ())
        assert found.si_per_raw == size
        silent = log_of(log.time, *rows.values(), dict.fromkeys(HEADER, "{}"))
        assert units_of(silent)[sensor].unit == unit  # by the same evidence
        other = next(each for each in OF_A_LOG[sensor] if each != unit)
        assert units_of(named, {sensor: other})[sensor].kind == "contradicted"


COUNTS = {  # of the units of the logs, each nearly a unit
    "accelerometer": [G0 / 1024.0, G0 / 1365.0],
    "gyro": [DEGREE / 16.4],
    "magnetometer": [0.2],
}


@pytest.mark.parametrize("sensor", OF_A_LOG)
def test_counts_are_no_unit(sensor):
    log = sound(table, 0, 0.3)
    for count in COUNTS[sensor]:
        rows = np.round(getattr(log, sensor) / count)
        counts = replace(log, columns=(), **{sensor: rows})
        assert units_of(counts)[sensor].unit == ""
        assert units_of(replace(counts, **{sensor: rows + 0.25}))[sensor].unit != ""


def test_a_hemisphere_tells_a_mirrored_magnetometer():
    log = sound(table, 5, 0.2)
    mirrored = changed(log, "magnetometer", MIRROR)
    assert said(log) == []
    assert "(simval calibrate --hemisphere)." in said(mirrored)[0]
    # over poses all around, what the two vary together has the sign of field and up
    pairs = np.cov(log.accelerometer.T, log.magnetometer.T)[:3, 3:]
    north = bool(np.trace(pairs) < 0.0)
    for hemisphere, right in (("north", north), ("south", not north)):
        axes = units_of(log, hemisphere=hemisphere)["magnetometer"].axes
        words = said(mirrored, "magnetometer", hemisphere=hemisphere)
        assert (axes == "as stated") == right
        assert any("z has the wrong sign" in x for x in words) == right


@pytest.mark.parametrize("seed", range(3))
def test_odd_rows_are_no_crash(seed):
    rng = np.random.default_rng(seed)
    kinds = (
        lambda x: 0.0 * x, lambda x: 0.0 * x + 3.0, np.round, lambda x: 1e150 * x,
        lambda x: 1e-200 * x, lambda x: np.add(x, [0.0, 0.0, 32768.0]),
        lambda x: x * [1.0, 0.0, 1.0], lambda x: np.cumsum(x, axis=0),
        lambda x: x * (x > 0.5), lambda x: x,
    )  # fmt: skip
    for count in (2, 9, 30, 900):
        for _ in range(6):
            rows = [
                kinds[rng.integers(len(kinds))](rng.standard_normal((count, 3)))
                for _ in range(3)
            ]
            found = units_of(log_of(np.arange(count) / 10.0, *rows))
            assert set(found) == set(OF_A_LOG)


# the commands


@pytest.fixture(scope="module")
def gimbal(tmp_path_factory):
    """A log of the scene, in which the sensor moves more than it rests."""
    path = tmp_path_factory.mktemp("gimbal") / "log.csv"
    assert run(["scene", "gimbal", "--set", "poses=20", "--out", str(path)]) == 0
    return path


@pytest.mark.ci
def test_what_moves_hides_no_axes_of_a_magnetometer(gimbal):
    """Means in motion are shorter than the field, and lie on no ellipsoid."""
    log = read_log(str(gimbal))
    assert said(log) == []
    for by, words in ((MIRROR, "z has the wrong sign"), (SWAP, "x and y are exch")):
        (found,) = said(changed(log, "magnetometer", by))
        assert words in found


@pytest.mark.ci
def test_what_a_gyroscopes_rows_are_is_on_the_page(half, simval, tmp_path):
    page = tmp_path / "page.html"
    _, out, _ = simval("calibrate", half, "--verbose", "--report", page)
    (line,) = (line for line in out.splitlines() if line.startswith("gyroscope's rows"))
    assert " ".join(line.split()[2:7]) in " ".join(page.read_text().split())
    # and nothing is said of rows that are not there
    force = written(
        tmp_path / "force.csv",
        "t,ax,ay,az",
        sound(table, 0).time,
        sound(table, 0).accelerometer,
    )
    code, _, error = simval("calibrate", force, "--gyro-rows", "instant")
    assert (code, "has no gyroscope" in error) == (2, True)


@pytest.fixture(scope="module")
def half(tmp_path_factory):
    """Header g, range twice what it was taken for; the gyroscope's z is mirrored."""
    log = sound(table, 2, 0.2)
    rows = log.time, log.accelerometer / (2.0 * G0), log.gyro @ MIRROR / DEGREE
    head = "t [s],ax [g],ay [g],az [g],wx [rad/s],wy [rad/s],wz [rad/s]"
    return written(tmp_path_factory.mktemp("units") / "half.csv", head, *rows)


WRONG = (
    *("accelerometer: the header says g", "is 2 times what", "are in deg/s"),
    *("gyroscope: the header says rad/s", "z has the wrong sign"),
)


@pytest.mark.ci
def test_every_command_says_it(simval, half, tmp_path):
    fit, fixed = tmp_path / "fit.json", tmp_path / "fixed.csv"
    files = {name: tmp_path / name for name in ("px4", "ardupilot", "ros")}
    to = [word for name, path in files.items() for word in ("--to", name, path)]
    texts = [
        simval("noise", half),
        simval("calibrate", half, "--out", fit, *to),
        simval("correct", half, "--calibration", fit, "--out", fixed)[::2],
        simval("filter", half, "--plugin", "simval:mekf-six"),
        *((0, path.read_text()) for path in files.values()),
    ]
    for code, text, *_ in texts:
        assert code == 0, text
        for words in WRONG:
            assert words in " ".join(text.split()), (words, text)
    units = json.loads(fit.read_text())["units"]
    assert units["accelerometer"]["kind"] == units["gyro"]["kind"] == "contradicted"
    assert abs(units["accelerometer"]["factor"] - 2.0) < 0.2
    assert units["gyro"]["axes"] == "left-handed"
    # right-handed matrices alone are written for Kalibr
    code, _, err = simval("calibrate", half, "--to", "kalibr", tmp_path / "kalibr")
    assert (code, "right-handed" in err) == (2, True), err
    # what is written is for the unit that the readings show
    scale = [
        float(x.split("\t")[3])
        for x in files["px4"].read_text().splitlines()
        if "SCALE" in x
    ]
    np.testing.assert_allclose(scale, 1.0, atol=0.1)
    found = simval("filter", half, "--plugin", "simval:mekf-six", "--json")[1]
    assert all(words in str(json.loads(found)["units"]["said"]) for words in WRONG)
    noise = json.loads(simval("noise", half, "--json")[1])
    assert noise["units"]["gyro"]["unit"] == "deg/s"
    assert abs(noise["sensors"]["accelerometer"]["si_per_raw"] / G0 - 2.0) < 1e-12


@pytest.mark.ci
def test_axes_that_are_wrong_say_nothing_of_a_filter_or_a_motion(
    simval, half, tmp_path
):
    """Noise is no cure for them, no settings are right; a calibration mends both."""
    fit, six = tmp_path / "fit.json", ("--plugin", "simval:mekf-six")
    simval("calibrate", half, "--out", fit)
    code, text, *_ = simval("filter", half, *six)
    assert code == 0
    assert "First correct the units and axes" in " ".join(text.split())
    code, *texts = simval("tell", "--motion", half)
    assert (code, "z has the wrong sign" in "".join(texts)) == (2, True)
    code, *texts = simval("filter", half, *six, "--calibration", fit)
    assert (code, "wrong sign" in "".join(texts)) == (0, False)
    code, *_ = simval("tell", fit, "--motion", half, "--rate", "4")
    assert code == 0


RIGHT = [
    ("mpu9150/imu0.log", 100.0, {"accelerometer": "m/s^2", "gyro": "rad/s"}),
    ("mpu9150/imu1.log", 100.0, {"accelerometer": "m/s^2", "gyro": "rad/s"}),
    ("broad/05_undisturbed_slow_rotation_with_breaks_B.mat", None,
     {"accelerometer": "m/s^2", "gyro": "rad/s", "magnetometer": "uT"}),
    ("broad/10_undisturbed_slow_translation_A.mat", None,
     {"accelerometer": "m/s^2", "gyro": "rad/s", "magnetometer": "uT"}),
    ("mpu6050/static.csv", 100.0, {"gyro": repr(DEGREE / 131.0)}),
]  # fmt: skip


@pytest.mark.ci
@pytest.mark.parametrize(("name", "rate", "right"), RIGHT)
def test_recordings_bear_their_units(name, rate, right):
    log = read_log(recording(name), rate=rate)
    assert said(log, given=right) == []
    turns = units_of(log, right)["gyro"].kind == "agrees"
    assert turns is ("translation" not in name and "static" not in name)
    for sensor, unit in right.items():
        for other in OF_A_LOG[sensor]:
            if other != unit and (sensor == "accelerometer" or turns):
                wrong = units_of(log, right | {sensor: other})[sensor]
                near = {"uT", "mgauss"} == {unit, other}
                assert wrong.kind == "contradicted" or near, (sensor, other)
    if turns:
        assert (
            "y has the wrong sign"
            in said(changed(log, "gyro", np.diag([1.0, -1.0, 1.0])))[0]
        )
