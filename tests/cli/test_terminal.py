"""What is printed: narrow terminals, readers that go early, and the numbers of g."""

import re
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simval.cli import COMMANDS, run
from simval.cli.terminal import folded

SENSOR = """
T = [[1, 0, 0], [0.03, 1, 0], [0.02, 0.05, 1]]
K = [1.03, 0.96, 1.05]
B = [0.3, -0.2, 0.1]
white_raw_per_sqrt_hz = 0.002
"""
WORDS = st.text("abc+-.,():", min_size=1, max_size=30)
SPACES = st.integers(1, 12).map(lambda count: " " * count)


@given(
    parts=st.lists(st.tuples(SPACES, WORDS), min_size=1, max_size=30),
    width=st.integers(20, 200),
)
def test_a_folded_line_has_all_its_words_and_none_is_wider_than_it_must(parts, width):
    line = "".join(space + word for space, word in parts)
    lines = folded(line, width)
    assert " ".join(lines).split() == line.split()
    if len(line) <= width:
        assert lines == [line]
    assert all(len(each) <= width or len(each.split()) == 1 for each in lines)


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "log.csv"
    words = ["--set", "poses=20", "--set", "first_hold=20", "--every", "5"]
    (path.parent / "s.toml").write_text(SENSOR)
    sensor = ["--sensor", str(path.parent / "s.toml"), "--out", str(path)]
    assert run(["scene", "gimbal", *words, *sensor]) == 0
    return path


@pytest.mark.ci
def test_sixty_columns_are_enough(simval, log, tiny_run, monkeypatch):
    commands = (
        ("list",),
        ("plan", "--noise-std", "0.01"),
        ("calibrate", log),
        ("noise", log),
        ("gate", tiny_run, "--no-baseline"),
        ("compare", tiny_run, tiny_run),
        ("scene", "gimbal"),
        ("plan", "--poses", "dodecahedron", "--noise-std", "1"),
    )
    for words in commands:
        code, wide, errors = simval(*words)
        monkeypatch.setenv("COLUMNS", "60")
        again, narrow, folded_errors = simval(*words)
        monkeypatch.delenv("COLUMNS")
        assert again == code
        if (
            words[0] in ("calibrate", "noise", "plan") and not code
        ):  # numbers may stand one below the other
            found = [sorted(re.findall(r"\S+ ± \S+", x)) for x in (narrow, wide)]
            assert found[0] == found[1] != []
        else:
            assert (narrow + folded_errors).split() == (wide + errors).split()
        assert any(len(line) > 60 for line in (wide + errors).splitlines())
        for line in (narrow + folded_errors).splitlines():
            assert len(line) <= 60 or " " not in line.strip(), line


@pytest.mark.ci
def test_a_reader_that_goes_early_is_no_failure(log, tiny_run, tmp_path):
    run, made = str(tiny_run), tmp_path / "made.json"
    for words, expected in (
        (("sweep", "--help"), 0),
        (("list",), 0),
        (("calibrate", str(log), "--out", str(made)), 0),
        (("gate", run, "--baseline", str(log)), 2),  # its own code
    ):
        child = subprocess.Popen(
            [sys.executable, "-m", "simval", *words],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        child.stdout.close()
        errors = child.communicate()[1]
        assert child.returncode == expected, (words, errors)
        assert "Traceback" not in errors
        assert "pipe" not in errors
    assert made.exists()  # the work is done


def ended(shell, *words):
    """Exit code and standard error of a command, its streams as the shell has them."""
    command = ["sh", "-c", f'exec "$@" {shell}', "sh", sys.executable, "-m", "simval"]
    done = subprocess.run([*command, *map(str, words)], capture_output=True, text=True)
    return done.returncode, done.stderr


@pytest.mark.ci
@pytest.mark.parametrize("command", [name for name, _ in COMMANDS])
def test_an_output_that_takes_nothing_is_a_sentence_and_2(command):
    full, closed = (ended(f">{end}", command, "--help") for end in ("/dev/full", "&-"))
    assert [code for code, _ in (full, closed)] == [2, 2]
    assert full[1].startswith("error: standard output could not be written: No space")
    assert closed[1] == "error: standard output could not be written: it is closed\n"
    assert full[1].count("\n") == 1


@pytest.mark.ci
def test_what_was_to_be_done_is_done_though_nothing_can_be_printed(
    log, tiny_run, tmp_path
):
    made = tmp_path / "made.json"
    for words, end in (
        (("calibrate", log, "--json", "--out", made), "/dev/full"),  # several buffers
        (("gate", tiny_run, "--baseline", log), "&-"),  # with an error of its own
    ):
        code, errors = ended(f">{end}", *words)
        assert code == 2, words
        assert "Traceback" not in errors
    assert made.exists()
    # where messages have no place they are lost, and nothing else is
    for end in ("2>/dev/full", "2>&-"):
        assert ended(f"{end} >{made}", "list")[0] == 0
        assert "smoke" in made.read_text()
        assert ended(end, "gate", tiny_run, "--baseline", log)[0] == 2
    assert ended(">&- 2>&- <&-", "list") == (2, "")


@pytest.mark.ci
@pytest.mark.parametrize("command", ["calibrate", "plan"])
def test_a_gravity_that_is_nowhere_on_the_earth_is_said(simval, log, command):
    words = (log,) if command == "calibrate" else ("--noise-std", "1e-3")
    for g in ("1.62", "32.17", "9806.65"):
        code, out, errors = simval(command, *words, "--g", g, "--json")
        assert (code, out[0]) == (0, "{")
        assert f"`--g` is {float(g):g} m/s^2, and gravity on the Earth is" in errors
    for earth in ("9.78", "9.832"):
        assert simval(command, *words, "--g", earth)[2] == ""


PLAN = {"--hold": "1", "--noise-density": "1e-3", "--angle-random-walk": "1e-4"}
OPTIONS = {
    "calibrate": {
        **{"g": "", "rest": "1e300", "rate": "1e300"},
        **{"field": "1e300", "full-scale": "1e300"},
    },
    "filter": {"time-limit": ""},
    "noise": {"rest": "1e300"},
    "plan": dict.fromkeys(
        [*("g", "noise-std", "hold", "noise-density"),
         *("angle-random-walk", "rotation-time")], "",
    ),
    "sweep": {"wait": ""},
}  # fmt: skip
"""Options that take a number, and a value that some recording may really have."""
NUMBERS = [
    pytest.param(command, option, possible, id=f"{command} --{option}")
    for command, options in OPTIONS.items()
    for option, possible in options.items()
]


@pytest.mark.parametrize(("command", "option", "possible"), NUMBERS)
def test_no_number_of_an_option_is_taken_that_cannot_be(
    simval, log, command, option, possible
):
    for value in ("nan", "inf", "-1", "0", "1e300", "ten"):
        if (option, value) == ("wait", "0"):
            continue
        words = {f"--{option}": value}
        if option in ("g", "noise-std") and command == "plan":
            words = {"--noise-std": "0.01"} | words
        elif command == "plan":
            words = PLAN | words
        given = [word for pair in words.items() for word in pair]
        first = {"plan": [], "sweep": ["smoke"]}.get(command, [log])
        code, _, errors = simval(command, *first, *given)
        if value == possible:
            assert code in (0, 2, 3)
        else:
            assert code == 2, value
            assert option.split("-")[0] in errors, value
