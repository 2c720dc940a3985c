"""One page of each kind that simval writes, made in a minute: what people open."""

import shutil

import numpy as np
from places import ROOT
from stores import edited

from simval.cli import run

EXAMPLES = ROOT / "docs" / "examples"

SUITE = """
title = "One of each"
question = "How <many> poses?"
seed = [1]

[[need]]
quantity = "calibration.rms[B]"
below = "0.3 mm/s^2"

[scene]
poses = 12

[calibration]
noise_std = [0.0, 0.01, 0.03]
poses = [12, 20]
hold_time = 0.02
trials = 1024

[attitude]
noise_std = [0.01, 0.02]
samples = 65536

[end_to_end]
poses = 12
attitudes = 6
trials = 256
"""

OWN = """
title = "Algorithms of a user"
seed = [1]

[filter]
trials = 16
seconds = 4.0
"""

SENSOR = """
T = [[1, 0, 0], [0.01, 1, 0], [-0.02, 0.03, 1]]
K = [0.0024, 0.0025, 0.0023]
B = [32768, 32700, 32810]
noise_std_raw = 4.0

[gyroscope]
T = [[1, 0.01, 0], [0, 1, 0.02], [-0.01, 0, 1]]
K = [1.1e-3, 1.1e-3, 1.1e-3]
B = [12, -30, 5]
white_raw_per_sqrt_hz = 0.15

[magnetometer]
T = [[1, 0.02, 0], [0.01, 1, 0], [0, 0, 1]]
K = [1e-7, 1e-7, 1e-7]
B = [40, -20, 10]
noise_std_raw = 1.0
"""

# broken in one family only, so that passes and fails stand side by side
BROKEN = (
    "UPDATE rows SET value = value + 20 * standard_error "
    "WHERE family = 'bias' AND controlled = 0 AND entries = json_array('x')"
)


def every_page(folder):
    """Paths of the pages by name, all written by the commands that a user runs."""
    suite = folder / "suite.toml"
    suite.write_text(SUITE)
    (folder / "own.toml").write_text(OWN)
    sound, broken, own = (folder / name for name in ("sound", "broken", "own"))
    _run("sweep", suite, "--out", sound, "--quiet")
    shutil.copytree(sound, broken)
    edited(broken, BROKEN)
    plugins = [
        word
        for name in ("align.py", "ellipsoid.py", "complementary.py")
        for word in ("--plugin", EXAMPLES / name)
    ]
    _run("sweep", folder / "own.toml", "--out", own, "--quiet", *plugins)
    pages = {
        name: folder / f"{name}.html"
        for name in ("sound", "failing", "algorithms", "compared")
    }
    _run("report", sound, "--out", pages["sound"])
    _run("report", broken, "--out", pages["failing"])
    _run("report", own, "--out", pages["algorithms"])
    _run("compare", sound, broken, "--out", pages["compared"])
    for name, words in log_commands(folder).items():
        pages[name] = folder / f"{name}.html"
        _run(*words, "--report", pages[name])
    return pages


def log_commands(folder):
    """Commands that write a page of a log: five logs, with faults and without."""
    log, odd, blind, quiet, stuck = (
        folder / name
        for name in (
            "log <b> & c.csv",
            "odd.csv",
            "blind.csv",
            "still.csv",
            "stuck.csv",
        )
    )
    (folder / "imu.toml").write_text(SENSOR)
    signal = ["--sensor", folder / "imu.toml", "--out", log, "--every", "10"]
    _run("scene", "gimbal", *signal, "--set", "poses=20", "--set", "move_time=3")
    header, rows = log.read_text().partition("\n")[::2]
    rows = np.loadtxt(rows.splitlines(), delimiter=",")
    _write(blind, header.split(",true")[0], rows[:, :10])
    still = rows[:, header.split(",").index("rest")]
    rests = np.split(np.arange(len(rows)), np.flatnonzero(np.diff(still)) + 1)
    leant = next(rest for rest in rests[10:] if still[rest[0]])  # somebody leant on it
    rows[leant, 1:4] += [20.0, 0.0, 0.0]
    _write(odd, header.split(",wx")[0], rows[:, :4])
    _write_still(quiet, stuck)
    found = folder / "calibration.json"
    _run("calibrate", log, "--out", found)
    own = ["--plugin", EXAMPLES / "complementary.py", "--calibration", found]
    return {
        "calibrated": ("calibrate", log, "--verbose"),
        "outlier": ("calibrate", odd, "--verbose"),
        "filtered": ("filter", log, "--plugin", "simval:mekf", *own, "--truth", "log"),
        "blind": ("filter", blind, *own),
        "noise": ("noise", quiet, "--gyro-unit", "1e-3"),
        "stuck": ("noise", stuck),
    }


def _run(*words):
    code = run([str(word) for word in words])
    assert code in (0, 1), (code, words)


def _write_still(still, stuck):
    """Logs at rest with white noise and a walk of the bias, raw counts; one stuck."""
    rng = np.random.default_rng(5)
    n = 20_000
    white = 5.0 * rng.standard_normal((n, 6))
    walk = 0.02 * np.cumsum(rng.standard_normal((n, 6)), axis=0)
    rows = np.column_stack([np.arange(n) / 100.0, white + walk])
    rows[:, 3] += 4096.0
    _write(still, "t,ax,ay,az,wx,wy,wz", rows)
    rows[:, 4:] = 3.0
    _write(stuck, "t,ax,ay,az,wx,wy,wz", rows[:6000])


def _write(path, header, rows):
    np.savetxt(path, rows, delimiter=",", header=header, comments="", fmt="%.8g")
