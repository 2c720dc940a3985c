"""A new baseline has a reason for each kind of statistic that moved."""

import re

import pytest
from stores import edited

from simval.errors import InputError
from simval.judge import read_baseline, write_baseline
from simval.judge.findings import reasons_given
from simval.sweep import load_run


@pytest.fixture
def moved(simval, tiny_run, tmp_path):
    """A run of which two kinds of statistic moved, and its old baseline."""
    baseline = tmp_path / "baseline.json"
    write_baseline(baseline, load_run(tiny_run), "before")
    edited(
        tiny_run,
        "UPDATE rows SET value = value + 9 * standard_error "
        "WHERE family IN ('bias', 'rms') AND standard_error > 0",
    )
    return tiny_run, baseline


def test_each_kind_that_moved_needs_its_reason(simval, moved):
    run, baseline = moved
    before = baseline.read_bytes()
    words = ("gate", run, "--baseline", baseline, "--update-baseline", "new solver")
    code, _, err = simval(*words)
    assert code == 2
    assert baseline.read_bytes() == before
    # what moved is printed with its size, and the options to give
    assert re.search(r"fail: .*baseline: \w+, .* standard errors", err)
    kinds = re.findall(r"--reason '(.*)=WHY'", err)
    assert len(kinds) >= 2
    assert re.search(rf"{len(kinds)} kinds of statistic moved", err)
    # all but one: that one is still missing
    *most, last = kinds
    stated = [x for kind in most for x in ("--reason", f"{kind}=because of {kind}")]
    code, _, err = simval(*words, *stated)
    assert code == 2
    assert re.findall(r"--reason '(.*)=WHY'", err) == [last]
    assert baseline.read_bytes() == before
    simval(*words, *stated, "--reason", f"{last}=it is the last")
    content = read_baseline(baseline)
    assert content["reason"] == "new solver"
    assert content["reasons"] == {
        **{kind: f"because of {kind}" for kind in most},
        last: "it is the last",
    }


def test_an_unchanged_run_needs_none(simval, tiny_run, tmp_path):
    baseline = tmp_path / "baseline.json"
    write_baseline(baseline, load_run(tiny_run), "before")
    words = ("gate", tiny_run, "--baseline", baseline)
    assert simval(*words, "--update-baseline", "the same again")[0] == 0
    assert read_baseline(baseline)["reasons"] == {}
    assert simval(*words, "--reason", "bias=why")[0] == 2  # without an update


def test_reasons_are_for_what_moved():
    kinds = ["calibration, bias of B", "ladder, efficiency of K"]
    assert reasons_given(kinds, [], "all") == {}
    assert reasons_given(kinds[:1], [], "all") == {kinds[0]: "all"}
    given = reasons_given(kinds, ["ladder=x = y", f"{kinds[0]}= z "], "all")
    assert given == {kinds[1]: "x = y", kinds[0]: "z"}
    for bad in ("ladder", "ladder=", "ladder= ", "=why", "laddr=why", "=", ""):
        with pytest.raises(InputError, match=r"--reason|nothing that is called"):
            reasons_given(kinds, [bad], "all")
    with pytest.raises(InputError, match="did you mean"):
        reasons_given(kinds, ["laddr=why"], "all")
