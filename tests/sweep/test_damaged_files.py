"""A damaged file of any kind that a user names: read with finite numbers, or refused.

Each reader has a file that it reads. Bytes are lost, changed and doubled in it; of a
document (JSON, TOML) values are taken out or replaced as well.
"""

import json
import tomllib

import numpy as np
import pytest
from log_formats import spelled
from scipy.spatial.transform import Rotation
from true_sensor import MODEL, G
from written import FILE, written

from simval.errors import SimvalError
from simval.imu.calibrate import calibrate, load_calibration, save_calibration
from simval.imu.logs import read_log, read_truth
from simval.imu.noise import load_noise
from simval.imu.sensor import NoiseModel, load_imu
from simval.poses import random_directions

VALUES = [None, True, "a", -1.0, 0, [], {}, [1.0], [[1.0, 2.0]], 1e308, float("nan"),
          float("inf"), {"T": 1}, [[float("nan")] * 3] * 3, 10**400, ["a", "b", "c"],
          [[0.0] * 3] * 3]  # fmt: skip
BYTES = [b"", b'",;', b"\x00", b"nan", b"1e999", b'"', b"((", b"[[0]", b"1_0", b"\n",
         b"\xff\xfe", b"{" * 50, b",," * 500]  # fmt: skip


def log(folder, rng, simval):
    (folder / "log").write_bytes(spelled(rng).content)


def truth(folder, rng, simval):
    q = Rotation.random(60, rng=rng).as_quat()
    written(folder / "truth", "t,qx,qy,qz,qs", 0.01 * np.arange(60.0), q)


def calibration(folder, rng, simval):
    poses = MODEL.distort(G * random_directions(30, rng), rng)
    fit = calibrate(poses + 1e-3 * rng.standard_normal(poses.shape), G)
    save_calibration(folder / "calibration", fit)


def noise(folder, rng, simval):
    rows = NoiseModel(white_raw_per_sqrt_hz=0.01).draw(600, 100.0, rng)
    rows[:, 2] += G
    path = written(folder / "still.csv", "ax,ay,az", rows)
    (folder / "noise").write_text(simval("noise", path, "--rate", 100, "--json")[1])


def sensors(folder, rng, simval):
    (folder / "sensors").write_text(FILE)


def sensors_json(folder, rng, simval):
    (folder / "sensors_json").write_text(json.dumps(tomllib.loads(FILE)))


READERS = {
    log: (read_log, lambda f: [f.accelerometer, np.diff(f.time)]),
    truth: (lambda path: read_truth(str(path)), lambda f: [np.diff(f.time)]),
    calibration: (load_calibration, lambda f: [f.matrix, f.B]),
    noise: (load_noise, lambda f: [a.variances for a in f.accelerometer]),
    sensors: (load_imu, lambda f: [f.accelerometer.matrix, f.accelerometer.B]),
    sensors_json: (load_imu, lambda f: [f.accelerometer.matrix, f.accelerometer.B]),
}


def some_bytes(content, rng):
    for _ in range(int(rng.integers(1, 6))):
        at = int(rng.integers(len(content) or 1))
        end = at + int(rng.integers(0, 30))
        pieces = [*BYTES, content[at // 2 : at]]
        content = content[:at] + pieces[rng.integers(len(pieces))] + content[end:]
    return content


def some_values(content, rng):
    values = json.loads(content)
    for _ in range(int(rng.integers(1, 4))):
        place = values
        while place and isinstance(place, dict):
            table, name = place, str(rng.choice([*place, "x"]))
            place = place.get(name) if rng.random() < 0.8 else None
        table[name] = VALUES[rng.integers(len(VALUES))]
        if rng.random() < 0.3:
            table.pop(name)
    return json.dumps(values).encode()


@pytest.mark.ci
@pytest.mark.parametrize("kind", READERS, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("trials", [100, pytest.param(2000, marks=pytest.mark.slow)])
def test_damage_ends_in_words_or_in_numbers(kind, trials, tmp_path, simval, unchecked):
    rng = np.random.default_rng([trials, len(kind.__name__)])
    reader, parts = READERS[kind]
    kind(tmp_path, rng, simval)
    path = tmp_path / kind.__name__
    if kind is sensors_json:
        path = path.rename(tmp_path / "sensors.json")
    content = path.read_bytes()
    reader(path)
    document = content.lstrip()[:1] == b"{"
    refused = []
    for _ in range(trials):
        change = some_values if document and rng.random() < 0.5 else some_bytes
        path.write_bytes(change(content, rng))
        try:
            found = reader(path)
        except SimvalError as error:
            refused.append(str(error))
            continue
        assert all(np.isfinite(each).all() for each in parts(found))
    assert len(refused) > trials / 10  # the damage is one
    for words in refused:
        assert path.name in words
        assert 20 < len(words) < 1500 + len(str(path))
