"""Finds where a text installs simval by its bare name, which is on no package index.

Whoever took the name there would run code on the machines of those who copy such a
line. A line is good that installs a file, a folder or a repository.

A text is made of commands and of lists of requirements. In prose only what stands
between backticks is a command with arguments; beside them the name must follow at once.
"""

import ast
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

NAME = "simval"
HINT = re.compile(
    r"install|download|wheel|create|\b(?:uvx?|pipx|add|deps|requires)\b|dependencies"
    r"|simval\s*[\[=~!<>@(]"
)
"""What a module has that names an installation, or a requirement."""
OPTION = r"(?:\s+-[\w-]+(?:=\S+)?(?:\s+[^\s-]\S*)??)*"
INSTALLS = re.compile(
    rf"""(?<![\w.-])(?P<command>
      pip[\d.]*{OPTION}\s+(?:install|download|wheel)
    | pipx{OPTION}\s+(?:install|run|inject|upgrade)
    | uvx | uv\s+(?:add|run|tool\s+(?:install|run)) | easy_install
    | (?:poetry|pdm|rye|pixi){OPTION}\s+(?:add|install) | pipenv\s+install
    | (?:conda|mamba|micromamba){OPTION}\s+(?:install|create)
    )(?=\s)(?P<rest>.*)""",
    re.X,
)
LIST = re.compile(
    r"""(?:dependencies|requires|deps|pip)["']?\s*[:=][ \t]*
    (?: \[ (?P<inline> (?: [^][] | \[[^]]*\] )* ) \]
      | (?P<first>[^\n[]*) \n
        (?P<below> (?: [ \t]*- [^\n]*\n | [ \t]+[^\n]*\n )* ) )""",
    re.X,
)
REQUIREMENT = re.compile(
    r"""simval \s* (?:\[ [^]]* \])? \s*
    (?: $ | ; | \(? \s* (?: [=~!<>]= | [<>](?=\s*v?[\d{$]) ) # any, or some versions
      | @ \s* (?: latest | \d ) )                  # of uv: simval@0.1
    """,
    re.X | re.I,
)
FENCE = re.compile(
    r"^[ \t]*(```|~~~)(?P<info>[^\n]*)\n(?P<body>.*?)^[ \t]*\1", re.S | re.M
)
SPAN = re.compile(r"(`+)(?!`)(?P<code>.+?)(?<!`)\1(?!`)", re.S)
TAG = re.compile(r"</?[A-Za-z][^>\n]*>")
EXEC = re.compile(r"""["']\s*,\s*["']""")

PATHS = frozenset(
    """-r --requirement -c --constraint -t --target -d --dest -w --wheel-dir -e -f
    --editable --find-links -i --index-url --extra-index-url --prefix --root --src
    --platform --python --python-version -p -n --name --channel --cache-dir --log
    --directory --project --group --extra --with-editable --with-requirements
    --path""".split()  # noqa: SIM905
)
"""Options whose value names no project."""
SOURCES = {"--from", "--spec", "--with"}
"""Options whose value is a requirement."""
RUNS = ("uvx", "uv tool run", "pipx run")
"""What runs the first word, and gives it the others."""


def is_bare(word: str) -> bool:
    """Whether a requirement leaves it to an index what simval is."""
    return REQUIREMENT.match(word.strip()) is not None


def by_name(text: str, kind: str) -> list[str]:
    """What installs simval by name in a text; `kind` is that of `kind_of`."""
    return list(dict.fromkeys(READERS[kind](TAG.sub(" ", text))))


def kind_of(path: Path) -> str:
    """How a file is read."""
    if re.match(r"(requirements|constraints)[\w.-]*\.(txt|in)$", path.name):
        return "requirements"
    return {".md": "prose", ".rst": "prose", ".py": "python"}.get(path.suffix, "code")


def _prose(text: str) -> Iterator[str]:
    if NAME not in text.lower():
        return
    for block in FENCE.finditer(text):
        title = re.search(r'title="([^"]+)"', block["info"])
        words = block["info"].split() or [""]
        kind = kind_of(Path(title[1] if title else f"block.{words[0]}"))
        kind = "python" if words[0] in {"python", "py"} else kind
        yield from READERS[kind](block["body"])
    beside = FENCE.sub("\n", text)
    for span in SPAN.finditer(beside):
        code = " ".join(span["code"].split())
        yield from _code(code)
        if is_bare(code) and not code.isalpha():
            yield code
    yield from _commands(SPAN.sub("`", beside), at_once=True)


def _code(text: str) -> Iterator[str]:
    yield from _commands(re.sub(r"\\\n", " ", text))
    for line in text.splitlines():
        item = line.strip().removeprefix("- ").strip(" \t\"',")
        if is_bare(item) and not item.isalpha():
            yield line.strip()
    yield from _lists(text)


def _lists(text: str) -> Iterator[str]:
    for found in LIST.finditer(text + "\n"):
        items = re.findall(r"[\"']([^\"']+)[\"']|([^\s,]+)", found["inline"] or "")
        items = ["".join(pair) for pair in items]
        items += [found["first"] or "", *(found["below"] or "").splitlines()]
        for item in items:
            word = item.strip().removeprefix("-").partition(" #")[0].strip(" \t\"',")
            if is_bare(word):
                yield " ".join(found[0].split())


def _python(text: str) -> Iterator[str]:
    if HINT.search(text.lower()) is None:  # most modules, which need not be parsed
        return
    yield from _lists(text)
    for comment in re.findall(r"#[^\n]*", text):
        yield from _prose(comment)
    try:
        tree = ast.parse(text)
    except SyntaxError:  # an excerpt
        yield from _code(text)
        return
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant | ast.JoinedStr):
            yield from _prose(_string(node))
        elif isinstance(node, ast.List | ast.Tuple):
            yield from _commands(" ".join(map(_string, node.elts)))
        elif isinstance(node, ast.Call):
            name = "pip install" if getattr(node.func, "attr", "") == "install" else ""
            yield from _commands(" ".join([name, *map(_string, node.args)]))


def _string(node: ast.expr) -> str:
    """Text of an expression, with a blank form for what is computed."""
    if isinstance(node, ast.JoinedStr):
        return "".join(map(_string, node.values))
    value = getattr(node, "value", None)
    return value if isinstance(value, str) else "{}"


def _requirements(text: str) -> Iterator[str]:
    for line in text.splitlines():
        if is_bare(line.partition(" #")[0]):
            yield line
    yield from _code(text)


READERS = {
    "prose": _prose,
    "code": _code,
    "python": _python,
    "requirements": _requirements,
}


def _commands(text: str, *, at_once: bool = False) -> Iterator[str]:
    for line in EXEC.sub(" ", text).splitlines():
        if NAME not in line.lower():
            continue
        for found in INSTALLS.finditer(line):
            yield from _commands(found["rest"], at_once=at_once)  # a second one in it
            words = _arguments(found["rest"])
            wanted = _wanted(" ".join(found["command"].split()), words)
            if any(map(is_bare, wanted[:1] if at_once else wanted)):
                yield " ".join([found["command"], *words])


def _arguments(rest: str) -> list[str]:
    """Words of a command up to its end; also where quotes are not in pairs."""
    lexer = shlex.shlex(rest, posix=True, punctuation_chars=";&|")
    lexer.whitespace_split = True
    words: list[str] = []
    try:
        for word in lexer:
            if set(word) <= set(";&|"):
                break
            words.append(word)
    except ValueError:
        words = re.split(r"&&|[;|]", rest)[0].split()
    return [_unwrapped(word) for word in words]


def _unwrapped(word: str) -> str:
    word = word.strip("`\"'(").rstrip(".,:!?`\"'}")
    for opening, closing in ("()", "[]"):
        if word.endswith(closing) and opening not in word:
            word = word.rstrip(closing + "\"'")
    return word


def _wanted(command: str, words: list[str]) -> list[str]:
    """Words of an installing command that are requirements an index may answer."""
    if {"--no-index", "--offline"} & set(words):
        return []
    given, free, left = [], [], iter(words)
    for word in left:
        option, equals, value = word.partition("=")
        if option in SOURCES:
            given.append(value if equals else next(left, ""))
        elif word in PATHS:
            next(left, "")
        elif not word.startswith("-"):
            free.append(word)
    return given + free[_places(command, has_source=bool(given))]


def _places(command: str, *, has_source: bool) -> slice:
    if command == "uv run":  # what is there already
        return slice(0)
    if command.endswith("inject"):  # into the environment of this name
        return slice(1, None)
    if command.startswith(RUNS):
        return slice(0 if has_source else 1)
    return slice(None)
