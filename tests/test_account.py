"""An account: each face has its answers, numbers and warnings, at any width."""

import re
from dataclasses import replace
from types import SimpleNamespace as Made

import numpy as np
import pytest
from faces import bare, check_faces, shown
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
from simval.account.terminal import MARKS, lines
from simval.imu.logs import read_log
from simval.imu.multiposition import calibrate_log, calibrate_sensors
from simval.imu.multiposition.description import with_log
from simval.imu.multiposition.log_units import Scale, units_of
from simval.imu.multiposition.noise import log_noise
from simval.imu.multiposition.noise_description import noise_account, noisy
from simval.imu.recorded.description import FilteredLog
from simval.imu.recorded.errors import NormalisedSquare, Rms, judged_once
from simval.imu.recorded.filter_account import filters_account
from simval.imu.recorded.settings import Signals, TurnedRest, start_of
from simval.imu.recorded.world import World
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
    notable=st.booleans(),
)  # fmt: skip
VALUES = st.builds(Values, title=st.just("sensor"), how=WORDS,
                   lines=st.lists(LINES, max_size=3), facts=FACTS)  # fmt: skip
REPLIES = st.builds(
    Reply, title=WORDS, headline=WORDS, answer=st.sampled_from(GRAVITY), do=WORDS,
    lines=st.lists(WORDS, max_size=2).map(tuple),
)  # fmt: skip
ACCOUNTS = st.builds(
    Account, title=st.just("Result of"), source=WORDS, said=WORDS,
    replies=st.lists(REPLIES, max_size=3), values=st.lists(VALUES, max_size=2),
    notes=st.lists(st.builds(Note, words=WORDS), max_size=1), facts=FACTS, record=FACTS,
)  # fmt: skip


# blanks at which no line ends, in more words than a line has
TANGLED = " ".join(["0", *["<" + 11 * "0"] * 5])


@given(account=ACCOUNTS)
@example(
    account=Account(title="Result of", said=TANGLED, facts=[Fact("a", TANGLED, True)])
)
def test_every_face_has_every_answer_number_and_warning(account):
    check_faces(account)
    everything = bare("\n".join(lines(account, verbose=True)))
    facts = [*account.all_facts, *(x for v in account.values for x in v.facts)]
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
    assert f"by up to {100.0 * gain:.2g} %" in str(found)
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
    left = {"magnetometer": Remark("geometry", "its field turns", "Turn it too.")}
    yield dict(left_out=left), "its field turns. Turn it too."
    for change, words in (
        (dict(geometry=9.0), "9 times that of as many poses"),
        (dict(widest=0.12), "known to 12 % only"),
        (dict(freedom=3), "3 degrees of freedom"),
        (dict(hidden=50.0, hides="the bias of x"), "a drift of the bias of x"),
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
    sensors = noisy(found, units)
    still = Remark("refused", "its readings stand still")
    found = replace(found, left_out={"magnetometer": still})
    account = with_log(noise_account(found, sensors), log)
    check_faces(account)
    for words in ("its readings stand still", "several times longer", "<"):
        assert words in bare("\n".join(lines(account)))


# filters over a log


def square(verdict, mean, expected=3.0):
    few = verdict == "not judged"
    return NormalisedSquare(
        mean=mean, expected=expected, low=mean / 2, high=2 * mean,
        blocks=0 if few else 24, verdict=verdict,
    )  # fmt: skip


WORLD = World(
    matrix=np.eye(3), tilt_sd=1e-3, tilt_dof=8, heading_sd=0.01, heading_dof=23,
    deviation=0.05, rests=5, name="NWU", off=np.zeros(3), taken="stated",
)  # fmt: skip


def evaluation(name, nees=None, *, rms=0.01, truth=True, nis=None, rows=None, **more):
    """A filter with such verdicts, with truth or without."""
    world, motion = more.pop("world", WORLD), more.pop("motion", 0.0)
    cautious = more.pop("cautious", False)
    of = {x: Rms(value=rms, sd=rms / 10, rows=100)
          for x in ("total", "heading", "inclination")}  # fmt: skip
    # errors that are as large all along, but for a sway by which blocks of time differ
    total = rms * (1.0 + 0.01 * np.sin(np.arange(100.0)))
    known = Made(
        rms=dict.fromkeys(("all", "rest", "moving"), of), nees=nees, world=world,
        errors=Made(time=np.arange(100.0), total=total),
        **dict(free=False, drift=None, bound=None, turned=(rms, rms), settled=1.0)
        | more,
    )  # fmt: skip
    return Made(
        run=Made(
            name=name, motion=motion, how="declared: attitude in NWU", cautious=cautious
        ),
        truth=known if truth else None, nis=nis, rows=rows, white=None, published=(),
        at_rest=Made(drift=1e-4, inclination=1e-3, rests=3, settled=2),
        microseconds=2.0,
    )  # fmt: skip


JUDGED = [
    (square("consistent", 3.0), "pass", "Yes: mine is as wrong as it states", ""),
    (square("overconfident", 75.0), "fail", "mine is 5 times as wrong", "more noise"),
    # a mean of a few stretches, whose interval holds all
    (
        replace(square("consistent", 75.0), high=1e4),
        "inconclusive",
        "mine is 5 times as wrong as it states, but only in some stretches",
        "more noise",
    ),
    (square("underconfident", 0.03), "fail", "states 10 times its error", "less noise"),
    (square("not judged", 3.0), "inconclusive", "too few rows", "Record for longer"),
    (
        replace(square("not judged", 3.0), blocks=6),
        "inconclusive",
        "north is too",
        "--truth-world",
    ),
    (None, "inconclusive", "mine states no covariance", ""),
]


@pytest.mark.usefixtures("unchecked")  # made of what the account reads, and no more
@pytest.mark.parametrize(("nees", "answer", "said", "do"), JUDGED)
def test_no_filter_is_trusted_that_is_wrong(nees, answer, said, do):
    account = filters_account([evaluation("mine", nees)])
    check_faces(account)
    wrong, trusted = account.replies
    assert wrong.headline.startswith("0.573 ± 0.057° RMS")  # 0.01 rad
    assert trusted.answer == answer
    assert said in trusted.headline
    assert do in trusted.do


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("innovations", "answer"),
    [("consistent", "inconclusive"), ("underconfident", "fail")],
)
def test_no_filter_is_blamed_for_a_walk_that_is_a_limit(innovations, answer):
    """It states what it was given; one that doubts its sensors, too, is to blame."""
    nees, nis = square("underconfident", 0.5, 2.0), square(innovations, 2.8, 3.0)
    drift = judged_once(np.ones(100))
    six = evaluation("six", nees, nis=nis, cautious=True, free=True, drift=drift)
    account = filters_account([six])
    check_faces(account)
    assert account.replies[1].answer == answer
    assert "states 2 times its error" in account.replies[1].headline
    limit = "is an upper limit" in account.replies[1].headline
    assert (
        limit == (answer == "inconclusive") == ("longer rest" in account.replies[1].do)
    )


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("drift", "answer", "said"),
    [(20.0, "fail", "the heading of six drifts 4.5 times as far as it states"),
     (1.0, "pass", "six is as wrong"), (np.nan, "pass", "six is as wrong")],
)  # fmt: skip
def test_a_drift_that_is_wrong_is_said(drift, answer, said):
    """Without a magnetometer inclination may be as stated where heading is not."""
    drifts = judged_once(np.full(100, drift))
    six = evaluation("six", square("consistent", 2.0, 2.0), free=True, drift=drifts)
    account = filters_account([six])
    check_faces(account)
    assert account.replies[1].answer == answer
    assert said in account.replies[1].headline
    assert "nan" not in str(lines(account, verbose=True))


def filters_said():
    """Filters, and what must be seen of them."""
    good = evaluation("mine", square("consistent", 3.0))
    yield filters_account([], {"other": "it returned NaN"}), "it returned NaN"
    yield filters_account([good], {"other": "it returned NaN"}), "not measured"
    blind = evaluation("mine", truth=False, nis=square("consistent", 6.0, 6.0))
    for found, words in (
        (good, "mine is as wrong"),
        (evaluation("mine", settled=np.nan), "does not settle within the log"),
        (evaluation("mine", square("overconfident", 9.0), motion=0.5), "noise 0.5"),
        (blind, "this is a self-check only"),
        (evaluation("mine", truth=False), "mine states no covariance"),
        (evaluation("mine", truth=False, nis=square("overconfident", 54.0, 6.0)),
         "the innovations of mine are 3 times as large as it states"),
    ):  # fmt: skip
        yield filters_account([found]), words
    for nis, do in (("consistent", "so more noise is no cure"),
                    ("overconfident", "Give mine more noise")):  # fmt: skip
        each = evaluation("mine", square("overconfident", 9.0), nis=square(nis, 6.0))
        yield filters_account([each]), do
    wide = replace(square("consistent", 800.0, 6.0), high=1e5)
    each = evaluation("mine", square("overconfident", 9.0), nis=wide)
    yield filters_account([each]), "Give mine more noise"
    clash = replace(square("not judged: rows", 3.0), blocks=24)
    rows = Made(remedy=Made(options=("--gyro-rows", "instant")))
    yield filters_account([evaluation("mine", clash, rows=rows)]), "--gyro-rows instant"
    yield filters_account([blind], quaternions=("opt_q",)), "add --truth opt_q"
    few = evaluation("late", square("not judged", 3.0), rms=np.nan)
    yield filters_account([few]), "Cannot tell: too few rows have truth"
    yield filters_account([good, few]), "too few rows have truth to judge late"
    # by another north they change places, or cannot be ranked
    world = replace(WORLD, off=np.array([0.0, 0.0, 0.1]))
    sizes = {"one": (0.01, 0.05), "two": (0.02, 0.01)}
    pair = [evaluation(name, rms=turned[0], world=world, turned=turned)
            for name, turned in sizes.items()]  # fmt: skip
    yield filters_account(pair), "one and two change places"
    for each in pair:
        each.truth.world = replace(WORLD, taken="estimated")
    yield filters_account(pair), "Cannot rank one and two"
    yield filters_account(pair), "a filter that follows it looks better"
    known = dict(rms=0.01, world=replace(WORLD, taken="estimated"))
    tied = [evaluation("one", turned=(0.01, 0.01), **known),
            evaluation("two", turned=(0.02, 0.02), **known)]  # fmt: skip
    yield filters_account(tied), "Cannot rank one and two"


@pytest.mark.usefixtures("unchecked")
def test_what_is_wrong_with_filters_is_in_the_short_view_of_every_face():
    for account, words in filters_said():
        check_faces(account)
        for face, spelled in shown(account):
            assert spelled(words) in face, words


@pytest.mark.usefixtures("unchecked")
def test_filters_are_ranked_with_ties_and_a_comparison_is_short():
    good = square("consistent", 3.0)
    sizes = {"best": 0.01, "tied": 0.01, "last": 0.02}
    three = [evaluation(name, good, rms=size) for name, size in sizes.items()]
    account = filters_account(three)
    assert len(lines(account)) <= 35 - 9  # warnings and a second table are to come
    (wrong, trusted) = account.replies
    assert "Least: best and tied, no difference beyond chance" in wrong.headline
    assert "Most: last" in wrong.headline
    assert trusted.headline.count("is as wrong as it states") == 3


def a_log(**changes):
    """Ten seconds at rest, and what was found wrong with them."""
    rng, time = np.random.default_rng(1), np.arange(0.0, 10.0, 0.02)
    noise = rng.standard_normal((2, 500, 3))
    rows = dict(gyro=1e-3 * noise[0], force=0.02 * noise[1] + [0.0, 0.0, 9.8])
    return Signals(
        **dict(time=time, field=None, rate=50.0, rests=np.array([[0, 400]]),
               gyro_unit="rad/s", force_unit="m/s^2", field_unit="") | rows | changes
    )  # fmt: skip


def test_what_is_wrong_with_a_filtered_log_is_in_the_short_view_of_every_face():
    cut = TurnedRest(start=1.0, stop=4.0, kept=((1.0, 2.0),), turns=0.2)
    scale = Scale(1.0, "rad/s", said=("the header says rad/s, but it is deg/s",))
    jolt = np.tile([0.0, 0.0, 9.8], (500, 1)) * np.linspace(1.0, 1.2, 500)[:, None]
    for changes, words in (
        (dict(cuts=(cut, cut)), "2 rests cut or left out: the gyroscope turns"),
        (dict(scales=(scale,)), "but it is deg/s"),
        (dict(force=jolt), "an axis while moving; the noise used is"),
    ):
        found = a_log(**changes)
        whole = FilteredLog(found=found, start=start_of(found), done=(), failed={})
        check_faces(whole.account)
        for face, spelled in shown(whole.account):
            assert spelled(words) in face, words


def test_up_that_is_off_by_more_than_chance_is_seen():
    """F of 2 and 8 degrees: 1 % at 8.649, so 4.159 times the deviation of an axis."""

    def upright(x, y, dof=8):
        return replace(WORLD, off=np.array([x, y, 0.5]), tilt_dof=dof).upright

    assert upright(0.0, 0.0)
    assert upright(4.15e-3, 0.0)
    assert not upright(0.0, 4.17e-3)
    assert not upright(3e-3, 3e-3)
    assert upright(1.0, 0.0, dof=0)  # one rest does not show it
