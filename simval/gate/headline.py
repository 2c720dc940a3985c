"""The gate's answer in one line: what is wrong in numbers, and what is right."""

from collections import Counter

from simval.gate.comparison import answer_of
from simval.gate.judgement import GateResult
from simval.verdict import WORST_FIRST, Answer

BADLY: tuple[Answer, Answer] = ("fail", "inconclusive")


def headline(result: GateResult) -> str:
    """Explain the answer in one line.

    Parameters
    ----------
    result : GateResult
        From `judge_run`.

    Returns
    -------
    str
        What was not measured, then what was judged, each with its count; the same line
        in every output.
    """
    endings = result.endings
    crashed, never = endings["crashed"], endings["pending"]
    refused = endings["refused"]
    compared = Counter(
        {
            answer: sum(n for c, n in result.changes.items() if answer_of(c) == answer)
            for answer in WORST_FIRST
        }
    )
    compared["pass"] -= result.changes["new"]
    theory = result.counts
    parts = [
        f"{_count(crashed, 'cell')} crashed" if crashed else "",
        f"{_count(refused, 'cell')} refused" if refused else "",
        f"{_count(never, 'cell')} never run" if never else "",
        f"{_count(len(result.gaps), 'thing')} not measured as stated"
        if result.gaps
        else "",
        "there was no baseline to compare with" if result.first else "",
        _judged(theory, "check", "against theory") or "nothing was judged",
        _judged(compared, "comparison", "with the baseline"),
    ]
    return "; ".join(filter(None, parts))


def _judged(answers: Counter[Answer], what: str, beside: str) -> str:
    """How many of a kind were judged, and how they ended."""
    total = answers.total()
    if not total:
        return ""
    failed, unclear = (answers[word] for word in BADLY)
    if not failed and not unclear:
        one = total == 1
        who = f"the only {what}" if one else f"all {_count(total, what)}"
        return f"{who} {beside} {'agrees' if one else 'agree'}"
    ends = [f"{failed:,} failed"] if failed else []
    if unclear:
        ends.append(f"{unclear:,} {'was' if unclear == 1 else 'were'} inconclusive")
    return f"of {_count(total, what)} {beside}, {' and '.join(ends)}"


def _count(number: int, what: str) -> str:
    return f"1 {what}" if number == 1 else f"{number:,} {what}s"
