"""An account: each face has its answers, numbers and warnings, at any width."""

import json
import re
from dataclasses import replace
from html import unescape
from types import SimpleNamespace as Made

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from made_logs import of_scene

from simval.account import (
    GRAVITY,
    Account,
    Fact,
    Line,
    Note,
    Quantity,
    Remark,
    Reply,
    Values,
    in_thousands,
)
from simval.account.html import fragment
from simval.account.markdown import safe, text
from simval.account.terminal import MARKS, lines
from simval.imu.logs import read_log
from simval.imu.multiposition import calibrate_log, calibrate_sensors
from simval.imu.multiposition.description import with_log
from simval.imu.multiposition.log_units import units_of
from simval.imu.multiposition.noise import log_noise
from simval.imu.multiposition.noise_description import noise_account
from simval.poses import GEOMETRY_LIMIT, fibonacci_sphere, named_poses
from simval.spelling import in_ascii
from simval.theory.plans import plan, plan_account, plan_gyroscope
from simval.theory.thermal import plan_thermal

WORDS = st.lists(
    st.text("abcxyz<>&|*_.±0", min_size=1, max_size=12), min_size=1, max_size=12
).map(" ".join)
NUMBERS = st.floats(-1e9, 1e9)
ERRORS = st.floats(1e-6, 1e6)
FACTS = st.lists(st.builds(Fact, st.sampled_from("abc"), WORDS, st.booleans()),
                 max_size=3)  # fmt: skip
QUANTITIES = st.builds(Quantity, st.sampled_from(["K_x", "T[1][0]"]), NUMBERS, ERRORS)
LINES = st.builds(
    Line, st.sampled_from(["scale K", "bias B"]), st.sampled_from(["", "m/s²"]),
    st.lists(QUANTITIES, min_size=1, max_size=3), st.booleans(),
)  # fmt: skip
VALUES = st.builds(Values, title=st.just("sensor"), how=WORDS, folded=st.booleans(),
                   lines=st.lists(LINES, max_size=3), facts=FACTS)  # fmt: skip
REPLIES = st.builds(
    Reply, title=WORDS, headline=WORDS, answer=st.sampled_from(GRAVITY), do=WORDS,
    lines=st.lists(WORDS, max_size=2).map(tuple),
)  # fmt: skip
ACCOUNTS = st.builds(
    Account, title=st.just("Result of"), source=WORDS, said=WORDS,
    replies=st.lists(REPLIES, max_size=3), values=st.lists(VALUES, max_size=2),
    notes=st.lists(st.builds(Note, words=WORDS), max_size=1), facts=FACTS,
)  # fmt: skip


def bare(words):
    """The words of a text, one blank between them."""
    return " ".join(words.split())


def shown(account):
    """What each face shows at once, and how it spells what it is given."""
    short = {w: bare("\n".join(lines(account, width=w))) for w in (60, 100)}
    html, markdown = fragment(account), text(account)
    return [
        *((found, bare) for found in short.values()),
        (bare(unescape(re.sub("<details>.*?</details>|<[^>]*>", " ", html))), bare),
        (bare(markdown.partition("<details>")[0]), safe),
    ]


def must_be_seen(account):
    """What no face may leave out: verdicts, reasons, what to do, and warnings."""
    for reply in account.replies:
        yield from (reply.title, reply.headline, reply.do)
    yield from (each.words for each in account.warnings)


def check_faces(account):
    for face, spelled in shown(account):
        for words in must_be_seen(account):
            assert spelled(words) in face, words
        for values in account.values:
            for line in () if values.folded else values.lines:
                for number in line.spelled:
                    assert spelled(number) in face
    whole = json.dumps(account.as_object())
    for words in must_be_seen(account):
        assert json.dumps(words)[1:-1] in whole


# blanks at which no line ends, in more words than a line has
TANGLED = " ".join(["0", *["<" + 11 * "0"] * 5])


@given(account=ACCOUNTS)
@example(
    account=Account(title="Result of", said=TANGLED, facts=[Fact("a", TANGLED, True)])
)
def test_every_face_has_every_answer_number_and_warning(account):
    check_faces(account)
    everything = bare("\n".join(lines(account, verbose=True)))
    facts = [*account.facts, *(x for v in account.values for x in v.facts)]
    for words in (
        *(each.words for each in facts),
        *(line for reply in account.replies for line in reply.lines),
        *(note.words for note in account.notes),
    ):
        assert bare(words) in everything


@given(account=ACCOUNTS, width=st.integers(40, 140))
def test_no_line_is_wider_than_the_terminal(account, width):
    """Sentences at any width, and numbers too where one of them has room."""
    assert max(map(len, lines(account, width=width))) <= max(64, min(width, 100))


@given(width=st.integers(40, 100), words=st.lists(st.sampled_from("abc"), max_size=40))
def test_no_line_ends_within_a_number(width, words):
    said = " ".join([*words, "is 1.25 ± 0.12 of 7 980 (p = 0.5, T < 3) or 5 %."] * 3)
    rows = lines(Account(title="", said=said), width=width)
    assert bare(" ".join(rows)) == bare(said)
    for row in rows:
        assert not re.search(r"([±=<]|\b7|\b5)$|^ *([±=<%]|980)", row), row


def test_in_ascii_columns_end_one_below_the_other():
    cells = [Quantity("x", 1.0, 0.1), Quantity("y", 10.0, 0.1)]
    limits = [Quantity("x", None, None, 0.0, 5.0)] * 2
    rows = [Line("N", "µg/√Hz", cells), Line("K", "", limits)]
    account = Account(title="Noise", values=[Values(title="noise", lines=rows)])
    *_, first, second = lines(account, spell=in_ascii)
    assert "ug/sqrt Hz" in first
    assert "1.00 +- 0.10" in first
    assert first.isascii()
    assert len(first) == len(second)


@given(account=ACCOUNTS)
def test_the_gravest_answer_is_that_of_the_account(account):
    grave = [GRAVITY.index(reply.answer) for reply in account.replies]
    assert account.answer == GRAVITY[max(grave, default=0)]
    for reply in account.replies:
        said = bare("\n".join(lines(account)))
        assert bare(f"{MARKS[reply.answer]} {reply.title}") in said


@given(size=st.floats(1e-12, 1e12), shares=st.lists(st.floats(-1.0, 1.0), max_size=5))
@example(size=0.00999, shares=[])
@example(size=999_999.9, shares=[0.5])
def test_numbers_of_one_quantity_have_one_power_of_ten(size, shares):
    cells = [Quantity("x", size * share, 1e-3 * size) for share in (1.0, *shares)]
    made = in_thousands([Line("K", "s", cells[:2]), Line("K", "s", cells[2:])])
    assert len({each.unit for each in made}) == 1
    power = round(-np.log10(made[0].factor))
    assert power % 3 == 0
    assert made[0].unit == (f"1e{power} s" if power else "s")
    # below a thousand where there is a power, and with no long row of zeros elsewhere
    top = size * made[0].factor
    low, high = (1.0, 1e3) if power else (1e-2, 1e6)
    assert low * (1.0 - 1e-12) <= top <= high * (1.0 + 1e-12)  # rounding of the power


def test_a_limit_is_a_limit_and_what_is_not_there_is_a_dash():
    cells = [Quantity("N", None, None, 0.0, 1234.0), Quantity("N", None)]
    assert Line("N", "", cells).spelled == ["< 1200", "-"]
    assert Quantity("T", None, None, 3.0, np.inf).spelled() == "> 3"


# results


def made_plan(poses, noise):
    """Plans of an accelerometer and of a gyroscope, and what is said of both."""
    found = plan(named_poses(poses), noise)
    turned = plan_gyroscope(
        named_poses(poses), pose_std=noise, angle_random_walk=1e-4,
        rotation_seconds=2.0, rest_seconds=5.0,
    )  # fmt: skip
    return found, turned, plan_account(found, turned)


@pytest.mark.parametrize(
    ("poses", "noise", "answer", "said"),
    [
        ("faces+edges", 0.003, "pass", "Yes: the poses determine all nine parameters"),
        ("faces", 0.003, "fail", "No: 6 poses determine 6 of the nine parameters"),
        ("fibonacci:20", 6.0, "fail", "the prediction does not hold"),
        ("fibonacci:20", 1.0, "fail", "a scale will be known to 11 % only"),
    ],
)
def test_a_plan_is_short_and_says_what_is_wrong_with_it(poses, noise, answer, said):
    found, turned, both = made_plan(poses, noise)
    for account in (found.account, turned.account, both):
        assert len(lines(account)) <= 25
        check_faces(account)
    assert {found.account.answer, both.answer} == {answer}
    for face, spelled in shown(both):
        assert spelled(said) in face
    assert str(found) == "\n".join(lines(found.account))


def test_a_plan_says_no_where_the_poses_are_in_one_half():
    u = fibonacci_sphere(60)
    found = plan(u[u[:, 2] > 0.6], 1e-3)
    assert found.rank == 9
    assert found.geometry > GEOMETRY_LIMIT
    assert found.account.answer == "fail"
    assert "directions not yet covered" in str(found)


def test_what_a_plan_says_that_helps_is_what_helps():
    """By plans of the poses that are proposed, and not of how errors are found."""
    u = fibonacci_sphere(20)
    found = plan(u, 0.003)
    more = plan(np.vstack([u, found.next_direction]), 0.003)
    gain = np.max(1.0 - more.sd / found.sd)
    assert f"by {100.0 * gain:.2g} % at most" in str(found)
    for better in (plan(u, 0.0015), plan(np.tile(u, (4, 1)), 0.003)):
        np.testing.assert_allclose(better.sd, found.sd / 2.0, rtol=1e-9)


def test_a_plan_over_temperature_says_every_rest():
    found = plan_thermal(fibonacci_sphere(20), [10.0, 25.0, 40.0], 0.003, rests=20)
    check_faces(found.account)
    assert len(lines(found.account)) <= 25
    assert str(found).count("(0.15,0.96,-0.25)") == np.sum(
        np.all(np.abs(found.directions - [0.15, 0.96, -0.25]) < 0.005, axis=1)
    )
    assert len(re.findall(r"\([-0-9.]+,[-0-9.]+,[-0-9.]+\)", str(found))) == 20


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A log of three sensors, and its calibration."""
    log = read_log(of_scene(tmp_path_factory.mktemp("scene")))
    return log, calibrate_sensors(log, calibrate_log(log))


def test_a_calibration_is_short_and_its_warnings_are_seen(whole):
    log, found = whole
    account = with_log(found.account, log)
    assert len(lines(account)) <= 35
    check_faces(account)
    assert str(found) == "\n".join(lines(found.account))


def changes(found):
    """Each thing that a reader must know, done to a result, and words of it."""
    units = {"gyro": Made(said=("gyroscope: the header says rad/s, but it is deg/s",))}
    yield dict(units=units), "but it is deg/s"
    yield dict(left_out={"magnetometer": "its field turns"}), "its field turns"
    for change, words in (
        (dict(geometry=9.0), "9 times that of as many poses"),
        (dict(widest=0.12), "known to 12 % only"),
        (dict(freedom=3), "3 degrees of freedom"),
        (dict(hidden=50.0, hides="the bias of x"), "a drift of the bias of x"),
        (dict(outliers=(3,)), "Look at rest 3"),
    ):
        yield dict(diagnosis=replace(found.diagnosis, **change)), words
    noise = replace(found.pose_noise, words="white noise alone: why", do="Rest longer.")
    yield dict(pose_noise=noise), "white noise alone: why. Rest longer."
    for name in ("cuts", "steps"):
        yield {name: ("rest 1 ...", "rest 2 ...")}, "2 rests"
    fit = replace(found.accelerometer, status="max iterations")
    yield dict(accelerometer=fit), "max iterations"
    iron = Remark("disturbed", "the field is disturbed", "Remove the iron.")
    compass = replace(found.magnetometer, findings=(iron,))
    yield dict(magnetometer=compass), "the field is disturbed. Remove the iron."
    # what an answer says is not said a second time
    out = replace(found.magnetometer, disturbed=(3,), findings=(Remark("poses", "3"),))
    yield dict(magnetometer=out), "the field is another in rest 3"
    why = ("the three sensors are not fitted together",)
    alone = dict(together=None, taken=found.taken._replace(reasons=why))
    yield alone, "not fitted together"


def test_each_warning_is_in_the_short_view_of_every_face(whole):
    log, found = whole
    for change, words in changes(found):
        account = replace(found, **change).account
        check_faces(account)
        for face, spelled in shown(account):
            assert spelled(words) in face, words
    # what was read of the log: mended, left out, columns by their place
    read = replace(
        log, source=(("mended", "row 7"),), unclear=(Remark("", "a compass: no names"),)
    )
    account = with_log(found.account, read)
    for face, spelled in shown(account):
        for words in ("row 7", "a compass: no names"):
            assert spelled(words) in face


def test_the_noise_of_a_log_says_what_it_does_not_show(whole):
    log, _ = whole
    found = log_noise(log)
    units = units_of(log, means=found.means)
    sensors = {name: (getattr(found, name), units[name]) for name in units}
    found = replace(found, left_out={"magnetometer": "its readings stand still"})
    account = with_log(noise_account(found, sensors), log)
    check_faces(account)
    for words in ("its readings stand still", "several times longer", "<"):
        assert words in bare("\n".join(lines(account)))
