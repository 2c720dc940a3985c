"""The gate's answer in one line: what is wrong in numbers, and what is right."""

from collections.abc import Sequence

from simval.gate.judgement import GateResult
from simval.verdict import Answer

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
    endings = [cell.ending for cell in result.unfinished]
    crashed, never = endings.count("crashed"), endings.count("pending")
    refused = endings.count("refused")
    compared = [c.answer for c in result.comparisons if c.change != "new"]
    theory = [verdict.answer for verdict in result.verdicts]
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


def _judged(answers: Sequence[Answer], what: str, beside: str) -> str:
    """How many of a kind were judged, and how they ended."""
    if not answers:
        return ""
    failed, unclear = (answers.count(word) for word in BADLY)
    if not failed and not unclear:
        one = len(answers) == 1
        who = f"the only {what}" if one else f"all {_count(len(answers), what)}"
        return f"{who} {beside} {'agrees' if one else 'agree'}"
    ends = [f"{failed:,} failed"] if failed else []
    if unclear:
        ends.append(f"{unclear:,} {'was' if unclear == 1 else 'were'} inconclusive")
    return f"of {_count(len(answers), what)} {beside}, {' and '.join(ends)}"


def _count(number: int, what: str) -> str:
    return f"1 {what}" if number == 1 else f"{number:,} {what}s"
