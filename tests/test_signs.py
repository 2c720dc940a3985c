"""T is printed as it stands in the file: S_zx is minus its entry."""

import json
import re

import numpy as np

from simval.imu.sensor import AccelerometerModel

G = 9.80665


def test_the_command_prints_the_entry_of_T(tmp_path, simval):
    rng = np.random.default_rng(3)
    sensor = AccelerometerModel.from_parameters(
        np.array([0.01, 0.02, 0.03, 1.0, 1.0, 1.0, 0.1, 0.2, 0.3]), noise_std=0.005
    )
    u = rng.standard_normal((24, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    rows = []
    for direction in u:
        rows += [np.tile(G * direction, (300, 1)), 9 * rng.standard_normal((60, 3))]
    np.savetxt(tmp_path / "log.txt", sensor.distort(np.vstack(rows), rng))
    how = ("calibrate", tmp_path / "log.txt", "--rate", 100)
    code, out, err = simval(*how)
    assert code == 0, err
    shown = re.search(r"misalignment, mrad.*T\[2\]\[0\] (-\d+\.\d+) ±", out)
    assert abs(float(shown[1]) + 20.0) < 5.0  # T[2][0] = -S_zx
    out = simval(*how, "--verbose")[1]
    # of the correlations there is another
    line = next(x for x in out.splitlines() if x.startswith("  T[2][0]"))
    value, low, high = (float(line.split()[i]) for i in (1, 3, 4))
    assert abs(value + 0.02) < 0.005
    assert low < value < high
    assert out.count("S_zx") == out.count("S_zx, is -T[2][0]") == 1
    rows = out.partition("with T =")[2].splitlines()[1:4]
    T = np.array([row.split() for row in rows], dtype=float)
    # of sigma 2e-5 the wrong sign is 0.04 away: a quarter of S_zx tells them apart
    assert abs(T[2, 0] + 0.02) < 0.005


def test_a_plan_says_entries_of_the_matrix(simval):
    """The bias of T[2][0] is minus that of S_zx, which JSON keeps."""
    words = ("plan", "--poses", "fibonacci:20", "--noise-std", "0.1")
    code, out, _ = simval(*words, "--verbose")
    assert code == 0
    assert "S_zx" not in out
    line = [line for line in out.splitlines() if "T[2][0]" in line][-1]
    plain = json.loads(simval(*words, "--json")[1])
    place = plain["names"].index("S_zx")
    bias = float(f"{-plain['bias'][place]:.2g}")
    assert float(line.split()[3]) == bias
