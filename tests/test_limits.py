"""What a user names has limits that are said in advance: kinds of file, sizes, numbers.

Each reader is given what never ends, what is too large and what takes for ever to
parse. A reader that tries all the same runs out of memory here, not of the machine's.
"""

import contextlib
import math
import os
import resource
import socket
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from pydantic import ValidationError

from simval import files
from simval.arguments import whole_number
from simval.calibrate import load_calibration
from simval.cli import report, run
from simval.cli.plan import read_directions
from simval.errors import InputError, PluginError, RefusedError
from simval.gate.baseline import read_baseline
from simval.logs import read_log, read_truth
from simval.noise import load_noise
from simval.plugins import Estimator, find_plugin
from simval.scene.models import load_model, model_path
from simval.sensor import load_imu
from simval.streams import Streams
from simval.studies import STUDIES
from simval.sweep.size import MOST_CELLS
from simval.sweep.suite import load_suite

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


@pytest.fixture(autouse=True)
def little_memory():
    """A gibibyte more than there is now, so that an attack that works is an error."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    before = resource.getrlimit(resource.RLIMIT_AS)
    most = pages * resource.getpagesize() + 2**30
    resource.setrlimit(resource.RLIMIT_AS, (most, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, before)


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
@pytest.mark.parametrize("path", ["/dev/zero", "/dev/urandom", "/dev/full"])
def test_devices(reader, path):
    words = said(reader, path)
    assert path in words
    assert "device" in words or "not a regular file" in words


@pytest.mark.parametrize("reader", READERS)
def test_pipes_and_sockets(reader, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    ends = os.pipe()  # as /dev/stdin is that another program writes into
    here = socket.socket(socket.AF_UNIX)
    here.bind(str(tmp_path / "socket"))
    for path in (tmp_path / "pipe", f"/dev/fd/{ends[0]}"):
        words = said(reader, path)
        assert "is a pipe" in words or "not a regular file" in words
    words = said(reader, tmp_path / "socket")
    assert "is a socket" in words or "not a regular file" in words
    here.close()
    for end in ends:
        os.close(end)


@pytest.mark.parametrize("reader", READERS)
def test_folders_and_what_is_not_there(reader, tmp_path):
    for path in (tmp_path, tmp_path / "none", tmp_path / ("x" * 300)):
        assert str(path)[:50] in said(reader, path)


@pytest.mark.parametrize("reader", READERS)
def test_what_is_larger_than_any_of_its_kind(reader, tmp_path):
    path = tmp_path / reader.replace(" ", "_")
    with path.open("wb") as file:
        file.truncate(10 * 2**30)  # sparse: no byte of it is on the disk
    words = said(reader, path)
    assert "it has 10,240 MiB; a file of its kind has at most" in words


def test_a_file_that_grows_while_it_is_read(tmp_path, monkeypatch):
    path = tmp_path / "log"
    path.write_bytes(b"1" * 100)
    assert files.read_bytes(path, 100) == b"1" * 100
    with pytest.raises(files.UnreadableError, match="it has 100 bytes"):
        files.read_bytes(path, 99)
    monkeypatch.setattr(files, "require_regular", lambda *_: None)
    with pytest.raises(files.UnreadableError, match="it has more than 99 bytes"):
        files.read_bytes(path, 99)


def test_text_is_as_python_reads_it(tmp_path):
    path = tmp_path / "text"
    path.write_bytes("\ufeffa\r\nb\rc\nd\u00e9".encode())
    for encoding in ("utf-8", "utf-8-sig"):
        expected = path.read_text(encoding=encoding)
        assert files.read_text(path, 100, encoding) == expected


DIGITS = "1" * 5000
PARTS = "a." * 20_000 + "a"
DEEP = 100_000
TEXTS = {  # content and part of what is said: of TOML, of JSON
    "sensor": {
        f"K = {DIGITS}": "number in line 1 has 5000 digits; at most 400",
        f"\nK = 0.{DIGITS}": "number in line 2 has 5000 digits",
        f"\n\n{PARTS} = 1": "a name in line 3 has more than 20 parts",
        f"[{PARTS}]": "a name in line 1 has more than 20 parts",
        '"b" . ' * 20_000 + "c = 1": "a name in line 1 has more than 20 parts",
        '"a\\"b".' * 20_000 + "c = 1": "a name in line 1 has more than 20 parts",
        '"\\\\".' * 20_000 + "c = 1": "a name in line 1 has more than 20 parts",
        "'\\'." * 20_000 + "c = 1": "a name in line 1 has more than 20 parts",
        f"K = 0x{'f' * 10_000}": "number in line 1 has 10002 digits",
        f"K = 0x1_{'F_f' * 2_000}f": "number in line 1 has 6005 digits",
        "K = " + "[" * DEEP: "nested too deeply",
        "K = " + "{a = " * DEEP: "nested too deeply",
    },
    "calibration": {
        f'{{"g": {DIGITS}}}': "number in line 1 has 5000 digits",
        '{"g": ' + "[" * DEEP: "nested too deeply",
        '{"g": ' * DEEP: "nested too deeply",
    },
    "log": {
        f"t,ax,ay,az\n0,1,2,{DIGITS}\n" * 3: "",
        ",".join(["ax"] * 400_000): "line 1: 1,199,999 characters; a row of a log has",
        "0 1 2 3\n" + "1 " * 600_000: "line 2: 1,200,000 characters",
    },
    "directions": {f"1 2 {DIGITS}": "", f"{DIGITS}": ""},
}
TEXTS["suite"] = {
    text.replace("K", "seed"): words for text, words in TEXTS["sensor"].items()
}
for name in ("noise", "baseline", "sensor.json"):
    TEXTS[name] = TEXTS["calibration"]


@pytest.mark.parametrize("reader", TEXTS)
def test_numbers_names_and_depths(reader, tmp_path):
    path = tmp_path / reader
    for text, words in TEXTS[reader].items():
        path.write_text(text)
        assert words in said(reader, path)


def test_what_is_legal_is_read():
    text = '[a.b."c.d"]\nx = 1_000_000\ny = 0.123456789\nz = "1.2.3.4.5"\n'
    assert files.parsed_toml(text) == {
        "a": {"b": {"c.d": {"x": 1_000_000, "y": 0.123456789, "z": "1.2.3.4.5"}}}
    }
    most = "1" * files.DIGITS
    assert files.parsed_toml(f"x = {most}") == {"x": int(most)}
    name = ".".join("a" * files.PARTS)
    assert files.parsed_toml(f"{name} = 1")["a"]["a"]
    with pytest.raises(ValueError, match="digits"):
        files.parsed_toml(f"x = {most}1")
    with pytest.raises(ValueError, match="parts"):
        files.parsed_toml(f"{name}.a = 1")


@pytest.mark.parametrize(
    "text",
    [
        *("a" * 2**20, '"' * 2**20, "a." * 2**19, "1 " * 2**19, "'\"" * 2**19),
        *('"\\' * 2**19 + "." * 20, '\\"' * 2**19 + "." * 20, "0x" * 2**19),
        *("'\\'\"." * 2**17, '."\\\\' * 2**18, '.\\"' * 2**18, ".'\\\"" * 2**18),
    ],
)
def test_looking_for_them_takes_no_time(text):
    start = time.process_time()
    with pytest.raises(ValueError, match=r"."):
        files.parsed_toml(text)
    assert time.process_time() - start < SECONDS


@pytest.mark.parametrize(
    "setting",
    [
        f"attitude.noise_std={DIGITS}",
        f"attitude.noise_std=0.{DIGITS}x",
        f"attitude.samples={DIGITS}",
        f"attitude.geometry=1e{'9' * 20}",
        f"{PARTS}=1",
        f"attitude.{PARTS}=1",
        "attitude.noise_std=" + "[" * 10_000,
        f"{DIGITS}=1",
    ],
)
def test_settings_of_the_command_line(setting, tmp_path):
    path = tmp_path / "suite.toml"
    path.write_text("[attitude]\n")
    start = time.process_time()
    with pytest.raises(InputError) as caught:
        load_suite(str(path), [setting])
    assert time.process_time() - start < SECONDS
    assert len(str(caught.value)) < 1000


@given(
    names=st.lists(
        st.sampled_from(
            ["a", "b-1", '"c"', '"d.e"', '"\\""', '"\\\\"', "'f'", "'\\'", '""']
        )
    ),
    dot=st.sampled_from([".", " . ", "\t.", ". "]),
    before=st.sampled_from(["", "[", "x = {", 'x = {y = """ " """, ']),
)
@example(names=["a"] * 21, dot=".", before='x = {y = """ " """, ')
@example(names=['"\\""'] * 21, dot=".", before="")
@example(names=['"\\""', "'\\'"] * 10, dot=".", before="")
def test_as_many_parts_are_counted_as_there_are(names, dot, before):
    """Wherever the name stands, whatever quotes are before it."""
    text = before + dot.join(names) + {"": " = 1", "[": "]"}.get(before, " = 1}")
    try:
        files.parsed_toml(text)
        said = ""
    except ValueError as error:
        said = str(error)
    assert ("more than 20 parts" in said) == (len(names) > files.PARTS)


def test_of_many_faults_the_first_are_told(tmp_path):
    path = tmp_path / "suite.toml"
    path.write_text("".join(f"[x{i}]\n" for i in range(3_000)))
    start = time.process_time()
    with pytest.raises(InputError, match=r"; and 2,980 more$") as caught:
        load_suite(str(path))
    assert time.process_time() - start < SECONDS
    assert len(str(caught.value)) < 10_000


@pytest.mark.parametrize("which", ["one", "below", "list"])
def test_a_number_that_python_does_not_write_is_refused_in_words(which):
    number = {"one": 10**5000, "below": -(10**5000), "list": [10**5000]}[which]
    with pytest.raises(InputError, match="too long to be written; it must be a whole"):
        whole_number("n", number, 1)


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


def test_number_of_cells_is_counted_rightly(tmp_path, monkeypatch):
    path = tmp_path / "few.toml"
    path.write_text(
        "seed = [1, 2]\n[attitude]\ngeometry = [1, 2, 3]\nnoise_std = [0.1, 0.2]\n"
        "[attitude_order]\ngeometry = [7, 8]\n[attitude_map]\n"
    )
    count = len(load_suite(str(path)).cells)
    monkeypatch.setattr("simval.sweep.size.MOST_CELLS", count)
    load_suite(str(path))
    monkeypatch.setattr("simval.sweep.size.MOST_CELLS", count - 1)
    with pytest.raises(InputError, match=f"has {count} cells"):
        load_suite(str(path))


@pytest.mark.ci
def test_a_plugin_of_ten_gibibytes(tmp_path):
    path = tmp_path / "mine.py"
    with path.open("wb") as file:
        file.truncate(10 * 2**30)
    try:
        with pytest.raises((PluginError, InputError), match="10,240 MiB"):
            find_plugin(str(path), Estimator)
        assert run(["check", str(path)]) == 2
    finally:
        path.unlink()  # Hypothesis reads the files of all modules


@pytest.mark.parametrize("kind", ["mesh", "include", "texture"])
def test_a_model_that_names_a_pipe(tmp_path, kind):
    os.mkfifo(tmp_path / "pipe.stl")
    part = {
        "mesh": '<asset><mesh name="m" file="pipe.stl"/></asset>',
        "include": '<include file="pipe.stl"/>',
        "texture": '<asset><texture name="t" type="2d" file="pipe.stl"/></asset>',
    }[kind]
    path = tmp_path / "model.xml"
    text = model_path("gimbal").read_text()
    path.write_text(text.replace("</mujoco>", f"{part}</mujoco>"))
    with pytest.raises(InputError, match=r"pipe\.stl.*it is a pipe"):
        load_model(path)


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
