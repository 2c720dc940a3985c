"""Calibration files: exact round trip, and files that are refused."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from simval.calibrate import calibrate
from simval.calibrate.files import (
    from_json,
    load_calibration,
    save_calibration,
    to_json,
)
from simval.cli.correct import command
from simval.errors import ConvergenceError, InputError
from simval.poses import fibonacci_sphere
from simval.sensor import MODELS, AccelerometerModel

G = 9.81
MODEL = AccelerometerModel.from_parameters(
    np.array([0.03, -0.02, 0.05, 1.03, 0.96, 1.05, 0.3, -0.2, 0.1])
)


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
    found = CliRunner().invoke(command, [*arguments, "--rate", "100"])
    assert found.exit_code == 0, found.output
    header = out.read_text().splitlines()[0]
    rows = np.loadtxt(out, delimiter=",", skiprows=1)
    assert header.startswith("t,ax,ay,az")
    expected = (raw - one.B) @ one.matrix.T
    np.testing.assert_allclose(rows[:, 1:4], expected, rtol=0, atol=1e-12)
    assert rows.shape[1] == (7 if extra else 4)


def test_correct_prints_and_reads_the_output_of_calibrate(tmp_path):
    one = fit()
    (tmp_path / "c.json").write_text(json.dumps(to_json(one) | {"intervals": 12}))
    path, raw = log_file(tmp_path, time=True)
    found = CliRunner().invoke(
        command, [str(path), "--calibration", str(tmp_path / "c.json")]
    )
    assert found.exit_code == 0
    first = np.array(found.output.splitlines()[1].split(","), dtype=float)
    expected = one.matrix @ (raw[0] - one.B)
    np.testing.assert_allclose(first[1:4], expected, atol=1e-12)


def test_correct_refuses(tmp_path):
    path, _ = log_file(tmp_path, time=True)
    missing = str(tmp_path / "no.json")
    found = CliRunner().invoke(command, [str(path), "--calibration", missing])
    assert isinstance(found.exception, InputError)
    assert "no.json" in str(found.exception)
    assert CliRunner().invoke(command, [str(path)]).exit_code == 2
    save_calibration(tmp_path / "c.json", fit())
    good = [str(path), "--calibration", str(tmp_path / "c.json")]
    found = CliRunner().invoke(command, [*good, "--out", str(tmp_path / "no/out.csv")])
    assert isinstance(found.exception, InputError)
    data = to_json(fit()) | {"status": "max iterations"}
    (tmp_path / "c.json").write_text(json.dumps(data))
    found = CliRunner().invoke(command, good)
    assert isinstance(found.exception, ConvergenceError)


def test_a_place_that_cannot_be_written(tmp_path):
    with pytest.raises(InputError, match="cannot write"):
        save_calibration(tmp_path / "no" / "c.json", fit())
