"""Hostile content of a run folder: shown as text, and never run."""

import json
import pickle
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest
from places import ROOT
from stores import edited, rewritten

from simval.cli import run as simval_command


def called(capsys, *words):
    """Exit code of a command and its words; an exception would be a bug of ours."""
    capsys.readouterr()
    with np.errstate(all="ignore"):
        code = simval_command([str(word) for word in words])
    captured = capsys.readouterr()
    assert code in (0, 1, 2, 3, 4), captured.err
    if code == 2:
        assert captured.err.strip(), "exit code 2 without a word"
    assert "Traceback" not in captured.err
    return code, captured.err if code == 2 else captured.out


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
