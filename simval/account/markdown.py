"""An account in Markdown, for the summary of a job and for a pull request."""

from collections.abc import Iterable, Sequence

from simval.account import Account, Fact, Values

MARKS = {"pass": "✅", "inconclusive": "❔", "fail": "❌"}


def text(account: Account) -> str:
    """The answers and the numbers; what they rest on is behind a fold."""
    found = [f"### {safe(account.name)}", ""]
    found += [safe(account.said), ""] if account.said else []
    found += _warnings(account.facts)
    for reply in account.replies:
        words = f"{reply.headline} {reply.do}".strip()
        found.append(f"- {MARKS[reply.answer]} **{safe(reply.title)}** {safe(words)}")
    for values in account.values:
        found += [] if values.folded else _table(values)
        found += ["", *_warnings(values.facts)]
    rests = [each for reply in account.replies for each in reply.lines]
    rests += [f"{label}: {words}" for label, words, _ in account.facts]
    if rests:
        found += ["", "<details><summary>What this rests on</summary>", ""]
        found += [*(f"- {safe(each)}" for each in rests), "", "</details>"]
    return "\n".join(found) + "\n"


def _table(values: Values) -> list[str]:
    how = f"`{values.how}`" if values.how else ""
    found = ["", f"**{safe(values.title)}** {how}".rstrip(), ""]
    heads = "", *values.heads
    found += [_row(heads), _row(["---"] * len(heads))] if values.lines else []
    for line in values.lines:
        cells = [safe(line.head), *map(safe, line.shown)]
        found.append(_row(cells + [""] * (len(heads) - len(cells))))
    return found


def _warnings(facts: Iterable[Fact]) -> list[str]:
    return [
        line
        for label, words, notable in facts
        for line in (f"**{safe(label)}:** {safe(words)}", "")
        if notable
    ]


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def safe(words: str) -> str:
    """The words without markup: names come from data."""
    for mark in "\\`*_[]<>|":
        words = words.replace(mark, f"\\{mark}")
    return " ".join(words.split())
