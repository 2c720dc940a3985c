"""An account as a fragment of HTML, as a notebook shows it."""

from collections.abc import Iterable, Sequence
from html import escape

from simval.account import Account, Fact, Line, Values
from simval.account.terminal import MARKS

COLOURS = {"pass": "#118844", "inconclusive": "#8a6500", "fail": "#cc0022"}


def fragment(account: Account) -> str:
    """Write the answers and numbers; what they rest on opens on a click."""
    parts = [f"<p><b>{escape(account.name)}</b> {escape(account.said)}</p>"]
    parts += _warnings(account.all_facts)
    for reply in account.replies:
        mark = f'<b style="color:{COLOURS[reply.answer]}">{MARKS[reply.answer]}</b>'
        words = escape(f"{reply.headline} {reply.do}".strip())
        parts.append(f"<p>{mark} <b>{escape(reply.title)}</b> {words}</p>")
    for values in account.values:
        seen = [each for each in values.lines if each.notable]
        parts += [] if values.folded else [_table(values, seen)]
        parts += _warnings(values.facts)
    rests = [each for reply in account.replies for each in reply.lines]
    rests += [f"{label}: {words}" for label, words, _ in account.all_facts]
    hidden = [(values, [each for each in values.lines if not each.notable])
              for values in account.values]  # fmt: skip
    more = "".join(_table(*each) for each in hidden if each[1])
    if rests or more:
        items = "".join(f"<li>{escape(each)}</li>" for each in rests)
        fold = "<details><summary>What this rests on</summary>"
        parts.append(f"{fold}<ul>{items}</ul>{more}</details>")
    return "".join(parts)


def _warnings(facts: Iterable[Fact]) -> list[str]:
    return [
        f"<p><b>{escape(label)}</b> {escape(words)}</p>"
        for label, words, notable in facts
        if notable
    ]


def _table(values: Values, lines: Sequence[Line]) -> str:
    rows = [("td", [line.head, *line.shown(MARKS)]) for line in lines]
    if any(len(line.cells) > 1 for line in lines):
        rows.insert(0, ("th", ["", *values.heads]))
    caption = escape(f"{values.title} {values.how}".strip())
    body = "".join(_row(*row) for row in rows)
    return f"<table><caption>{caption}</caption>{body}</table>"


def _row(tag: str, cells: Sequence[str]) -> str:
    return f"<tr>{''.join(f'<{tag}>{escape(each)}</{tag}>' for each in cells)}</tr>"
