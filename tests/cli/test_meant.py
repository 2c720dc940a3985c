"""A slip of the pen is answered with the name that was meant, from one place."""

import os

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from simval import vocabulary
from simval.arguments import choice
from simval.cli import COMMANDS
from simval.errors import InputError
from simval.plugins.loading import find_plugin
from simval.plugins.protocol import Estimator
from simval.scene import simulate
from simval.studies import find_study
from simval.text import LONGEST, OTHER_WORDS, did_you_mean, nearest

LISTS = {
    "commands": tuple(name for name, _ in COMMANDS),
    "scenes": vocabulary.SCENES,
    "studies": vocabulary.STUDIES,
    "suites": vocabulary.builtin_suites(),
}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["swep"], "No such command 'swep' (did you mean `sweep`?)"),
        (["suite_schema"], "(suite-schema)"),
        (["cal"], "(calibrate)"),
        (["sweep", "--see", "1"], "Did you mean"),
        (["sweep", "acuracy", "--dry-run"], "`acuracy` (did you mean `accuracy`?)"),
        (["sweep", "smoke", "--set", "atitude.noise_std=1"], "(attitude)"),
        (["sweep", "smoke", "--set", "attitude.nois_std=1"], "(noise_std)"),
        (["sweep", "smoke", "--set", "calibration.positions=9"], "(poses)"),
        (["sweep", "smoke", "--plugin", "simval:whaba"], "(simval:wahba)"),
        (["scene", "gimbel"], "(gimbal)"),
        (["scene", "--set", "directions=4"], "(poses)"),
        (["scene", "die", "--set", "throws=4"], "(poses)"),
        (["scene", "--set", "holdtime=4"], "(hold_time)"),
        (["repro", "attitude_map(frame=plian)@1"], "the nearest are"),
    ],
)  # fmt: skip
def test_a_slip_is_answered(simval, words, said):
    if said.startswith("("):
        said = f"(did you mean `{said[1:-1]}`?)"
    code, _, err = simval(*words)
    assert code == 2
    assert said in " ".join(err.split())
    assert "Traceback" not in err


@pytest.mark.parametrize(
    "ask",
    [
        lambda: find_study("attitud"),
        lambda: find_plugin("wahba", Estimator),
        lambda: simulate("gimbal", n_poses=4),
        lambda: choice("loss", "hubr", vocabulary.LOSSES),
    ],
    ids=["study", "plugin", "parameter", "choice"],
)
def test_every_name_asks_the_same_way(ask):
    with pytest.raises(InputError, match=r"\(did you mean `[\w:]+`\?\)"):
        ask()


def test_a_run_of_a_near_name_is_named_and_the_latest_is_found(
    simval, tiny_run, tmp_path, monkeypatch
):
    runs = tmp_path / vocabulary.RUNS
    runs.mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    code, _, err = simval("gate", "latest")
    assert (code, f"there is no run under {vocabulary.RUNS}" in err) == (2, True)
    (runs / "nightly").symlink_to(os.path.realpath(tiny_run))
    assert simval("gate", "latest", "--no-baseline")[0] == 0
    for slip in ("nightly", "nighly", str(vocabulary.RUNS / "Nightly_")):
        code, _, err = simval("report", slip)
        assert code == 2
        assert f"is no run folder (did you mean `{vocabulary.RUNS}/nightly`?)" in err
    code, _, err = simval("report", "quite-another")
    assert (code, "is no run folder" in err, "did you mean" in err) == (2, True, False)


@pytest.mark.parametrize("names", LISTS.values(), ids=LISTS.keys())
def test_each_name_is_found_with_one_letter_left_out(names):
    for name in names:
        for place in range(len(name)):
            slip = name[:place] + name[place + 1 :]
            if slip not in names and len(slip) > 2:
                assert name in nearest(slip, names, 2), slip


@given(st.text(max_size=40))
@example("")
@example(" \0\ud800")
@example("x" * (LONGEST + 1))
@example("poses" * 10**5)
def test_any_text_gives_one_of_the_known_names_or_nothing(word):
    known = ("poses", "noise_std", "N_POSES")
    found = nearest(word, known, 2)
    assert len(found) <= 2
    assert set(found) <= set(known)
    assert did_you_mean(word, known) == (
        f" (did you mean `{found[0]}`?)" if found else ""
    )
    assert nearest(word, ()) == []


def test_an_earlier_name_leads_to_the_present_one_where_that_is_known():
    for old, new in OTHER_WORDS.items():
        assert nearest(old, ["noise", new]) == [new]
        assert new not in nearest(old, ["noise"])
    assert nearest("directions", ["poses", "directions_2"]) == ["poses"]
