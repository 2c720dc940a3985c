"""Calibration files: exact round trip, and files that are refused."""

import json
import re

import numpy as np
import pytest
from click.testing import CliRunner
from rounding import EPS
from true_sensor import MODEL, G

from simval.calibrate import calibrate
from simval.calibrate.files import (
    from_json,
    load_calibration,
    require_same_sensor,
    save_calibration,
    to_json,
)
from simval.cli import group
from simval.errors import ConvergenceError, InputError, RefusedError, SimvalError
from simval.poses import fibonacci_sphere, random_directions
from simval.sensor import MODELS, AccelerometerModel


def fit(model="triangular", n=12):
    clean = MODEL.distort(G * fibonacci_sphere(n), np.random.default_rng(0))
    noise = np.random.default_rng(1).standard_normal((n, 3))
    return calibrate(clean + 0.01 * noise, G, model)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("n", [9, 12])
def test_round_trip_is_exact(tmp_path, model, n):
    one = fit(model, n)
    save_calibration(tmp_path / "c.json", one)
    two = load_calibration(tmp_path / "c.json")
    for name in ("parameters", "covariance", "T", "K", "B", "matrix", "rms", "cost"):
        np.testing.assert_array_equal(getattr(two, name), getattr(one, name))
    for name in ("model", "method", "residual", "g", "dof", "covariance_kind"):
        assert getattr(two, name) == getattr(one, name)
    assert str(two.status) == "converged"
    assert json.loads((tmp_path / "c.json").read_text())["chi2_per_dof"] is None


@pytest.mark.usefixtures("unchecked")
def test_what_is_no_path_is_said_by_its_name():
    for call in (lambda: save_calibration(3, fit()), lambda: load_calibration(3)):
        with pytest.raises(InputError, match=r"^`path` is 3"):
            call()


def test_an_edited_file_is_noticed(tmp_path):
    data = to_json(fit())
    data["matrix"][0][0] *= 1.01
    with pytest.raises(InputError, match="edited by hand"):
        from_json(data)
    data = to_json(fit())
    data["parameters"][4] = None
    with pytest.raises(InputError, match="not finite"):
        from_json(data)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is not JSON"),
        ("[1, 2]", "is not a calibration file"),
        ('{"format": "other"}', "is not a calibration file"),
        ('{"format": "simval calibration 1"}', "lacks 'model'"),
        ("[" * 100_000, "is not JSON"),
    ],
)
def test_files_that_are_no_calibration(tmp_path, text, words):
    path = tmp_path / "bad.json"
    path.write_text(text)
    with pytest.raises(InputError, match=words):
        load_calibration(path)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("model", "lower"),
        ("parameters", [1, 2]),
        ("covariance", "x"),
        ("g", None),
        ("g", -1.0),
        ("dof", float("inf")),
    ],
)
def test_wrong_values(key, value):
    data = to_json(fit()) | {key: value}
    with pytest.raises(InputError):
        from_json(data)


def test_a_batch_is_not_one_calibration():
    clean = MODEL.distort(G * fibonacci_sphere(12), np.random.default_rng(0))
    with pytest.raises(InputError, match="batch of 2"):
        to_json(calibrate(np.stack([clean, clean * 1.01]), G))


def log_file(tmp_path, time=False, extra=False):
    rng = np.random.default_rng(2)
    raw = MODEL.distort(rng.normal(size=(50, 3)) * 5, rng)
    columns = [raw]
    if time:
        columns.insert(0, np.arange(50)[:, None] / 100.0)
    if extra:
        columns.append(rng.normal(size=(50, 3)))
    path = tmp_path / "log.txt"
    np.savetxt(path, np.hstack(columns), fmt="%.17g")
    return path, raw


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(
    ("time", "extra"), [(True, False), (False, True), (True, True)]
)
def test_correct_applies_the_calibration(tmp_path, model, time, extra):
    """The command's output is M (y - B) to the last printed digit."""
    one = fit(model)
    save_calibration(tmp_path / "c.json", one)
    path, raw = log_file(tmp_path, time, extra)
    out = tmp_path / "out.csv"
    arguments = [
        str(path),
        "--calibration",
        str(tmp_path / "c.json"),
        "--out",
        str(out),
    ]
    found = CliRunner().invoke(group, ["correct", *arguments, "--rate", "100"])
    assert found.exit_code == 0, found.output
    header = out.read_text().splitlines()[0]
    rows = np.loadtxt(out, delimiter=",", skiprows=1)
    assert header.startswith("t,ax,ay,az")
    expected = (raw - one.B) @ one.matrix.T
    # written with all digits, computed alike: equal to some eps of 12
    np.testing.assert_allclose(rows[:, 1:4], expected, rtol=0, atol=4 * EPS * 16)
    assert rows.shape[1] == (7 if extra else 4)


def test_correct_prints_and_reads_the_output_of_calibrate(tmp_path):
    one = fit()
    (tmp_path / "c.json").write_text(json.dumps(to_json(one) | {"intervals": 12}))
    path, raw = log_file(tmp_path, time=True)
    found = CliRunner().invoke(
        group, ["correct", str(path), "--calibration", str(tmp_path / "c.json")]
    )
    assert found.exit_code == 0
    first = np.array(found.output.splitlines()[1].split(","), dtype=float)
    expected = one.matrix @ (raw[0] - one.B)
    # one product of a 3 x 3 matrix, numbers below 16
    np.testing.assert_allclose(first[1:4], expected, rtol=0, atol=4 * EPS * 16)


def test_correct_refuses(tmp_path):
    path, _ = log_file(tmp_path, time=True)
    missing = str(tmp_path / "no.json")
    found = CliRunner().invoke(group, ["correct", str(path), "--calibration", missing])
    assert isinstance(found.exception, InputError)
    assert "no.json" in str(found.exception)
    assert CliRunner().invoke(group, ["correct", str(path)]).exit_code == 2
    save_calibration(tmp_path / "c.json", fit())
    good = [str(path), "--calibration", str(tmp_path / "c.json")]
    found = CliRunner().invoke(
        group, ["correct", *good, "--out", str(tmp_path / "no/out.csv")]
    )
    assert isinstance(found.exception, InputError)
    data = to_json(fit()) | {"status": "max iterations"}
    (tmp_path / "c.json").write_text(json.dumps(data))
    found = CliRunner().invoke(group, ["correct", *good])
    assert isinstance(found.exception, ConvergenceError)


def test_a_place_that_cannot_be_written(tmp_path):
    with pytest.raises(InputError, match="cannot write"):
        save_calibration(tmp_path / "no" / "c.json", fit())


EDITS = {
    "B": ("B", 0), "K": ("K", 1), "T": ("T", 2, 0), "a zero of T": ("T", 0, 1),
    "matrix": ("matrix", 1, 1), "parameters": ("parameters", 6), "sd": ("sd", 3),
    "confidence_95": ("confidence_95", 2, 1), "covariance": ("covariance", 3, 4),
    "g": ("g",), "raw_per_g": ("raw_per_g", 2), "raw_range": ("raw_range", 0, 1),
}  # fmt: skip


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("place", EDITS.values(), ids=EDITS)
@pytest.mark.parametrize("change", [1e-4, 0.01, 3.0])
def test_a_hand_edit_in_one_place_is_refused(model, place, change):
    """It was ignored for B, K and T: the file said one thing and meant another."""
    data = to_json(fit(model))
    if model == "symmetric" and place[0] == "K":
        place = ("K", 1, 1)
    holder = data
    for step in place[:-1]:
        holder = holder[step]
    if place[0] == "raw_range" and change < 1.0:
        return  # a range is a range: it counts
    holder[place[-1]] = (holder[place[-1]] or 1.0) * (1.0 + change) + change
    with pytest.raises(
        InputError, match=r"`\w+(\[\d\])*`.* is .*(makes it|leave|reads)"
    ):
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
    assert ignored_edits(np.random.default_rng(11), count) == []


def test_statements_may_be_left_out():
    data = to_json(fit())
    whole = from_json(data)
    for kept in (("T", "K", "B"), ("model", "parameters"), ("T", "K", "B", "g")):
        part = from_json({name: data[name] for name in kept})
        np.testing.assert_array_equal(part.matrix, whole.matrix)
        np.testing.assert_array_equal(part.B, whole.B)
        assert part.require_converged().covariance_kind == "none"
    for missing in ("T", "K", "B"):
        few = {name: data[name] for name in ("T", "K", "B") if name != missing}
        with pytest.raises(InputError, match=f"lacks .*'{missing}'"):
            from_json(few)
    # copied with six digits, as a person does
    rounded = [[float(f"{x:.6g}") for x in row] for row in data["matrix"]]
    from_json(data | {"matrix": rounded})


@pytest.mark.parametrize(
    "T", [[[1, 0.1, 0], [0.1, 1, 0], [0, 0, 1]], [[2, 0, 0], [0, 1, 0], [0, 0, 1]]]
)
def test_factors_of_no_form_are_refused(T):
    with pytest.raises(InputError, match="`T` is"):
        from_json({"T": T, "K": [1.0, 1.0, 1.0], "B": [0.0, 0.0, 0.0]})


def test_a_name_that_stands_twice_is_refused(tmp_path):
    path = tmp_path / "c.json"
    path.write_text('{"B": [1, 2, 3], "B": [0, 0, 0]}')
    with pytest.raises(InputError, match="'B' is given twice"):
        load_calibration(path)


UNITS = {"SI": (1.0, 0.0), "g": (1.0 / 9.80665, 0.0), "counts": (417.0, 32768.0),
         "signed counts": (1670.0, 20.0)}  # fmt: skip


def unit_sensor(unit, rng, drift=0.0):
    size, offset = UNITS[unit]
    p = np.concatenate([TILT, np.array([1.03, 0.96, 1.05]) / size, np.zeros(3)])
    p[6:] = offset + size * np.array([0.3, -0.2, 0.1])
    p[3:6] *= 1.0 + 0.01 * drift * rng.standard_normal(3)
    p[6:] += 0.2 * drift * size * rng.standard_normal(3)
    return AccelerometerModel.from_parameters(p)


TILT = np.array([0.03, -0.02, 0.05])


def recorded_force(kind, rate, rng):
    """Specific force of a log, m/s^2: with rests, turning, carried or shaken."""
    t = np.arange(int(8 * rate)) / rate
    if kind == "rests":
        turn = random_directions(8, rng)[(t // 1.0).astype(int)]
        moving = (t % 1.0 > 0.8)[:, None] * rng.uniform(2, 8)
        return 9.8 * turn + moving * rng.standard_normal((len(t), 3))
    if kind == "turning":
        angle = rng.uniform(1, 5) * t
        up = np.stack([np.cos(angle), 0.8 * np.sin(angle), 0.6 * np.sin(angle)], -1)
        return 9.8 * up
    swing = np.sin(2 * np.pi * rng.uniform(1, 4) * t[:, None] + rng.uniform(0, 6, 3))
    size = rng.uniform(0.5, 4) if kind == "carried" else rng.uniform(4, 25)
    return np.array([0.0, 0.0, 9.8]) + size * swing


def wrong_answers(rng, count):
    """Logs of another unit that pass, and logs of the sensor that are refused."""
    wrong = []
    for _ in range(count):
        unit, other = rng.choice(list(UNITS), 2, replace=False)
        size = UNITS[unit][0]
        poses = unit_sensor(unit, rng).distort(9.80665 * fibonacci_sphere(20), rng)
        made = calibrate(poses + 0.003 * size * rng.standard_normal((20, 3)), 9.80665)
        rate = float(rng.choice([25, 50, 100, 400]))
        kind = rng.choice(["rests", "turning", "carried", "shaken"])
        force = recorded_force(kind, rate, rng)
        force = force + rng.choice([0.003, 0.05]) * rng.standard_normal(force.shape)
        for log_unit in (unit, other):
            drift = 1.0 if log_unit == unit else 0.0
            raw = unit_sensor(log_unit, rng, drift).distort(force, rng)
            try:
                require_same_sensor(made, raw, rate)
                passed = True
            except RefusedError:
                passed = False
            if passed != (log_unit == unit):
                wrong.append((str(kind), str(unit), str(log_unit), rate))
    return wrong


@pytest.mark.ci
@pytest.mark.parametrize("count", [60, pytest.param(1000, marks=pytest.mark.slow)])
def test_a_log_of_another_unit_is_refused_and_no_other(count):
    # signed counts in motion may pass for counts: a factor of four is a shaken hand
    wrong = wrong_answers(np.random.default_rng(21), count)
    assert [w for w in wrong if {w[1], w[2]} & {"SI", "g"} or w[1] == w[2]] == []


def test_raw_counts_are_not_corrected_with_a_calibration_in_si(tmp_path):
    """They became 32 983 m/s^2 without a word."""
    rng = np.random.default_rng(4)
    poses = unit_sensor("SI", rng).distort(9.80665 * fibonacci_sphere(20), rng)
    made = calibrate(poses + 0.003 * rng.standard_normal((20, 3)), 9.80665)
    save_calibration(tmp_path / "c.json", made)
    raw = unit_sensor("counts", rng).distort(recorded_force("rests", 100, rng), rng)
    np.savetxt(tmp_path / "log.txt", raw)
    words = [str(tmp_path / "log.txt"), "--calibration", str(tmp_path / "c.json")]
    found = CliRunner().invoke(group, ["correct", *words, "--rate", "100"])
    assert isinstance(found.exception, RefusedError)
    for part in (r"made from readings of -\d", r"\(m/s\^2", r"holds \d+", "counts"):
        assert re.search(part, str(found.exception)), found.exception
    assert (
        CliRunner()
        .invoke(group, ["correct", *words, "--rate", "100", "--unchecked"])
        .output
    )
    bare = {name: to_json(made)[name] for name in ("T", "K", "B")}
    (tmp_path / "c.json").write_text(json.dumps(bare))
    found = CliRunner().invoke(group, ["correct", *words, "--rate", "100"])
    assert "is for readings of" in str(found.exception)
