"""The claims of the four sources and docs/errata.md: see tests/errata."""

import re
from pathlib import Path

import errata
import numpy as np
import pytest
from errata import moments, page, symmetric
from errata.claim import CLAIMS, RIGHT, check
from mutants import claims as faults

from simval.geometry import normalize
from simval.theory import attitude_moments

EVALUATED = [name for name, claim in CLAIMS.items() if claim.evaluate]
DOCS = Path(__file__).parents[2] / "docs"
INDEX = (DOCS / "errata.md").read_text("utf-8")
PAGES = {path.stem: path.read_text("utf-8") for path in DOCS.glob("errata/*.md")}
THEORY = (DOCS / "theory.md").read_text("utf-8")


@pytest.mark.parametrize("name", EVALUATED)
def test_claim(name):
    check(CLAIMS[name], seeds=slice(1))


@pytest.mark.ci
def test_claims_at_other_draws():
    for name in EVALUATED:
        check(CLAIMS[name], seeds=slice(1, None))


def test_pages_have_what_the_command_prints():
    # counts and every claim, neither one more nor one less
    assert page.counts() in INDEX
    assert {*page.SOURCES, "theorem"} == set(PAGES)
    for source in page.SOURCES:
        assert PAGES[source].endswith("\n\n" + page.table(source))


def test_every_erratum_has_its_sentence_and_every_name_its_claim():
    sentences = INDEX + "".join(
        text.partition("## Every claim")[0] for text in PAGES.values()
    )
    rows = re.findall(r"^\|.*\| ((?:`\w+`(?:, )?)+) \|$", sentences, re.M)
    named = [name for row in rows for name in re.findall(r"\w+", row)]
    wrong = [name for name in EVALUATED if CLAIMS[name].verdict != RIGHT]
    assert sorted(named) == sorted(wrong)
    # and those that sentences call by name, as theory.md does
    theory = re.findall(r"`(\w+)` in \[errata\.md\]", THEORY)
    called = re.findall(r"`([a-z]+\w*_\w+)`", sentences)
    assert len(theory) >= 1
    assert {*theory, *called} - {"s_ij"} <= set(EVALUATED)


def test_every_numbered_equation_of_the_paper_is_a_claim():
    places = [CLAIMS[name].place for name in EVALUATED]
    numbers = [re.match(r"\((\d+)\)", place) for place in places]
    assert {int(n[1]) for n in numbers if n} == set(range(1, 66))


def test_figures_of_the_page():
    ratios = [c.error(c.with_square) / c.error(c.second) for c in moments.sample()]
    farther = sum(c.error(c.paper) > c.error(c.second) for c in moments.sample())
    text = " ".join(" ".join(PAGES.values()).split())
    stated = f"median ratio of the errors of {np.median(ratios):.2f}, "
    assert f"{stated}at worst {max(ratios):.3f}." in text
    assert f"in {farther} of {len(ratios)} random geometries" in text
    # the same noise on b1 and b2: what the bilinear part's mean adds across q
    rng = np.random.default_rng(1664)
    q, r1, r2 = (normalize(rng.standard_normal(n)) for n in (4, 3, 3))
    L = 0.02 * np.eye(12)
    L[3:6, :3], L[3:6, 3:6] = L[:3, :3], 0.0
    second, exact = (
        attitude_moments(q, r1, r2, L @ L.T, order, "plain").bias[3]
        for order in (2, "exact")
    )
    length = abs(q[:3] @ np.cross(r1, r2))
    paper = second + 0.75 * 0.02**2 / length * (1.0 - q[3] ** 2)
    stated = f"(52) gives {paper:.5f} for the scalar part, with that mean it is "
    assert f"is {length:.3f}, {stated}{second:.5f}, and exactly {exact:.5f}." in text


def test_every_second_derivative_but_one_is_printed_right_somewhere():
    right = {place.rstrip("+") for place in symmetric.lines()} - {"99"}
    right = {min(p, p[::-1]) for p in right if p.isdigit() and p not in symmetric.WRONG}
    wanted = {f"{i}{j}" for i in range(1, 10) for j in range(i, 10)}
    # 7 7 is right in its second form, 2A; 9 9 is nowhere
    assert wanted - right == {"77", "99"}
    values, *true = symmetric.problem(np.random.default_rng(0))
    assert symmetric.said("77", values, *true) == pytest.approx(
        symmetric.entry("77", *true), rel=1e-14
    )


@pytest.mark.ci
def test_a_fault_in_a_sample_of_claims_is_seen():
    left = faults.left_over(EVALUATED, 60)
    assert left == []


@pytest.mark.slow
def test_every_fault_in_a_claim_is_seen():
    assert faults.left_over(EVALUATED, 1) == []


def test_a_kept_fault_has_a_reason_and_a_claim():
    listed = faults.listed()
    assert all(one["why"] and one["claim"] in CLAIMS for one in listed)


def test_every_module_of_claims_is_entered():
    modules = {path.stem for path in Path(errata.__file__).parent.glob("*.py")}
    defining = modules - {"__init__", "claim", "geometry", "page", "polynomials"}
    text = Path(errata.__file__).read_text("utf-8")
    entered = re.findall(r"^import errata\.(\w+)$", text, re.M)
    assert sorted(entered) == sorted(defining)
