"""An account in lines of a terminal: answers first, then values; more on request."""

import re
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence

from simval.account import Account, Answer, Fact, Line, Note, Quantity, Reply, Values
from simval.text import columns, number, printable

WIDTH = 100
"""Columns that lines take at most."""
LABEL = 18
"""Columns of the label of a fact."""
MARKS: Mapping[Answer, str] = {"pass": "✓", "inconclusive": "?", "fail": "!"}
Style = Callable[[str, str], str]  # text, and its role
_TOGETHER = re.compile(r" (?=[±%°<>=]|\d{3}\b)|(?<=[±<>=]) ")
"""Blanks at which no line ends: in ``a ± b``, ``7 980``, ``p = 0.5`` and ``5 %``."""
_LONG = ("", "value", "sd", " 95 % from", "to", "least sd")


def plain(words: str, _: str) -> str:
    """Return the words without colour."""
    return words


def lines(
    account: Account,
    *,
    verbose: bool = False,
    width: int = WIDTH,
    style: Style = plain,
    spell: Callable[[str], str] = str,
) -> list[str]:
    """Write an account in lines of at most so many columns.

    Parameters
    ----------
    account : Account
        What there is to say.
    verbose : bool, default False
        Whether all of it is said: what each answer rests on, every digit, all facts.
    width : int, default 100
        Columns.
    style : callable, optional
        Of words and what they are (``title``, or an answer): the words in colour.
    spell : callable, optional
        Of the cells of a table: as the stream can show them.

    Returns
    -------
    list of str
        Lines without their ends.
    """
    width = max(40, min(width, WIDTH))
    found = [style(line, "title") for line in folded(account.name, width, 0)]
    found += folded(account.said, width, 2)
    if not verbose:
        found += _facts([each for each in account.all_facts if each.notable], width)
    for reply in account.replies:
        found += ["", *_reply(reply, width, style, verbose=verbose)]
    for values in account.values:
        if verbose or not values.folded:
            found += ["", *_values(values, width, style, spell, verbose=verbose)]
        else:
            found += _facts([each for each in values.facts if each.notable], width)
    for note in account.notes if verbose else ():
        found += ["", *_note(note, width)]
    if verbose and account.all_facts:
        found += ["", *_facts(account.all_facts, width)]
    return found


def folded(words: str, width: int, indent: int, begin: str = "") -> list[str]:
    """Wrap words to a width, with an indent; the first line may begin otherwise."""
    room = width - max(indent, len(begin))
    kept = [  # what is longer than a line ends at any blank
        each if len(each) <= room else each.replace("\u00a0", " ")
        for each in _TOGETHER.sub("\u00a0", printable(words)).split(" ")
    ]
    found = textwrap.wrap(
        " ".join(kept), width, initial_indent=begin or " " * indent,
        subsequent_indent=" " * indent, break_on_hyphens=False,
    )  # fmt: skip
    return [line.replace("\u00a0", " ") for line in found]


def _reply(reply: Reply, width: int, style: Style, *, verbose: bool) -> Iterator[str]:
    mark = style(MARKS[reply.answer], reply.answer)
    for k, line in enumerate(folded(reply.title, width - 2, 0)):
        yield f"{' ' if k else mark} {style(line, 'title')}"
    yield from folded(reply.headline, width, 2)
    yield from folded(reply.do, width, 2)
    for line in reply.lines if verbose else ():
        yield from folded(line, width, 4, "  - ")


def _values(
    values: Values,
    width: int,
    style: Style,
    spell: Callable[[str], str],
    *,
    verbose: bool,
) -> Iterator[str]:
    title = printable(values.title)
    first, *more = folded(f"{title}  {values.how}".rstrip(), width, 2, " ")
    yield style(title, "title") + first[1 + len(title) :]
    yield from more
    seen = [line for line in values.lines if verbose or line.notable]
    named = [line for line in seen if line.named]
    others = [line for line in seen if not line.named]
    found = _grid(named, width, spell) + _grid(others, width, spell, values.heads)
    if max(map(len, found), default=0) > width:  # a row for each number
        found = columns(
            [(x.name, spell(words), spell(line.unit)) for line in seen
             for x, words in zip(line.cells, line.marked(MARKS), strict=True)],
            -1, 2, -1,
        )  # fmt: skip
    yield from found
    cells = [each for line in values.lines for each in line.cells if each.bounded]
    if verbose and cells and not values.folded:
        yield ""
        yield from _long(cells)
    facts = [each for each in values.facts if verbose or each.notable]
    yield from _facts(facts, width, "  ")


def _grid(
    lines: Sequence[Line],
    width: int,
    spell: Callable[[str], str],
    heads: Sequence[str] = (),
) -> list[str]:
    judged = any(each.answer for line in lines for each in line.cells)
    rows = [
        (spell(line.head), *(
            spell(words) + "  " * (judged and each.answer is None)
            for words, each in zip(line.shown(MARKS), line.cells, strict=True)
        ))
        for line in lines
    ]  # fmt: skip
    most = max(map(len, rows), default=0)
    if most > 2 and heads:
        rows.insert(0, ("", *map(spell, heads)))
    numbers = columns([row[1:] for row in rows], *[2] * (most - 1))
    room = max(LABEL, width - max(map(len, numbers), default=0))
    found = []
    for (label, *_), cells in zip(rows, numbers, strict=True):
        *above, last = folded(label, room, 2) or [""]
        found += [*above, (last, cells)]
    wide = max((len(each[0]) for each in found if not isinstance(each, str)), default=0)
    return [
        each if isinstance(each, str) else f"{each[0]:<{wide}}{each[1]}".rstrip()
        for each in found
    ]


def _long(cells: Sequence[Quantity]) -> list[str]:
    # every digit, both ends of the interval, and the least error that is possible
    rows = [
        (x.name, _digits(x.value, 8), _digits(x.sd, 3), _digits(x.low, 8),
         _digits(x.high, 8), _digits(x.least, 3))
        for x in cells
    ]  # fmt: skip
    return columns([_LONG, *rows], -2, 12, 9, 14, 14, 9)


def _digits(value: float | None, digits: int) -> str:
    return "-" if value is None or value != value else number(value, digits)


def _note(note: Note, width: int) -> Iterator[str]:
    yield from folded(note.words, width, 0)
    yield from (f"  {row}" for row in note.matrix.splitlines())
    for line in note.lines:
        yield from folded(line, width, 2)


def _facts(facts: Sequence[Fact], width: int, indent: str = "") -> Iterator[str]:
    last = ""
    for label, words, _ in facts:
        begin = indent + ("" if label == last else printable(label))
        yield from folded(words, width, LABEL, f"{begin:<{LABEL - 1}} ")
        last = label
