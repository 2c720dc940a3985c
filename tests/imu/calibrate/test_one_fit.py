"""One calibration, one set of numbers; and every yes or no is that of its test."""

import json
import re
from dataclasses import replace
from html import unescape

import made_logs as logs
import numpy as np
import pytest
import yaml
from places import recording

from simval.cli import run
from simval.imu.calibrate import load_calibration
from simval.imu.calibrate.values import G_NAMES
from simval.imu.logs import read_log
from simval.imu.multiposition import calibrate_log, calibrate_sensors
from simval.imu.multiposition.description import conditions, honest, with_log
from simval.imu.sensor import forms
from simval.theory import calibration_moments

FELT, PUSHED = 2, 7  # seeds of logs whose gyroscope is well


def force_felt(folder):
    made = logs.three(FELT, turning=False)
    force = made.accelerometer.correct(made.log.accelerometer)
    gyro = made.log.gyro + 2e-3 * force
    return written(replace(made.log, gyro=gyro), folder / "force.csv")


def pushed(folder):
    made = logs.three(PUSHED, turning=False)
    rows = made.log.accelerometer.copy()
    rows[slice(*made.holds[5])] *= 1.02  # along gravity, which a push across is not
    return written(replace(made.log, accelerometer=rows), folder / "pushed.csv")


def written(log, path):
    rows = np.hstack([log.time[:, None], log.accelerometer, log.gyro])
    header = "t,ax,ay,az,wx,wy,wz"
    np.savetxt(path, rows, delimiter=",", header=header, comments="")
    return [str(path)]


NONE = ("--sensors", "none")
LOGS = {
    "forces on the gyroscope": force_felt,
    "a rest that is pushed": pushed,
    "three sensors": lambda folder: [str(logs.of_scene(folder))],
    "Xsens": lambda folder: [str(recording("xsens/xsens_acc.mat")), *NONE],
}
HOLDS = {  # whether the error bars hold, by the answer at the end
    "forces on the gyroscope": (True,), "a rest that is pushed": (False,),
    "three sensors": (True, None),
}  # fmt: skip
NUMBER = r"(-?[\d.e+-]+)"
ROW = re.compile(rf"^  ([A-Za-z]\S*){4 * rf' +{NUMBER}'} ", re.MULTILINE)


def close(printed, value, digits):
    """Whether a number is a value to so many digits."""
    return float(printed) == pytest.approx(value, rel=0.51 * 10.0 ** (1 - digits))


def stated(data, fit):
    """Value and error bar of each parameter in the file, by sensor and name."""
    signs = forms.entries(fit.model)
    found = {
        ("accelerometer", name): (sign * value, sd)
        for (name, sign), value, sd in zip(signs, fit.parameters, fit.sd, strict=True)
    }
    own, compass = data.get("gyroscope"), data.get("magnetometer")
    if own is not None:
        for name, *pair in zip(own["names"], own["parameters"], own["sd"], strict=True):
            found["gyroscope", name] = tuple(pair)
        if np.any(own["G"]):
            G = np.ravel(own["G"]), np.ravel(own["G_sd"])
            for name, *pair in zip(G_NAMES, *G, strict=True):
                found["gyroscope", name] = tuple(pair)
    if compass is not None:
        for name, each in compass["parameters"].items():
            if name != "dip":
                found["magnetometer", name] = each["value"], each["sd"]
    return found


def check_terminal(text, data, numbers):
    """Every row of a table is a parameter of the file, once, and none is left out."""
    parameters, *_ = text.partition("uncertainty budget")
    parts = re.split(r"^(?=gyroscope  |magnetometer  )", parameters, flags=re.M)
    seen = []
    for part in parts:
        word = part.split()[0]
        sensor = word if word in ("gyroscope", "magnetometer") else "accelerometer"
        for name, value, sd, *_ in ROW.findall(part):
            if name != "dip":
                want = numbers[sensor, name]
                assert close(value, want[0], 8), (sensor, name)
                assert close(sd, want[1], 3), (sensor, name)
                seen.append((sensor, name))
    assert sorted(seen) == sorted(numbers)
    assert close(re.search(r"poses leave (\S+) mm", text)[1], 1e3 * data["rms"], 2)
    ratio = re.search(r"^chi-square +(\S+) per", text, re.MULTILINE)[1]
    assert close(ratio, data["chi2_per_dof"], 3)


def check_page(page, data, numbers):
    """The page's tables have the same digits, and its answers the same words."""
    page = page.replace("−", "-")
    for value, sd in numbers.values():  # in the unit of their row: mrad, 1e-3 of one
        units = (1.0, 1e3, 1e6, 1e9)
        assert any(
            f"{unit * value:.8g}" in page and f"{unit * sd:.3g}" in page
            for unit in units
        ), value
    for judged in data["judgements"]:
        assert judged["words"] in page


def check_kalibr(text, data, fit):
    imu, own = yaml.safe_load(text)["imu0"], data["gyroscope"]
    M = np.array(imu["accelerometers"]["M"])
    np.testing.assert_allclose(M @ fit.matrix, np.eye(3), atol=1e-12)
    turned = (np.array(imu["gyroscopes"][k]) for k in ("M", "C_gyro_i"))
    np.testing.assert_allclose(
        np.matmul(*turned) @ np.array(own["M"]), np.eye(3), atol=1e-12
    )
    felt = np.array(imu["gyroscopes"]["A"]) @ np.array(imu["gyroscopes"]["C_gyro_i"])
    np.testing.assert_allclose(felt, own["G"], atol=1e-15)
    for kind in ("noise_density", "random_walk"):  # a value, or what it is below
        for name in (f"accelerometer_{kind}", f"gyroscope_{kind}"):
            bound = re.search(rf"# {name}: not seen, below \d", text)
            assert name in imu or bound or "# noise: " in text, name


def check_corrected(path, log, data, fit):
    rows = np.loadtxt(path, delimiter=",", skiprows=1, max_rows=50)
    force = (log.accelerometer[:50] - fit.B) @ fit.matrix.T
    np.testing.assert_allclose(rows[:, 1:4], force, rtol=1e-9, atol=1e-12)
    if "gyroscope" in data:
        own = data["gyroscope"]
        rate = log.gyro[:50] - own["B"] - force @ np.transpose(own["G"])
        rate = rate @ np.transpose(own["M"])
        np.testing.assert_allclose(rows[:, 4:7], rate, rtol=1e-9, atol=1e-12)


def check_sentences(whole):
    """Each answer is that of its test, and the page and the file say no other."""
    found = conditions(whole)
    for each in found:
        if np.isfinite(each.p_value) and each.holds is not None:
            assert each.holds == (each.p_value >= each.level), each
    holds, said = honest(found)
    assert holds == (
        False
        if any(each.holds is False for each in found)
        else None
        if any(each.holds is None for each in found)
        else True
    )
    assert said.startswith({True: "Yes", False: "No", None: "Cannot tell"}[holds])
    text = " ".join(str(whole).split())
    assert f"{said}." in text
    for each in found:  # every one that does not hold is in the short view
        assert each.holds or (each.words in text and each.do in text)
    return holds


@pytest.mark.ci
@pytest.mark.parametrize("name", LOGS)
def test_a_calibration_is_one_fit_wherever_it_is_stated(name, tmp_path, capsys):
    """Terminal, file, JSON, page, Kalibr's file and `correct` hold the same numbers."""
    words = LOGS[name](tmp_path)
    out, page, imu = (tmp_path / k for k in ("out.json", "page.html", "imu.yaml"))
    ask = ["calibrate", *words, "--out", str(out), "--report", str(page)]
    kalibr = [] if name == "Xsens" else ["--to", "kalibr", str(imu)]
    assert run([*ask, *kalibr]) == 0
    text = capsys.readouterr().out
    assert run(["calibrate", *words, "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data == json.loads(out.read_text())
    log = read_log(words[0])
    if "--sensors" not in words:  # the command prints what Python prints
        result = calibrate_log(log, predict=calibration_moments)
        whole = calibrate_sensors(log, result)
        assert set(str(whole).splitlines()[2:]) <= set(text.splitlines())
        account = with_log(whole.account, log).as_object()
        assert account["answers"] == data["answers"]
        assert check_sentences(whole) in HOLDS[name]
    fit = load_calibration(out)
    numbers = stated(data, fit)
    assert len(numbers) >= (21 if kalibr else 9)
    assert run([*ask, "--verbose"]) == 0
    check_terminal(capsys.readouterr().out, data, numbers)
    check_page(unescape(page.read_text()), data, numbers)
    if kalibr:
        check_kalibr(imu.read_text(), data, fit)
    correct = ["correct", words[0], "--calibration", str(out)]
    assert run([*correct, "--out", str(tmp_path / "right.csv")]) == 0
    check_corrected(tmp_path / "right.csv", log, data, fit)
