"""Calibration files: what is refused in them, and which readings they are for."""

import json

import numpy as np
import pytest
from rounding import EPS
from true_sensor import MODEL, G

from simval.errors import ConvergenceError, InputError, RefusedError, SimvalError
from simval.imu.calibrate import calibrate, load_calibration, save_calibration
from simval.imu.calibrate.files import (
    from_json,
    load_others,
    require_same_sensor,
    rest_forces,
    to_json,
)
from simval.imu.sensor import MODELS, AccelerometerModel
from simval.poses import fibonacci_sphere

# What a calibration's round trip keeps is in `test_fits`.


def fit(model="triangular", n=12):
    clean = MODEL.distort(G * fibonacci_sphere(n), np.random.default_rng(0))
    noise = np.random.default_rng(1).standard_normal((n, 3))
    return calibrate(clean + 0.01 * noise, G, model)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is not JSON"),
        ("[1, 2]", "is not a calibration file"),
        ('{"format": "simval calibration 1"}', "lacks 'model'"),
        ("[" * 100_000, "is not JSON"),
        ('{"B": [1, 2, 3], "B": [0, 0, 0]}', "'B' is given twice"),
    ],
)
def test_files_that_are_no_calibration(tmp_path, text, words):
    path = tmp_path / "bad.json"
    path.write_text(text)
    with pytest.raises(InputError, match=words):
        load_calibration(path)
    with pytest.raises(InputError, match="cannot write"):
        save_calibration(tmp_path / "no" / "c.json", fit())


FACTORS = {"K": [1.0, 1.0, 1.0], "B": [0.0, 0.0, 0.0]}
SHEARED = [[1, 0.1, 0], [0.1, 1, 0], [0, 0, 1]]


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (to_json(fit()) | {"model": "lower"}, "model"),
        (to_json(fit()) | {"parameters": [1, 2]}, "parameters"),
        (to_json(fit()) | {"parameters": [None] * 9}, "not finite"),
        (to_json(fit()) | {"g": -1.0}, "`g`"),
        (to_json(fit()) | {"dof": float("inf")}, "dof"),
        (FACTORS | {"T": SHEARED}, "`T` is"),
        *(
            ({k: v for k, v in (FACTORS | {"T": np.eye(3).tolist()}).items() if k != n},
             f"lacks .*'{n}'")
            for n in "TKB"
        ),
    ],
)  # fmt: skip
def test_wrong_values(data, words):
    with pytest.raises(InputError, match=words):
        from_json(data)


def leaves(value, path=()):
    if not isinstance(value, list):
        yield path
        return
    for index, entry in enumerate(value):
        yield from leaves(entry, (*path, index))


def ignored_edits(rng, count):
    """Edits of one value anywhere that neither count nor are refused."""
    words = [*MODELS, "norm", "lm", "type A", "none", "stalled", "S_yx", "g", "x"]
    found = []
    fits = [to_json(fit(model, n)) for model in MODELS for n in (9, 12)]
    for _ in range(count):
        data = json.loads(json.dumps(fits[rng.integers(len(fits))]))
        key = str(rng.choice(list(data)))
        paths = list(leaves(data[key]))
        place = (key, *paths[rng.integers(len(paths))])
        holder = data
        for step in place[:-1]:
            holder = holder[step]
        old = holder[place[-1]]
        if isinstance(old, str):
            new = str(rng.choice(words))
        elif isinstance(old, int):
            new = old + int(rng.integers(1, 5))
        else:
            by = rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-5, 1)
            new = (old or 0.0) * (1.0 + by) + (0.0 if old else by)
        holder[place[-1]] = new
        try:
            back = to_json(from_json(data))
        except SimvalError:
            continue
        for step in place:
            back = back[step]
        if back != new:
            found.append((place, old, new))
    return found


@pytest.mark.ci
@pytest.mark.parametrize("count", [100, pytest.param(2000, marks=pytest.mark.slow)])
def test_no_edit_is_ignored(count):
    """It was for B, K and T: the file said one thing and meant another."""
    assert ignored_edits(np.random.default_rng(11), count) == []


def test_statements_may_be_left_out():
    data = to_json(fit())
    whole = from_json(data)
    for kept in (("T", "K", "B"), ("model", "parameters"), ("T", "K", "B", "g")):
        part = from_json({name: data[name] for name in kept})
        np.testing.assert_array_equal(part.matrix, whole.matrix)
        np.testing.assert_array_equal(part.B, whole.B)
        assert part.require_converged().covariance_kind == "none"
    # copied with six digits, as a person does
    rounded = [[float(f"{x:.6g}") for x in row] for row in data["matrix"]]
    from_json(data | {"matrix": rounded})


BAD = [
    1, [], {}, {"M": [[1, 0], [0, 1]], "B": [0, 0, 0]},
    {"M": [[0] * 3] * 3, "B": [0] * 3, "b": [0] * 3},
    {"M": [["a"] * 3] * 3, "B": [0] * 3, "b": [0] * 3},
]  # fmt: skip


@pytest.mark.parametrize("name", ["gyroscope", "magnetometer"])
@pytest.mark.parametrize("block", BAD)
def test_a_damaged_block_of_another_sensor_is_refused(tmp_path, name, block):
    path = tmp_path / "imu.json"
    path.write_text(json.dumps({name: block}))
    with pytest.raises(InputError, match=str(path)):
        load_others(path)


# the command that applies a calibration


def test_correct_applies_the_calibration(simval, tmp_path):
    """Rows without a clock and with three columns more; that the output is M (y - B) is
    `test_one_fit`'s."""
    one, rng, log = fit("upper"), np.random.default_rng(2), tmp_path / "log.txt"
    # the output of `calibrate` holds more than a calibration
    (tmp_path / "c.json").write_text(json.dumps(to_json(one) | {"intervals": 12}))
    raw = MODEL.distort(rng.normal(size=(50, 3)) * 5, rng)
    np.savetxt(log, np.hstack([raw, rng.normal(size=(50, 3))]), fmt="%.17g")
    words = ["correct", log, "--calibration", tmp_path / "c.json", "--rate", "100"]
    words += ["--columns", "ax,ay,az,wx,wy,wz"]  # which noise cannot tell
    code, out, _ = simval(*words)
    assert code == 0
    header, *lines = out.splitlines()
    rows = np.array([line.split(",") for line in lines], dtype=float)
    assert (header[:10], rows.shape[1]) == ("t,ax,ay,az", 7)
    # written with all digits, computed alike: equal to some eps of 12
    expected = (raw - one.B) @ one.matrix.T
    np.testing.assert_allclose(rows[:, 1:4], expected, rtol=0, atol=4 * EPS * 16)
    # and what it refuses
    assert simval("correct", log)[0] == 2
    code, _, said = simval(*words[:3], tmp_path / "no.json", *words[4:])
    assert (code, "no.json" in said) == (InputError.exit_code, True)
    assert simval(*words, "--out", tmp_path / "no/out.csv")[0] == InputError.exit_code
    stopped = to_json(one) | {"status": "max iterations"}
    (tmp_path / "c.json").write_text(json.dumps(stopped))
    assert simval(*words)[0] == ConvergenceError.exit_code


# which readings a calibration belongs to: each limit on both of its sides

OFF = 1e-6  # of a limit; a fit to exact readings is right to 1e-12
SENSOR = AccelerometerModel.from_parameters(
    [0.03, -0.02, 0.05, 2.0, 1.9, 2.1, 0.3, -0.2, 0.1]
)


@pytest.mark.parametrize(
    ("moving", "limit", "above"),
    [(False, 0.75, True), (False, 1.25, False), (True, 0.75, True), (True, 8.0, False)],
)
@pytest.mark.parametrize("inside", [True, False])
def test_the_mean_force_of_a_log_is_near_gravity(moving, limit, above, inside):
    """A rest within a quarter; a log in motion between three quarters and eight."""
    quiet = np.random.default_rng(0)
    made = calibrate(SENSOR.distort(G * fibonacci_sphere(12), quiet), G)
    angle = 0.3 * np.arange(400)
    turning = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    force = turning if moving else np.tile([0.0, 0.6, 0.8], (200, 1))
    size = limit * (1.0 + (OFF if above == inside else -OFF))
    raw = SENSOR.distort(size * G * force, quiet)
    if inside:
        require_same_sensor(made, raw, 100.0)
        return
    words = "mean reading, in motion" if moving else "the log's 4 stretches at rest"
    with pytest.raises(RefusedError, match=words):
        require_same_sensor(made, raw, 100.0)


@pytest.mark.parametrize(
    ("rate", "rows"), [(100.0, 50), (20.0, 10), (10.0, 10), (1.0, 10), (400.0, 200)]
)
def test_a_stretch_at_rest(rate, rows):
    """Half a second and ten rows at least; it scatters by less than a twentieth."""
    rest = np.tile([0.0, 0.6, 0.8], (3 * rows, 1))
    assert len(rest_forces(rest, rate)) == 3
    assert len(rest_forces(rest[1:], rate)) == 2
    np.testing.assert_allclose(rest_forces(rest, rate), 1.0, rtol=1e-12)
    # plus and minus alternate: a standard deviation of just that; of one axis, of all
    for axes in ([0], [0, 1, 2]):
        for share in (1 - OFF, 1 + OFF):
            rest = np.tile([0.0, 0.0, 2.0], (100, 1))
            one = 0.05 * 2.0 * share / np.sqrt(len(axes))
            rest[:, axes] += one * (-1.0) ** np.arange(100)[:, None]
            assert len(rest_forces(rest, 100.0)) == (2 if share < 1 else 0)
