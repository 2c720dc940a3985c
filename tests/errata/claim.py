"""What a source states, as one claim: its place, our verdict, and its evaluation.

An evaluation computes a truth by a route of its own, then `printed`, what the source
prints, and, where that is not right, `right`, each in one assignment, so that
`tests/mutants/claims.py` can exchange or damage them. It returns them in this order.
A group evaluates several claims of one setting, each in one assignment of these two or
three: `eq_34 = truth, printed`.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

RIGHT, MISPRINTED, FALSE = "right", "misprinted", "false"
WORDING, ILLEGIBLE = "wording", "illegible"  # nothing to evaluate

SEEDS: Final = range(3)
# two numbers are the same below `tol` of their size (rounding, or as stated) and differ
# above FAR; between the two a claim is not decided, which is an error of its test
FAR: Final = 1e-3

Evaluation = Callable[[np.random.Generator], tuple[Any, ...]]


@dataclass(frozen=True, kw_only=True)
class Claim:
    """One equation or sentence of a source."""

    source: str
    place: str
    verdict: str
    evaluate: Evaluation | None = None
    name: str = ""
    group: Callable[[np.random.Generator], dict[str, Any]] | None = None
    tol: float = 1e-9
    seeds: int = len(SEEDS)


CLAIMS: dict[str, Claim] = {}


def claim(source: str) -> Callable[..., Any]:
    """Give a decorator that enters a function as a claim of `source`."""

    def of_source(place: str, verdict: str = RIGHT, **options: Any) -> Any:
        def enter(evaluate: Evaluation) -> Evaluation:
            add(source, place, verdict, evaluate, evaluate.__name__, **options)
            return evaluate

        return enter

    return of_source


def claims(source: str, **entries: Any) -> Callable[..., Any]:
    """Give a decorator that enters each claim of a group, in the order of its lines.

    `entries` has the place of a claim, or its place, verdict and options; a name
    `eq_34` that is not there is the equation (34), and right.
    """

    def enter(group: Any) -> Any:
        for name in group.__code__.co_varnames[1:]:
            number = re.fullmatch(r"eq_(\d+)", name)
            if name not in entries and not number:
                continue
            entry = entries.get(name, f"({number[1]})" if number else "")
            place, verdict, *more = (entry, RIGHT) if isinstance(entry, str) else entry
            options = more[0] if more else {}

            def evaluate(rng: np.random.Generator, name: str = name) -> Any:
                return group(rng)[name]

            add(source, place, verdict, evaluate, name, group=group, **options)
        return group

    return enter


def unevaluated(source: str, *places: str, verdict: str = WORDING) -> None:
    """Enter slips of words, or what is illegible: nothing to evaluate."""
    for place in places:
        add(source, place, verdict)


def add(
    source: str,
    place: str,
    verdict: str,
    evaluate: Evaluation | None = None,
    name: str = "",
    **options: Any,
) -> None:
    """Enter a claim; its name, or its place if it has none, must be new."""
    key = name or f"{source}: {place}"
    assert key not in CLAIMS, key
    CLAIMS[key] = Claim(
        source=source,
        place=place,
        verdict=verdict,
        evaluate=evaluate,
        name=name,
        **options,
    )


def check(
    claim: Claim, evaluate: Evaluation | None = None, seeds: slice = slice(None)
) -> None:
    """Demand that the claim is as its verdict says; `evaluate` for a mutant."""
    evaluate = evaluate or claim.evaluate
    assert evaluate is not None
    for seed in range(claim.seeds)[seeds]:
        truth, *forms = evaluate(np.random.default_rng(seed))
        assert len(forms) == (1 if claim.verdict == RIGHT else 2)
        printed, right = forms[0], forms[-1]
        assert same(right, truth, claim.tol), "what we call right is not"
        expected = claim.verdict == RIGHT
        assert same(printed, truth, claim.tol) is expected, "what is printed is right"


def same(value: Any, truth: Any, tol: float) -> bool:
    """Whether two arrays agree within `tol` of their size; an error if undecided."""
    value, truth = np.asarray(value), np.asarray(truth)
    if value.shape != truth.shape:
        return False
    if truth.dtype.kind not in "fiuc":
        return bool(np.all(value == truth))
    gap = np.abs(value - truth).max() / max(1.0, np.abs(truth).max())
    assert gap <= tol or gap >= FAR, f"neither equal nor different: {gap:.1e}"
    return bool(gap <= tol)
