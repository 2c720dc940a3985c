"""docs/attitude.md states what its suite measures: docs/examples/attitude.toml."""

import re

import numpy as np
import pytest
from places import EXAMPLES, ROOT

from simval.sweep import load_run, run_suite

PAGE = " ".join((ROOT / "docs" / "attitude.md").read_text(encoding="utf-8").split())


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    folder = tmp_path_factory.mktemp("page") / "run"
    run_suite(str(EXAMPLES / "attitude.toml"), folder)
    cells = load_run(folder).cells

    def found(study, statistic, predictor=None, **own):
        """The one row of the one cell with these parameters."""
        (row,) = (
            row
            for cell in cells
            if cell.study == study
            and all(cell.parameters[name] == value for name, value in own.items())
            for row in cell.rows
            if str(row.statistic) == statistic and predictor in (None, row.predictor)
        )
        return row

    return found


def stated(row, digits, factor=1.0):
    value, error = factor * row.value, factor * row.standard_error
    return f"{value:.{digits}f}" + (f" ± {error:.{digits}f}" if error else "")


@pytest.mark.slow  # the suite takes two minutes
def test_the_page_states_what_its_suite_measures(rows):
    said = []

    def efficiency(name, kind, digits, **own):
        own = {"noise": "isotropic", "normalized": False} | own
        pair = (
            rows("attitude_efficiency", f"{kind}[{name},{what}]", **own).value
            for what in ("median", "worst")
        )
        return ", ".join(f"{value:.{digits}f}" for value in pair)

    best = efficiency("best of four", "rms_ratio", 2)
    tangent = efficiency("best of four", "rms_ratio", 2, noise="tangent")
    said.append(f"{best} | {tangent} |")
    assert efficiency("best of four", "rms_ratio", 2, normalized=True) == tangent
    said.append(f"{efficiency('combined', 'rms_ratio', 3)} | 1 |")
    said.append(f"{efficiency('TRIAD', 'simulated_rms_ratio', 2)} (simulated)")
    unequal = [
        efficiency("combined", "rms_ratio", 3, noise="unequal", normalized=normalized)
        for normalized in (False, True)
    ]
    said.append("at {} times, normalised at {}.".format(*unequal))
    longer, longest = (
        rows("attitude_efficiency", f"length_turn[{name},worst]", noise="isotropic")
        for name in ("combined", "best of four")
    )
    turns = [f"{np.degrees(row.value):.1f}" for row in (longer, longest)]
    said.append(f"{turns[0]} degrees in the 500 geometries, `best` by up to {turns[1]}")
    near = {"distance": 3.0, "noise_std": 3e-3}
    plain, normalised = (
        {
            case: rows("attitude_singular", f"rms_over_bound[{k}]", case=case, **near)
            for case in "BC"
        }
        for k in ("plain", "plain, normalised")
    )
    said.append(
        f"is {stated(plain['C'], 1)} times the bound, normalised "
        f"{stated(normalised['C'], 3)} times"
    )
    said.append(f"it is {stated(plain['B'], 1)} and {stated(normalised['B'], 1)} times")
    for name, words in (
        ("best of four", "best of four frames"),
        ("sequential", "sequential rotations"),
        ("Table 1", "Table 1, cases B to D, turns of 46 to 86 degrees"),
        ("combined", "all four frames combined"),
    ):
        least, median, most = (
            [
                rows("attitude_singular", f"rms_ratio[{name},{what}]", case=case,
                     distance=0.0, noise_std=1e-3).value
                for case in ("BCD" if name == "Table 1" else "ABCD")
            ]
            for what in ("least", "median", "most")
        )  # fmt: skip
        ends = sorted({f"{value:.2f}" for value in (min(median), max(median))})
        said.append(
            f"| {words} | {min(least):.2f} | {' to '.join(ends)} | {max(most):.2f} |"
        )
    heavy = rows("attitude_vectors", "inconsistent_rate[good]", noise="heavy tails",
                 ratio=1.0)  # fmt: skip
    said.append(f"rejects {stated(heavy, 2, 100.0)} %")
    nees = [
        rows("attitude_vectors", f"nees[{name}]", noise="isotropic", ratio=100.0)
        for name in ("combined", "equal weights", "weighted")
    ]
    said.append(
        f"{stated(nees[0], 1)} for `combined`, {stated(nees[1], 2)} for equal weights, "
        f"{stated(nees[2], 2)} for `weighted`"
    )
    for label, words in (("source", "the source's"), ("complete", "complete")):
        for frame in ("greatest", "plain"):
            shares = [
                stated(rows("attitude_map", f"nearer_at[{ratio}]", f"order 4, {label}",
                            frame=frame), 0, 100.0)
                for ratio in ("6", "4", "3", "2.5", "2", "1.5", "1", "0.5")
            ]  # fmt: skip
            said.append(f"| {words} fourth, {frame} | {' | '.join(shares)} |")
    assert [each for each in said if each not in PAGE] == []


def test_every_study_that_the_page_names_is_in_its_suite():
    suite = (EXAMPLES / "attitude.toml").read_text(encoding="utf-8")
    named = set(re.findall(r"`(attitude_[a-z]+)`", PAGE))
    studies = named - {"attitude_moments", "attitude_bound", "attitude_density"}
    assert studies == set(re.findall(r"^\[(\w+)\]", suite, re.MULTILINE))
