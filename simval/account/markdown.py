"""An account in Markdown, for the summary of a job and for a pull request."""

from collections.abc import Iterable, Mapping, Sequence

from simval.account import Account, Answer, Fact, Line, Values

MARKS: Mapping[Answer, str] = {"pass": "✅", "inconclusive": "❔", "fail": "❌"}


def text(account: Account) -> str:
    """Write the answers and numbers; what they rest on opens on a click."""
    found = [f"### {safe(account.name)}", ""]
    found += [safe(account.said), ""] if account.said else []
    found += _warnings(account.all_facts)
    for reply in account.replies:
        words = f"{reply.headline} {reply.do}".strip()
        found.append(f"- {MARKS[reply.answer]} **{safe(reply.title)}** {safe(words)}")
    for values in account.values:
        if not values.folded:
            how = f"`{values.how}`" if values.how else ""
            found += ["", f"**{safe(values.title)}** {how}".rstrip(), ""]
            found += _table(values, [each for each in values.lines if each.notable])
        found += ["", *_warnings(values.facts)]
    rests = [each for reply in account.replies for each in reply.lines]
    rests += [f"{label}: {words}" for label, words, _ in account.all_facts]
    tables = [_table(values, [each for each in values.lines if not each.notable])
              for values in account.values]  # fmt: skip
    if rests or any(tables):
        found += ["", "<details><summary>What this rests on</summary>", ""]
        found += [*(f"- {safe(each)}" for each in rests), ""]
        found += [line for table in tables if table for line in (*table, "")]
        found += ["</details>"]
    return "\n".join(found) + "\n"


def _warnings(facts: Iterable[Fact]) -> list[str]:
    return [
        line
        for label, words, notable in facts
        for line in (f"**{safe(label)}:** {safe(words)}", "")
        if notable
    ]


def _table(values: Values, lines: Sequence[Line]) -> list[str]:
    if not lines:
        return []
    heads = "", *map(safe, values.heads)
    rows = [[safe(line.head), *map(safe, line.shown(MARKS))] for line in lines]
    rows = [row + [""] * (len(heads) - len(row)) for row in rows]
    return [_row(heads), _row(["---"] * len(heads)), *map(_row, rows)]


def _row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def safe(words: str) -> str:
    """Escape what Markdown would take for markup, as names come from data."""
    for mark in "\\`*_[]<>|":
        words = words.replace(mark, f"\\{mark}")
    return " ".join(words.split())
