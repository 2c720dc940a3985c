"""Malformed and hostile files: never a traceback, a hang, a pass, or code that runs.

Each file starts out good and is then damaged at random, by a fixed seed: bytes turned,
cut out, doubled or cut off, numbers and words replaced. The command that reads it must
end with an exit code of its own and in words. It may end in 0 only where what was read
is still what a good file says.
"""

import contextlib
import json
import os
import pickle
import re
import signal
import tomllib
import zipfile
from pathlib import Path

import numpy as np
import pytest
from places import ROOT
from stores import edited, rewritten

from simval.cli import run as simval_command
from simval.errors import SimvalError
from simval.judge import read_baseline, write_baseline
from simval.plugins.probe import probe_sensor
from simval.plugins.programs import log_of
from simval.poses import fibonacci_sphere
from simval.scene.physics import load_model
from simval.sweep import load_run

LIMIT = 60  # s, for what takes less than one: a hang, not a slow machine

WORDS = (
    b"NaN", b"1e999", b"-1e999", b"", b"\x00", b"\xff\xfe", b"null", b"true", b"[",
    b"{", b'"', b"<", b"&x;", b",", b"-0", b"9" * 400, b"[" * 5000, b"{\"a\":" * 5000,
    b"\r\n\r\n", b"../../etc/passwd", b"0x10", b"1_0", b"--", b"'''", b"=",
)  # fmt: skip


def damaged(data, rng):
    """Some damage or other: at least one byte is another."""
    kind = rng.integers(6)
    at = int(rng.integers(len(data)))
    length = int(min(rng.integers(1, 200), len(data) - at))
    if kind == 0:
        return data[:at]
    if kind == 1:
        return data[:at] + data[at + length :]
    if kind == 2:
        return data[:at] + data[at : at + length] * 2 + data[at + length :]
    if kind == 3:
        noise = rng.integers(0, 256, length, dtype=np.uint8).tobytes()
        return data[:at] + noise + data[at + length :]
    if kind == 4:
        return (
            data[:at] + bytes([data[at] ^ (1 << int(rng.integers(8)))]) + data[at + 1 :]
        )
    numbers = [m.span() for m in re.finditer(rb"[-+\w.]+", data)]
    start, stop = numbers[int(rng.integers(len(numbers)))]
    return data[:start] + WORDS[int(rng.integers(len(WORDS)))] + data[stop:]


@contextlib.contextmanager
def watched():
    """No hang: an alarm ends what takes longer than `LIMIT`."""

    def stop(*_):
        msg = f"no end within {LIMIT} s"
        raise TimeoutError(msg)

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(LIMIT)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def called(capsys, *words):
    """Exit code of a command and its words; an exception would be a bug of ours."""
    capsys.readouterr()
    with watched(), np.errstate(all="ignore"):
        code = simval_command([str(word) for word in words])
    captured = capsys.readouterr()
    assert code in (0, 1, 2, 3, 4), captured.err
    if code == 2:
        assert captured.err.strip(), "exit code 2 without a word"
    assert "Traceback" not in captured.err
    return code, captured.err if code == 2 else captured.out


class Files:
    """A good file of each kind, and what may be said of a damaged one."""

    def __init__(self, folder, run, capsys):
        self.folder, self.run, self.capsys = folder, run, capsys
        self.baseline = folder / "good.json"
        write_baseline(self.baseline, load_run(run), "good")
        self.good_baseline = read_baseline(self.baseline)

    def json(self):
        return self.baseline.read_bytes()

    def check_json(self, data):
        path = self.folder / "bad.json"
        path.write_bytes(data)
        code, _ = called(self.capsys, "gate", self.run, "--baseline", path)
        if code == 0:
            # a stored value may move by rounding, a standard error or a count at will
            cells = read_baseline(path)["cells"]
            assert cells.keys() <= self.good_baseline["cells"].keys()

    def toml(self):
        return (
            b'title = "Good"\nseed = [1, 2]\n\n[attitude]\nnoise_std = [0.01, 0.02]\n'
            b"samples = 65536\n\n[calibration]\nnoise_std = 0.01\nposes = 12\n"
            b'\n[estimator]\nalgorithm = "plugin.py"\n'
        )

    def check_toml(self, data):
        path = self.folder / "bad.toml"
        path.write_bytes(data)
        code, _ = called(self.capsys, "sweep", path, "--dry-run")
        try:
            tomllib.loads(data.decode())
        except (ValueError, RecursionError):
            assert code == 2

    def csv(self):
        sensor = probe_sensor()
        raw = sensor.distort(9.80665 * fibonacci_sphere(12), np.random.default_rng(0))
        rows = log_of(raw, 1e-4)
        lines = ["t,ax,ay,az", *(",".join(f"{x:.6f}" for x in row) for row in rows)]
        return "\n".join(lines).encode()

    def check_csv(self, data):
        path = self.folder / "bad.csv"
        path.write_bytes(data)
        code, out = called(self.capsys, "calibrate", path, "--json")
        if code == 0:
            answer = json.loads(out, parse_constant=_refused)
            assert np.isfinite(answer["matrix"]).all()
            assert np.isfinite(answer["B"]).all()

    def log(self):
        return self.csv().replace(b"t,ax,ay,az\n", b"").replace(b",", b" ")

    check_log = check_csv

    def xml(self):
        return (ROOT / "models" / "gimbal.xml").read_bytes()

    def check_xml(self, data):
        path = self.folder / "bad.xml"
        path.write_bytes(data)
        with watched(), contextlib.suppress(SimvalError):
            load_model(path, None, None, None)


def _refused(word):
    raise ValueError(word)


def damage(kind, seed, count, files):
    rng = np.random.default_rng([seed, sum(kind.encode())])
    good = getattr(files, kind)()
    check = getattr(files, f"check_{kind}")
    for number in range(count):
        data = damaged(good, rng)
        if data == good:
            continue
        try:
            check(data)
        except BaseException:
            kept = Path(os.environ.get("TMPDIR", "/tmp")) / f"damaged.{kind}"
            kept.write_bytes(data)
            print(f"damage {number} of {kind}, kept as {kept}")  # noqa: T201
            raise


KINDS = ("json", "toml", "csv", "log", "xml")
"""A damaged store is in tests/sweep/test_store.py."""


@pytest.mark.parametrize(
    "count",
    [pytest.param(34, marks=pytest.mark.ci), pytest.param(400, marks=pytest.mark.slow)],
)
@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files_end_in_words(kind, count, tiny_run, tmp_path, capsys, undrawn):
    damage(kind, 20_265, count, Files(tmp_path, tiny_run, capsys))


@pytest.mark.ci
def test_the_good_files_are_good(tiny_run, tmp_path, capsys):
    files = Files(tmp_path, tiny_run, capsys)
    assert called(capsys, "gate", tiny_run, "--baseline", files.baseline)[0] == 0
    for kind, command in (
        ("toml", "sweep"),
        ("csv", "calibrate"),
        ("log", "calibrate"),
    ):
        path = tmp_path / f"good.{kind}"
        path.write_bytes(getattr(files, kind)())
        rest = ["--dry-run"] if command == "sweep" else ["--json"]
        assert called(capsys, command, path, *rest)[0] == 0
    path = tmp_path / "good.xml"
    path.write_bytes(files.xml())
    load_model(path, None, None, None)


HOSTILE = "<script>alert(1)</script>\"'>&<img src=x onerror=y>"
PLAIN = (
    "<img src=x onerror=y>"  # without a slash, which makes a value the name of a file
)


@pytest.mark.ci
def test_html_escapes_what_comes_from_data_and_plugins(tiny_run, tmp_path, capsys):
    with rewritten(tiny_run) as db:
        for table, column, where in (
            ("rows", "entries", "cell = 0 AND ordinal = 0"),
            ("rows", "predictor", "cell = 1 AND ordinal = 2"),
            ("rows", "unit", "cell = 1 AND ordinal = 3"),
            ("cells", "error", "position = 2"),
        ):
            value = json.dumps([HOSTILE]) if column == "entries" else HOSTILE
            db.execute(f"UPDATE {table} SET {column} = ? WHERE {where}", (value,))
        db.execute("UPDATE cells SET status = 'failed' WHERE position = 2")
        values = (PLAIN, f"{PLAIN}!")
        for position, value in enumerate(values, start=2):
            db.execute(
                "UPDATE cells SET cell = 'hostile(x=' || ? || ')@1', "
                "study = 'hostile', parameters = ? WHERE position = ?",
                (value, json.dumps({"x": value}), position),
            )
        (manifest,) = db.execute(
            "SELECT value FROM meta WHERE key = 'manifest'"
        ).fetchone()
        content = json.loads(manifest) | {"suite": HOSTILE, "title": HOSTILE}
        del content["grid"]["attitude"]
        content["grid"]["hostile"] = {"x": values}
        db.execute(
            "UPDATE meta SET value = ? WHERE key = 'manifest'", (json.dumps(content),)
        )
    page = tmp_path / "report.html"
    assert called(capsys, "report", tiny_run, "--out", page)[0] == 0
    text = page.read_text()
    assert "alert(1)" in text  # it is there, as text
    assert "<script>alert" not in text
    assert "<img src=x" not in text


class Payload:
    def __init__(self, mark):
        self.mark = mark

    def __reduce__(self):
        return Path.touch, (self.mark,)


@pytest.mark.ci
def test_no_pickle_is_loaded_from_a_run_folder(tiny_run, tmp_path, capsys, undrawn):
    mark = tmp_path / "executed"
    edited(tiny_run)  # of a complete run no other file is opened
    folder = tiny_run / "artifacts"
    folder.mkdir(exist_ok=True)
    data = pickle.dumps(np.array([Payload(mark)], dtype=object))
    names = {p.name for p in folder.glob("*.npz")} | {"scene-gimbal-40.npz"}
    for name in names:
        with zipfile.ZipFile(folder / name, "w") as archive:
            for member in ("directions.npy", "t.npy"):
                header = np.lib.format.magic(1, 0)
                text = b"{'descr': '|O', 'fortran_order': False, 'shape': (1,), }"
                text += b" " * (118 - len(text) - 1) + b"\n"
                size = len(text).to_bytes(2, "little")
                archive.writestr(member, header + size + text + data)
    for name in ("run.pkl", "results.pickle"):
        (tiny_run / name).write_bytes(data)
    called(capsys, "gate", tiny_run)
    code, words = called(capsys, "report", tiny_run)
    assert code == 2
    assert "damaged" in words
    assert not mark.exists()
    pickle.loads(pickle.dumps(Payload(mark)))  # the payload itself does work
    assert mark.exists()


def test_no_module_of_the_package_unpickles():
    allowed = re.compile(r"allow_pickle\s*=\s*False")
    for file in (ROOT / "simval").rglob("*.py"):
        text = allowed.sub("", file.read_text())
        if file.name == "cluster.py":  # on a worker, what its own scheduler hands it
            continue
        assert not re.search(
            r"^\s*(import|from) (pickle|dill|shelve|joblib)", text, re.M
        )
        assert "allow_pickle" not in text
