"""A damaged file of any kind that a user names: read with finite numbers, or refused.

Each kind has a good file and what reads it. Bytes are lost, changed and doubled in it;
in JSON values are taken out or replaced as well. A damaged store of a run is in
`tests/sweep/test_store.py`.
"""

import json
import tomllib

import numpy as np
import pytest
from log_formats import spelled
from places import ROOT
from scipy.spatial.transform import Rotation
from true_sensor import MODEL, G
from written import FILE, written

from simval.errors import SimvalError
from simval.imu.calibrate import calibrate, load_calibration, save_calibration
from simval.imu.logs import read_log, read_truth
from simval.imu.multiposition import calibrate_log
from simval.imu.noise import load_noise
from simval.imu.sensor import NoiseModel, load_imu
from simval.judge import judge_run, read_baseline, write_baseline
from simval.plugins.calibrator_probe import probe_sensor
from simval.plugins.programs import log_of
from simval.poses import fibonacci_sphere, random_directions
from simval.scene.physics import load_model
from simval.sweep import load_run, load_suite

VALUES = [None, True, "a", -1.0, 0, [], {}, [1.0], [[1.0, 2.0]], 1e308, float("nan"),
          float("inf"), {"T": 1}, [[float("nan")] * 3] * 3, 10**400, ["a", "b", "c"],
          [[0.0] * 3] * 3]  # fmt: skip
BYTES = [b"", b'",;', b"\x00", b"nan", b"1e999", b'"', b"((", b"[[0]", b"1_0", b"\n",
         b"\xff\xfe", b"{" * 50, b",," * 500, b"9" * 400, b"[" * 5000, b'{"a":' * 5000,
         b"null", b"true", b"-0", b"<", b"&x;", b"=", b"'''", b"0x10"]  # fmt: skip


def log(path, rng, simval, run):
    path.write_bytes(spelled(rng).content)
    return read_log, lambda f: [f.accelerometer, np.diff(f.time)]


def tumble(path, rng, simval, run):
    sensor = probe_sensor()
    raw = sensor.distort(G * fibonacci_sphere(12), rng)
    written(path, "t,ax,ay,az", log_of(raw, 1e-4), form="{:.6f}")
    return lambda path: calibrate_log(read_log(path)).fit, lambda f: [f.matrix, f.B]


def truth(path, rng, simval, run):
    q = Rotation.random(60, rng=rng).as_quat()
    written(path, "t,qx,qy,qz,qs", 0.01 * np.arange(60.0), q)
    return lambda path: read_truth(str(path)), lambda f: [np.diff(f.time)]


def calibration(path, rng, simval, run):
    poses = MODEL.distort(G * random_directions(30, rng), rng)
    fit = calibrate(poses + 1e-3 * rng.standard_normal(poses.shape), G)
    save_calibration(path, fit)
    return load_calibration, lambda f: [f.matrix, f.B]


def noise(path, rng, simval, run):
    rows = NoiseModel(white_raw_per_sqrt_hz=0.01).draw(600, 100.0, rng)
    rows[:, 2] += G
    still = written(path.with_name("still.csv"), "ax,ay,az", rows)
    path.write_text(simval("noise", still, "--rate", 100, "--json")[1])
    return load_noise, lambda f: [a.variances for a in f.accelerometer]


def sensors(path, rng, simval, run):
    path.write_text(FILE)
    return load_imu, lambda f: [f.accelerometer.matrix, f.accelerometer.B]


def sensors_json(path, rng, simval, run):
    path.write_text(json.dumps(tomllib.loads(FILE)))
    return load_imu, lambda f: [f.accelerometer.matrix, f.accelerometer.B]


def baseline(path, rng, simval, run):
    write_baseline(path, load_run(run), "good")
    cells = load_run(run)

    def questions(content):  # a cell of another name is one of other noise
        return [(c.study, dict(c.parameters)) for c in content["cells"].values()]

    good = questions(read_baseline(path))

    def judged(path):
        content = read_baseline(path)
        if judge_run(cells, content).answer == "pass":
            assert all(each in good for each in questions(content))
        return content["cells"]

    return judged, lambda f: [[e.error for c in f.values() for e in c[2].values()]]


def suite(path, rng, simval, run):
    path.write_text(
        'title = "Good"\nseed = [1, 2]\n\n[attitude]\nnoise_std = [0.01, 0.02]\n'
        "samples = 65536\n\n[calibration]\nnoise_std = 0.01\nposes = 12\n"
        '\n[estimator]\nalgorithm = "plugin.py"\n'
    )
    return lambda path: load_suite(str(path)), lambda f: [len(f.cells)]


def model_xml(path, rng, simval, run):
    path.write_bytes((ROOT / "models" / "gimbal.xml").read_bytes())
    return lambda path: load_model(path, None, None, None), lambda f: []


KINDS = (
    *(log, tumble, truth, calibration, noise, sensors, sensors_json),
    *(baseline, suite, model_xml),
)
NAMED = set(KINDS) - {tumble}  # a refused fit speaks of its poses


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
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("trials", [60, pytest.param(1500, marks=pytest.mark.slow)])
def test_damage_ends_in_words_or_in_numbers(
    kind, trials, tmp_path, simval, tiny_run, unchecked
):
    rng = np.random.default_rng([trials, len(kind.__name__)])
    path = tmp_path / kind.__name__.replace("_", ".")
    reader, parts = kind(path, rng, simval, tiny_run)
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
        assert path.name in words or kind not in NAMED
        assert 20 < len(words) < 1500 + len(str(path))
