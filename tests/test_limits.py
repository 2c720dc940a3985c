"""What a user names has limits that are said in advance: kinds of file, sizes, numbers.

Each reader is given what never ends, what is too large and what takes for ever to
parse.
"""

import contextlib
import math
import os
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from pydantic import ValidationError

from simval import files, report
from simval.cli import run
from simval.errors import InputError, PluginError, RefusedError
from simval.imu.calibrate import load_calibration
from simval.imu.logs import read_log, read_truth
from simval.imu.noise import load_noise
from simval.imu.sensor import load_imu
from simval.judge.baseline import read_baseline
from simval.poses import read_directions
from simval.scene.physics import load_model
from simval.streams import Streams
from simval.studies import STUDIES
from simval.sweep.suite import MOST_CELLS, load_suite

READERS = {
    "log": read_log,
    "truth": read_truth,
    "calibration": load_calibration,
    "noise": load_noise,
    "sensor": load_imu,
    "sensor.json": load_imu,
    "suite": load_suite,
    "baseline": lambda path: read_baseline(Path(path)),
    "directions": lambda path: read_directions(Path(path)),
    "model": load_model,
}
SECONDS = 5.0  # at once, on a busy machine; what is attacked here took minutes or more


def said(reader, path):
    """Words of a refusal, given at once."""
    start = time.process_time()
    with pytest.raises((InputError, PluginError)) as caught:
        READERS[reader](str(path))
    assert time.process_time() - start < SECONDS
    words = str(caught.value)
    assert len(words) < 600
    return words


@pytest.mark.parametrize("reader", READERS)
def test_what_is_no_file_that_could_be_read_is_refused_at_once(reader, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with (tmp_path / "large").open("wb") as file:
        file.truncate(10 * 2**30)  # sparse: no byte of it is on the disk
    for name, expected in {
        "/dev/zero": "a device",
        "pipe": "a pipe",
        "large": "it has 10,240 MiB; a file of its kind has at most",
        "": "",
        "none": "",
        "x" * 300: "",
    }.items():
        path = tmp_path / name
        words = said(reader, path)
        assert expected in words or "not a regular file" in words, (path, words)
        assert str(path)[:50] in words


def test_text_is_as_python_reads_it(tmp_path):
    path = tmp_path / "text"
    path.write_bytes("\ufeffa\r\nb\rc\nd\u00e9".encode())
    for encoding in ("utf-8", "utf-8-sig"):
        expected = path.read_text(encoding=encoding)
        assert files.read_text(path, 100, encoding) == expected


@pytest.mark.parametrize("reader", ["sensor", "suite", "calibration", "noise", "log"])
@pytest.mark.parametrize("text", ["1" * 5000, "[" * 10_000, '{"g": ' * 10_000, "a\0"])
def test_what_no_person_writes_is_refused_in_words(reader, text, tmp_path):
    path = tmp_path / reader
    for start in ("", "K = ", '{"g": '):
        path.write_text(start + text)
        said(reader, path)


@pytest.mark.parametrize("reader", ["sensor", "suite"])
@pytest.mark.parametrize("part", ["a", '"b c"', "'d'", "e ", "f \t"])
@pytest.mark.parametrize("form", ["{} = 1", "[{}]", "[[{}]]", "K = 1\nx = {{{} = 1}}"])
def test_a_key_of_many_parts_is_refused(reader, part, form, tmp_path):
    # `tomllib` takes 6 GB for 50 000
    path = tmp_path / reader
    path.write_text(form.format(".".join([part] * 50_000)))
    assert "parts" in said(reader, path)
    assert files.toml(form.format(".".join([part] * 30)))


def test_a_threshold_is_not_rounded_to_nothing():
    """5e-324 times a variance of 1e-18 was 0, and a crash of the cell."""
    for multiplier in (5e-324, 1e-300, 0.0, math.nextafter(1e-9, 0.0)):
        with pytest.raises(ValidationError, match="greater than or equal to"):
            STUDIES["detector"].parameters(multiplier=multiplier)
    values = {"multiplier": 1e-9, "noise_std": 1e-9, "poses": 9, "window": 3}
    own = STUDIES["detector"].parameters(**values, trim=0, trials=2)
    with contextlib.suppress(RefusedError):  # nothing is below so low a threshold
        STUDIES["detector"].run(own, Streams(1, (1,)))


AXIS = list(range(1, 1001))


def test_number_of_cells(tmp_path):
    path = tmp_path / "many.toml"
    text = (
        f"seed = {AXIS[:9]}\n[attitude]\ngeometry = {AXIS}\n"
        f"noise_std = {[0.1 + 1e-4 * k for k in AXIS]}\n[attitude_order]\n"
    )
    path.write_text(text)
    start = time.process_time()
    with pytest.raises(InputError) as caught:
        load_suite(str(path))
    assert time.process_time() - start < SECONDS
    assert "has 9,000,009 cells (1,000 of `attitude.geometry`" in str(caught.value)
    assert f"may have {MOST_CELLS:,}" in str(caught.value)


@pytest.mark.parametrize(
    ("words", "full"),
    [
        ("--out {0}", "page"),
        ("--out {0}/page --figures {0}", "a.svg"),
        ("--out {0}/page --figures {0}", "a.png"),
        ("--out {0}/page --tables {0}", "a.csv"),
    ],
)
def test_a_full_disk_names_the_file(
    tiny_run, tmp_path, monkeypatch, words, full, capsys, unchecked
):
    # what is drawn does not matter here, and takes long
    part = SimpleNamespace(name="a")
    for name, made in {
        "render": "page",
        "drawings": [part],
        "svg_file": "figure",
        "png": b"figure",
        "tables": [part],
        "csv_text": "table",
    }.items():
        monkeypatch.setattr(report, name, lambda *_, made=made, **__: made)
    path = tmp_path / full
    path.symlink_to("/dev/full")
    place = path if full == "page" else tmp_path
    assert run(["report", str(tiny_run), *words.format(place).split()]) == 2
    said = capsys.readouterr().err
    assert f"cannot write {path}: No space left" in said
