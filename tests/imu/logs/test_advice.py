"""What a message of the reader advises is done, and helps."""

import re
import shlex

import numpy as np
import pytest
from written import written

from simval.errors import InputError
from simval.imu.calibrate import calibrate
from simval.imu.calibrate.files import to_json, write_json
from simval.imu.logs.truth import read_truth
from simval.poses import fibonacci_sphere

ROWS, RATE = 300, 100.0
TIME = np.arange(ROWS) / RATE
FORCE = np.random.default_rng(4).normal([0.1, -0.2, 9.8], 0.01, (ROWS, 3))
OTHER = FORCE[::-1] + 0.3
WORDS = np.full((ROWS, 1), "x7", dtype=object)
EMPTY = np.full((ROWS, 3), "nan", dtype=object)
COARSE, EARLY = np.floor(TIME * 20.0) / 20.0, np.arange(ROWS) < 150
SPOILT = np.array(OTHER, dtype=object)
SPOILT[7, 1] = "oops"
WARM = np.where(EARLY, 300.0, np.nan)
ZONED = [f"2024-03-31 0{1 if early else 3}:{59 * early:02d}:" for early in EARLY]
SECONDS = [f"{58.5 + t if t < 1.5 else t - 1.5:05.2f}" for t in TIME]
DATES = [day + second for day, second in zip(ZONED, SECONDS, strict=True)]
PRINTED = r"--(?:until|from|instance|columns) [^\s;)]*[^\s;),.]"

CASES = {
    # a header and its columns, the options given, what is said, and what is done then:
    # the options that are printed, or those that the words mean
    "no clock": ("ax,ay,az", [FORCE], "", "(--rate)", ["--rate 100"]),
    "unknown clock": (
        "foo,ax,ay,az", [TIME, FORCE], "", "name the time column `t`",
        ["--rate 100", "--columns t,ax,ay,az"],
    ),
    "clock in words": (
        "t,ax,ay,az", [WORDS, FORCE], "", "leave the column out",
        ["--columns -,ax,ay,az --rate 100"],
    ),
    "unit of the clock": (
        "t,ax,ay,az", [1e3 * TIME, FORCE], "", "what is its unit?",
        ["--columns t[ms],ax,ay,az", "--rate 100", "--columns -,ax,ay,az --rate 100"],
    ),
    "coarse clock": (
        "t [s],ax,ay,az", [COARSE, FORCE], "", "too coarse for its rows",
        ["--columns -,ax,ay,az --rate 100"],
    ),
    "slow clock": (
        "t [s],ax,ay,az", [1e3 * TIME, FORCE], "", "mark its column -",
        ["--columns -,ax,ay,az --rate 100"],
    ),
    "summer time": (
        "t,ax,ay,az", [np.array(DATES, dtype=object), FORCE], "",
        "the part before it or after it", [],
    ),
    "no sensor's name": (
        "", [TIME, FORCE], "--instance imu", "leave out --instance", [""],
    ),
    "two sensors": (
        "t,imu1_ax,imu1_ay,imu1_az,imu2_ax,imu2_ay,imu2_az", [TIME, FORCE, OTHER], "",
        "2 accelerometers", [],
    ),
    "none of the sensors": (
        "t,imu1_ax,imu1_ay,imu1_az,imu2_ax,imu2_ay,imu2_az", [TIME, FORCE, OTHER],
        "--instance imu3", "give its name", ["--instance imu1", "--instance imu2"],
    ),
    "no reading": (
        "t,a,b,c,d,e,f", [TIME, EMPTY, FORCE], "--columns t,ax,ay,az,-,-,-",
        "name other columns", ["--columns t,-,-,-,ax,ay,az"],
    ),
    "a part without a clock": (
        "ax,ay,az", [FORCE], "--from 1", "(--rate)", ["--rate 100 --from 1"],
    ),
    "temperature with a hole": (
        "t,ax,ay,az,temp", [TIME, FORCE, WARM], "--columns t,ax,ay,az,temp",
        "leave the column out", ["--columns t,ax,ay,az,-"],
    ),
    "temperature of no unit": (
        "t,ax,ay,az,temp", [TIME, FORCE, np.full(ROWS, 300.0)],
        "--columns t,ax,ay,az,temp", "name the column with its unit",
        ["--columns t,ax,ay,az,temp[K]"],
    ),
    "names of another number": (
        "t,ax,ay,az,wx", [TIME, FORCE, OTHER], "", "name them with --columns",
        ["--columns t,ax,ay,az,-,-,-"],
    ),
    "a word among numbers": (
        "t,ax,ay,az,wx,wy,wz", [TIME, FORCE, SPOILT], "", "leave that column out",
        ["--columns t,ax,ay,az,-,-,-"],
    ),
    "no names": ("", [TIME, FORCE, OTHER[:, :1]], "", "so name them", []),
    "a clock first": (
        "", [TIME, FORCE, OTHER[:, :2]], "", "as a clock does", [],
    ),
}  # fmt: skip


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """A calibration to correct with, which is the shortest use of a log."""
    path = tmp_path_factory.mktemp("fit") / "c.json"
    noise = np.random.default_rng(1).normal(0.0, 1e-3, (24, 3))
    write_json(path, to_json(calibrate(9.8 * fibonacci_sphere(24) + noise)))
    return path


@pytest.mark.parametrize("name", CASES)
def test_what_is_advised_is_done_and_helps(name, fitted, tmp_path, simval):
    header, columns, given, said, done = CASES[name]
    path = tmp_path / "log.csv"
    written(path, header, *columns, form="{}")
    words = "correct", path, "--calibration", fitted, "--out", tmp_path / "o.csv"
    code, _, err = simval(*words, *given.split())
    assert code == 2
    assert said in err
    printed = re.findall(PRINTED, err.splitlines()[-1])
    assert printed or done
    for options in done or printed:
        code, _, err = simval(*words, *shlex.split(options))
        assert code == 0, (options, err)


def test_two_temperatures_and_one_is_chosen(fitted, tmp_path, simval):
    warm = np.column_stack([np.linspace(20.0, 21.0, ROWS), np.linspace(30, 31, ROWS)])
    path = written(tmp_path / "a.csv", "t,ax,ay,az,temp_a,temp_b", TIME, FORCE, warm)
    words = "correct", path, "--calibration", fitted, "--out", tmp_path / "o.csv"
    code, out, err = simval(*words)
    assert code == 0
    assert "Choose by --columns with temp" in out + err
    code, out, err = simval(*words, "--columns", "t,ax,ay,az,-,temp")
    assert code == 0
    assert "30.00 to 31.00 degC" in out + err


HALF = np.sqrt(0.5)
TURNED = np.column_stack(
    [np.full(ROWS, HALF), np.zeros((ROWS, 2)), np.full(ROWS, HALF)]
)


@pytest.mark.parametrize(
    ("header", "columns", "given", "said", "done"),
    [
        ("t,p_qx,p_qy,p_qz,p_qw,r_qx,r_qy,r_qz,r_qw", [TIME, TURNED, TURNED], {},
         "(--truth NAME)",
         [{"stem": "p_q"}, {"columns": "t,-,-,-,-,qx,qy,qz,qs"}]),
        ("t,a,b,c,d", [TIME, TURNED], {}, "say what each column is",
         [{"columns": "t,q0,q1,q2,q3"}]),
        ("t,a,b,c,d", [TIME, TURNED], {"columns": "t,qx,qy,qz,-"},
         "q0, q1, q2, q3", [{"columns": "t,q0,q1,q2,q3"}]),
        ("t,q0,q1,q2,q3,e,f,g,h", [TIME, 2.0 * TURNED, TURNED], {},
         "give other columns", [{"columns": "t,-,-,-,-,q0,q1,q2,q3"}]),
        ("t,q0,q1,q2,q3,e,f,g,h", [TIME, 0.0 * TURNED, TURNED], {},
         "look at the columns", [{"columns": "t,-,-,-,-,q0,q1,q2,q3"}]),
        ("foo,q0,q1,q2,q3", [TIME, TURNED], {}, "time column `t` (--truth-columns)",
         [{"rate": RATE}, {"columns": "t,q0,q1,q2,q3"}]),
    ],
)  # fmt: skip
def test_what_is_advised_for_a_truth_helps(
    header, columns, given, said, done, tmp_path
):
    path = str(written(tmp_path / "truth.csv", header, *columns))
    with pytest.raises(InputError, match=re.escape(said)):
        read_truth(path, **given)
    for options in done:
        assert len(read_truth(path, **options).components) == ROWS


def test_of_several_truths_of_a_folder_one_is_given(tmp_path):
    for name in ("vicon0", "vicon1"):
        (tmp_path / name).mkdir()
        header = "t [s],q_RS_w,q_RS_x,q_RS_y,q_RS_z"
        written(tmp_path / name / "data.csv", header, TIME, TURNED)
    with pytest.raises(InputError, match=r"give one \(--truth FILE\)") as refusal:
        read_truth(str(tmp_path))
    file = re.search(r"truths, (\S+),", str(refusal.value))[1]
    assert len(read_truth(file).components) == ROWS
